"""Raster grid as a value: CRS, affine transform and shape. Every change gives a new one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from affine import Affine
from pyproj import CRS
from pyproj.exceptions import CRSError

from geomosaic.errors import InputError
from geomosaic.geo.crs import crs_code
from geomosaic.types import FloatArray

Bounds = tuple[float, float, float, float]


@dataclass(frozen=True)
class Window:
    """Rectangle of pixels.

    Attributes
    ----------
    col, row : int
        Of the upper-left pixel, counted from 0.
    width, height : int
        Pixels.

    Examples
    --------
    >>> Window(0, 0, 4, 3).intersection(Window(2, 1, 9, 9))
    Window(col=2, row=1, width=2, height=2)
    """

    col: int
    row: int
    width: int
    height: int

    @property
    def stop_col(self) -> int:
        """Column after the last."""
        return self.col + self.width

    @property
    def stop_row(self) -> int:
        """Row after the last."""
        return self.row + self.height

    @property
    def empty(self) -> bool:
        """Whether there is no pixel in it."""
        return self.width <= 0 or self.height <= 0

    def intersection(self, other: Window) -> Window:
        """Common part of two windows; it may be empty.

        Parameters
        ----------
        other : Window
        """
        col, row = max(self.col, other.col), max(self.row, other.row)
        return Window(col, row, min(self.stop_col, other.stop_col) - col, min(self.stop_row, other.stop_row) - row)

    def grown(self, pixels: int) -> Window:
        """Window with a margin on each side.

        Parameters
        ----------
        pixels : int
        """
        return Window(self.col - pixels, self.row - pixels, self.width + 2 * pixels, self.height + 2 * pixels)

    def slices_in(self, outer: Window) -> tuple[slice, slice]:
        """Rows and columns of this window in an array of another window that holds it.

        Parameters
        ----------
        outer : Window
        """
        row, col = self.row - outer.row, self.col - outer.col
        return slice(row, row + self.height), slice(col, col + self.width)

    def split(self, width: int, height: int) -> list[Window]:
        """Pieces of at most width × height, row by row, from the upper left.

        Parameters
        ----------
        width, height : int
            Pixels.
        """
        return [
            Window(c, r, min(width, self.stop_col - c), min(height, self.stop_row - r))
            for r in range(self.row, self.stop_row, height)
            for c in range(self.col, self.stop_col, width)
        ]


@dataclass(frozen=True)
class Grid:
    """Raster grid: CRS, affine transform and shape.

    Attributes
    ----------
    crs : CRS
        Horizontal CRS.
    transform : Affine
        Pixel corner (col, row) to map (x, y): (0, 0) is the outer corner of the upper-left pixel, (0.5, 0.5) its
        centre.
    width, height : int
        Pixels.

    Examples
    --------
    >>> grid = Grid.from_bounds(CRS("EPSG:32633"), (500000.0, 5400000.0, 500100.0, 5400050.0), 0.5)
    >>> grid.shape, grid.resolution
    ((100, 200), (0.5, 0.5))
    >>> grid.xy([[0.5, 0.5]]).tolist()
    [[500000.25, 5400049.75]]
    >>> Grid.from_profile(grid.to_profile()) == grid
    True
    """

    crs: CRS
    transform: Affine
    width: int
    height: int

    def __post_init__(self) -> None:
        for name, kind in (("crs", CRS), ("transform", Affine)):
            if not isinstance(getattr(self, name), kind):
                what = f"{type(getattr(self, name)).__name__} is no {kind.__name__}"
                raise InputError(what, where=f"`{name}`", hint="give a pyproj.CRS and an affine.Affine")
        if self.width < 1 or self.height < 1:
            raise InputError(
                f"a grid of {self.width} x {self.height} pixels has no area",
                hint="give bounds that are wider than a pixel",
            )
        if self.transform.determinant == 0:
            raise InputError("the grid's pixel size is zero", hint="give a pixel size above 0")

    @property
    def label(self) -> str:
        """Shape, pixel size and CRS in words, for one line."""
        return f"{self.width} x {self.height} px of {self.resolution[0]:g}, {crs_code(self.crs)}"

    def __repr__(self) -> str:
        return f"Grid({self.label}, from x {self.bounds[0]:.10g}, y {self.bounds[3]:.10g})"

    @classmethod
    def from_bounds(cls, crs: CRS, bounds: Bounds, resolution: float, *, snap: bool = True) -> Grid:
        """North-up grid that covers `bounds` (left, bottom, right, top) with square pixels.

        With `snap`, pixel edges fall on whole multiples of the resolution, so that independent runs overlay exactly.

        Parameters
        ----------
        crs : CRS
        bounds : Bounds
            Left, bottom, right, top in `crs`.
        resolution : float
            Pixel size in map units.
        snap : bool
            Pixel edges on whole multiples of the resolution, so that independent runs overlay exactly.
        """
        left, bottom, right, top = bounds
        if not (resolution > 0 and math.isfinite(resolution)):
            raise InputError(f"resolution {resolution} is not a positive number", hint="give `resolution` in map units")
        if not all(map(math.isfinite, bounds)) or left >= right or bottom >= top:
            raise InputError(f"bounds {bounds} enclose no area", hint="give left bottom right top in the output CRS")
        if snap:
            # A hair of tolerance keeps 12.000000001 from costing a column of empty pixels.
            # A millionth of a pixel is rounding of the bounds, and must not add a row or a column.
            left = math.floor(left / resolution + 1e-6) * resolution
            top = math.ceil(top / resolution - 1e-6) * resolution
        width = max(1, math.ceil((right - left) / resolution - 1e-6))
        height = max(1, math.ceil((top - bottom) / resolution - 1e-6))
        return cls(crs, Affine(resolution, 0.0, left, 0.0, -resolution, top), width, height)

    @classmethod
    def from_profile(cls, profile: Mapping[str, Any]) -> Grid:
        """Grid of a rasterio profile, `dataset.profile`.

        Parameters
        ----------
        profile : mapping
            With crs, transform, width and height; the CRS as anything pyproj understands.

        Raises
        ------
        InputError
            One of the four is missing.
        """
        missing = [name for name in ("crs", "transform", "width", "height") if profile.get(name) is None]
        if missing:
            raise InputError(
                f"the profile has no {' and no '.join(missing)}", where="profile", hint="take that of a placed raster"
            )
        return cls(
            _crs(profile["crs"]), Affine(*profile["transform"][:6]), int(profile["width"]), int(profile["height"])
        )

    def to_profile(self) -> dict[str, Any]:
        """Part of a rasterio profile: `crs` (WKT), `transform`, `width` and `height`."""
        return {"crs": self.crs.to_wkt(), "transform": self.transform, "width": self.width, "height": self.height}

    @classmethod
    def from_geobox(cls, geobox: Any) -> Grid:
        """Grid of an `odc.geo.geobox.GeoBox`, or of anything with crs, affine and shape as it has them.

        Parameters
        ----------
        geobox : object
        """
        height, width = geobox.shape
        return cls(_crs(geobox.crs), Affine(*geobox.affine[:6]), int(width), int(height))

    def to_geobox(self, geobox: Callable[..., Any] | None = None) -> Any:
        """GeoBox of the same place.

        Parameters
        ----------
        geobox : callable, optional
            Called with shape (rows, columns), affine and CRS (WKT); `odc.geo.geobox.GeoBox` unless given.

        Raises
        ------
        InputError
            None is given, and odc-geo is not installed.
        """
        if geobox is None:
            try:
                from odc.geo.geobox import GeoBox
            except ImportError:
                raise InputError("odc-geo is not installed", where="to_geobox", hint="pip install odc-geo") from None
            geobox = GeoBox
        return geobox(self.shape, self.transform, self.crs.to_wkt())

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, columns."""
        return self.height, self.width

    @property
    def window(self) -> Window:
        """The whole grid as a window."""
        return Window(0, 0, self.width, self.height)

    @property
    def resolution(self) -> tuple[float, float]:
        """Pixel size along columns and rows, in map units (positive)."""
        t = self.transform
        return math.hypot(t.a, t.d), math.hypot(t.b, t.e)

    @property
    def bounds(self) -> Bounds:
        """Left, bottom, right, top of all four corners."""
        corners = np.array([[0, 0], [self.width, 0], [0, self.height], [self.width, self.height]], dtype=np.float64)
        xy = self.xy(corners)
        return float(xy[:, 0].min()), float(xy[:, 1].min()), float(xy[:, 0].max()), float(xy[:, 1].max())

    def xy(self, colrow: FloatArray) -> FloatArray:
        """Pixel coordinates (N, 2), corner-based, to map coordinates (N, 2).

        Parameters
        ----------
        colrow : array (N, 2)
            Pixels, of which (0.5, 0.5) is the centre of the upper-left one.
        """
        t, p = self.transform, np.asarray(colrow, dtype=np.float64)
        return np.column_stack([t.a * p[:, 0] + t.b * p[:, 1] + t.c, t.d * p[:, 0] + t.e * p[:, 1] + t.f])

    def colrow(self, xy: FloatArray) -> FloatArray:
        """Map coordinates (N, 2) to pixel coordinates (N, 2), corner-based.

        Parameters
        ----------
        xy : array (N, 2)
            Map units.
        """
        t, p = ~self.transform, np.asarray(xy, dtype=np.float64)
        return np.column_stack([t.a * p[:, 0] + t.b * p[:, 1] + t.c, t.d * p[:, 0] + t.e * p[:, 1] + t.f])

    def crop(self, window: Window) -> Grid:
        """Grid of one window of this grid.

        Parameters
        ----------
        window : Window
        """
        return replace(
            self,
            transform=self.transform @ Affine.translation(window.col, window.row),
            width=window.width,
            height=window.height,
        )

    def coarser(self, factor: int) -> Grid:
        """Same area in pixels `factor` times as large, the last row and column reaching over.

        Parameters
        ----------
        factor : int
        """
        return replace(
            self,
            transform=self.transform @ Affine.scale(factor),
            width=-(-self.width // factor),
            height=-(-self.height // factor),
        )

    def window_of(self, bounds: Bounds) -> Window:
        """Smallest window, cut to the grid, that covers map bounds; it may be empty.

        Parameters
        ----------
        bounds : Bounds
            Left, bottom, right, top in map units.
        """
        left, bottom, right, top = bounds
        p = self.colrow(np.array([[left, bottom], [left, top], [right, bottom], [right, top]]))
        # Bounds on the edge of a pixel do not take its neighbour.
        low, high = np.floor(p.min(axis=0) + 1e-9), np.ceil(p.max(axis=0) - 1e-9)
        window = Window(int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))
        return window.intersection(self.window)


def _crs(given: Any) -> CRS:
    """CRS of another library, such as rasterio's or odc-geo's, which all write WKT."""
    if isinstance(given, CRS):
        return given
    try:
        return CRS.from_user_input(given.to_wkt() if hasattr(given, "to_wkt") else given)
    except CRSError as error:
        raise InputError(f"the grid's CRS is not one ({error})", hint="name one, for example EPSG:32633") from None
