"""Surface contract, surfaces of one height, and the stakes of an undeclared vertical datum."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from affine import Affine
from pyproj import CRS

from geomosaic.errors import HeightDatumError, InputError
from geomosaic.geo.crs import has_heights, horizontal, with_heights
from geomosaic.geo.grid import Bounds
from geomosaic.geo.transform import Transform
from geomosaic.types import Float32Array, FloatArray


@dataclass(frozen=True, eq=False)
class HeightPatch:
    """A window of heights for the sampling kernel.

    Attributes
    ----------
    heights : float32 array (rows, cols)
        Metres; NaN where unknown.
    transform : Affine
        Surface map (x, y) to patch (col, row), corner-based: a node's height holds at (col + 0.5, row + 0.5).
    """

    heights: Float32Array
    transform: Affine

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest known height; NaN where none is known."""
        low, high = (step.reduce(self.heights, None, initial=np.nan) for step in (np.fmin, np.fmax))
        return float(low), float(high)


class Surface(Protocol):
    """Heights z over (x, y)."""

    @property
    def crs(self) -> CRS:
        """3-D CRS of x, y and z."""

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest height in metres; every height lies between them."""

    def height(self, xy: FloatArray) -> FloatArray:
        """Heights (N,) at (N, 2) in `crs`; NaN where unknown."""

    def patch(self, bounds: Bounds, spacing: float = 0.0) -> HeightPatch:
        """Heights that cover bounds (left, bottom, right, top) in `crs`, with a margin for interpolation.

        They may be means over `spacing`, in units of the CRS: no more detail is needed.
        """


@dataclass(frozen=True)
class Plane:
    """A constant height above the vertical datum of its CRS: flat on the map, parallel to geoid or ellipsoid.

    Attributes
    ----------
    crs : CRS
        3-D; says what the height is above.
    z : float
        Metres.
    """

    crs: CRS
    z: float

    def __post_init__(self) -> None:
        if not np.isfinite(self.z):
            raise InputError(f"height {self.z} is not a number", hint="give a height in metres")
        if not has_heights(self.crs):
            raise HeightDatumError(
                f"height {self.z} m in '{self.crs.name}' has no vertical datum",
                hint="declare the heights: 'ellipsoidal', 'egm96', a vertical EPSG code or a geoid grid",
            )
        if self.crs.is_geocentric:
            raise InputError(
                "a height needs a map or geographic CRS, not a geocentric one",
                hint="give the map CRS in which the height holds",
            )

    @property
    def range(self) -> tuple[float, float]:
        """The height, twice."""
        return self.z, self.z

    def height(self, xy: FloatArray) -> FloatArray:
        """Heights (N,) at (N, 2) in `crs`; NaN where a coordinate is."""
        points = np.asarray(xy, dtype=np.float64)
        return np.where(np.isfinite(points[:, :2]).all(axis=1), self.z, np.nan)

    def patch(self, bounds: Bounds, spacing: float = 0.0) -> HeightPatch:
        """Heights that cover bounds (left, bottom, right, top) in `crs`, with a margin for interpolation."""
        return _constant_patch(self.z, bounds)


def _constant_patch(z: float, bounds: Bounds) -> HeightPatch:
    """Height patch of one height: nine nodes, the bounds being the cell in the middle."""
    left, bottom, right, top = bounds
    # A single place has no extent, and a transform without extent no inverse.
    width, height = max(right - left, 1e-3), max(top - bottom, 1e-3)
    to_map = Affine(width, 0.0, left - width, 0.0, -height, top + height)
    return HeightPatch(np.full((3, 3), z, dtype=np.float32), ~to_map)


def undulation(crs: CRS, x: float, y: float) -> float:
    """Height of the EGM96 geoid above the WGS 84 ellipsoid at a place of a map.

    Parameters
    ----------
    crs : CRS
        Of the map.
    x, y : float
        In `crs`.

    Returns
    -------
    float
        Metres; NaN where it cannot be known (a CRS that is not tied to the Earth, a place outside it).
    """
    wgs84 = CRS.from_epsg(4326)
    try:
        place = Transform(horizontal(crs), wgs84)(np.array([[x, y]]))
        geoid = Transform(with_heights(wgs84, "egm96"), CRS.from_epsg(4979))
        return float(geoid(np.column_stack([place, [0.0]]))[0, 2])
    except InputError:
        return math.nan


def undeclared_heights(crs: CRS, x: float, y: float, where: str) -> HeightDatumError:
    """Error for heights without a vertical datum, with what a wrong guess would cost at this place.

    Parameters
    ----------
    crs : CRS
        Horizontal, of the heights.
    x, y : float
        Place of the heights, in `crs`.
    where : str
        File or parameter at fault.

    Returns
    -------
    HeightDatumError
        Made, not raised.
    """
    shift = undulation(crs, x, y)
    size = ""
    if math.isfinite(shift):
        size = (
            f": whether they count from the geoid or from the ellipsoid makes {abs(shift):.1f} m here (EGM96), which "
            f"moves a place seen 30 degrees off nadir by {abs(shift) * math.tan(math.radians(30)):.1f} m"
        )
    return HeightDatumError(
        f"the heights have no vertical datum{size}",
        where=where,
        hint="say what they count from: `dem_heights`: ellipsoidal, egm96, EPSG:<vertical CRS>, or the path of a geoid "
        "grid",
    )
