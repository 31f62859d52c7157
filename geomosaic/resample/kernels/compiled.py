"""Numba's decorators as all kernels use them."""

from __future__ import annotations

from typing import Any

from numba import njit
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys

OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
_LEANT_ON = ("_load_overload", "_guard_against_spurious_io_errors", "_index_key")


class _Kept(FunctionCache):
    """Machine code kept on disk, loaded without what only a compiler needs.

    Numba first gathers all that its compiler knows, a sixth of a second. Code that is there needs the memory manager
    only; where it is not, the compiler gathers for itself. Numba 0.68 was read for this; where a version does not have
    the methods it leans on, kernels start as Numba starts them.
    """

    def load_overload(self, sig, target_context):
        """Load the code for these types, None if there is none."""
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)

    def _index_key(self, sig, codegen):
        """What code is kept under: the options stand in this file, whose changes Numba does not look at."""
        return *super()._index_key(sig, codegen), str(OPTIONS)


part = njit(**OPTIONS)
"""What kernels of the same module call."""
inlined = njit(**OPTIONS, inline="always")
"""The same, merged before types are known."""


def kernel(function):
    """Compile on the first call, once for each set of types; keep the code beside the module."""
    if not all(hasattr(FunctionCache, name) for name in _LEANT_ON):
        return njit(**OPTIONS, cache=True)(function)
    dispatcher: Any = part(function)
    dispatcher._cache = _Kept(function)
    return dispatcher
