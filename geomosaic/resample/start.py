"""Numba's start, without what no kernel here needs."""

from __future__ import annotations

from threading import Lock

_lock = Lock()


def load_numba() -> None:
    """Import what Numba imports when it first runs a kernel.

    To learn whether there is a BLAS, Numba's array functions import SciPy's linear algebra, a tenth of a second and
    more for matrix products that no kernel takes. They are told that there is one; who multiplies matrices later asks
    again, and gets the true answer.
    """
    import numba.np.linalg as linear

    with _lock:
        asked = linear.ensure_blas
        linear.ensure_blas = _taken_for_granted
        try:
            import numba.np.arraymath  # noqa: F401
        finally:
            linear.ensure_blas = asked


def _taken_for_granted() -> None:
    """Stand in for the question whether there is a BLAS."""
