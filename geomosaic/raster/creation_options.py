"""Creation options of rasters: defaults, what users may change, and values that GDAL can use."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.options.render import SAMPLE_TYPES
from geomosaic.raster.cog.codec import BLOCK

# Compressions of the GTiff driver in rasterio's wheels; the rest of GDAL's (JXL, CCITT...) it lacks or cannot use.
METHODS = ("NONE", "DEFLATE", "ZSTD", "LZW", "PACKBITS", "LZMA", "JPEG", "WEBP", "LERC", "LERC_DEFLATE", "LERC_ZSTD")

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


def _checked_values(
    options: Mapping[str, str], bands: int, dtype: str, level: str | None, where: str
) -> dict[str, str]:
    """Options with words in capitals."""
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


def _refused(name: str, value: str, hint: str, where: str) -> InputError:
    return InputError(f"`creation={name}={value}` is not possible", where=where, hint=hint)


DRIVERS = ("COG", "GTiff")
# Deflate level 1 is 4 times as fast as GDAL's level 6 for 5 % more bytes, and every TIFF reader knows it.
_DEFAULTS = {"COMPRESS": "DEFLATE", "BIGTIFF": "IF_SAFER"}
_LEVELS = {"DEFLATE": "ZLEVEL", "ZSTD": "ZSTD_LEVEL", "LERC_DEFLATE": "ZLEVEL", "LERC_ZSTD": "ZSTD_LEVEL"}
_QUALITIES = {"JPEG": "JPEG_QUALITY", "WEBP": "WEBP_LEVEL"}
_PREDICTORS = {"NO": "1", "STANDARD": "2", "FLOATING_POINT": "3"}
_PREDICTED = ("DEFLATE", "ZSTD", "LZW")
# How a file is cut is this program's business; other values than its own cannot be had.
_FIXED = {
    "TILED": ("YES", "TRUE", "ON"),
    "INTERLEAVE": ("PIXEL",),
    "BLOCKXSIZE": (str(BLOCK),),
    "BLOCKYSIZE": (str(BLOCK),),
    "BLOCKSIZE": (str(BLOCK),),
    "OVERVIEWS": ("AUTO", "NONE"),
    "NUM_THREADS": None,
}
_KNOWN = {
    "COMPRESS",
    "PREDICTOR",
    "ZLEVEL",
    "ZSTD_LEVEL",
    "JPEG_QUALITY",
    "WEBP_LEVEL",
    "WEBP_LOSSLESS",
    "LZMA_PRESET",
    "MAX_Z_ERROR",
    "DISCARD_LSB",
    "PHOTOMETRIC",
    "ALPHA",
    "BIGTIFF",
    "GEOTIFF_VERSION",
    "GEOTIFF_KEYS_FLAVOR",
    "LEVEL",
    "QUALITY",
    "OVERVIEW_RESAMPLING",
}


@dataclass(frozen=True)
class Creation:
    """Creation options of a file, checked and complete.

    Attributes
    ----------
    gtiff : dict, creation options in the words of GDAL's GTiff driver
    overviews : str or None, 'average', 'rms', 'nearest' or none
    """

    gtiff: dict[str, str]
    overviews: str | None


def creation_options(
    driver: str,
    bands: int,
    dtype: np.dtype[Any],
    given: Mapping[str, str],
    overviews: str,
    where: str,
) -> Creation:
    """Creation options of a raster: the defaults, and those of the user, which come first.

    Parameters
    ----------
    driver : str, 'GTiff' or 'COG'; the user's options may use the words of either
    bands : int
    dtype : dtype
    given : mapping of str to str, options of the user
    overviews : str, resampling of overviews unless the user names one: 'average', 'rms' or 'nearest'
    where : str, named in errors

    Raises
    ------
    InputError
        An unknown driver or option, or a value or layout that cannot be had.
    """
    if driver not in DRIVERS:
        raise InputError(f"rasters are not written as '{driver}'", where=where, hint=f"choose {' or '.join(DRIVERS)}")
    user = {key.upper(): str(value) for key, value in given.items()}
    wanted: str | None = user.pop("OVERVIEW_RESAMPLING", overviews).lower()
    if wanted not in ("average", "rms", "nearest"):
        raise InputError(
            f"overviews are not resampled by '{wanted}'", where=where, hint="choose average, rms or nearest"
        )
    if driver == "GTiff" or user.get("OVERVIEWS", "AUTO").upper() == "NONE":
        wanted = None
    for key, values in _FIXED.items():
        value = user.pop(key, None)
        if value is not None and values is not None and value.upper() not in values:
            raise InputError(
                f"`creation={key}={value}` is not possible: files are pixel-interleaved in tiles of {BLOCK}",
                where=where,
                hint=f"leave {key} out, and convert the result with gdal_translate",
            )
    unknown = sorted(set(user) - _KNOWN)
    if unknown:
        raise InputError(
            f"no option of `creation` is named {', '.join(unknown)}",
            where=where,
            hint=f"one of {', '.join(sorted(_KNOWN))}",
        )
    level = _LEVELS.get(user.get("COMPRESS", _DEFAULTS["COMPRESS"]).strip().upper())
    user = _checked_values(user, bands, dtype.name, level, where)
    return Creation(_gtiff(user, bands, dtype), wanted)


def _gtiff(user: dict[str, str], bands: int, dtype: np.dtype[Any]) -> dict[str, str]:
    options = {**_DEFAULTS, **user}
    method = options["COMPRESS"]
    level, quality = options.pop("LEVEL", None), options.pop("QUALITY", None)
    if method in _LEVELS:
        options.setdefault(_LEVELS[method], level or "1")
    if method in _QUALITIES and quality is not None:
        options.setdefault(_QUALITIES[method], quality)
    predictor = options.pop("PREDICTOR", "YES")
    if method in _PREDICTED:
        best = "3" if dtype.kind == "f" else "2"
        options["PREDICTOR"] = best if predictor == "YES" else _PREDICTORS.get(predictor, predictor)
    rgb = bands == 3 and dtype == np.uint8
    # Without MINISBLACK, GDAL would call the fourth of four bands alpha.
    options.setdefault("PHOTOMETRIC", ("YCBCR" if method == "JPEG" else "RGB") if rgb else "MINISBLACK")
    return options


def check_type(dtype: str, where: str) -> np.dtype[Any]:
    """NumPy type of samples that can be written.

    Parameters
    ----------
    dtype : str
    where : str, named in errors

    Raises
    ------
    InputError
        It cannot be written.
    """
    if dtype not in SAMPLE_TYPES:
        raise InputError(
            f"samples of type {dtype} cannot be written", where=where, hint=f"one of {', '.join(SAMPLE_TYPES)}"
        )
    return np.dtype(dtype)


def check_nodata(dtype: str, nodata: float | None, where: str) -> None:
    """Check that samples can have a nodata value.

    Parameters
    ----------
    dtype : str
    nodata : float or None
    where : str, named in errors

    Raises
    ------
    InputError
        It is not a value of the type.
    """
    if nodata is None:
        return
    if np.dtype(dtype).kind == "f":
        fits = not np.isfinite(nodata) or abs(nodata) <= float(np.finfo(dtype).max)
    else:
        limits = np.iinfo(dtype)
        fits = float(nodata).is_integer() and limits.min <= nodata <= limits.max
    if not fits:
        raise InputError(
            f"nodata {nodata} is not a value of type {dtype}",
            where=where,
            hint="choose another nodata value, or none: then an internal mask marks the invalid pixels",
        )
