"""A polygon in image coordinates beyond which pixels are not to be used."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from affine import Affine
from rasterio.features import rasterize

from geomosaic.geo.grid import Window
from geomosaic.types import AnyArray


class Usable:
    """The part of an image that may be used.

    Parameters
    ----------
    ring : sequence of (col, row)
        Its corners, in order.
    """

    def __init__(self, ring: Sequence[tuple[float, float]]) -> None:
        import shapely

        self._area = shapely.Polygon(ring)
        shapely.prepare(self._area)

    def mask(self, window: Window, mask: AnyArray | None) -> AnyArray | None:
        """Mask (rows, cols) of a window, 0 where not valid, with what lies outside added; None where all is valid."""
        import shapely

        if self._area.covers(shapely.box(window.col, window.row, window.stop_col, window.stop_row)):
            return mask
        shape, place = (window.height, window.width), Affine.translation(window.col, window.row)
        inside: AnyArray = rasterize([(self._area, 1)], out_shape=shape, transform=place, fill=0, dtype="uint8")
        return inside if mask is None else np.where(inside > 0, mask, 0)
