"""Sensor over a developed surface: (u, v, h) of the surface to the image, whatever the sensor.

The wrapped model is asked where it sees the surface's points; what it sees from behind, or too obliquely, is NaN. On a
convex body that is all the hiding there is: from outside a point is hidden by its own body where the line of sight
comes from behind the surface, and nowhere else; from inside nothing is hidden. The result is a sensor model like any
other, over the plane map (u, v): lattice, kernels, orthos and mosaics serve it unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import geocentric, geographic, has_heights, is_local
from geomosaic.geo.transform import Transform
from geomosaic.limits import Limits
from geomosaic.sensor import corrected as state_of
from geomosaic.sensor.plugin import HasRays, WrappedModel
from geomosaic.sensor.solve.inverse import image_to_height
from geomosaic.surface.developed.placement import Developed
from geomosaic.types import FloatArray

# Degrees between line of sight and normal beyond which nothing is drawn: a pixel is stretched six times there.
OBLIQUE = 80.0
OBLIQUE_LIMITS = Limits(above=0.0, below=90.0)
# Metres: of two places on a line of sight, and back along it to where it may well begin.
RISE, FAR = 10.0, 10_000.0


@dataclass(frozen=True, eq=False)
class DevelopedModel(WrappedModel):
    """A sensor model over a developed surface.

    Attributes
    ----------
    model : SensorModel
    surface : Developed
    sensor : str
        Name of the sensor plugin that `model` comes from, by which its state finds back.
    oblique : float
        Largest angle between the line of sight and the surface's normal that is drawn, degrees.
    """

    surface: Developed
    sensor: str
    oblique: float = OBLIQUE

    def __post_init__(self) -> None:
        OBLIQUE_LIMITS.check(self.oblique, "`oblique`")
        _ = self._to_model

    @property
    def crs(self) -> CRS:
        """3-D CRS of u, v and h."""
        return self.surface.crs

    @property
    def notes(self) -> tuple[str, ...]:
        """Those of the wrapped model."""
        return tuple(getattr(self.model, "notes", ()))

    @cached_property
    def seed(self) -> tuple[float, float, float]:
        """The drawn place nearest to the middle of the image; the origin where the image shows none."""
        places, pixels = self.seen()
        if not len(places):
            return 0.0, 0.0, 0.0
        nearest = int(np.argmin(np.hypot(*(pixels - np.array(self.size) / 2).T)))
        u, v = places[nearest]
        return float(u), float(v), 0.0

    @cached_property
    def _to_model(self) -> Transform | None:
        """From the Earth-centred frame to the model's; None where both are the same free local frame."""
        frame, crs = self.surface.frame, self.model.crs
        if not has_heights(crs):
            raise InputError(
                f"sensor '{self.sensor}' is a plane transformation, which sees no surface in space",
                hint="give a sensor with a projection centre, such as frame; a plane object alone can be rectified by "
                "`geomosaic georeference` with control points in its plane",
            )
        if (frame is None) != is_local(crs):
            hint = "give crs (and heights) in the surface file, and point, apex or centre in it"
            what = f"the surface stands in a local frame, the camera in '{crs.name}'"
            if frame is not None:
                what = f"the surface stands in '{frame.crs.name}', the camera in a local frame that is nowhere on Earth"
                hint = "leave crs out of the surface file, or give the CRS of the positions"
            raise InputError(what, hint=hint)
        return None if frame is None else Transform(frame.crs, crs)

    def _of_local(self, xyz: FloatArray) -> FloatArray:
        """Local frame (N, 3) to the model's CRS."""
        if self._to_model is None or self.surface.frame is None:
            return xyz
        return self._to_model(self.surface.frame.to_geocentric(xyz))

    def _to_local(self, xyz: FloatArray) -> FloatArray:
        """The model's CRS (N, 3) to the local frame."""
        if self._to_model is None or self.surface.frame is None:
            return xyz
        return self.surface.frame.to_enu(self._to_model.inverse()(xyz))

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Developed coordinates (N, 3) to image (N, 2); NaN where the surface is hidden or seen too obliquely."""
        uvh = np.asarray(xyz, dtype=np.float64)
        points = self.surface.point(uvh)
        image = self.model.ground_to_image(self._of_local(points))
        cosine = -(self.surface.normal(points) * self._sight(points, image)).sum(axis=1)
        with np.errstate(invalid="ignore"):
            image[~(cosine > np.cos(np.radians(self.oblique)))] = np.nan
        return image

    def _sight(self, points: FloatArray, image: FloatArray) -> FloatArray:
        """Unit directions (N, 3) in which points (N, 3) of the local frame are seen, local frame."""
        # From the origin of the ray of the image point, cut to the image: rays may be wild outside of it. A sensor
        # without rays is asked for the direction in which its image does not move; of its two senses that is taken in
        # which col, row and depth are right-handed, as in any picture that is not mirrored.
        if isinstance(self.model, HasRays):
            known = np.isfinite(image).all(axis=1)
            direction = np.full(points.shape, np.nan)
            if known.any():
                inside = np.clip(image[known], 0.0, np.array(self.size, dtype=np.float64))
                direction[known] = points[known] - self._to_local(self.model.rays(inside)[0])
        else:
            # A tenth of a metre both ways: far more than rounding, far less than the curvature of any image.
            step = 0.1
            slopes = []
            for axis in range(3):
                move = np.zeros(3)
                move[axis] = step
                ahead, behind = (self.model.ground_to_image(self._of_local(points + sign * move)) for sign in (1, -1))
                slopes.append((ahead - behind) / (2.0 * step))
            by = np.stack(slopes, axis=-1)
            direction = np.cross(by[:, 0], by[:, 1])
        with np.errstate(invalid="ignore", divide="ignore"):
            seen: FloatArray = direction / np.linalg.norm(direction, axis=1)[:, None]
        return seen

    def rays_in_local(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Lines of sight of image points (N, 2): origins and unit directions (N, 3) in the local frame."""
        # A sensor without rays stands far off: its line is drawn through two heights near the surface, `RISE` apart,
        # and starts `FAR` behind.
        if isinstance(self.model, HasRays):
            origins, directions = self.model.rays(colrow)
            start, end = self._to_local(origins), self._to_local(origins + directions)
        else:
            frame = self.surface.frame
            if frame is None:
                raise InputError(
                    "this sensor has no lines of sight in a local frame", hint="give crs in the surface file"
                )
            level = geographic(frame.crs)
            down = Transform(level, geocentric(frame.crs))
            here = Transform(frame.crs, level)(frame.to_geocentric(self.surface.axes.origin[None]))[0, 2]
            above, below = (image_to_height(self.model, colrow, here + rise, level) for rise in (RISE, 0.0))
            start, end = frame.to_enu(down(above)), frame.to_enu(down(below))
        with np.errstate(invalid="ignore"):
            along = end - start
            along = along / np.linalg.norm(along, axis=1)[:, None]
        return start if isinstance(self.model, HasRays) else end - FAR * along, along

    def origin(self) -> FloatArray | None:
        """Projection centre (3,) of the middle of the image in the local frame; None for a sensor without rays."""
        if not isinstance(self.model, HasRays):
            return None
        middle = np.array([[self.size[0] / 2, self.size[1] / 2]])
        place: FloatArray = self._to_local(self.model.rays(middle)[0])[0]
        return place

    def seen(self, across: int = 64) -> tuple[FloatArray, FloatArray]:
        """Drawn places (N, 2), u and v, and their pixels (N, 2): those of a net of pixels that show the surface."""
        width, height = self.size
        # Just inside the edges, where a pixel still counts as in the image.
        t = np.linspace(0.0, 1.0, across + 1) * (1 - 2e-9) + 1e-9
        c, r = np.meshgrid(t * width, t * height)
        pixels = np.column_stack([c.ravel(), r.ravel()])
        there = self.surface.meeting(*self.rays_in_local(pixels))
        uvh = self.surface.coordinates(there) * [1.0, 1.0, 0.0]
        shown = np.isfinite(self.ground_to_image(uvh)).all(axis=1)
        return uvh[shown, :2], pixels[shown]

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values, with the sensor's name."""
        wrapped = state_of.model_to_dict(self.sensor, self.model)
        return {"model": wrapped, "surface": self.surface.to_dict(), "oblique": self.oblique}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Model of a state, as `to_dict` gives it; the sensor's plugin must be installed."""
        inner, surface = state_of.model_from_dict(state["model"]), Developed.from_dict(state["surface"])
        return cls(inner, surface, state["model"]["sensor"], float(state["oblique"]))
