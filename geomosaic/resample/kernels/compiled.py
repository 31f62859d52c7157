"""Compilation and disk cache of kernels: the only user of Numba's private classes.

Two things that Numba's own cache does not do:

- It first gathers all that its compiler knows, though loaded machine code needs the memory manager only. Without that
  an ortho of 512 x 512 pixels by compiled kernels takes 1.00 s of processor time, with it 1.25 s (medians of 7 pairs
  of whole processes).
- It looks for changes in the file of a kernel only. Here the key holds the bytecode and the constants of everything
  that a kernel calls, whichever module it stands in, so that no kernel runs with an old part.

Numba 0.68 was read for this; where a version lacks the methods leant on, kernels start as Numba starts them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pickle import UnpicklingError
from types import CodeType, ModuleType
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys

OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
_METHODS = ("_load_overload", "_guard_against_spurious_io_errors", "_index_key")


class _KernelCache(FunctionCache):
    """Cache of one kernel's machine code, one file for each set of argument types."""

    def load_overload(self, sig, target_context):
        """Machine code for these types; None if there is none, and then the compiler gathers what it needs."""
        rtsys.initialize(target_context)
        try:
            with self._guard_against_spurious_io_errors():
                return self._load_overload(sig, target_context)
        except (AttributeError, EOFError, ImportError, UnpicklingError):
            # Numba unpickles an index before it looks at its stamp: that of another version may name what is gone.
            self.flush()
            return None

    def _index_key(self, sig, codegen):
        parts = "\n".join((str(OPTIONS), *_sources(self._py_func, set())))
        return *super()._index_key(sig, codegen), hashlib.sha256(parts.encode()).hexdigest()


def _sources(function: Any, seen: set[Any]) -> Iterator[str]:
    """Texts of a function's bytecode and constants, of the globals it uses, and of the functions it calls."""
    if function in seen:
        return
    seen.add(function)
    codes = [function.__code__]
    while codes:
        code = codes.pop()
        codes += [value for value in code.co_consts if isinstance(value, CodeType)]
        yield f"{code.co_code.hex()} {[value for value in code.co_consts if not isinstance(value, CodeType)]}"
        for name in code.co_names:
            value = function.__globals__.get(name)
            if hasattr(value, "py_func"):
                yield from _sources(value.py_func, seen)
            elif value is not None and not isinstance(value, ModuleType):
                yield f"{name} = {value!r}"


# Decorator of functions that kernels call.
part = njit(**OPTIONS)
# The same, merged into the caller before types are known.
inlined = njit(**OPTIONS, inline="always")


def kernel(function):
    """Decorator of kernels: compiled on the first call for each set of types, and kept on disk beside the module.

    Parameters
    ----------
    function : callable
        Of the module's top level, without closures.

    Returns
    -------
    callable
    """
    if not all(hasattr(FunctionCache, name) for name in _METHODS):
        return njit(**OPTIONS, cache=True)(function)
    dispatcher: Any = part(function)
    dispatcher._cache = _KernelCache(function)
    return dispatcher
