"""What an adjustment of a block gives: each photo's transformation, and how well it is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomosaic.adjust.planar.equations import Views
from geomosaic.adjust.planar.kinds import NAMES, by_parameters
from geomosaic.adjust.planar.transform import Frame, PlanarTransform, photo_coordinates
from geomosaic.adjust.planar.values import PlanarBlock
from geomosaic.types import FloatArray


@dataclass(frozen=True, eq=False)
class PlanarSolution:
    """An adjusted block.

    Attributes
    ----------
    block : PlanarBlock
    kind : str
    frame : Frame
        Normalised ground coordinates of `values` and `cofactors`.
    values : array (K, P)
        Parameters of each photo, normalised photo → normalised ground, see `kinds`.
    cofactors : mapping of (int, int) to array (P, P)
        Of the parameters of two photos that show a common point, by their numbers; zeros where a photo is held fixed.
        Times `sigma0`², or as they are where the standard deviations of the measurements are trusted, they are
        covariances.
    views : Views
        The measurements.
    points : array (M, 2)
        Adjusted map position of each of `views.ids`.
    residuals : array (N, 2)
        Measured minus computed (col, row) of each view in pixels; NaN for ground coordinates.
    standardised : array (N, 2)
        The same over their own standard deviations, a-priori; NaN where no redundancy controls a measurement.
    sigma0 : float
        Standard deviation of unit weight: 1 where the measurements are as good as their sigmas say; NaN without
        redundancy.
    redundancy : int
        Independent equations less unknowns.
    equations : int
        Observation equations (9-3) and (9-4) that were written.
    condition : float
        Condition number of the design with columns of unit length.
    rounds : int
        Solutions of the normal equations it took.
    """

    block: PlanarBlock
    kind: str
    frame: Frame
    values: FloatArray
    cofactors: Mapping[tuple[int, int], FloatArray]
    views: Views
    points: FloatArray
    residuals: FloatArray
    standardised: FloatArray
    sigma0: float
    redundancy: int
    equations: int
    condition: float
    rounds: int

    @cached_property
    def transforms(self) -> dict[str, PlanarTransform]:
        """Transformation of each photo, by name."""
        return {
            photo.name: PlanarTransform(photo, self.kind, self.frame, values)
            for photo, values in zip(self.block.photos, self.values, strict=True)
        }

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the columns of `values`."""
        return NAMES[self.kind]

    def sigmas(self, photo: str) -> FloatArray:
        """A-priori standard deviations (P,) of a photo's `values`."""
        number = self.block.index[photo]
        spread: FloatArray = np.sqrt(np.diag(self.cofactors[number, number]))
        return spread

    def position_sigmas(self, photo: str, colrow: FloatArray) -> FloatArray:
        """A-priori standard deviations (N,) in map units of where image places (N, 2) lie: √((σX² + σY²)/2)."""
        number = self.block.index[photo]
        xy = photo_coordinates(self.block.photos[number].size, colrow)
        by = by_parameters(self.kind, self.values[number], xy)
        variance = np.einsum("nip,pq,niq->n", by, self.cofactors[number, number], by) / 2.0
        spread: FloatArray = np.sqrt(variance) * self.frame.scale
        return spread

    @property
    def rms(self) -> float:
        """Root mean square length of the residuals, pixels."""
        lengths = (self.residuals[~self.views.is_ground] ** 2).sum(axis=1)
        return float(np.sqrt(lengths.mean())) if len(lengths) else float("nan")
