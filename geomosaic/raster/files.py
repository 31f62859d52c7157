"""Files on disk: free names for outputs, journals of databases, digests of what inputs hold."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from geomosaic.digests import digest_of, sha256
from geomosaic.errors import InputError, OutputExistsError
from geomosaic.geo.grid import Grid
from geomosaic.stores.path import StorePath
from geomosaic.whole_files import workplace, write_atomic

_DATABASES = (".gpkg", ".sqlite", ".db", ".mbtiles")


def journal_of(path: Path) -> Path | None:
    """Path of the write-ahead journal of an SQLite database, None for other files.

    Parameters
    ----------
    path : Path
    """
    # QGIS keeps GeoPackages open: an edit that is saved there is in the journal, which readers see, long before it is
    # in the file itself. With journals of the older kind (`-journal`) the file itself holds what was saved.
    # No program holds an object of a store open.
    database = path.suffix.lower() in _DATABASES and not isinstance(path, StorePath)
    return path.with_name(f"{path.name}-wal") if database else None


def _filled_journal(path: Path) -> Path | None:
    """Journal of a database that has changes in it, else None."""
    journal = journal_of(path)
    try:
        return journal if journal is not None and journal.stat().st_size > 0 else None
    except OSError:  # it goes when the other program closes the file, perhaps at this moment
        return None


@dataclass
class Hashes:
    """SHA-256 of what files hold; a file of known size and modification time is not read again.

    Attributes
    ----------
    known : dict, path to [size, mtime in ns, sha256]
    """

    # Of a database that another program holds open, what stands in its journal counts too: see `journal_of`.
    known: dict[str, list[Any]] = field(default_factory=dict)

    def of(self, path: Path) -> str:
        """Digest of what a file holds.

        Raises
        ------
        InputError
            The file is missing or unreadable.
        """
        changes = ""
        if (journal := _filled_journal(path)) is not None:
            with suppress(InputError):  # it has just gone into the file, which is read after it
                changes = self._of(journal)
        digest = self._of(path)
        return digest_of(digest, changes) if changes else digest

    def _of(self, path: Path) -> str:
        try:
            stat = path.stat()
        except OSError:
            raise InputError("the file does not exist", where=str(path), hint="check the path") from None
        entry = self.known.get(str(path))
        if entry and entry[0] == stat.st_size and entry[1] == stat.st_mtime_ns:
            return str(entry[2])
        if isinstance(path, StorePath):  # not read as a whole: its entity tag is in the time
            return digest_of(str(path), stat.st_size, stat.st_mtime_ns)
        digest = sha256(path)
        self.known[str(path)] = [stat.st_size, stat.st_mtime_ns, digest]
        return digest


# Endings of what a raster is not written as.
_OTHER_FORMATS = (
    ".bmp", ".ecw", ".gif", ".gpkg", ".img", ".jp2", ".jpeg", ".jpg", ".json", ".kmz", ".mbtiles", ".nc", ".pdf",
    ".png", ".shp", ".sid", ".vrt", ".webp", ".zip",
)  # fmt: skip


def check_output(path: Path, *, overwrite: bool, inputs: Iterable[Path] = (), geotiff: bool = False) -> None:
    """Check of an output's final name: free, in a folder that exists, and none of the inputs.

    Parameters
    ----------
    path : Path
    overwrite : bool, whether an existing file may be replaced
    inputs : iterable of Path, files that are read
    geotiff : bool, whether it becomes a GeoTIFF, whose name must not promise another format

    Raises
    ------
    OutputExistsError
        The file exists and `overwrite` is false, or it is a database that another program is writing to.
    InputError
        The name is a folder's, a device's or an input's, or that of another format, or its folder does not exist.
    """
    if isinstance(path, StorePath):
        path.check_writable()
    exists = path.exists()  # asked once: in a store it is a request
    if exists and any(file.exists() and path.samefile(file) for file in inputs):
        raise InputError("the output is one of the inputs", where=str(path), hint="give another name for the output")
    if geotiff and path.suffix.lower() in _OTHER_FORMATS:
        raise InputError(
            f"the output would be a GeoTIFF, and is called '{path.suffix}'",
            where=str(path),
            hint=f"call it {path.stem}.tif; gdal_translate makes other formats of it",
        )
    if exists and path.is_dir():
        raise InputError("the output is a folder", where=str(path), hint="give the name of a file in it")
    if exists and not path.is_file():
        raise InputError("the output is no ordinary file", where=str(path), hint="give another name")
    if not isinstance(path, StorePath) and not path.parent.is_dir():
        raise InputError(
            "the folder of the output does not exist", where=str(path), hint="make it, or give another path"
        )
    if exists and not overwrite:
        raise OutputExistsError("the output exists", where=str(path), hint="give another name, or `overwrite`")
    if (journal := _filled_journal(path)) is not None:
        # Readers would put the journal of the old file into the new one, page by page, and show neither.
        raise OutputExistsError(
            f"changes to the output stand beside it ({journal.name}): another program holds it open, or ended badly",
            where=str(path),
            hint="save a copy of what you drew there, then close it (in QGIS: remove the layer), or remove both files",
        )


def companion(output: Path, mark: str, suffix: str) -> Path:
    """Path of a file named after an output, beside it.

    Parameters
    ----------
    output : Path
        Such as mosaic.tif.
    mark : str
        Put after its stem: '-labels' for mosaic-labels.tif; may be empty.
    suffix : str
        With its dot.

    Returns
    -------
    Path
    """
    return output.with_name(f"{output.stem}{mark}{suffix}")


# Bytes, uncompressed, of an output that nobody has asked for by its size: hours of work, as a rule a slip.
MOST_OUTPUT = 64 << 30
# Rows, columns and tiles of a GeoTIFF are counted in 31 bits.
_MOST_COUNT, _TILE = 1 << 31, 512 * 512


def check_output_size(path: Path, grid: Grid, pixel_bytes: float, most: int | None = None) -> None:
    """Check of an output's size, before any work.

    Parameters
    ----------
    path : Path
    grid : Grid
    pixel_bytes : float
        Bytes of a pixel in all bands, and in the rasters that go with it.
    most : int, optional
        Bytes that are asked for; without it `MOST_OUTPUT`, and no more than is free on the disk.

    Raises
    ------
    InputError
        More than that, or more pixels than a GeoTIFF can count.
    """
    size = f"the output would have {grid.width:.6g} x {grid.height:.6g} pixels"
    coarser = f"a coarser `resolution` or smaller `bounds`; one pixel is {grid.resolution[0]:g} map units now"
    if max(grid.width, grid.height) >= _MOST_COUNT or grid.width * grid.height / _TILE >= _MOST_COUNT:
        raise InputError(f"{size}, more than a GeoTIFF can hold", where=str(path), hint=coarser)
    needed = grid.width * grid.height * pixel_bytes
    folder = workplace(path)
    free = shutil.disk_usage(folder).free if folder.is_dir() else math.inf  # another check tells of it
    if needed <= (min(free, MOST_OUTPUT) if most is None else most):
        return
    limit = f"{size_text(free)} are free on its disk" if free < MOST_OUTPUT else f"{size_text(MOST_OUTPUT)} are made"
    raise InputError(
        f"{size}, {size_text(needed)} uncompressed; "
        + (f"{limit} unless more is asked for" if most is None else f"`max_output` allows {size_text(most)}"),
        where=str(path),
        hint=f"{coarser}; or ask for it: `max_output` {-int(-needed // (1 << 30))}G",
    )


def size_text(size: float) -> str:
    """Size of a file in GB, MB or kB.

    Parameters
    ----------
    size : float
        Bytes.
    """
    unit, name = next(((u, n) for u, n in ((1e9, "GB"), (1e6, "MB")) if size >= u), (1e3, "kB"))
    return f"{size / unit:.1f} {name}"


def write_text(path: Path, text: str, *, overwrite: bool, encoding: str = "utf-8") -> None:
    """Text file, written whole under its name or not at all.

    Parameters
    ----------
    path : Path
    text : str
    overwrite : bool, whether an existing file may be replaced
    encoding : str

    Raises
    ------
    OutputExistsError, OutputError
        The name is taken; writing failed.
    """
    check_output(path, overwrite=overwrite)
    write_atomic(path, text, encoding)
