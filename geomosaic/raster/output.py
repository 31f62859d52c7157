"""Final names: taken only with leave, and only by whole files; until then a file has a name that says whose it is."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Iterable
from pathlib import Path

from geomosaic.errors import InputError, OutputExistsError
from geomosaic.raster.journal import holds, journal_of

OTHER_FORMATS = (
    ".bmp", ".ecw", ".gif", ".gpkg", ".img", ".jp2", ".jpeg", ".jpg", ".json", ".kmz", ".mbtiles", ".nc", ".pdf",
    ".png", ".shp", ".sid", ".vrt", ".webp", ".zip",
)  # fmt: skip
"""Endings of what a raster is not written as."""


def check_output(path: Path, *, overwrite: bool, inputs: Iterable[Path] = ()) -> None:
    """Refuse a final name that is taken, or whose folder does not exist, or that is one of the inputs.

    Raises
    ------
    OutputExistsError
        The file exists and `overwrite` is false, or it is a database that another program is writing to.
    InputError
        The name is a folder's, a device's or an input's, or its folder does not exist.
    """
    if path.exists() and any(file.exists() and path.samefile(file) for file in inputs):
        raise InputError("the output is one of the inputs", where=str(path), mend="give another name for the output")
    if path.exists() and not (path.is_dir() or path.is_file()):
        raise InputError("the output is no ordinary file", where=str(path), mend="give another name")
    if path.is_dir():
        raise InputError("the output is a folder", where=str(path), mend="give the name of a file in it")
    if not path.parent.is_dir():
        raise InputError(
            "the folder of the output does not exist", where=str(path), mend="make it, or give another path"
        )
    if path.exists() and not overwrite:
        raise OutputExistsError("the output exists", where=str(path), mend="give another name, or --overwrite")
    if (journal := journal_of(path)) is not None and holds(journal):
        # Readers would put the journal of the old file into the new one, page by page, and show neither.
        raise OutputExistsError(
            f"changes to the output stand beside it ({journal.name}): another program holds it open, or ended badly",
            where=str(path),
            mend="save a copy of what you drew there, then close it (in QGIS: remove the layer), or remove both files",
        )


def check_geotiff(path: Path, *, overwrite: bool) -> None:
    """As `check_output`; names that promise another format are refused too.

    Raises
    ------
    OutputExistsError, InputError
    """
    check_output(path, overwrite=overwrite)
    if path.suffix.lower() in OTHER_FORMATS:
        raise InputError(
            f"the output would be a GeoTIFF, and is called '{path.suffix}'",
            where=str(path),
            mend=f"call it {path.stem}.tif; gdal_translate makes other formats of it",
        )


def partial(path: Path, suffix: str = "") -> Path:
    """Name of a file under construction: `.NAME.partial-HOST-PID`, in the folder of the final one.

    Those that dead processes of this machine left of the same final name are removed.
    """
    start = f".{path.name}.partial-{_host()}-"
    pattern = re.compile(re.escape(start) + r"(\d+)(\..*|-.*)?")
    for entry in os.scandir(path.parent):
        found = pattern.fullmatch(entry.name)
        if found and not _alive(int(found.group(1))):
            Path(entry.path).unlink(missing_ok=True)
    return path.with_name(f"{start}{os.getpid()}{suffix}")


def remove(unfinished: Path) -> None:
    """Remove a file under construction and what lies beside it under longer names (levels, journals)."""
    for entry in os.scandir(unfinished.parent):
        if entry.name == unfinished.name or entry.name.startswith((f"{unfinished.name}.", f"{unfinished.name}-")):
            Path(entry.path).unlink(missing_ok=True)


def _host() -> str:
    return re.sub(r"[^A-Za-z0-9]", "", platform.node()) or "here"


def _alive(process: int) -> bool:
    if os.name == "nt":  # there is no harmless signal
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def sync(path: Path) -> None:
    """Bring a file, or a folder's entries, to the disk."""
    if os.name == "nt" and path.is_dir():
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
