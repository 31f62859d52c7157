"""What a scheme of sheets is, and schemes whose sheets are cells of a regular grid in some CRS."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol

from geomosaic.errors import InputError
from geomosaic.types import FloatArray

DIRECTIONS: dict[str, tuple[int, int]] = {
    "NW": (-1, 1), "N": (0, 1), "NE": (1, 1), "W": (-1, 0), "E": (1, 0), "SW": (-1, -1), "S": (0, -1), "SE": (1, -1),
}  # fmt: skip
"""Steps east and north."""

Cell = tuple[float, float, float, float]
"""Left, bottom, right, top in the CRS of the scheme."""


class Scheme(Protocol):
    """Sheets of an area and their names."""

    @property
    def title(self) -> str:
        """What it is called."""

    @property
    def crs(self) -> str:
        """CRS in which the edges are straight: x east (longitude), y north (latitude)."""

    @property
    def scale(self) -> float | None:
        """Denominator of the maps; None where the scheme has none."""

    def map_crs(self, name: str) -> str | None:
        """CRS in which the sheet is drawn; None where the scheme leaves it open."""

    def find(self, x: float, y: float) -> str:
        """Name of the sheet at a place in `crs`; a place on an edge belongs to the sheet east or north of it."""

    def proper(self, name: str) -> str:
        """The name as the scheme writes it, however it is spelled; an InputError where there is no such sheet."""

    def edges(self, name: str) -> tuple[str, FloatArray]:
        """CRS, and corners (N, 2) of the neatline, counter-clockwise, not closed; its sides are straight there."""

    def neighbours(self, name: str) -> dict[str, str]:
        """Names of the sheets around, by direction; those that do not exist are left out."""

    def within(self, box: Cell) -> Iterator[str]:
        """Sheets that touch a box in `crs`, from north to south and west to east."""


@dataclass(frozen=True)
class GridScheme:
    """Cells of one size.

    Attributes
    ----------
    title, crs : str
    scale : float or None
    origin : tuple of Fraction
        x of the left edge of column 0; y of the lower edge of row 0, or of its upper edge where rows go south.
    step : tuple of Fraction
        Width and height.
    south : bool
        Rows are counted southwards.
    name_of : callable
        Column and row to a name; None where there is no such sheet.
    place_of : callable
        A name to column and row; None where it is no name.
    example : str
        A name, for errors.
    own_crs : callable, optional
        CRS in which a sheet is drawn.
    """

    title: str
    crs: str
    scale: float | None
    origin: tuple[Fraction, Fraction]
    step: tuple[Fraction, Fraction]
    south: bool
    name_of: Callable[[int, int], str | None]
    place_of: Callable[[str], tuple[int, int] | None]
    example: str
    own_crs: Callable[[str], str | None] = lambda name: None

    def map_crs(self, name: str) -> str | None:
        """CRS in which the sheet is drawn."""
        return self.own_crs(self.proper(name))

    def find(self, x: float, y: float) -> str:
        """Name at a place.

        Raises
        ------
        InputError
            The scheme has no sheet there.
        """
        name = self.name_of(*self._index(x, y)) if math.isfinite(x) and math.isfinite(y) else None
        if name is None:
            raise InputError(
                f"{self.title} has no sheet there", where=f"{x:.10g}, {y:.10g} ({self.crs})",
                mend="give a place inside the area of the scheme",
            )  # fmt: skip
        return name

    def _index(self, x: float, y: float) -> tuple[int, int]:
        # A billionth of a cell is forgiven, so that an edge computed in floats is the edge.
        col = math.floor((x - float(self.origin[0])) / float(self.step[0]) + 1e-9)
        up = math.floor((y - float(self.origin[1])) / float(self.step[1]) + 1e-9)
        return col, -1 - up if self.south else up

    def _place(self, name: str) -> tuple[int, int]:
        place = self.place_of(name.strip())
        if place is None or self.name_of(*place) is None:
            raise InputError(f"'{name}' is no sheet of {self.title}", mend=f"names look like {self.example}")
        return place

    def proper(self, name: str) -> str:
        """The name as the scheme writes it."""
        return self.name_of(*self._place(name)) or name

    def cell(self, name: str) -> Cell:
        """Edges, each the float nearest to the exact number."""
        col, row = self._place(name)
        up = -1 - row if self.south else row
        (x, y), (dx, dy) = self.origin, self.step
        return float(x + col * dx), float(y + up * dy), float(x + (col + 1) * dx), float(y + (up + 1) * dy)

    def edges(self, name: str) -> tuple[str, FloatArray]:
        """CRS and corners."""
        return self.crs, corners(self.cell(name))

    def neighbours(self, name: str) -> dict[str, str]:
        """Names around."""
        col, row = self._place(name)
        up = -1 if self.south else 1
        around = {way: self.name_of(col + east, row + up * north) for way, (east, north) in DIRECTIONS.items()}
        return {way: found for way, found in around.items() if found is not None}

    def within(self, box: Cell) -> Iterator[str]:
        """Sheets that touch a box."""
        (first, low), (last, high) = self._index(box[0], box[1]), self._index(box[2], box[3])
        rows = range(high, low + 1) if self.south else range(high, low - 1, -1)
        for row in rows:
            for col in range(first, last + 1):
                name = self.name_of(col, row)
                if name is not None:
                    yield name


def corners(cell: Cell) -> FloatArray:
    """Corners of a rectangle, counter-clockwise from the lower left."""
    import numpy as np

    left, bottom, right, top = cell
    return np.array([(left, bottom), (right, bottom), (right, top), (left, top)])
