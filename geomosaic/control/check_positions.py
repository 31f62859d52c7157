"""Check points measured on a map: true coordinates, and coordinates on the map."""

from __future__ import annotations

from pyproj import CRS

from geomosaic.control.parsing import (
    Measured,
    control_of,
    delimiter_of,
    ground_crs,
    has_decimal_commas,
    number,
    read_lines,
    split,
)
from geomosaic.control.points import ControlPoints
from geomosaic.control.table import comment_crs, header_at, rows
from geomosaic.errors import InputError
from geomosaic.types import PathLike

PLACES = ("measured_x", "measured_y")


NUMBERS = ("x", "y", *PLACES)


def has_positions(path: PathLike) -> bool:
    """Whether a text is a table with the columns measured_x and measured_y."""
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
