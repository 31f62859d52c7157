"""A strip without a place: nominal numbers alone remove skew and tangential distortion, in relative metres.

The map is one of its own. Its origin is the ground below the scanner at the middle of the image, x runs along the
middle line of scan to the right of the flight and y ahead, both in metres. An aircraft's ground is a level plane; a
satellite's is the ellipsoid, and x, y are distance and direction on it from the origin (azimuthal equidistant).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import geographic
from geomosaic.geo.transform import Transform
from geomosaic.sensor.parameters import Parameters
from geomosaic.types import FloatArray
from geomosaic_panoramic.model import PanoramicModel

LOCAL = (
    'ENGCRS["relative metres of a scanned strip",EDATUM["ground below the scanner at the middle of the strip"],'
    'CS[Cartesian,2],AXIS["across (X)",east,ORDER[1]],AXIS["ahead (Y)",north,ORDER[2]],LENGTHUNIT["metre",1]]'
)
SAID = "relative metres: x across, y ahead of the scanner; the strip has no place and no north on the Earth"


@dataclass(frozen=True)
class RelativeStrip:
    """A strip over ground of one height, in a map of its own.

    Attributes
    ----------
    model : PanoramicModel
        At a nominal place.
    above : float
        Height of the nominal position above the ground, metres.
    curved : bool
        Whether the ground is the ellipsoid rather than a plane.
    """

    model: PanoramicModel
    above: float
    curved: bool

    @property
    def crs(self) -> CRS:
        """The strip's own map."""
        return CRS.from_wkt(LOCAL)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.model.size

    @property
    def parameters(self) -> Parameters:
        """Those of the strip."""
        return self.model.parameters

    @property
    def seed(self) -> tuple[float, float, float]:
        """Where the strip's own lies in this map."""
        place = np.array([self.model.seed])
        east, north, _ = (self._from_map.inverse()(place) if self.curved else self.model.frame.to_enu(place))[
            0
        ].tolist()
        c, s = math.cos(self.heading), math.sin(self.heading)
        return c * east - s * north, s * east + c * north, 0.0

    @property
    def notes(self) -> tuple[str, ...]:
        """What the map is."""
        return (SAID,)

    @cached_property
    def heading(self) -> float:
        """Direction of the nose at the middle of the image, radians clockwise from true north."""
        flight, now = self.model.track, np.zeros(1)
        east, north, _ = flight.to_enu(np.array([[1.0, 0.0, 0.0]]), now)[0]
        return float(np.arctan2(east, north))

    @cached_property
    def _from_map(self) -> Transform:
        frame = self.model.frame
        longitude, latitude, _ = Transform(frame.crs, geographic(frame.crs))(frame.origin[None])[0].tolist()
        base = geographic(frame.crs).ellipsoid
        shape = f"+a={base.semi_major_metre} +b={base.semi_minor_metre}" if base else "+ellps=WGS84"
        text = f"+proj=aeqd +lat_0={latitude!r} +lon_0={longitude!r} {shape} +units=m +type=crs"
        return Transform(CRS.from_proj4(text).to_3d(), _earth(shape))

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Map (N, 2 or more) to image (N, 2); heights play no part."""
        x, y = np.asarray(xyz, dtype=np.float64)[:, :2].T
        c, s = np.cos(self.heading), np.sin(self.heading)
        east, north = c * x + s * y, -s * x + c * y
        if self.curved:
            return self.model.ground_to_image(self._from_map(np.column_stack([east, north, np.zeros_like(x)])))
        return self.model.ground_to_image(
            self.model.frame.to_geocentric(np.column_stack([east, north, np.full_like(x, -self.above)]))
        )

    def with_values(self, values: FloatArray) -> Self:
        """Return the strip with other parameter values."""
        return replace(self, model=self.model.with_values(values))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"relative": {"model": self.model.to_dict(), "above": self.above, "curved": self.curved}}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Rebuild from `to_dict`."""
        inner = state["relative"]
        return cls(PanoramicModel.from_dict(inner["model"]), inner["above"], inner["curved"])


def _earth(shape: str) -> CRS:
    return CRS.from_proj4(f"+proj=geocent {shape} +units=m +type=crs")
