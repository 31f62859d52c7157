"""GDAL environment: settings, formats that are opened, and the rule that only files of this machine are read."""

from __future__ import annotations

import re
import sys
import threading
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree

import rasterio
from rasterio.errors import NotGeoreferencedWarning, RasterioError

from geomosaic.errors import RasterReadError
from geomosaic.raster.formats import READ_DRIVERS, SUBDATASETS, drivers_of
from geomosaic.stores.path import StorePath, to_path

# Decoded blocks that GDAL keeps, over all files and threads of the process; and their part of a memory limit. It keeps
# them full even of files of which each block is read once.
_CACHE_BYTES, _CACHE_PART = 96 << 20, 1 / 10

_SETTINGS: dict[str, Any] = {
    "GDAL_CACHEMAX": _CACHE_BYTES,
    # Sidecars (.tfw, .aux.xml, .ovr) are looked for by name; a folder of 100,000 photos is never listed.
    "GDAL_DISABLE_READDIR_ON_OPEN": "TRUE",
    "GDAL_TIFF_INTERNAL_MASK": "YES",
    # A DEM that declares its vertical datum must not lose it.
    "GTIFF_REPORT_COMPD_CS": "YES",
    "REPORT_COMPD_CS": "YES",
    "GDAL_VRT_ENABLE_PYTHON": "NO",
    "VRT_VIRTUAL_OVERVIEWS": "NO",
    # Inputs are files of this machine. No address is allowed, and the proxy that everything else would go through is
    # of a kind that does not exist, which fails before a connection is tried.
    "CPL_VSIL_CURL_ALLOWED_FILENAME": "none",
    "GDAL_HTTP_PROXY": "none://none",
}


def environment(**settings: Any) -> AbstractContextManager[object]:
    """Context manager in which GDAL works with geomosaic's settings.

    Settings hold for the thread that enters it: every thread enters its own.

    Parameters
    ----------
    **settings : GDAL configuration options to add or change
    """
    return rasterio.Env(**{**_SETTINGS, **settings}) if settings else _Environment()


def limit_cache(memory: int) -> None:
    """GDAL's part of a memory limit, set before anything is opened.

    Parameters
    ----------
    memory : int
        The limit, bytes.
    """
    _SETTINGS["GDAL_CACHEMAX"] = min(_CACHE_BYTES, int(memory * _CACHE_PART))


def gdal_version() -> str:
    """Version of the GDAL that reads and compresses."""
    return str(rasterio.__gdal_version__)


_opening = threading.RLock()


@contextmanager
def opening() -> Iterator[None]:
    """Opening of rasters that may have no georeference, as raw photos, without rasterio's warning of it."""
    # One thread at a time: warning filters belong to the process, and threads that change them at once would not
    # bring back the caller's.
    with _opening, warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        yield


def enter_for_good() -> None:
    """Enter the environment for the rest of this thread's life, as threads do that read all the time."""
    _Environment().__enter__()


class _Entered(threading.local):
    """Number of nested entries of this thread, and the environment that the first one made."""

    depth = 0
    env: Any = None


_entered = _Entered()


class _Environment:
    """rasterio's environment, made by the outermost of nested entries."""

    # Nested rasterio environments would take all settings back and make them anew, at every read of every thread.
    def __enter__(self) -> None:
        if _entered.depth == 0:
            _entered.env = rasterio.Env(**_SETTINGS)
            _entered.env.__enter__()
        _entered.depth += 1

    def __exit__(self, *error: object) -> None:
        _entered.depth -= 1
        if _entered.depth == 0:
            env, _entered.env = _entered.env, None
            env.__exit__(*error)


# GDAL's virtual file systems, addresses, datasets written out as XML, and the prefixes of its drivers ("WMS:http").
_REMOTE = re.compile(r"^\s*<|^[\\/]vsi|://|^\w\w+:")
# A VRT or DIMAP is known by its root element, looked for in the first bytes.
_VRT, _DIMAP, _PCIDSK, _HEAD = b"<VRTDataset", b"<Dimap_Document", b"PCIDSK  ", 4096
# One variable of a file of many, as a virtual raster names it: NETCDF:"a.nc":z.
_SUBDATASET = re.compile(rf"({'|'.join(SUBDATASETS)}):(?:\"([^\"]+)\"|([^\":]+)):[^:]*", re.IGNORECASE)
# Deeper than anyone nests VRTs: ends circles of files that name each other.
_DEEPEST = 8
# Beside a raster, GDAL opens these in whatever format they are.
_SIDECARS = (".ovr", ".OVR", ".msk", ".MSK")
_DATASET_KEYS = ("X_DATASET", "Y_DATASET", "OVERVIEW_FILE")
# rasterio's file system of an opener.
_SERVED = "/vsiriopener_"
_BASE = ":::BASE:::"  # "in the folder of this file", as GDAL writes it


def source_files(path: Path) -> tuple[Path, ...]:
    """Files that a raster reads its pixels from besides itself: the sources of a VRT, and the sources of those.

    Parameters
    ----------
    path : Path

    Raises
    ------
    RasterReadError
        A source is no file of this machine, is of a format that is not read, or VRTs are nested too deep.
    """
    # They are looked for in the text of the file: opening it, GDAL would open them too, in any format it knows.
    return _sources(path, 0)


def check_files(dataset: Any, path: str) -> None:
    """Check that an open dataset reads from this machine only, whatever a sidecar or its own format names.

    Parameters
    ----------
    dataset : rasterio dataset
    path : str, of the dataset, named in errors

    Raises
    ------
    RasterReadError
        It reads from elsewhere, by a sidecar or by what its format names inside.
    """
    # Before the list of files is asked for: to make it, GDAL opens the overviews.
    overviews = dataset.tags(ns="OVERVIEWS").get("OVERVIEW_FILE", "")
    if overviews:
        if _REMOTE.search(overviews):
            raise _not_local(overviews, path)
        inside = overviews.startswith(_BASE)
        file = to_path(path).parent / overviews.removeprefix(_BASE) if inside else Path(overviews)
        if file.is_file():
            _sources(file, 1)
    # What is opened in a store is served by `store_files`, which opens nothing else.
    served = isinstance(to_path(path), StorePath)
    for name in dataset.files:
        if name != path and not (served and name.startswith(_SERVED)) and _REMOTE.search(_file_of(name)):
            raise _not_local(name, path)


def _file_of(name: str) -> str:
    """File of a dataset's name, which may be that of one variable in it."""
    part = _SUBDATASET.fullmatch(name)
    return (part[2] or part[3]) if part else name


def _sources(path: Path, depth: int) -> tuple[Path, ...]:
    if depth > _DEEPEST:
        raise RasterReadError(
            f"virtual rasters are nested more than {_DEEPEST} deep", where=str(path), hint="make one of the images"
        )
    for sidecar in _sidecars(path):
        _sources(sidecar, depth + 1)
    try:
        stat = path.stat()
        names = _names(path, stat.st_size, stat.st_mtime_ns, depth > 0)
    except OSError as error:
        raise RasterReadError(
            f"the file cannot be read ({error.strerror})", where=str(path), hint="check the path and its rights"
        ) from error
    found: dict[Path, None] = {}
    for named, relative, needed in names:
        name = _file_of(named)
        if _REMOTE.search(name):
            raise _not_local(name, str(path))
        if isinstance(path, StorePath) and (not relative or ".." in PurePosixPath(name).parts or name.startswith("/")):
            raise _not_local(name, str(path))
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


def _sidecars(path: Path) -> list[Path]:
    """Overviews and masks beside a raster."""
    names = [path.name + suffix for suffix in _SIDECARS]
    if isinstance(path, StorePath):
        return [file for file in path.neighbours() if file.name in names]
    return [file for name in names if (file := path.with_name(name)).is_file()]


@lru_cache(maxsize=4096)
def _names(path: Path, size: int, time: int, inside: bool) -> tuple[tuple[str, bool, bool], ...]:
    """Other files that a file, as it was at that time, names: name, from its folder or not, must be there or not."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if head.startswith(_PCIDSK):
        _whole_pcidsk(path, head)
    if _VRT not in head and _DIMAP not in head:
        if inside:
            _readable(path)
        return ()
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except ElementTree.ParseError as error:
        raise RasterReadError(
            f"the text of this raster is damaged ({error})", where=str(path), hint="make or get the file again"
        ) from error
    return tuple(named for element in root.iter() if (named := _named(element)) is not None)


def _named(element: ElementTree.Element) -> tuple[str, bool, bool] | None:
    """File that an element of a VRT or DIMAP names. As for GDAL, neither capitals nor namespaces count."""
    tag = element.tag.rpartition("}")[2].lower()
    attributes = {key.lower(): value for key, value in element.attrib.items()}
    text = (element.text or "").strip()
    if tag in ("data_file_path", "component_path"):
        return attributes.get("href", ""), True, False
    if not text:
        return None
    if tag in ("sourcefilename", "sourcedataset", "dempath"):
        relative = attributes.get("relativetovrt", "0").lower() not in ("0", "false", "no", "off")
        return text, relative, tag != "dempath"
    if tag == "mdi" and attributes.get("key", "").upper() in _DATASET_KEYS:
        return text.removeprefix(_BASE), text.startswith(_BASE), False
    if tag == "argument" and "filename" in attributes.get("name", "").lower():
        return text, attributes.get("relativetovrt", "0") == "1", False
    return None


def _whole_pcidsk(path: Path, head: bytes) -> None:
    """Refuse a PCIDSK file whose channels lie in other files, which GDAL would open in any format it knows."""
    # As the format's description has it: in the file header the block of the first image header, counted from 1, and
    # the number of channels; in each image header the name of the file that has its pixels, or a segment of this one.
    try:
        start, count = (int(head[336:352]) - 1) * 512, int(head[376:384])
        with path.open("rb") as file:
            file.seek(start)
            headers = file.read(1024 * count)
        names = [headers[k * 1024 + 64 : k * 1024 + 128].strip(b"\0 ") for k in range(count)]
    except (ValueError, OSError, OverflowError, MemoryError) as error:
        raise RasterReadError(
            f"the header of this PCIDSK file is damaged ({error})", where=str(path), hint="make or get the file again"
        ) from error
    outside = next((name for name in names if name and not name.startswith(b"/SIS=")), None)
    if outside is not None:
        raise RasterReadError(
            f"this PCIDSK file has its pixels in another file, '{outside.decode(errors='backslashreplace')}'",
            where=str(path),
            hint="export it as a file with pixels of its own, or as GeoTIFF",
        )


def _readable(path: Path) -> None:
    """Refuse a source or sidecar of a format that is not read; some of the others fetch addresses that a file names."""
    with environment():
        for driver in drivers_of(path):
            with suppress(RasterioError, OSError):
                with opening(), rasterio.open(str(path), driver=driver, **opened(path)) as dataset:
                    check_files(dataset, str(path))
                return
    raise RasterReadError(
        "this source of a virtual raster, or overview or mask of another, is not a raster that can be read",
        where=str(path),
        hint=f"check that it is whole and of a known format ({', '.join(READ_DRIVERS)}); delete it if it is not needed",
    )


def opened(path: Path, sources: Sequence[Path] = ()) -> dict[str, Any]:
    """Arguments of `rasterio.open` for a raster: what serves its bytes, where it lies in a store.

    Parameters
    ----------
    path : Path
    sources : sequence of Path
        Files that it is made of, those of a virtual raster.
    """
    if not isinstance(path, StorePath):
        return {}
    from geomosaic.raster.store_files import StoreFiles

    return {"opener": StoreFiles(path, sources)}


def close_all(datasets: Iterable[Any]) -> None:
    """Close datasets that any threads have opened.

    Parameters
    ----------
    datasets : iterable of rasterio dataset
    """
    if "geomosaic.raster.store_files" in sys.modules:
        from geomosaic.raster.store_files import share_open_files

        share_open_files()
    for dataset in datasets:
        dataset.close()


def _not_local(name: str, where: str) -> RasterReadError:
    return RasterReadError(
        f"this raster reads from '{name[:100]}', which is no file of this machine",
        where=where,
        hint="copy that data here first and name the copy; what stands in files opens no connection",
    )
