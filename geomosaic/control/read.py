"""Control of one image from a file of any known format."""

from __future__ import annotations

from pathlib import Path

from pyproj import CRS

from geomosaic.control.odm import is_odm, read_odm
from geomosaic.control.qgis import is_qgis, read_qgis
from geomosaic.control.reading import Reading
from geomosaic.control.table import header_at, is_table, read_table_control
from geomosaic.control.tagged import read_tagged
from geomosaic.control.text import read_lines
from geomosaic.control.world import is_world, read_world
from geomosaic.errors import InputError
from geomosaic.types import PathLike

FORMATS = {
    "csv": "table with a header: id,x,y,z,image,col,row",
    "qgis": "points of the QGIS georeferencer: mapX,mapY,sourceX,sourceY,enable",
    "odm": "OpenDroneMap's gcp_list.txt: a CRS, then x y z col row image [name]",
    "raster": "control points inside a raster",
    "world": "world file: six lines of one number",
}
COUNTS = {"corner": 0.0, "centre": 0.5}


def recognise(path: PathLike) -> str:
    """Say which of `FORMATS` a file has, by its content.

    Raises
    ------
    InputError
        None of them; what each looks like is listed.
    """
    try:
        with Path(path).open("rb") as file:
            start = file.read(4096)
    except OSError:
        start = b""  # reading the lines says what is wrong
    if b"\0" in start or start.lstrip().startswith((b"<VRTDataset", b"\xff\xd8", b"\x89PNG")):
        return "raster"
    lines = read_lines(path)
    at = header_at(lines)
    header = lines[at][1] if at is not None else ""
    if is_world([line for _, line in lines]):
        return "world"
    if is_qgis(header):
        return "qgis"
    if is_odm(header):
        return "odm"
    if is_table(header):
        return "csv"
    raise InputError(
        f"this is no control that can be read; its first line is '{header[:60]}'",
        where=str(path),
        mend="give one of: " + "; ".join(FORMATS.values()),
    )


def read_control(
    path: PathLike,
    *,
    image: str | None = None,
    crs: str | CRS | None = None,
    size: tuple[int, int] | None = None,
    format: str | None = None,
    sign: str | None = None,
    count: str | None = None,
) -> Reading:
    """Read the control of one image; the reading says which format was taken, and what else was decided.

    Parameters
    ----------
    path : path
        The file; its content decides how it is read.
    image : str, optional
        Name or path of the image, where the file has points of several.
    crs : str or CRS, optional
        CRS of the ground, where the file names none.
    size : tuple of int, optional
        Width and height of the image in pixels; needed for a world file.
    format : str, optional
        One of `FORMATS`, to take instead of what the content says.
    sign : str, optional
        'up' or 'down', for rows in a QGIS file whose sign is not QGIS's.
    count : str, optional
        'corner' where (0.5, 0.5) is the centre of the upper-left pixel in the file, 'centre' where (0, 0) is. By
        default 'centre' for OpenDroneMap and 'corner' for a table; the other formats leave no choice.

    Raises
    ------
    InputError
        Names file, line, point and column, and how to mend it.
    """
    kind = format or recognise(path)
    if kind not in FORMATS:
        raise InputError(f"there is no format '{kind}' of control", mend=f"choose one of {', '.join(FORMATS)}")
    if count is not None and (count not in COUNTS or kind not in ("csv", "odm")):
        what = f"pixels cannot be counted by '{count}' in format '{kind}'"
        raise InputError(what, where=str(path), mend="'corner' or 'centre', and only for csv and odm")
    if sign is not None and kind != "qgis":
        raise InputError(f"the sign of rows has no meaning in format '{kind}'", where=str(path), mend="leave it out")
    if kind == "qgis":
        return read_qgis(path, crs=crs, size=size, sign=sign)
    if kind == "odm":
        return read_odm(path, image=image, crs=crs, half=COUNTS[count or "centre"])
    if kind == "csv":
        return read_table_control(path, image=image, crs=crs, half=COUNTS[count or "corner"])
    if kind == "raster":
        return read_tagged(path, crs=crs)
    return read_world(path, size=size, crs=crs)
