"""Regular grids in a CRS, and sheets that someone drew."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from geomosaic.carto.series.scheme import DIRECTIONS, Cell, GridScheme
from geomosaic.errors import InputError, did_you_mean
from geomosaic.types import FloatArray


def regular(
    crs: str, size: tuple[float, float], *, origin: tuple[float, float] = (0.0, 0.0), scale: float | None = None
) -> GridScheme:
    """Sheets of one size in map units, named by the column and row of their lower left corner: 'C12-R345'.

    Columns and rows are counted from the origin, eastwards and northwards, and may be negative: 'C-3-R7'.
    """
    if not (size[0] > 0 and size[1] > 0):
        raise InputError(
            f"sheets of {size[0]:g} x {size[1]:g} have no area", where="--size", mend="two lengths above 0"
        )

    def place_of(name: str) -> tuple[int, int] | None:
        found = re.fullmatch(r"C(-?\d+)-R(-?\d+)", name.upper())
        return (int(found[1]), int(found[2])) if found else None

    return GridScheme(
        f"the grid of {size[0]:g} x {size[1]:g} in {crs}", crs, scale,
        (Fraction(repr(float(origin[0]))), Fraction(repr(float(origin[1])))),
        (Fraction(repr(float(size[0]))), Fraction(repr(float(size[1])))), False,
        lambda col, row: f"C{col}-R{row}", place_of, "C12-R345",
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Polygons:
    """Sheets given as polygons.

    Attributes
    ----------
    title, crs : str
    rings : mapping of str to array (N, 2)
        Outer ring of each sheet by its name, not closed.
    scale : float, optional
    """

    title: str
    crs: str
    rings: Mapping[str, FloatArray]
    scale: float | None = None
    _boxes: Mapping[str, Cell] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        boxes = {name: (*ring.min(axis=0).tolist(), *ring.max(axis=0).tolist()) for name, ring in self.rings.items()}
        object.__setattr__(self, "_boxes", boxes)

    def map_crs(self, name: str) -> str | None:
        """Left open."""
        return None

    def proper(self, name: str) -> str:
        """The name, if there is such a sheet."""
        if name not in self.rings:
            raise InputError(f"'{name}' is no sheet of {self.title}", mend=did_you_mean(name, self.rings) or None)
        return name

    def find(self, x: float, y: float) -> str:
        """First sheet that contains a place."""
        from shapely import Point, Polygon

        for name, ring in self.rings.items():
            if Polygon(ring).intersects(Point(x, y)):
                return name
        raise InputError(f"{self.title} has no sheet there", where=f"{x:.10g}, {y:.10g} ({self.crs})")

    def edges(self, name: str) -> tuple[str, FloatArray]:
        """CRS and ring."""
        return self.crs, np.asarray(self.rings[self.proper(name)], dtype=np.float64)

    def neighbours(self, name: str) -> dict[str, str]:
        """In each direction the sheet that contains a place just beyond the box of this one; none twice."""
        from shapely import Point, Polygon

        left, bottom, right, top = self._boxes[self.proper(name)]
        middle, half = ((left + right) / 2, (bottom + top) / 2), ((right - left) / 2, (top - bottom) / 2)
        found: dict[str, str] = {}
        for way in ("N", "E", "S", "W", "NW", "NE", "SW", "SE"):
            east, north = DIRECTIONS[way]
            place = Point(middle[0] + 1.2 * east * half[0], middle[1] + 1.2 * north * half[1])
            for other, ring in self.rings.items():
                if other != name and other not in found.values() and Polygon(ring).intersects(place):
                    found[way] = other
                    break
        return found

    def within(self, box: Cell) -> Iterator[str]:
        """Sheets whose boxes touch a box, in the order of the file."""
        for name, (left, bottom, right, top) in self._boxes.items():
            if left <= box[2] and right >= box[0] and bottom <= box[3] and top >= box[1]:
                yield name
