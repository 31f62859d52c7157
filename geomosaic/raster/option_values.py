"""Values of creation options: what GDAL can do with them, for it says nothing of what it ignores."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

import numpy as np

from geomosaic.errors import InputError

METHODS = ("NONE", "DEFLATE", "ZSTD", "LZW", "PACKBITS", "LZMA", "JPEG", "WEBP", "LERC", "LERC_DEFLATE", "LERC_ZSTD")
"""Compressions of the GTiff driver in rasterio's wheels; the rest of GDAL's (JXL, CCITT...) it lacks or cannot use."""

_YES_NO = ("YES", "NO", "TRUE", "FALSE", "ON", "OFF")
_CHOICES = {
    "COMPRESS": METHODS,
    "PREDICTOR": ("YES", "NO", "STANDARD", "FLOATING_POINT", "1", "2", "3"),
    "BIGTIFF": ("YES", "NO", "IF_NEEDED", "IF_SAFER"),
    # GDAL writes the others too, but as something else, or without what would make sense of them (a palette).
    "PHOTOMETRIC": ("MINISBLACK", "RGB", "YCBCR"),
    "ALPHA": ("YES", "NO", "PREMULTIPLIED", "NON-PREMULTIPLIED", "UNSPECIFIED"),
    "WEBP_LOSSLESS": _YES_NO,
    "GEOTIFF_VERSION": ("AUTO", "1.0", "1.1"),
    "GEOTIFF_KEYS_FLAVOR": ("STANDARD", "ESRI_PE"),
}
_RANGES = {
    "ZLEVEL": (1, 12),
    "ZSTD_LEVEL": (1, 22),
    "LZMA_PRESET": (0, 9),
    "JPEG_QUALITY": (1, 100),
    "WEBP_LEVEL": (1, 100),
    "QUALITY": (1, 100),
}


def checked_values(options: Mapping[str, str], bands: int, dtype: str, level: str | None, where: str) -> dict[str, str]:
    """Return the options with words in capitals.

    Parameters
    ----------
    options : mapping
        By name in capitals.
    bands : int
    dtype : str
    level : str or None
        The option that LEVEL stands for, by the compression.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        A value that GDAL would ignore, or that these bands cannot have; names the choices.
    """
    found = {name: _checked(name, value.strip(), level, where) for name, value in options.items()}
    floats = np.dtype(dtype).kind == "f"
    if found.get("PREDICTOR") in ("3", "FLOATING_POINT") and not floats:
        raise _refused("PREDICTOR", options["PREDICTOR"], f"for {dtype} use 2 (STANDARD), or leave it out", where)
    colour, method = found.get("PHOTOMETRIC"), found.get("COMPRESS")
    if colour == "RGB" and bands < 3:
        raise _refused("PHOTOMETRIC", "RGB", f"there {'is one band' if bands == 1 else 'are two bands'}", where)
    if colour == "YCBCR" and (method, bands, dtype) != ("JPEG", 3, "uint8"):
        raise _refused("PHOTOMETRIC", "YCBCR", "it needs COMPRESS=JPEG and three bands of uint8", where)
    return found


def _checked(name: str, value: str, level: str | None, where: str) -> str:
    if name in _CHOICES:
        if value.upper() not in _CHOICES[name]:
            raise _refused(name, value, f"choose one of {', '.join(_CHOICES[name])}", where)
        return value.upper()
    limits = _RANGES.get(level or "ZSTD_LEVEL") if name == "LEVEL" else _RANGES.get(name)
    if limits is not None:
        low, high = limits
        if not re.fullmatch(r"[0-9]+", value) or not low <= int(value) <= high:
            raise _refused(name, value, f"give a whole number from {low} to {high}", where)
    elif name == "MAX_Z_ERROR":
        try:
            error = float(value)
        except ValueError:
            error = math.nan
        if not (math.isfinite(error) and error >= 0.0):
            raise _refused(name, value, "give a number that is not negative", where)
    elif name == "DISCARD_LSB" and not re.fullmatch(r"[0-7](,[0-7])*", value):
        raise _refused(name, value, "give a number of bits from 0 to 7, or one for each band: 1,1,2", where)
    return value


def _refused(name: str, value: str, mend: str, where: str) -> InputError:
    return InputError(f"creation option {name}={value} cannot be had", where=where, mend=mend)
