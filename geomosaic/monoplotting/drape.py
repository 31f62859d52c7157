"""A map seen through a photo: places draped on the surface, where they fall in the image, and which are hidden."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import has_heights, horizontal
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import linear_unit, metres_per_unit
from geomosaic.sensor.model import SensorModel
from geomosaic.sensor.solve import image_to_ground
from geomosaic.sensor.solve.derivatives import pixel_step
from geomosaic.surface.model import Surface
from geomosaic.types import BoolArray, FloatArray

TOLERANCE = 0.05
"""Pixels' widths on the ground by which ground must be nearer to hide a place."""
UNSEEN, HIDDEN, SEEN = 0, 1, 2
"""What becomes of a place: the model cannot show it or its height is unknown; ground stands before it; it is shown."""


@dataclass(frozen=True)
class View:
    """A photo over a map.

    Attributes
    ----------
    model : SensorModel
    surface : Surface or None
        None where heights play no part.
    crs : CRS
        Of the map, 2-D.
    sampling : float
        Map units that one pixel covers in the middle of the image.
    spacing : float
        Distance of the surface's nodes in map units; inf where it has one height.
    """

    model: SensorModel
    surface: Surface | None
    crs: CRS
    sampling: float
    spacing: float

    @classmethod
    def of(cls, model: SensorModel, surface: Surface | None, crs: CRS) -> View:
        """Measure what one pixel covers."""
        flat = horizontal(crs)
        own = model.crs if surface is None else surface.crs
        middle = np.array([[model.size[0] / 2.0, model.size[1] / 2.0]])
        seen = image_to_ground(model, middle, surface)
        if not np.isfinite(seen).all():
            seen = Transform(model.crs, own)(np.array([model.seed])) if has_heights(own) else np.array([model.seed])
        place = Transform(horizontal(own), flat)(seen[:, :2])[0]
        draft = cls(model, surface, flat, 1.0, np.inf)

        def image(xy: FloatArray) -> FloatArray:
            ground = draft.ground(xy)
            ground[:, 2] = seen[0, 2]
            return draft.image(ground)

        step = pixel_step(image, place, 1.0 if flat.is_projected else 1e-5)
        return cls(model, surface, flat, step, _spacing(surface, flat, seen[0, :2]))

    def ground(self, xy: FloatArray) -> FloatArray:
        """Places (N, 2) of the map draped on the surface: (N, 3) in its CRS (the model's where there is none)."""
        own = self.model.crs if self.surface is None else self.surface.crs
        place = Transform(self.crs, horizontal(own))(np.asarray(xy, dtype=np.float64))
        heights = np.zeros(len(place)) if self.surface is None else self.surface.height(place)
        return np.column_stack([place, heights])

    def image(self, ground: FloatArray) -> FloatArray:
        """Image coordinates (N, 2) of draped places (N, 3); NaN where there are none."""
        if self.surface is None:
            return self.model.ground_to_image(ground)
        if has_heights(self.model.crs):
            return self.model.ground_to_image(Transform(self.surface.crs, self.model.crs)(ground))
        flat = Transform(horizontal(self.surface.crs), self.model.crs)(ground[:, :2])
        return self.model.ground_to_image(np.column_stack([flat, np.zeros(len(flat))]))

    def look(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image coordinates (N, 2) of places (N, 2) of the map, and what becomes of each (N,).

        A place is hidden where its line of sight meets the surface before it, by more than `TOLERANCE`.
        Places outside the frame are not examined: they count as seen.
        """
        ground = self.ground(xy)
        image = self.image(ground)
        state = np.where(np.isfinite(image).all(axis=1), SEEN, UNSEEN)
        if self.surface is None or not has_heights(self.model.crs):
            return image, state
        inside = np.flatnonzero((state == SEEN) & self.within(np.nan_to_num(image, nan=-1e9), 2.0))
        if len(inside):
            state[inside[self._hidden(ground[inside], image[inside])]] = HIDDEN
        return image, state

    def within(self, image: FloatArray, margin: float = 0.0) -> BoolArray:
        """Which image points (N, 2) lie in the frame, grown by a margin in pixels."""
        near = (image >= -margin) & (image <= np.array(self.model.size) + margin)
        inside: BoolArray = np.asarray(near.all(axis=1))
        return inside

    def _hidden(self, ground: FloatArray, image: FloatArray) -> BoolArray:
        assert self.surface is not None
        first = image_to_ground(self.model, image, self.surface)
        apart = (first - ground) * metres_per_unit(self.surface.crs, ground)
        tolerance = TOLERANCE * self.sampling * linear_unit(self.crs)
        hidden: BoolArray = (np.linalg.norm(apart, axis=1) > tolerance) & (apart[:, 2] > 0.0)
        return hidden


def _spacing(surface: Surface | None, crs: CRS, place: FloatArray) -> float:
    """Distance of a surface's nodes in units of a map; a surface that does not tell is asked for a patch at a place."""
    if surface is None or surface.range[0] == surface.range[1]:
        return np.inf
    known = getattr(surface, "spacing", None)
    if known is None:
        x, y = place
        t = surface.patch((x, y, x, y)).transform
        known = 1.0 / max(np.hypot(t.a, t.d), np.hypot(t.b, t.e))
    return float(known) * linear_unit(surface.crs) / linear_unit(crs)
