"""Map points draped on the surface and projected into a photo, with occlusion."""

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
"""Ground pixels by which the surface must be in front of a point to occlude it: below lies the solver's noise."""
NO_IMAGE, OCCLUDED, VISIBLE = 0, 1, 2
"""States of a point: no image or no height; occluded by the surface; visible."""


@dataclass(frozen=True)
class View:
    """Projection of map points into one photo over a surface.

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
        """View whose sampling is measured in the middle of the image."""
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
        """Map points (N, 2) draped on the surface: (N, 3) in its CRS, or in the model's without a surface."""
        own = self.model.crs if self.surface is None else self.surface.crs
        place = Transform(self.crs, horizontal(own))(np.asarray(xy, dtype=np.float64))
        heights = np.zeros(len(place)) if self.surface is None else self.surface.height(place)
        return np.column_stack([place, heights])

    def image(self, ground: FloatArray) -> FloatArray:
        """Image coordinates (N, 2) of draped points (N, 3), pixels; NaN where there are none."""
        if self.surface is None:
            return self.model.ground_to_image(ground)
        if has_heights(self.model.crs):
            return self.model.ground_to_image(Transform(self.surface.crs, self.model.crs)(ground))
        flat = Transform(horizontal(self.surface.crs), self.model.crs)(ground[:, :2])
        return self.model.ground_to_image(np.column_stack([flat, np.zeros(len(flat))]))

    def look(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image coordinates (N, 2) of map points (N, 2), pixels, and the state (N,) of each.

        A point is occluded where its line of sight meets the surface before it, by more than `TOLERANCE`.
        Points outside the frame are not examined: they count as visible.
        """
        ground = self.ground(xy)
        image = self.image(ground)
        state = np.where(np.isfinite(image).all(axis=1), VISIBLE, NO_IMAGE)
        if self.surface is None or not has_heights(self.model.crs):
            return image, state
        inside = np.flatnonzero((state == VISIBLE) & self.within(np.nan_to_num(image, nan=-1e9), 2.0))
        if len(inside):
            state[inside[self._hidden(ground[inside], image[inside])]] = OCCLUDED
        return image, state

    def within(self, image: FloatArray, margin: float = 0.0) -> BoolArray:
        """Mask (N,) of image points (N, 2) within the frame, enlarged by a margin in pixels."""
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
    """Node spacing of a surface in map units; if it has no attribute `spacing`, that of a patch at `place`."""
    if surface is None or surface.range[0] == surface.range[1]:
        return np.inf
    known = getattr(surface, "spacing", None)
    if known is None:
        x, y = place
        t = surface.patch((x, y, x, y)).transform
        known = 1.0 / max(np.hypot(t.a, t.d), np.hypot(t.b, t.e))
    return float(known) * linear_unit(surface.crs) / linear_unit(crs)
