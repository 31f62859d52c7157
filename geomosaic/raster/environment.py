"""GDAL environment: settings, formats that are opened, and the rule that only files of this machine are read."""

from __future__ import annotations

import re
import threading
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import rasterio
from rasterio.errors import NotGeoreferencedWarning, RasterioError

from geomosaic.errors import RasterReadError

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


# GDAL's virtual file systems, addresses, datasets written out as XML, and the prefixes of its drivers ("WMS:http").
_ELSEWHERE = re.compile(r"^\s*<|^[\\/]vsi|://|^\w\w+:")


_VRT, _DIMAP, _HEAD = b"<VRTDataset", b"<Dimap_Document", 4096
_DEEPEST = 8


# Beside a raster, GDAL opens these in whatever format they are.
_SIDECARS = (".ovr", ".OVR", ".msk", ".MSK")


_DATASET_KEYS = ("X_DATASET", "Y_DATASET", "OVERVIEW_FILE")


_BASE = ":::BASE:::"  # "in the folder of this file", as GDAL writes it


def named_files(path: Path) -> tuple[Path, ...]:
    """Files that a raster reads its pixels from besides itself: the sources of a VRT, and the sources of those.

    They are looked for in the text of the file: opening it, GDAL would open them too, in any format it knows.

    Parameters
    ----------
    path : Path

    Returns
    -------
    tuple of Path

    Raises
    ------
    RasterReadError
        A source is no file of this machine, is of a format that is not read, or VRTs are nested deeper than anyone
        would.
    """
    return _sources(path, 0)


def check_files(dataset: Any, path: str) -> None:
    """Check that an open dataset reads from this machine only, whatever a sidecar or its own format names.

    Parameters
    ----------
    dataset : rasterio dataset
    path : str
        Of the dataset, named in errors.

    Raises
    ------
    RasterReadError
        It reads from elsewhere, by a sidecar or by what its format names inside.
    """
    # Asked first: to list its files, GDAL opens the overviews.
    overviews = dataset.tags(ns="OVERVIEWS").get("OVERVIEW_FILE", "")
    if overviews:
        if _ELSEWHERE.search(overviews):
            raise _elsewhere(overviews, path)
        inside = overviews.startswith(_BASE)
        file = Path(path).parent / overviews.removeprefix(_BASE) if inside else Path(overviews)
        if file.is_file():
            _sources(file, 1)
    for name in dataset.files:
        if name != path and _ELSEWHERE.search(name):
            raise _elsewhere(name, path)


def _sources(path: Path, depth: int) -> tuple[Path, ...]:
    if depth > _DEEPEST:
        raise RasterReadError(f"virtual rasters are nested more than {_DEEPEST} deep", where=str(path))
    for suffix in _SIDECARS:
        sidecar = path.with_name(path.name + suffix)
        if sidecar.is_file():
            _sources(sidecar, depth + 1)
    try:
        stat = path.stat()
        names = _names(path, stat.st_size, stat.st_mtime_ns, depth > 0)
    except OSError as error:
        raise RasterReadError(f"the file cannot be read ({error.strerror})", where=str(path)) from error
    found: dict[Path, None] = {}
    for name, relative, needed in names:
        if _ELSEWHERE.search(name):
            raise _elsewhere(name, str(path))
        source = path.parent / name if relative else Path(name)
        if source.is_file():
            found.update(dict.fromkeys((source, *_sources(source, depth + 1))))
        elif needed:
            raise RasterReadError(
                f"this virtual raster reads from '{name[:100]}', and there is no such file",
                where=str(path),
                hint="bring that file to its place, or make the virtual raster again",
            )
    return tuple(found)


@lru_cache(maxsize=4096)
def _names(path: Path, size: int, time: int, inside: bool) -> tuple[tuple[str, bool, bool], ...]:
    """Other files that a file, as it was at that time, names: name, from its folder or not, must be there or not."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if _VRT not in head and _DIMAP not in head:
        if inside:
            _readable(path)
        return ()
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except ElementTree.ParseError as error:
        raise RasterReadError(f"the text of this raster is damaged ({error})", where=str(path)) from error
    return tuple(named for element in root.iter() if (named := _named(element)) is not None)


def _named(element: ElementTree.Element) -> tuple[str, bool, bool] | None:
    """File that an element of a VRT or DIMAP names. As for GDAL, neither capitals nor namespaces count."""
    tag = element.tag.rpartition("}")[2].lower()
    said = {key.lower(): value for key, value in element.attrib.items()}
    text = (element.text or "").strip()
    if tag in ("data_file_path", "component_path"):
        return said.get("href", ""), True, False
    if not text:
        return None
    if tag in ("sourcefilename", "sourcedataset", "dempath"):
        relative = said.get("relativetovrt", "0").lower() not in ("0", "false", "no", "off")
        return text, relative, tag != "dempath"
    if tag == "mdi" and said.get("key", "").upper() in _DATASET_KEYS:
        return text.removeprefix(_BASE), text.startswith(_BASE), False
    if tag == "argument" and "filename" in said.get("name", "").lower():
        return text, said.get("relativetovrt", "0") == "1", False
    return None


def _readable(path: Path) -> None:
    """Refuse a source or sidecar of a format that is not read; some of the others fetch addresses that a file names."""
    with environment():
        for driver in READ_DRIVERS:
            with suppress(RasterioError, OSError):
                with opening(), rasterio.open(str(path), driver=driver) as dataset:
                    check_files(dataset, str(path))
                return
    raise RasterReadError(
        "this source of a virtual raster, or overview or mask of another, is not a raster that can be read",
        where=str(path),
        hint=f"check that it is whole and of a known format ({', '.join(READ_DRIVERS)}); delete it if it is not needed",
    )


def _elsewhere(name: str, where: str) -> RasterReadError:
    return RasterReadError(
        f"this raster reads from '{name[:100]}', which is no file of this machine",
        where=where,
        hint="copy that data here first and name the copy; geomosaic fetches nothing",
    )
