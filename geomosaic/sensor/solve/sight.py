"""Lines of sight of any sensor model, as map positions over height.

A line of sight is the locus P(h): the ground point at height h that the model maps onto a given image point. It is
found by Newton's method on (x, y) with h held, so it needs nothing but `ground_to_image`. Heights, x and y are those of
a 3-D map CRS; the model is reached through a `Transform`, so geoid and projection are exact at every point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic.errors import HeightDatumError
from geomosaic.geo.crs import has_heights, in_degrees
from geomosaic.geo.transform import Transform
from geomosaic.sensor.model import SensorModel
from geomosaic.sensor.solve.derivatives import pixel_step
from geomosaic.sensor.solve.newton import ACCEPTED, ROUGHLY, solve_pairs
from geomosaic.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class SightLines:
    """Lines of sight of N image points.

    Attributes
    ----------
    model : SensorModel
    colrow : array (N, 2)
        Pixels.
    to_model : Transform
        From the map CRS to `model.crs`.
    step : float
        Map units that move the image by about one pixel.
    height : float
        Height of the model's seed in the map CRS.
    xy : array (N, 2)
        The lines at that height; NaN where a line does not reach it.
    slope : array (N, 2)
        Change of xy per unit of height there: a line of sight is nearly straight, so this starts every other height.
    seed : array (2,)
        Map position of the model's seed.
    """

    model: SensorModel
    colrow: FloatArray
    to_model: Transform
    step: float
    height: float
    xy: FloatArray
    slope: FloatArray
    seed: FloatArray

    @classmethod
    def of(cls, model: SensorModel, colrow: FloatArray, crs: CRS) -> SightLines:
        """Find the lines at the height of the model's seed, started at the seed.

        Raises
        ------
        HeightDatumError
            The model needs heights and `crs` does not say what its heights are.
        """
        if has_heights(model.crs) and not has_heights(crs):
            raise HeightDatumError(
                f"the heights of '{crs.name}' have no vertical datum: they cannot meet a model in '{model.crs.name}'",
                mend="declare the heights: 'ellipsoidal', 'egm96', a vertical EPSG code or a geoid grid",
            )
        to_model = Transform(crs, model.crs)
        seed = to_model.inverse()(np.array([model.seed], dtype=np.float64))[0]
        image = np.asarray(colrow, dtype=np.float64).reshape(-1, 2)
        height = float(seed[2]) if has_heights(model.crs) else 0.0

        def near_seed(xy: FloatArray) -> FloatArray:
            return model.ground_to_image(to_model(np.column_stack([xy, np.full(len(xy), height)])))

        step = pixel_step(near_seed, seed[:2], 1e-5 if in_degrees(crs) else 1.0)
        unknown = np.full_like(image, np.nan)
        lines = cls(model, image, to_model, step, height, unknown, np.zeros_like(image), seed[:2])
        xy = lines._solve(np.arange(len(image)), np.full(len(image), height), np.tile(seed[:2], (len(image), 1)))
        if not has_heights(model.crs):
            return cls(model, image, to_model, step, height, xy, np.zeros_like(image), seed[:2])
        # A second height, as far off as moves the image by some pixels, gives the slope for all others.
        rise = 10.0 * step * (1e5 if in_degrees(crs) else 1.0)
        above = lines._solve(np.arange(len(image)), np.full(len(image), height + rise), xy)
        return cls(model, image, to_model, step, height, xy, (above - xy) / rise, seed[:2])

    def at(self, heights: FloatArray, rows: IntArray | None = None, start: FloatArray | None = None) -> FloatArray:
        """Map positions (M, 2) of the lines `rows` (M,) at heights (M,); NaN where a line does not reach the height.

        `start` (M, 2) gives better first guesses than the lines' slopes. Solutions are as good as rounding allows. That
        is not 1e-6 pixel close to the projection centre, where a search may pass but no result may lie: see `exact`.
        """
        which = np.arange(len(self.colrow)) if rows is None else rows
        known = np.isfinite(self.xy[which, 0]) & np.isfinite(self.slope[which, 0])
        guess = np.where(
            known[:, None], self.xy[which] + self.slope[which] * (heights - self.height)[:, None], self.seed
        )
        # No other start: from elsewhere Newton may end where the line leaves the Earth again, on its far side.
        return self._solve(which, heights, guess if start is None else start)

    def _solve(self, rows: IntArray, heights: FloatArray, start: FloatArray) -> FloatArray:
        def evaluate(xy: FloatArray, index: IntArray) -> FloatArray:
            return self.model.ground_to_image(self.to_model(np.column_stack([xy, heights[index]])))

        return solve_pairs(evaluate, self.colrow[rows], start, self.step, ROUGHLY)

    def exact(self, xyz: FloatArray) -> BoolArray:
        """Which of the map points (N, 3) fall on the image points of their lines within 1e-6 pixel."""
        off = np.abs(self.model.ground_to_image(self.to_model(xyz)) - self.colrow)
        return (off[:, 0] <= ACCEPTED) & (off[:, 1] <= ACCEPTED)
