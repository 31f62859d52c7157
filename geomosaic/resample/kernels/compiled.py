"""Numba's decorators as all kernels use them."""

from __future__ import annotations

from typing import Any

from numba import njit
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys


class _Kept(FunctionCache):
    """Machine code kept on disk, loaded without what only a compiler needs.

    Numba first gathers all that its compiler knows, a sixth of a second. Code that is there needs the memory manager
    only; where it is not, the compiler gathers for itself.
    """

    def load_overload(self, sig, target_context):
        """Load the code for these types, None if there is none."""
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)


part = njit(nogil=True, error_model="numpy")
"""What kernels of the same module call."""
inlined = njit(nogil=True, error_model="numpy", inline="always")
"""The same, merged before types are known."""


def kernel(function):
    """Compile on the first call, once for each set of types; keep the code beside the module."""
    dispatcher: Any = part(function)
    dispatcher._cache = _Kept(function)
    return dispatcher
