"""Numba's start, without what no kernel here needs."""

from __future__ import annotations

import sys
import threading
from types import ModuleType

_BLAS = "scipy.linalg.cython_blas"


def load_numba() -> None:
    """Import what Numba imports when it first runs a kernel.

    To learn whether there is a BLAS it imports SciPy's linear algebra, a tenth of a second and more for matrix products
    that no kernel takes. That module is given an empty stand-in meanwhile; who multiplies matrices later gets the true
    one, which Numba looks up anew. Not where other threads run: one that imports SciPy meanwhile would be given it.
    """
    absent = _BLAS not in sys.modules and threading.active_count() == 1
    if absent:
        sys.modules[_BLAS] = ModuleType(_BLAS)
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        if absent:
            del sys.modules[_BLAS]
