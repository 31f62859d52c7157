"""Tie point correction of RPCs: several scenes corrected so that their lines of sight meet in tie points.

Every tie point has three unknown ground coordinates, which its measurements are freed of by a projection; what is left
depends on the corrections alone. Where all scenes together lie is not seen by tie points: an a-priori sigma of the
corrections keeps them near zero, as a free network (Grodecki and Dial 2003, with a-priori values of the producer).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.estimation.equations import Equations
from geomosaic.estimation.solver import Unknowns
from geomosaic.sensor.solve import image_to_height
from geomosaic.types import BoolArray, FloatArray, IntArray
from geomosaic_rpc.model import KINDS, NAMES, WGS84, RpcModel

UNITS = np.array([1e-5, 1e-5, 1.0])
"""Degrees and metres that count as one: each about a metre on the ground."""

_ROUNDS = 12


@dataclass(frozen=True)
class TieMeasurements:
    """Measurements of tie points.

    Attributes
    ----------
    image, point : int array (M,)
        Which image and which tie point each measurement is of, from 0.
    colrow : array (M, 2)
        Pixels.
    """

    image: IntArray
    point: IntArray
    colrow: FloatArray

    @property
    def points(self) -> int:
        """Number of tie points."""
        return int(self.point.max(initial=-1)) + 1

    def seen_by(self, models: Sequence[RpcModel], ground: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals of the measurements and their derivatives.

        Parameters
        ----------
        models : sequence of RpcModel
        ground : array (T, 3)
            Tie points: longitude, latitude in degrees, ellipsoidal height in metres.

        Returns
        -------
        residuals : array (M, 2)
            Measured minus computed, pixels.
        by_parameters : array (M, 2, 6)
        by_ground : array (M, 2, 3)
            Pixels per `UNITS` of ground, about a metre each.
        """
        residuals = np.full_like(self.colrow, np.nan)
        by_parameters, by_ground = np.zeros((len(self.colrow), 2, 6)), np.zeros((len(self.colrow), 2, 3))
        for index, model in enumerate(models):
            rows = self.image == index
            here = ground[self.point[rows]]
            residuals[rows] = self.colrow[rows] - model.ground_to_image(here)
            by_parameters[rows], by_ground[rows] = model.jacobian(here)
        return residuals, by_parameters, by_ground * UNITS


def intersect(
    models: Sequence[RpcModel],
    sights: TieMeasurements,
    sigma_px: float,
    sigma_height: float,
    start: FloatArray | None = None,
) -> FloatArray:
    """Intersection of lines of sight: ground points whose images are nearest to the measurements.

    Parameters
    ----------
    models : sequence of RpcModel
    sights : TieMeasurements
        At least two of each point.
    sigma_px, sigma_height : float
        Standard deviations of a measurement in pixels, and of the height about that of the scenes' seeds in metres; the
        latter decides only where lines of sight are nearly parallel.
    start : array (T, 3), optional
        Approximate ground; that of each point's first measurement at the height of the seeds unless given.

    Returns
    -------
    array (T, 3)
        Longitude, latitude, ellipsoidal height; NaN where a line of sight reaches no ground.
    """
    middle = float(np.mean([model.seed[2] for model in models]))
    ground = _start(models, sights, middle) if start is None else start.copy()
    for _ in range(_ROUNDS):
        residuals, _, by_ground = sights.seen_by(models, ground)
        normal = np.zeros((sights.points, 3, 3))
        right = np.zeros((sights.points, 3))
        weighted = by_ground / sigma_px**2
        np.add.at(normal, sights.point, np.einsum("mij,mik->mjk", weighted, by_ground))
        np.add.at(right, sights.point, np.einsum("mij,mi->mj", weighted, residuals))
        normal[:, 2, 2] += 1.0 / sigma_height**2
        right[:, 2] += (middle - ground[:, 2]) / sigma_height**2
        good = np.isfinite(right).all(axis=1) & np.isfinite(normal).all(axis=(1, 2))
        step = np.full_like(ground, np.nan)
        step[good] = np.linalg.solve(normal[good], right[good][:, :, None])[:, :, 0]
        ground = ground + step * UNITS
        if not np.nanmax(np.abs(step), initial=0.0) > 1e-6:
            break
    return ground


def _start(models: Sequence[RpcModel], sights: TieMeasurements, height: float) -> FloatArray:
    """Ground of the first measurement of each point, at one height."""
    ground = np.full((sights.points, 3), np.nan)
    for index in reversed(range(len(models))):
        rows = sights.image == index
        if rows.any():
            ground[sights.point[rows]] = image_to_height(models[index], sights.colrow[rows], height, WGS84)
    return ground


_RELATION_ROUNDS, _ROBUST_ROUNDS = 40, 12
_CUT = 3.5


@dataclass(frozen=True)
class TieCorrection:
    """Scenes corrected by tie points, with the tie points' ground and residuals.

    Attributes
    ----------
    models : tuple of RpcModel
    sigmas : array (K, 6)
        Standard deviations of their parameters in pixels, with respect to the mean of all scenes.
    ground : array (T, 3)
        Tie points: longitude, latitude, ellipsoidal height.
    residuals : array (M, 2)
        Measured minus computed, pixels.
    used : bool array (T,)
        Tie points that took part.
    rms_before, rms_after : float
        RMS length of the residuals of the measurements used, in pixels.
    """

    models: tuple[RpcModel, ...]
    sigmas: FloatArray
    ground: FloatArray
    residuals: FloatArray
    used: BoolArray
    rms_before: float
    rms_after: float


def correct_by_ties(
    models: Sequence[RpcModel],
    sights: TieMeasurements,
    kind: str = "shift",
    *,
    sigma_px: float = 0.5,
    sigma_correction: float = 20.0,
    sigma_height: float = 1000.0,
    fixed: Sequence[int] = (),
) -> TieCorrection:
    """Corrections of several scenes by which their lines of sight meet in tie points.

    Parameters
    ----------
    models : sequence of RpcModel
        At least two; corrections they have are the start, and the values the a-priori sigmas hold to.
    sights : TieMeasurements
        Measurements of tie points.
    kind : str
        'shift', 'drift' or 'affine'.
    sigma_px : float
        Standard deviation of a measurement, pixels.
    sigma_correction : float
        A-priori standard deviation of every correction, pixels.
    sigma_height : float
        Metres, see `intersect`.
    fixed : sequence of int
        Scenes that keep their corrections, because they have been refined with control.

    Returns
    -------
    TieCorrection

    Raises
    ------
    SolveError
        No tie point is seen in two scenes.
    """
    scenes = [model.freed(kind) for model in models]
    count = KINDS[kind]
    free = [index for index in range(len(scenes)) if index not in fixed]
    times = np.bincount(sights.point, minlength=sights.points)
    start = np.array([scene.parameters.values for scene in scenes])
    values, ground = start.copy(), intersect(scenes, sights, sigma_px, sigma_height)
    used = (times > 1) & np.isfinite(ground).all(axis=1)
    if not used.any() or not free:
        raise SolveError(
            "no tie point is seen in two scenes, or every scene is held fixed",
            hint="give tie points where the scenes overlap, and leave one scene free",
        )
    before = _length(sights, sights.seen_by(scenes, ground)[0], used)
    weights, good = used.astype(np.float64), used
    for number in range(_RELATION_ROUNDS):
        misfit, design = _freed(scenes, sights, ground, sigma_px, sigma_height)
        if number < _ROBUST_ROUNDS:  # nearly least absolute residuals: wrong points do not pull harder than good ones
            weights = np.where(used, 1.0 / np.maximum(_sizes(misfit), 0.05 * np.median(_sizes(misfit)[used])), 0.0)
        elif number == _ROBUST_ROUNDS:
            size = _sizes(misfit)
            # 1.4826 medians of absolute values are one standard deviation of normal errors.
            scatter = 1.4826 * float(np.median(size[used]))
            good = used & (size <= _CUT * max(scatter, 1e-6 / sigma_px))
            weights = good.astype(np.float64)
        step, covariance = _solve(misfit, design, weights, values - start, free, count, sigma_correction)
        values[free, :count] += step
        scenes = [scene.with_values(row) for scene, row in zip(scenes, values, strict=True)]
        ground = intersect(scenes, sights, sigma_px, sigma_height, ground)
        if number > _ROBUST_ROUNDS and np.abs(step).max() < 1e-8:
            break
    residuals = sights.seen_by(scenes, ground)[0]
    sigmas = np.zeros_like(values)
    sigmas[free, :count] = np.sqrt(np.diag(covariance)).reshape(len(free), count)
    after = _length(sights, residuals, good)
    return TieCorrection(tuple(scenes), sigmas, ground, residuals, good, before, after)


def _freed(
    scenes: Sequence[RpcModel], sights: TieMeasurements, ground: FloatArray, sigma_px: float, sigma_height: float
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Misfit (F,) and design (F, K, 6) of each point, freed of its ground coordinates, in units of `sigma_px`."""
    residuals, by_parameters, by_ground = sights.seen_by(scenes, ground)
    misfit, design = [], []
    for point in range(sights.points):
        rows = np.flatnonzero(sights.point == point)
        size = 2 * len(rows)
        b = np.vstack([by_ground[rows].reshape(size, 3) / sigma_px, [[0.0, 0.0, 1.0 / sigma_height]]])
        a = np.zeros((size + 1, len(scenes), len(NAMES)))
        for place, row in enumerate(rows):
            a[2 * place : 2 * place + 2, sights.image[row]] = by_parameters[row] / sigma_px
        # The row of the height holds what is left of it; its own misfit is small and left out.
        r = np.append(residuals[rows].ravel() / sigma_px, 0.0)
        if not (np.isfinite(r).all() and np.isfinite(a).all() and np.isfinite(b).all()):
            misfit.append(np.zeros(0))
            design.append(np.zeros((0, len(scenes), len(NAMES))))
            continue
        # Directions orthogonal to the columns of b do not change with the ground point: its coordinates drop out.
        across = np.linalg.qr(b, mode="complete")[0][:, 3:].T
        misfit.append(across @ r)
        design.append(np.tensordot(across, a, 1))
    return misfit, design


def _sizes(misfit: list[FloatArray]) -> FloatArray:
    """RMS misfit (T,) of each tie point, in units of `sigma_px`; 0 for a point without equations."""
    return np.array([float(np.sqrt((each**2).mean())) if len(each) else 0.0 for each in misfit])


def _solve(
    misfit: list[FloatArray],
    design: list[FloatArray],
    weights: FloatArray,
    moved: FloatArray,
    free: list[int],
    count: int,
    sigma: float,
) -> tuple[FloatArray, FloatArray]:
    """Step (free scenes, count) of the corrections, and their covariance."""
    root = np.sqrt(weights)
    rows = np.vstack([w * each[:, free, :count].reshape(len(each), -1) for w, each in zip(root, design, strict=True)])
    right = np.concatenate([w * each for w, each in zip(root, misfit, strict=True)])
    size = rows.shape[1]
    names, sigmas = ("",) * size, np.full(size, sigma)
    priors = Unknowns(names, np.zeros(size), np.ones(size), sigmas).a_priori(moved[free, :count].ravel())
    equations = Equations.stacked(Equations(rows, right), priors)
    return equations.step().reshape(len(free), count), equations.singular_values.cofactors()


def _length(sights: TieMeasurements, residuals: FloatArray, used: BoolArray) -> float:
    """RMS length of the residuals (M, 2) of tie points used (T,), pixels."""
    return float(np.sqrt((residuals[used[sights.point]] ** 2).sum(axis=1).mean()))
