"""Control points of one image from any known file, its format recognised: tables, raster tags, world files, others."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np
from pyproj import CRS

from geomosaic.control.parsing import (
    Measured,
    Reading,
    check_count,
    choose_image,
    control_of,
    ground_crs,
    has_decimal_commas,
    number,
    read_lines,
    split,
)
from geomosaic.control.points import ControlPoints, Origin
from geomosaic.control.table import comment_crs, header_at, is_table, read_table_control, rows
from geomosaic.errors import InputError, counted
from geomosaic.geo.grid import Grid
from geomosaic.raster.environment import environment
from geomosaic.raster.info import open_raster
from geomosaic.stores.path import given_path, to_path
from geomosaic.types import FloatArray, PathLike
from geomosaic.whole_files import delimiter_of

# Of newer and of older versions.
HEADERS = (("mapx", "mapy", "sourcex", "sourcey"), ("mapx", "mapy", "pixelx", "pixely"))
SIGNS = ("up", "down")


def _is_qgis(header: str) -> bool:
    """Whether a header is one that QGIS writes."""
    fields = tuple(field.casefold() for field in split(header, delimiter_of(header)))
    return fields[:4] in HEADERS


def _read_qgis(path: PathLike, crs: str | CRS | None, size: tuple[int, int] | None, sign: str | None) -> Reading:
    """Read a `.points` file.

    QGIS counts x and y of an image without georeference from the upper left corner of the upper-left pixel, y upwards:
    it is negative in the image. Other programs write rows downwards, positive, under the same header. An image that
    was georeferenced already has map coordinates there, which are no image coordinates.
    """
    where = str(path)
    if sign is not None and sign not in SIGNS:
        raise InputError(f"the sign of rows is '{sign}'", hint=f"give {' or '.join(SIGNS)}")
    lines = read_lines(path)
    header, body, delimiter = rows(lines, where)
    check_count(len(body), where)  # all are of one image
    cells = [(line.origin, text) for line in body for text in line.fields[:4]]
    commas = delimiter != "," and has_decimal_commas(cells)
    points, values = [], []
    for index, line in enumerate(body):
        x, y, col, row = (number(line.fields[i], header[i], line.origin, commas=commas) for i in range(4))
        flag = dict(zip(header, line.fields, strict=True)).get("enable") or "1"
        if flag not in ("0", "1"):
            raise InputError(f"column 'enable' has '{flag}'", where=str(line.origin), hint="write 1 or 0")
        points.append((str(index), x, y, line.origin, flag == "1"))
        values.append((col, row))
    image = np.array(values).reshape(-1, 2)
    sign, note = (sign, f"rows {sign}wards, as given") if sign else _sign(image, size, points, where)
    image[:, 1] *= -1.0 if sign == "up" else 1.0
    image += 0.0  # no negative zero
    measured = [
        Measured(name, (float(at[0]), float(at[1])), (x, y, float("nan")), origin, enabled=enabled)
        for (name, x, y, origin, enabled), at in zip(points, image, strict=True)
    ]
    control = control_of(measured, ground_crs(comment_crs(lines), crs, where), where)
    return Reading(control, "qgis", (note, "points named by their number in the table of QGIS, from 0"))


def _sign(
    image: FloatArray,
    size: tuple[int, int] | None,
    points: Sequence[tuple[str, float, float, Origin, bool]],
    where: str,
) -> tuple[str, str]:
    rows_ = image[:, 1]
    if (rows_ <= 0).all():
        return "up", "rows upwards (negative in the image), as QGIS writes them: sign changed"
    if (rows_ < 0).any():
        few = np.flatnonzero(rows_ > 0) if (rows_ < 0).mean() >= 0.5 else np.flatnonzero(rows_ < 0)
        raise InputError(
            f"rows have both signs: point {points[few[0]][0]} has {rows_[few[0]]:g}, most others not",
            where=str(points[few[0]][3]),
            hint="correct the sign; or, where a point lies beyond the upper edge, give the sign: 'up' as QGIS writes",
        )
    if size is None:
        raise InputError(
            "rows are positive, which QGIS does not write for an image without georeference",
            where=where,
            hint="give the sign 'down' where they count from the top; map coordinates of an image that was "
            "georeferenced already are no image coordinates",
        )
    inside = (image >= 0).all() and (image <= size).all()
    if not inside:
        raise InputError(
            f"rows are positive and points lie outside the image of {size[0]} × {size[1]} pixels: these look like map "
            "coordinates of an image that was georeferenced already",
            where=where,
            hint="take away the georeference of the image and set the points anew, or give the sign 'down'",
        )
    return "down", "rows downwards (positive), which QGIS does not write: taken as they are, all inside the image"


_UTM = re.compile(r"WGS\s?84\s+UTM\s+(?:zone\s+)?(\d{1,2})\s*([NS]?)", re.IGNORECASE)
_CRS = re.compile(r"\+(proj|init)=|epsg:\d|wgs\s?84\s+utm|(proj|geog|compd)(crs|cs)\[", re.IGNORECASE)
_COLUMNS = ("geo_x", "geo_y", "geo_z", "im_x", "im_y", "image_name")


def _is_odm(first: str) -> bool:
    """Whether a first line is that of OpenDroneMap: a CRS and nothing else."""
    return _CRS.match(first.strip()) is not None


def _odm_crs(text: str, where: str) -> str:
    """CRS of the first line: EPSG code, PROJ string, or 'WGS84 UTM 16N'.

    Raises
    ------
    InputError
        A UTM zone without hemisphere, or one that does not exist.
    """
    match = _UTM.fullmatch(text.strip())
    if match is None:
        return text.strip()
    zone, hemisphere = int(match[1]), match[2].upper()
    if not hemisphere or not 1 <= zone <= 60:
        what = f"there is no UTM zone {zone}" if hemisphere else f"UTM zone {zone} has no hemisphere"
        raise InputError(f"'{text.strip()}': {what}", where=where, hint="write for example: WGS84 UTM 16N")
    return f"EPSG:{(32600 if hemisphere == 'N' else 32700) + zone}"


def _read_odm(path: PathLike, image: str | None, crs: str | CRS | None, half: float) -> Reading:
    """Read control of one image: lines of x, y, z, image x, image y, image name and optionally the point's name."""
    where = str(path)
    stated, measured, unnamed = odm_measurements(path, half=half)
    chosen = choose_image([name for name, _ in measured], image, where)
    points = [point for name, point in measured if name in chosen]
    made = sum(point.origin in unnamed for point in points)
    notes = [f"{half:g} added to image coordinates: pixels are counted by their centres"] * bool(half)
    others = len(measured) - len(points)
    notes += [f"{counted(others, 'point')} of other images left out"] * bool(others)
    notes += [f"{counted(made, 'point')} without a name called by line"] * bool(made)
    return Reading(control_of(points, ground_crs(stated, crs, where), where), "odm", tuple(notes))


def is_odm_list(path: PathLike) -> bool:
    """Whether a file is OpenDroneMap's list of control points, by its first line.

    Parameters
    ----------
    path : path-like
    """
    try:
        lines = [line for _, line in read_lines(path) if not line.lstrip().startswith("#")]
    except InputError:
        return False
    return bool(lines) and _is_odm(lines[0])


def odm_measurements(path: PathLike, half: float = 0.5) -> tuple[str, list[tuple[str, Measured]], set[Origin]]:
    """Control points of all images in OpenDroneMap's list.

    Parameters
    ----------
    path : path-like
    half : float
        Added to image coordinates. OpenSfM, which OpenDroneMap reads them with, counts pixels by their centres from 0
        (its normalised coordinates are (x + 0.5 - width / 2) / size).

    Returns
    -------
    crs : str
        As the first line states it.
    points : list of (str, Measured)
        Name of the image, and the point.
    unnamed : set of Origin
        Lines without a name, whose points are called by line.

    Raises
    ------
    InputError
        Names file, line and column.
    """
    where = str(path)
    lines = [(origin, line) for origin, line in read_lines(path) if not line.lstrip().startswith("#")]
    if not lines or not _is_odm(lines[0][1]):
        raise InputError("the first line names no CRS", where=where, hint="write one, for example: EPSG:32633")
    stated = _odm_crs(lines[0][1], str(lines[0][0]))
    split = [(origin, line.split()) for origin, line in lines[1:]]
    for origin, fields in split:
        if len(fields) < len(_COLUMNS):
            raise InputError(
                f"{counted(len(fields), 'value')} where at least {len(_COLUMNS)} are needed",
                where=str(origin),
                hint=f"write: {' '.join(_COLUMNS)} [name], separated by tabs or blanks; names of images have no blanks",
            )
    if not split:
        raise InputError("there are no points in the file", where=where, hint="is it the right file?")
    points, unnamed = list[tuple[str, Measured]](), set[Origin]()
    for origin, fields in split:
        x, y, col, row = (number(fields[i], _COLUMNS[i], origin) for i in (0, 1, 3, 4))
        z = math.nan if fields[2].casefold() == "nan" else number(fields[2], "geo_z", origin)
        name = fields[6] if len(fields) > 6 else f"line {origin.number}"
        if len(fields) == len(_COLUMNS):
            unnamed.add(origin)
        points.append((fields[5], Measured(name, (col + half, row + half), (x, y, z), origin)))
    return stated, points, unnamed


def _read_tagged(path: PathLike, crs: str | CRS | None) -> Reading:
    """Read the control points of a raster; its col and row are corner-based as ours."""
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


def _is_world(lines: list[str]) -> bool:
    """Whether lines are six single numbers."""
    try:
        return len(lines) == 6 and len([float(line.strip().replace(",", ".")) for line in lines]) == 6
    except ValueError:
        return False


def read_world_transform(path: PathLike) -> tuple[float, float, float, float, float, float]:
    """Read a world file as a, b, c, d, e, f, corner-based: x = a col + b row + c, y = d col + e row + f.

    Parameters
    ----------
    path : path

    Raises
    ------
    InputError
        Not six numbers, or numbers that map the image onto a line; the line is named.
    """
    # The file itself counts from the centre of the upper-left pixel, which is (0.5, 0.5) here.
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


def _read_world(path: PathLike, size: tuple[int, int] | None, crs: str | CRS | None) -> Reading:
    """Read a world file as control at the centres of the four corner pixels."""
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
    """Format of a file, one of `FORMATS`, by its content.

    Parameters
    ----------
    path : path

    Raises
    ------
    InputError
        None of them; what each looks like is listed.
    """
    try:
        with to_path(path).open("rb") as file:
            start = file.read(4096)
    except OSError:
        start = b""  # reading the lines says what is wrong
    if b"\0" in start or start.lstrip().startswith((b"<VRTDataset", b"\xff\xd8", b"\x89PNG")):
        return "raster"
    lines = read_lines(path)
    at = header_at(lines)
    header = lines[at][1] if at is not None else ""
    if _is_world([line for _, line in lines]):
        return "world"
    if _is_qgis(header):
        return "qgis"
    if _is_odm(header):
        return "odm"
    if is_table(header):
        return "csv"
    raise InputError(
        f"this is no control that can be read; its first line is '{header[:60]}'",
        where=str(path),
        hint="give one of: " + "; ".join(FORMATS.values()),
    )


def read_control_file(
    path: PathLike,
    *,
    image: str | None = None,
    crs: str | CRS | None = None,
    size: tuple[int, int] | None = None,
    format: str | None = None,
    sign: str | None = None,
    count: str | None = None,
    reference: Grid | None = None,
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
    reference : Grid, optional
        Of the image that positions in a table (ref_col, ref_row) in place of x and y were measured in.

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
        return _read_qgis(path, crs, size, sign)
    if kind == "odm":
        return _read_odm(path, image, crs, COUNTS[count or "centre"])
    if kind == "csv":
        return read_table_control(path, image=image, crs=crs, half=COUNTS[count or "corner"], reference=reference)
    if kind == "raster":
        return _read_tagged(path, crs)
    return _read_world(path, size, crs)


def read_control(
    path: PathLike,
    *,
    image: str | None = None,
    crs: CRS | str | None = None,
    size: tuple[int, int] | None = None,
) -> ControlPoints:
    """Control points of one image from a file: a table, QGIS .points, gcp_list.txt, tags of a raster, a world file.

    Parameters
    ----------
    path : path
    image : str, optional
        Name of the image, where the file has points of several.
    crs : CRS or str, optional
        Of the ground, where the file names none.
    size : tuple of int, optional
        Width and height of the image in pixels; needed for a world file.

    Returns
    -------
    ControlPoints

    Raises
    ------
    InputError
        Names file, line, point and column.
    """
    return read_control_file(given_path(path), image=image, crs=crs, size=size).control
