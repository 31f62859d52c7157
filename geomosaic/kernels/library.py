"""Compiled kernels: the shared library that stands beside this file, and calls of its functions with NumPy arrays.

The library is built from the C++ files of this folder when the package is installed (`hatch_build.py`), once for each
set of vector instructions. All give the same bytes: no operation is contracted or reordered, whatever the width.
"""

from __future__ import annotations

import ctypes
import hashlib
import platform
from collections.abc import Callable, Collection
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.errors import InstallationError

# The order is that of `Type` in array.hpp.
TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float32", "float64")
_CODES = {np.dtype(name): code for code, name in enumerate(TYPES)} | {np.dtype(bool): 0}
_NO_FORM = -(1 << 63)
SUFFIX = {"Windows": ".dll", "Darwin": ".dylib"}.get(platform.system(), ".so")


class _Array(ctypes.Structure):
    _fields_ = [
        ("data", ctypes.c_void_p),
        ("type", ctypes.c_int64),
        ("shape", ctypes.c_int64 * 4),
        ("stride", ctypes.c_int64 * 4),
    ]


_NUMBERS = {"i": ctypes.c_int64, "f": ctypes.c_double}
# Arrays whose type a kernel takes for granted.
_CODES_OF = {"a": range(len(TYPES)), "u": (0,), "w": (5,), "l": (7,), "s": (8,), "d": (9,)}


@cache
def library() -> ctypes.CDLL:
    """The library for the vector instructions that this processor has.

    Raises
    ------
    InstallationError
        It was not built, or of other sources than stand here.
    """
    folder = Path(__file__).parent
    hint = "install the package with pip, which builds them, or in a checkout run `python hatch_build.py`"
    try:
        lowest = ctypes.CDLL(str(folder / f"kernels{SUFFIX}"))
        name = {1: "-avx2", 2: "-avx512"}.get(lowest.vector_instructions(), "")
        found = ctypes.CDLL(str(folder / f"kernels{name}{SUFFIX}")) if name else lowest
    except OSError as error:
        raise InstallationError(f"the compiled kernels cannot be loaded ({error})", hint=hint) from error
    # Arguments of another order would end the process, or change pixels in silence.
    found.sources.restype = ctypes.c_char_p
    if found.sources().decode() != sources(folder):
        raise InstallationError("the compiled kernels are not of the C++ files beside them", hint=hint)
    return found


def sources(folder: Path) -> str:
    """SHA-256 of the C++ files of a folder, as `hatch_build.py` gives it to the library.

    Parameters
    ----------
    folder : Path
        Folder of the `.cpp` and `.hpp` files.

    Returns
    -------
    str
        In hexadecimal digits.
    """
    files = sorted(folder.glob("*.[ch]pp"))
    return hashlib.sha256(b"".join(file.name.encode() + b"\n" + file.read_bytes() for file in files)).hexdigest()


def native(name: str, arguments: str) -> Callable[..., int]:
    """Function of the library, loaded on its first call; other threads run while it works.

    Parameters
    ----------
    name : str
    arguments : str
        One letter each: 'i' whole number or bool, 'f' float; 'u', 'w', 'l', 's' and 'd' arrays of uint8 (or bool),
        int32, int64, float32 and float64; 'a' array of any type.

    Returns
    -------
    callable
        Takes arrays of at most four axes as they are, with any strides; returns a whole number.
    """
    function: Any = None
    # Codes of the types that an array may have, by place; numbers have none.
    codes = [_CODES_OF.get(letter) for letter in arguments]

    def call(*values: Any) -> int:
        nonlocal function
        if function is None:
            found = library()[name]
            kinds: list[Any] = [_NUMBERS.get(letter, ctypes.POINTER(_Array)) for letter in arguments]
            found.argtypes = kinds
            found.restype = ctypes.c_int64
            function = found
        result = function(
            *(value if code is None else _array(value, code) for value, code in zip(values, codes, strict=True))
        )
        if result == _NO_FORM:
            types = ", ".join(str(value.dtype) for value, code in zip(values, codes, strict=True) if code is not None)
            raise TypeError(f"the kernel {name} has no form for arrays of {types}, or for rows with gaps")
        return int(result)

    return call


def _array(value: np.ndarray[Any, Any], codes: Collection[int]) -> Any:
    axes, size, code = value.ndim, value.itemsize, _CODES.get(value.dtype, -1)
    if code not in codes:
        raise TypeError(f"a kernel takes arrays of {', '.join(TYPES[k] for k in codes)}, not of {value.dtype}")
    described = _Array(value.ctypes.data, code)
    described.shape[:axes] = value.shape
    described.stride[:axes] = [stride // size for stride in value.strides]
    return ctypes.byref(described)
