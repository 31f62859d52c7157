"""Monoplotting: places on the ground from pixels, in pixel axes of any program; lengths on a map in metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pyproj import CRS
from pyproj.crs import CompoundCRS

from geomosaic.errors import HeightDatumError
from geomosaic.geo.crs import has_heights, horizontal, with_heights
from geomosaic.geo.transform import Transform
from geomosaic.monoplotting.uncertainty import Ellipses, InputUncertainty, ellipses
from geomosaic.sensor.model import SensorModel
from geomosaic.sensor.solve import image_to_ground
from geomosaic.surface.model import Surface
from geomosaic.types import BoolArray, FloatArray


@dataclass(frozen=True)
class Places:
    """Where image points lie on the ground.

    Attributes
    ----------
    crs : CRS
        Of `xyz`; its vertical part says what z counts from. 2-D where heights play no part.
    colrow : array (N, 2)
        Pixels.
    xyz : array (N, 3)
        NaN where the line of sight meets no known ground; z is 0 where heights play no part.
    ellipses : Ellipses
        NaN where no part of the error is known.
    """

    crs: CRS
    colrow: FloatArray
    xyz: FloatArray
    ellipses: Ellipses

    @property
    def seen(self) -> BoolArray:
        """Which points (N,) have a place."""
        return np.asarray(np.isfinite(self.xyz).all(axis=1), dtype=np.bool_)


def locate(
    model: SensorModel, surface: Surface | None, colrow: FloatArray, crs: CRS, uncertainty: InputUncertainty
) -> Places:
    """Find the places that image points show.

    Parameters
    ----------
    model : SensorModel
    surface : Surface or None
        None for models without heights.
    colrow : array (N, 2)
        Pixels; (0.5, 0.5) is the centre of the upper-left one.
    crs : CRS
        Of the result, see `ground_crs`.
    uncertainty : InputUncertainty
    """
    image = np.asarray(colrow, dtype=np.float64).reshape(-1, 2)
    ground = image_to_ground(model, image, surface)
    own = model.crs if surface is None else surface.crs
    if has_heights(crs) and has_heights(own):
        xyz = Transform(own, crs)(ground)
    else:
        xyz = np.column_stack([Transform(horizontal(own), horizontal(crs))(ground[:, :2]), ground[:, 2]])
    xyz[~np.isfinite(xyz).all(axis=1)] = np.nan
    found = ellipses(model, surface, crs, xyz, uncertainty)
    if not uncertainty.known:
        found = Ellipses(np.full((len(xyz), 3, 3), np.nan))
    return Places(crs, image, xyz, found)


def ground_crs(model: SensorModel, surface: Surface | None, crs: CRS | None, heights: str | None) -> CRS:
    """Choose the CRS of places: what is asked for, and the rest as the surface has it.

    Parameters
    ----------
    model : SensorModel
    surface : Surface or None
    crs : CRS, optional
        Asked for; a vertical part of its own holds.
    heights : str, optional
        Vertical datum asked for.

    Raises
    ------
    HeightDatumError
        A vertical datum is asked for where heights play no part.
    """
    own = model.crs if surface is None else surface.crs
    if not has_heights(own):
        if heights is not None:
            raise HeightDatumError(
                "heights play no part here, so they have no vertical datum", where="`dst_heights`", hint="leave it out"
            )
        return own if crs is None else horizontal(crs)
    chosen = own if crs is None else crs
    if heights is not None:
        return with_heights(chosen, heights, "`dst_heights`")
    if has_heights(chosen):
        return chosen
    if own.is_compound:
        vertical = own.sub_crs_list[1]
        return CompoundCRS(f"{chosen.name} + {vertical.name}", [chosen, vertical])
    return chosen.to_3d()


ROWS = ("down", "negative", "up")
"""Rows count down from the top edge; the same with a minus sign, as QGIS shows images without georeference; or up from
the bottom edge."""


@dataclass(frozen=True)
class PixelAxes:
    """How a file counts pixels.

    Attributes
    ----------
    height : int
        Of the image, pixels.
    rows : str
        One of `ROWS`.
    first : float
        What it calls the centre of the first pixel: 0.5, as everywhere in geomosaic, 0 or 1.
    """

    height: int
    rows: str = "down"
    first: float = 0.5

    def colrow(self, xy: FloatArray) -> FloatArray:
        """Coordinates of the file (N, 2) to (col, row)."""
        return self._turned(np.asarray(xy, dtype=np.float64)) + (0.5 - self.first) * np.array([1.0, self._down])

    def xy(self, colrow: FloatArray) -> FloatArray:
        """(col, row) (N, 2) to coordinates of the file."""
        return self._turned(np.asarray(colrow, dtype=np.float64) - (0.5 - self.first) * np.array([1.0, self._down]))

    @property
    def _down(self) -> float:
        """An offset of the count goes with the count: up, where rows count up."""
        return -1.0 if self.rows == "up" else 1.0

    def _turned(self, points: FloatArray) -> FloatArray:
        """Turn the direction of rows; doing it twice undoes it."""
        if self.rows == "down":
            return points[:, :2].copy()
        start = self.height if self.rows == "up" else 0.0
        return np.column_stack([points[:, 0], start - points[:, 1]])
