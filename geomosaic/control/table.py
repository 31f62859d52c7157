"""geomosaic's own table: id, x, y, z, image, col, row, sigma_px, sigma_xy, role, enabled, in any order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from pyproj import CRS

from geomosaic.control.coordinate_diagnostics import plane_coordinates
from geomosaic.control.diagnostics import pixel_on_ground
from geomosaic.control.parsing import (
    Line,
    Measured,
    Reading,
    choose_image,
    control_of,
    ground_crs,
    has_decimal_commas,
    number,
    read_lines,
    split,
)
from geomosaic.control.points import GROUND_NAMES, ControlPoints, Origin
from geomosaic.errors import InputError, counted
from geomosaic.geo.crs import is_local
from geomosaic.geo.grid import Grid
from geomosaic.geo.units import linear_unit
from geomosaic.types import FloatArray, PathLike
from geomosaic.whole_files import delimiter_of

NEEDED = ("x", "y", "col", "row")
EXAMPLE = "id,x,y,z,image,col,row"
# Columns, each with other names that can mean nothing else.
WORDS: Mapping[str, tuple[str, ...]] = {
    "id": ("name", "point", "label", "gcp"),
    **GROUND_NAMES,
    "image": ("filename", "file", "photo", "imagename", "image_name"),
    "col": ("column", "drawing_x"),
    "row": ("line", "drawing_y"),
    "sigma_px": ("sigma",),
    "sigma_xy": (),
    "role": (),
    "enabled": ("enable",),
}
# Positions in a reference image, read in place of ground coordinates.
PAIRED = {"ref_col": "x", "ref_row": "y"}
_NAMES = {other: word for word, others in WORDS.items() for other in (word, *others)}
_NUMBERS = (*NEEDED, "z", "sigma_px", "sigma_xy")
FLAGS = {"1": True, "true": True, "yes": True, "": True, "0": False, "false": False, "no": False}


def header_at(lines: Sequence[tuple[Origin, str]]) -> int | None:
    """Index of the first line that is no comment.

    Parameters
    ----------
    lines : sequence of (Origin, str)
    """
    return next((i for i, (_, line) in enumerate(lines) if not line.lstrip().startswith("#")), None)


def comment_crs(lines: Sequence[tuple[Origin, str]]) -> str | None:
    """CRS of a comment '#CRS: ...', where there is one (QGIS writes it so).

    Parameters
    ----------
    lines : sequence of (Origin, str)
    """
    for _, line in lines:
        head, colon, rest = line.lstrip().partition(":")
        if colon and head.replace(" ", "").casefold() == "#crs":
            return rest.strip() or None
    return None


def is_table(header: str) -> bool:
    """Whether a header names image and ground coordinates.

    Parameters
    ----------
    header : str
    """
    names = {_NAMES.get(field.casefold()) for field in split(header, delimiter_of(header))}
    return {"col", "row"} <= names or {"x", "y"} <= names


def rows(lines: Sequence[tuple[Origin, str]], path: str) -> tuple[tuple[str, ...], list[Line], str]:
    """Split a table into its header (lower case), its lines and the delimiter.

    Parameters
    ----------
    lines : sequence of (Origin, str)
    path : str
        Named by errors.

    Raises
    ------
    InputError
        A line with more or fewer values than the header.
    """
    at = header_at(lines)
    if at is None:
        raise InputError("the table is empty", where=path, hint=f"its first line should read: {EXAMPLE}")
    delimiter = delimiter_of(lines[at][1])
    header = tuple(field.casefold() for field in split(lines[at][1], delimiter))
    body = []
    for origin, text in lines[at + 1 :]:
        if text.lstrip().startswith("#"):
            continue
        fields = split(text, delimiter)
        fields += ("",) * (len(header) - len(fields))
        if len(fields) > len(header):
            raise InputError(
                f"{counted(len(fields), 'value')} for {len(header)} columns",
                where=str(origin),
                hint="if these are decimal commas, separate the columns by semicolons"
                if delimiter == ","
                else "every line needs one value per column",
            )
        body.append(Line(origin, fields))
    return header, body, delimiter


def read_table_control(
    path: PathLike,
    *,
    image: str | None = None,
    crs: str | CRS | None = None,
    half: float = 0.0,
    reference: Grid | None = None,
) -> Reading:
    """Read control of one image from a table.

    Parameters
    ----------
    path : path
        A header and one line per measurement, separated by commas, semicolons, tabs or blanks; decimal commas where
        commas do not part the columns. `#CRS: EPSG:32633` in a comment names the CRS.
    image : str, optional
        Needed where the column `image` names several.
    crs : str or CRS, optional
        Needed where no comment names it.
    half : float
        Added to col and row: 0.5 for a file that counts pixels by their centres from 0.
    reference : Grid, optional
        Of the image that the columns ref_col and ref_row, in place of x and y, have positions in.

    Raises
    ------
    InputError
        Names file, line, point and column.
    """
    where = str(path)
    lines = read_lines(path)
    header, body, delimiter = rows(lines, where)
    paired = set(PAIRED) <= set(header)
    if paired:
        _check_paired(header, reference, crs or comment_crs(lines), where)
        header = tuple(PAIRED.get(name, name) for name in header)
    column = _columns(header, f"{where}, line {lines[header_at(lines) or 0][0].number}")
    cells = [(line.origin, line.fields[column[name]]) for line in body for name in _NUMBERS if name in column]
    commas = delimiter != "," and has_decimal_commas(cells)
    notes = [f"columns separated by {_DELIMITERS[delimiter]}"] + ["decimal commas"] * commas
    unknown = [name for name in header if name and name not in _NAMES]
    notes += [f"columns not used: {', '.join(unknown)}"] * bool(unknown)
    if "image" in column:
        at = column["image"]
        empty = next((line for line in body if not line.fields[at]), None)
        if empty is not None:
            raise InputError("column 'image' is empty", where=str(empty.origin), hint="name the image of every point")
        chosen = choose_image([line.fields[at] for line in body], image, where)
        others = sum(line.fields[at] not in chosen for line in body)
        notes += [f"{counted(others, 'point')} of other images left out"] * bool(others)
        body = [line for line in body if line.fields[at] in chosen]
    points = [_point(index, line, column, commas, half) for index, line in enumerate(body, start=1)]
    if paired and reference is not None:
        control = control_of([_on_ground(point, reference, half) for point in points], reference.crs, where)
        notes.append("places are those of positions in another image (ref_col, ref_row)")
    else:
        # Coordinates of a frame that is no CRS need none named.
        frame = reference.crs if reference is not None and is_local(reference.crs) else None
        control = control_of(points, ground_crs(comment_crs(lines), crs or frame, where), where)
    if "sigma_xy" in column:
        spread = [_ground_sigma(line, line.fields[column["sigma_xy"]], commas) for line in body]
        control, said = _with_ground_sigma(control, np.array(spread))
        notes += said
    return Reading(control, "csv", tuple(notes))


def _check_paired(header: Sequence[str], reference: Grid | None, crs: str | CRS | None, where: str) -> None:
    """Check that positions in a reference have one, and nothing else that says where points lie."""
    if reference is None:
        raise InputError(
            "the columns ref_col and ref_row have positions in another image, and none is given",
            where=where,
            hint="name the image that they were measured in with `like`",
        )
    if crs is not None or {"x", "y"} & {_NAMES.get(name) for name in header}:
        raise InputError(
            "the table has positions in another image (ref_col, ref_row), and a "
            + ("CRS is given" if crs is not None else "column of ground coordinates"),
            where=where,
            hint="leave out one of the two: that image gives points their place and its CRS",
        )


def _on_ground(point: Measured, reference: Grid, half: float) -> Measured:
    """Point whose x and y are a position (col, row) in a georeferenced image, with its place there."""
    (x, y), *_ = reference.xy(np.array([point.xyz[:2]]) + half).tolist()
    return replace(point, xyz=(x, y, point.xyz[2]))


def _ground_sigma(line: Line, text: str, commas: bool) -> float:
    sigma = number(text, "sigma_xy", line.origin, commas=commas) if text else 0.0
    if not sigma >= 0.0:
        raise InputError(f"column 'sigma_xy' has {text}", where=str(line.origin), hint="give metres, 0 or more")
    return sigma


def _with_ground_sigma(control: ControlPoints, spread: FloatArray) -> tuple[ControlPoints, list[str]]:
    """Add standard deviations on the ground (N,), metres, to those in the image: a fit weighs the two together."""
    pixel = pixel_on_ground(control.colrow, plane_coordinates(control)) * linear_unit(control.crs)
    if pixel <= 0.0 or not spread.any():
        return control, []
    return (
        replace(control, sigma=np.hypot(control.sigma, spread / pixel)),
        [f"sigma_xy counted in pixels of {pixel:.3g} m"],
    )


_DELIMITERS = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "blanks"}


def _columns(header: Sequence[str], where: str) -> dict[str, int]:
    found: dict[str, int] = {}
    for index, name in enumerate(header):
        word = _NAMES.get(name)
        if word is None:
            continue
        if word in found:
            raise InputError(
                f"columns '{header[found[word]]}' and '{name}' both mean {word}", where=where, hint="keep one of them"
            )
        found[word] = index
    missing = [name for name in NEEDED if name not in found]
    if missing:
        raise InputError(
            f"control needs the column{'s' * (len(missing) > 1)} {', '.join(missing)}; the header has "
            f"{', '.join(header)}",
            where=where,
            hint=f"the header should read: {EXAMPLE}",
        )
    return found


def _point(index: int, line: Line, column: Mapping[str, int], commas: bool, half: float) -> Measured:
    text = {name: line.fields[at] for name, at in column.items()}
    get = {
        name: number(text[name], name, line.origin, commas=commas)
        for name in _NUMBERS
        if name in text and (name in NEEDED or text[name])
    }
    flag = text.get("enabled", "").casefold()
    if flag not in FLAGS:
        raise InputError(f"column 'enabled' has '{flag}'", where=str(line.origin), hint="write 1 or 0")
    return Measured(
        text.get("id") or str(index),
        (get["col"] + half, get["row"] + half),
        (get["x"], get["y"], get.get("z", float("nan"))),
        line.origin,
        get.get("sigma_px", 1.0),
        text.get("role", "").casefold() or "control",
        FLAGS[flag],
    )


PLACES = ("measured_x", "measured_y")


NUMBERS = ("x", "y", *PLACES)


def has_positions(path: PathLike) -> bool:
    """Whether a text is a table with the columns measured_x and measured_y.

    Parameters
    ----------
    path : path
        Named by errors.
    """
    try:
        lines = read_lines(path)
    except InputError:
        return False  # a raster, or nothing at all: its own reader says what is wrong
    at = header_at(lines)
    header = lines[at][1] if at is not None else ""
    return set(PLACES) <= {field.casefold() for field in split(header, delimiter_of(header))}


def read_positions(path: PathLike, *, crs: str | CRS | None = None) -> ControlPoints:
    """Check points from a table with the columns x, y, measured_x, measured_y and optionally id.

    Parameters
    ----------
    path : path
    crs : str or CRS, optional
        CRS of x and y; needed where no comment `#CRS:` names it.

    Returns
    -------
    ControlPoints
        In place of col and row it holds the measured x and y, in the CRS of the map.

    Raises
    ------
    InputError
        Names file, line and column.
    """
    where = str(path)
    lines = read_lines(path)
    header, body, delimiter = rows(lines, where)
    missing = [name for name in NUMBERS if name not in header]
    if missing:
        raise InputError(
            f"check points need the column {missing[0]}; the header has {', '.join(header)}",
            where=where,
            hint="the header should read: id,x,y,measured_x,measured_y",
        )
    column = {name: header.index(name) for name in (*NUMBERS, "id") if name in header}
    cells = [(line.origin, line.fields[column[name]]) for line in body for name in NUMBERS]
    commas = delimiter != "," and has_decimal_commas(cells)
    points = []
    for index, line in enumerate(body, start=1):
        x, y, east, north = (number(line.fields[column[n]], n, line.origin, commas=commas) for n in NUMBERS)
        name = line.fields[column["id"]] if "id" in column else ""
        points.append(Measured(name or str(index), (east, north), (x, y, float("nan")), line.origin, role="check"))
    return control_of(points, ground_crs(comment_crs(lines), crs, where), where)
