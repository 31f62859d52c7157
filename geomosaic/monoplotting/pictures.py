"""Pictures to digitize in: a map, a georeferenced raster in its own pixels, or a raw photo over a surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from affine import Affine
from pyproj import CRS

from geomosaic.geo.crs import horizontal
from geomosaic.geo.transform import Transform
from geomosaic.monoplotting.line_drawing import View
from geomosaic.monoplotting.places import outside_image
from geomosaic.sensor.solve import image_to_ground
from geomosaic.types import FloatArray

# Image pixels between the samples of a line drawn on a photo; pixels that leaving samples out may move it by.
_SAMPLES, _SIMPLER = 4.0, 0.05


class Picture(Protocol):
    """Coordinates in which features of a layer are shown and drawn."""

    @property
    def sampling(self) -> float | None:
        """Distance of the samples of a line, picture units; None where its straight lines are those of the layer."""
        ...

    @property
    def tolerance(self) -> float:
        """Layer units within which a vertex lies on an edge, and leaving out samples may move a line."""
        ...

    def shown(self, xy: FloatArray) -> FloatArray:
        """Picture coordinates (N, 2) of places (N, 2) of the layer; NaN where there are none."""
        ...

    def drawn(self, places: FloatArray) -> FloatArray:
        """Places (N, 2) of the layer at picture coordinates (N, 2); NaN where there are none."""
        ...


@dataclass(frozen=True)
class MapPicture:
    """Map in a CRS.

    Attributes
    ----------
    layer, map : CRS
        2-D.
    """

    layer: CRS
    map: CRS
    sampling = None  # vertices alone are carried between the two CRS

    @property
    def tolerance(self) -> float:
        """Rounding of coordinates."""
        return 1e-10 if self.layer.is_geographic else 1e-5

    def shown(self, xy: FloatArray) -> FloatArray:
        """Map places (N, 2)."""
        return Transform(self.layer, self.map)(xy)

    def drawn(self, places: FloatArray) -> FloatArray:
        """Places of the layer (N, 2)."""
        return Transform(self.map, self.layer)(places)


@dataclass(frozen=True)
class RasterPicture:
    """Georeferenced raster in its own pixels, as orthos and map sheets in another CRS are shown.

    Attributes
    ----------
    map : MapPicture
        With the raster's CRS.
    transform : Affine
        Pixels to its CRS.
    """

    map: MapPicture
    transform: Affine
    sampling = None  # vertices alone are carried

    @property
    def tolerance(self) -> float:
        """Rounding of coordinates."""
        return self.map.tolerance

    def shown(self, xy: FloatArray) -> FloatArray:
        """Pixels (N, 2)."""
        return _moved(~self.transform, self.map.shown(xy))

    def drawn(self, places: FloatArray) -> FloatArray:
        """Places of the layer (N, 2)."""
        return self.map.drawn(_moved(self.transform, places))


@dataclass(frozen=True)
class PhotoPicture:
    """Raw photo whose lines of sight meet a surface.

    Attributes
    ----------
    view : View
        With the CRS of the layer.
    """

    view: View

    @property
    def sampling(self) -> float:
        """Pixels: no farther apart than the nodes of the surface."""
        return float(np.clip(self.view.spacing / self.view.sampling, 1.0, _SAMPLES))

    @property
    def tolerance(self) -> float:
        """A fraction of a pixel on the ground."""
        return _SIMPLER * self.view.sampling

    def shown(self, xy: FloatArray) -> FloatArray:
        """Pixels (N, 2) of places draped on the surface, hidden ones too."""
        return self.view.image(self.view.ground(xy))

    def drawn(self, places: FloatArray) -> FloatArray:
        """Places (N, 2) that pixels of the photo show; NaN beyond the known heights and outside of the photo."""
        model, surface = self.view.model, self.view.surface
        inside = np.where(outside_image(places, model.size)[:, None], np.nan, places)
        ground = image_to_ground(model, inside, surface)
        own = model.crs if surface is None else surface.crs
        xy: FloatArray = Transform(horizontal(own), self.view.crs)(ground[:, :2])
        xy[~np.isfinite(ground).all(axis=1)] = np.nan
        return xy


def _moved(transform: Affine, places: FloatArray) -> FloatArray:
    x, y = places.T
    t = transform
    return np.column_stack([t.a * x + t.b * y + t.c, t.d * x + t.e * y + t.f])
