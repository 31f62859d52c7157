"""World files: six numbers that say where the centre of the upper-left pixel lies and how far the next ones are."""

from __future__ import annotations

from pyproj import CRS

from geomosaic.control.points import Origin
from geomosaic.control.reading import Measured, Reading, control_of, ground_crs
from geomosaic.control.text import has_decimal_commas, number, read_lines
from geomosaic.errors import InputError
from geomosaic.types import PathLike

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
        raise InputError(f"a world file has 6 lines, not {len(lines)}", where=str(path), mend="is it the right file?")
    commas = has_decimal_commas((origin, line.strip()) for origin, line in lines)
    a, d, b, e, x, y = (
        number(line.strip(), name, origin, commas=commas) for (origin, line), name in zip(lines, _NAMES, strict=True)
    )
    if abs(a * e - b * d) <= 1e-12 * max(map(abs, (a, b, d, e))) ** 2:
        raise InputError("the world file maps the image onto a line", where=str(path), mend="correct lines 1 to 4")
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
        raise InputError("a world file says nothing without its image", where=where, mend="give the size of the image")
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
