"""Schemes of sheets: regular grids in a CRS, drawn sheets, and the neatline of each."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, ClassVar, Protocol

import numpy as np
import shapely
from pyproj import CRS

from geomosaic.errors import InputError, did_you_mean
from geomosaic.geo.crs import crs_label, horizontal, parse_crs
from geomosaic.geo.grid import Bounds
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import short_unit
from geomosaic.sheets.grid_lines import Extent, densified_ring, extent_of, neatline_points
from geomosaic.types import FloatArray

# Steps east and north.
DIRECTIONS: dict[str, tuple[int, int]] = {
    "NW": (-1, 1), "N": (0, 1), "NE": (1, 1), "W": (-1, 0), "E": (1, 0), "SW": (-1, -1), "S": (0, -1), "SE": (1, -1),
}  # fmt: skip

# Left, bottom, right, top in the CRS of the scheme.
Cell = tuple[float, float, float, float]


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

    @property
    def area(self) -> str:
        """Hint where a place has no sheet: what the scheme covers."""

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
    step : tuple of Fraction, width and height
    south : bool, rows are counted southwards
    name_of : callable, column and row to a name; None where there is no such sheet
    place_of : callable, A name to column and row; None where it is no name
    example : str, A name, for errors
    own_crs : callable, optional, CRS in which a sheet is drawn
    area : str, hint where a place has no sheet
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
    area: str = "use another scheme"

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
                f"{self.title} has no sheet there", where=f"{x:.10g}, {y:.10g} ({self.crs})", hint=self.area
            )
        return name

    def _index(self, x: float, y: float) -> tuple[int, int]:
        # A billionth of a cell is forgiven, so that an edge computed in floats is the edge.
        col = math.floor((x - float(self.origin[0])) / float(self.step[0]) + 1e-9)
        up = math.floor((y - float(self.origin[1])) / float(self.step[1]) + 1e-9)
        return col, -1 - up if self.south else up

    def _place(self, name: str) -> tuple[int, int]:
        place = self.place_of(name.strip())
        if place is None or self.name_of(*place) is None:
            raise InputError(f"'{name}' is no sheet of {self.title}", hint=f"names look like {self.example}")
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
    """Corners of a rectangle, counter-clockwise from the lower left.

    Parameters
    ----------
    cell : Cell
    """
    left, bottom, right, top = cell
    return np.array([(left, bottom), (right, bottom), (right, top), (left, top)])


def regular(
    crs: str, size: tuple[float, float], *, origin: tuple[float, float] = (0.0, 0.0), scale: float | None = None
) -> GridScheme:
    """Sheets of one size in map units, named by the column and row of their lower left corner: 'C12-R345'.

    Columns and rows are counted from the origin, eastwards and northwards, and may be negative: 'C-3-R7'.

    Parameters
    ----------
    crs : str
    size : tuple of float, width and height, map units
    origin : tuple of float, map units
    scale : float, optional, denominator
    """
    if not (size[0] > 0 and size[1] > 0):
        raise InputError(
            f"sheets of {size[0]:.10g} x {size[1]:.10g} have no area", where="`size`", hint="two lengths above 0"
        )

    def place_of(name: str) -> tuple[int, int] | None:
        found = re.fullmatch(r"C(-?\d+)-R(-?\d+)", name.upper())
        return (int(found[1]), int(found[2])) if found else None

    parsed = parse_crs(crs, "`crs`")
    return GridScheme(
        f"the grid of {size[0]:.10g} x {size[1]:.10g} {short_unit(parsed)} in {crs_label(parsed)}", crs, scale,
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
    rings : mapping of str to array (N, 2), outer ring of each sheet by its name, not closed
    scale : float, optional
    """

    title: str
    crs: str
    rings: Mapping[str, FloatArray]
    scale: float | None = None
    area: ClassVar[str] = "draw a sheet there"
    _areas: Mapping[str, Any] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_areas", {name: shapely.Polygon(ring) for name, ring in self.rings.items()})

    def map_crs(self, name: str) -> str | None:
        """Left open."""
        return None

    def proper(self, name: str) -> str:
        """The name, if there is such a sheet."""
        if name not in self.rings:
            raise InputError(f"'{name}' is no sheet of {self.title}", hint=did_you_mean(name, self.rings) or None)
        return name

    def find(self, x: float, y: float) -> str:
        """First sheet that contains a place."""
        name = self._at(x, y)
        if name is not None:
            return name
        raise InputError(f"{self.title} has no sheet there", where=f"{x:.10g}, {y:.10g} ({self.crs})", hint=self.area)

    def _at(self, x: float, y: float, but: Collection[str] = ()) -> str | None:
        place = shapely.Point(x, y)
        return next((name for name, area in self._areas.items() if name not in but and area.intersects(place)), None)

    def edges(self, name: str) -> tuple[str, FloatArray]:
        """CRS and ring."""
        return self.crs, np.asarray(self.rings[self.proper(name)], dtype=np.float64)

    def neighbours(self, name: str) -> dict[str, str]:
        """In each direction the sheet that contains a place just beyond the box of this one; none twice."""
        left, bottom, right, top = self._areas[self.proper(name)].bounds
        middle, half = ((left + right) / 2, (bottom + top) / 2), ((right - left) / 2, (top - bottom) / 2)
        found: dict[str, str] = {}
        for way in ("N", "E", "S", "W", "NW", "NE", "SW", "SE"):
            east, north = DIRECTIONS[way]
            place = middle[0] + 1.2 * east * half[0], middle[1] + 1.2 * north * half[1]
            other = self._at(*place, but=(name, *found.values()))
            if other is not None:
                found[way] = other
        return found

    def within(self, box: Cell) -> Iterator[str]:
        """Sheets whose boxes touch a box, in the order of the file."""
        for name, area in self._areas.items():
            left, bottom, right, top = area.bounds
            if left <= box[2] and right >= box[0] and bottom <= box[3] and top >= box[1]:
                yield name


# Pieces of a side: between its nodes a side of 6° at 1:1 000 000 is off by 0.02 mm, shorter ones by less.
PARTS = 64


@dataclass(frozen=True, eq=False)
class SheetPlace:
    """A sheet on the map.

    Attributes
    ----------
    name, series : str
    scale : float or None
    ring : array (N, 2), neatline in the CRS of the map, not closed
    corners : array (K, 2), its corners there
    neighbours : mapping of str to str, names around by direction
    """

    name: str
    series: str
    scale: float | None
    ring: FloatArray
    corners: FloatArray
    neighbours: Mapping[str, str]

    @property
    def bounds(self) -> Bounds:
        """Smallest box around the neatline."""
        low, high = self.ring.min(axis=0), self.ring.max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def sheet_place(scheme: Scheme, name: str, map_crs: CRS, overlap: float = 0.0) -> SheetPlace:
    """Bring a sheet to a map.

    Parameters
    ----------
    scheme : Scheme
    name : str
    map_crs : CRS, projected
    overlap : float, units of the map by which the sheet reaches beyond its edges

    Raises
    ------
    InputError
        There is no such sheet, or the CRS does not reach it.
    """
    name = scheme.proper(name)
    crs, edges = scheme.edges(name)
    move = Transform(parse_crs(crs), map_crs)
    # Straight sides of a sheet in the map's own CRS stay as they are.
    ring = edges if move.source == move.target else move(densified_ring(edges, PARTS))
    corners = move(edges)
    if not np.isfinite(ring).all():
        raise InputError(
            f"sheet {name} lies where '{map_crs.name}' has no coordinates", hint="use a map CRS for its area"
        )
    if overlap > 0:
        from shapely import Polygon

        grown = Polygon(ring).buffer(overlap, join_style="mitre").exterior
        ring = np.asarray(grown.coords)[:-1]
    return SheetPlace(name, scheme.title, scheme.scale, ring, corners, scheme.neighbours(name))


def sheets_on(scheme: Scheme, map_crs: CRS, bounds: Bounds) -> Iterator[str]:
    """Names of the sheets that share ground with a rectangle of the map.

    Parameters
    ----------
    scheme : Scheme
    map_crs : CRS
    bounds : Bounds, in `map_crs`

    Raises
    ------
    InputError
        The rectangle cannot be brought to the scheme's CRS.
    """
    crs = parse_crs(scheme.crs)
    try:
        there = Transform(map_crs, crs)
    except InputError as error:
        hint = "use another scheme, or reproject the raster first"
        raise InputError(error.what, where=scheme.title, hint=hint) from None
    if not np.isfinite(there(neatline_points(bounds))).all():
        raise InputError(f"the area has no coordinates in {scheme.crs}", hint="use another scheme")
    extent = extent_of(horizontal(crs), there, Transform(crs, map_crs), bounds)
    area = shapely.box(*bounds)
    names = dict.fromkeys(name for part in _boxes(extent) for name in scheme.within(part))
    for name in names:
        part = shapely.Polygon(sheet_place(scheme, name, map_crs).ring).intersection(area)
        if part.area > 1e-9 * area.area:  # not those that only touch it
            yield name


def _boxes(extent: Extent) -> list[Bounds]:
    """The box of an extent, or one on each side of the 180th meridian where it lies across it."""
    (left, bottom), (right, top) = extent.low.tolist(), extent.high.tolist()
    if extent.turns and right > 180.0:
        return [(left, bottom, 180.0, top), (-180.0, bottom, right - 360.0, top)]
    return [(left, bottom, right, top)]
