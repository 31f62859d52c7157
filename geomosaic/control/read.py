"""Control points of one image from any known file: tables, tags of a raster, world files."""

from __future__ import annotations

from pathlib import Path

from pyproj import CRS

from geomosaic.control.other_programs import is_odm, is_qgis, read_odm, read_qgis
from geomosaic.control.parsing import Measured, Reading, control_of, ground_crs, has_decimal_commas, number, read_lines
from geomosaic.control.points import Origin
from geomosaic.control.table import header_at, is_table, read_table_control
from geomosaic.errors import InputError
from geomosaic.raster.environment import environment
from geomosaic.raster.info import open_raster
from geomosaic.types import PathLike


def read_tagged(path: PathLike, *, crs: str | CRS | None = None) -> Reading:
    """Read the control points of a raster; its col and row are corner-based as ours.

    Parameters
    ----------
    path : path
    crs : str or CRS, optional
        Needed where the raster does not say it.

    Raises
    ------
    RasterReadError
        This is no raster.
    InputError
        It has no control points.
    """
    where = str(path)
    with environment(), open_raster(path) as dataset:
        gcps, stated = dataset.gcps
        wkt = stated.to_wkt() if stated else None
    if not gcps:
        raise InputError(
            "the raster has no control points in it",
            where=where,
            hint="give a table of them; an image that has a georeference already needs none",
        )
    names = [str(gcp.id or "") for gcp in gcps]
    own = len(set(names)) == len(names) and all(names)
    points = [
        Measured(
            names[i] if own else str(i + 1),
            (float(gcp.col), float(gcp.row)),
            (float(gcp.x), float(gcp.y), float("nan") if gcp.z is None else float(gcp.z)),
            Origin(where, i + 1, "GCP"),
        )
        for i, gcp in enumerate(gcps)
    ]
    notes = () if own else ("points called by their number, since their names are missing or doubled",)
    return Reading(control_of(points, ground_crs(wkt, crs, where), where), "raster", notes)


_NAMES = ("x per column", "y per column", "x per row", "y per row", "x of the first pixel", "y of the first pixel")


def is_world(lines: list[str]) -> bool:
    """Say whether lines are six single numbers."""
    try:
        return len(lines) == 6 and len([float(line.strip().replace(",", ".")) for line in lines]) == 6
    except ValueError:
        return False


def read_world_transform(path: PathLike) -> tuple[float, float, float, float, float, float]:
    """Read a world file as a, b, c, d, e, f, corner-based: x = a col + b row + c, y = d col + e row + f.

    The file itself counts from the centre of the upper-left pixel, which is (0.5, 0.5) here.

    Raises
    ------
    InputError
        Not six numbers, or numbers that map the image onto a line; the line is named.
    """
    lines = read_lines(path)
    if len(lines) != 6:
        raise InputError(f"a world file has 6 lines, not {len(lines)}", where=str(path), hint="is it the right file?")
    commas = has_decimal_commas((origin, line.strip()) for origin, line in lines)
    a, d, b, e, x, y = (
        number(line.strip(), name, origin, commas=commas) for (origin, line), name in zip(lines, _NAMES, strict=True)
    )
    if abs(a * e - b * d) <= 1e-12 * max(map(abs, (a, b, d, e))) ** 2:
        raise InputError("the world file maps the image onto a line", where=str(path), hint="correct lines 1 to 4")
    return a, b, x - (a + b) / 2, d, e, y - (d + e) / 2


def read_world(path: PathLike, *, size: tuple[int, int] | None, crs: str | CRS | None = None) -> Reading:
    """Read a world file as control at the centres of the four corner pixels.

    Parameters
    ----------
    path : path
    size : tuple of int
        Width and height of the image, pixels.
    crs : str or CRS
        A world file names none.

    Raises
    ------
    InputError
        The size or the CRS is missing, or the file is wrong.
    """
    where = str(path)
    a, b, c, d, e, f = read_world_transform(path)
    if size is None:
        raise InputError("a world file says nothing without its image", where=where, hint="give the size of the image")
    width, height = size
    corners = ((0.5, 0.5), (width - 0.5, 0.5), (width - 0.5, height - 0.5), (0.5, height - 0.5))
    names = ("upper left", "upper right", "lower right", "lower left")
    points = [
        Measured(
            name, at, (a * at[0] + b * at[1] + c, d * at[0] + e * at[1] + f, float("nan")), Origin(where, i, "corner")
        )
        for i, (name, at) in enumerate(zip(names, corners, strict=True), start=1)
    ]
    note = "the corners follow from six numbers: their residuals after an affine fit are 0 and say nothing"
    return Reading(control_of(points, ground_crs(None, crs, where), where), "world", (note,))


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
        hint="give one of: " + "; ".join(FORMATS.values()),
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
        Names file, line, point and column, and how to correct it.
    """
    kind = format or recognise(path)
    if kind not in FORMATS:
        raise InputError(f"there is no format '{kind}' of control", hint=f"choose one of {', '.join(FORMATS)}")
    if count is not None and (count not in COUNTS or kind not in ("csv", "odm")):
        what = f"pixels cannot be counted by '{count}' in format '{kind}'"
        raise InputError(what, where=str(path), hint="'corner' or 'centre', and only for csv and odm")
    if sign is not None and kind != "qgis":
        raise InputError(f"the sign of rows has no meaning in format '{kind}'", where=str(path), hint="leave it out")
    if kind == "qgis":
        return read_qgis(path, crs=crs, size=size, sign=sign)
    if kind == "odm":
        return read_odm(path, image=image, crs=crs, half=COUNTS[count or "centre"])
    if kind == "csv":
        return read_table_control(path, image=image, crs=crs, half=COUNTS[count or "corner"])
    if kind == "raster":
        return read_tagged(path, crs=crs)
    return read_world(path, size=size, crs=crs)
