"""GDAL environment: settings while geomosaic reads and writes, the same in every thread."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import rasterio
from rasterio.errors import NotGeoreferencedWarning

CACHE_BYTES = 96 << 20
"""Decoded blocks that GDAL keeps, over all files and threads of the process."""

READ_DRIVERS = (
    "GTiff",
    "JPEG",
    "PNG",
    "JP2OpenJPEG",
    "VRT",
    "HFA",
    "ENVI",
    "NITF",
    "DIMAP",
    "BMP",
    "GPKG",
)
"""Formats that are opened; GDAL has many more, some of which run code or fetch addresses that a file names."""

_SETTINGS: dict[str, Any] = {
    "GDAL_CACHEMAX": CACHE_BYTES,
    # Sidecars (.tfw, .aux.xml, .ovr) are looked for by name; a folder of 100,000 photos is never listed.
    "GDAL_DISABLE_READDIR_ON_OPEN": "TRUE",
    "GDAL_TIFF_INTERNAL_MASK": "YES",
    # A DEM that declares its vertical datum must not lose it.
    "GTIFF_REPORT_COMPD_CS": "YES",
    "GDAL_VRT_ENABLE_PYTHON": "NO",
    "VRT_VIRTUAL_OVERVIEWS": "NO",
    # Inputs are files of this machine. No address is allowed, and the proxy that everything else would go through is
    # of a kind that does not exist, which fails before a connection is tried.
    "CPL_VSIL_CURL_ALLOWED_FILENAME": "none",
    "GDAL_HTTP_PROXY": "none://none",
}


def environment(**settings: Any) -> AbstractContextManager[object]:
    """Context manager in which GDAL works with geomosaic's settings.

    Options hold for the thread that enters it, so every thread enters its own. Entered again inside of itself it does
    nothing, which costs nothing: rasterio would take all settings back and make them anew.

    Parameters
    ----------
    **settings
        GDAL configuration options to add or change.

    Returns
    -------
    context manager
    """
    return rasterio.Env(**{**_SETTINGS, **settings}) if settings else _Held()


_opening = threading.RLock()


@contextmanager
def opening() -> Iterator[None]:
    """Opening of rasters that may have no georeference, as raw photos, without rasterio's warning of it.

    One thread at a time: warning filters belong to the process, and threads that change them at once would not bring
    back the caller's.
    """
    with _opening, warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        yield


def enter_for_good() -> None:
    """Enter the environment for the rest of this thread's life, as threads do that read all the time."""
    _Held().__enter__()


class _Here(threading.local):
    """How often this thread has entered, and what it entered first."""

    depth = 0
    env: Any = None


_here = _Here()


class _Held:
    """rasterio's environment, made by the first of those that are entered one inside the other."""

    def __enter__(self) -> None:
        if _here.depth == 0:
            _here.env = rasterio.Env(**_SETTINGS)
            _here.env.__enter__()
        _here.depth += 1

    def __exit__(self, *error: object) -> None:
        _here.depth -= 1
        if _here.depth == 0:
            env, _here.env = _here.env, None
            env.__exit__(*error)
