"""One height everywhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from affine import Affine
from pyproj import CRS

from geomosaic.errors import HeightDatumError, InputError
from geomosaic.geo.crs import has_heights
from geomosaic.geo.grid import Bounds
from geomosaic.surface.model import HeightPatch
from geomosaic.types import FloatArray


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
            raise InputError(f"height {self.z} is not a number", mend="give a height in metres")
        if not has_heights(self.crs):
            raise HeightDatumError(
                f"height {self.z} m in '{self.crs.name}' has no vertical datum",
                mend="declare the heights: 'ellipsoidal', 'egm96', a vertical EPSG code or a geoid grid",
            )
        if self.crs.is_geocentric:
            raise InputError("a height needs a map or geographic CRS, not a geocentric one")

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
        return constant_patch(self.z, bounds)


def constant_patch(z: float, bounds: Bounds) -> HeightPatch:
    """Nine nodes of one height; the bounds are the cell in the middle."""
    left, bottom, right, top = bounds
    width, height = max(right - left, 1e-3), max(top - bottom, 1e-3)
    to_map = Affine(width, 0.0, left - width, 0.0, -height, top + height)
    return HeightPatch(np.full((3, 3), z, dtype=np.float32), ~to_map)
