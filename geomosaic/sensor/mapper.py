"""From the output map and a surface's heights to the image, through every CRS in between."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import has_heights, horizontal
from geomosaic.geo.domain import domain, limits
from geomosaic.geo.transform import Transform
from geomosaic.geo.turn import near, whole_turn
from geomosaic.sensor.model import SensorModel
from geomosaic.types import FloatArray

BACK = 10.0
"""Map units by which a place that is brought to degrees and back may miss itself; one beyond the rim is far away."""
SLIVER = 1e-9
"""Degrees along a seam that belong to neither side."""


@dataclass(frozen=True, eq=False)
class MapToImage:
    """Map (x, y) of the output and height z of the surface to image (col, row).

    The map point is first brought to the surface's own map, where z has its meaning; only then do both go together to
    the model's frame. So heights never change their datum by accident.

    Attributes
    ----------
    model : SensorModel
    to_surface : Transform
        Output map → horizontal CRS of the surface (or of the model, where heights play no part).
    to_model : Transform
        Surface CRS → CRS of the model.
    turn : float, optional
        A whole turn of longitude, where the image lies in longitude and latitude: of places that are the same, the one
        nearest to its middle is meant.
    from_surface : Transform, optional
        The way back, where the output is a map of the globe and the image lies in longitude and latitude: a place
        beyond the rim of the map, which some projections take for one on the other side, does not come back.
    seam : tuple of float, optional
        Of a cylindrical map, x in the middle and its longitude: a place beyond one side goes on from there.
    branch : float
        Longitudes are those near the image's middle and so much farther east: half a turn brings together what lies
        on both sides of the seam of a picture of the whole globe.
    """

    model: SensorModel
    to_surface: Transform
    to_model: Transform
    turn: float | None = None
    from_surface: Transform | None = None
    seam: tuple[float, float] | None = None
    branch: float = 0.0

    @classmethod
    def between(cls, output: CRS, surface: CRS | None, model: SensorModel) -> MapToImage:
        """Chain output map, surface (None: heights play no part) and model."""
        if surface is None or not has_heights(model.crs):
            flat = horizontal(model.crs)
            there, turn = Transform(horizontal(output), flat), whole_turn(flat)
            if turn is None or not output.is_projected:
                return cls(model, there, Transform(flat, flat), turn)
            map_, shown = horizontal(output), domain(horizontal(output))
            back = there.inverse() if shown.folds else None
            return cls(model, there, Transform(flat, flat), turn, back, _seam(map_, there) if shown.torn else None)
        return cls(model, Transform(horizontal(output), horizontal(surface)), Transform(surface, model.crs))

    @property
    def uses_heights(self) -> bool:
        """Whether the image position depends on height."""
        return self.to_model.spatial

    def surface_xy(self, xy: FloatArray) -> FloatArray:
        """Output map (N, 2) to the surface's map (N, 2)."""
        found = self.to_surface(xy)
        if self.from_surface is not None:
            away = np.abs(self.from_surface(found) - xy).max(axis=1)
            found[~(away < BACK)] = np.nan
        if self.turn is None:
            return found
        if self.seam is None:
            return near(found, self.model.seed[0] + self.branch, self.turn)
        return self._beside_the_seam(xy, found, self.turn, *self.seam)

    def _beside_the_seam(self, xy: FloatArray, found: FloatArray, turn: float, x: float, middle: float) -> FloatArray:
        """Longitudes that go on beyond the sides of a map, turned as those just within are."""
        side = np.where(xy[:, 0] < x, -1.0, 1.0)
        off = (found[:, 0] - middle + turn / 2) % turn - turn / 2
        off += side * turn * (side * off < -turn / 4)
        within = found.copy()
        within[:, 0] = middle + np.clip(off, -turn / 2 + SLIVER, turn / 2 - SLIVER)
        turned = near(within, self.model.seed[0] + self.branch, turn)
        turned[:, 0] += middle + off - within[:, 0]
        return turned

    def beside(self) -> tuple[MapToImage, MapToImage]:
        """The same with longitudes west and east of the image's seam, where this one has a turn."""
        half = (self.turn or 0.0) / 2
        return replace(self, branch=-half), replace(self, branch=half)

    def torn(self, places: FloatArray) -> bool:
        """Whether longitudes of neighbours in an array (rows, cols, 2) of surface places jump by a turn."""
        if self.turn is None:
            return False
        with np.errstate(invalid="ignore"):
            return any(bool((np.abs(np.diff(places[..., 0], axis=k)) > self.turn / 2).any()) for k in (0, 1))

    def image(self, surface_xy: FloatArray, z: FloatArray) -> FloatArray:
        """Surface map (N, 2) and heights (N,) to image (N, 2)."""
        return self.model.ground_to_image(self.to_model(np.column_stack([surface_xy, z])))

    def __call__(self, xy: FloatArray, z: FloatArray) -> FloatArray:
        """Output map (N, 2) and surface heights (N,) to image (N, 2)."""
        return self.image(self.surface_xy(xy), z)


def _seam(output: CRS, there: Transform) -> tuple[float, float] | None:
    """X in the middle of a cylindrical map, and its longitude."""
    left, bottom, right, top = limits(output)
    middle = (left + right) / 2
    longitude = float(there(np.array([[middle, (bottom + top) / 2]]))[0, 0])
    return (middle, longitude) if np.isfinite(longitude) else None
