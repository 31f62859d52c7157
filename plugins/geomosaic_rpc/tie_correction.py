"""Tie point correction of RPCs: several scenes corrected so that their lines of sight meet in tie points.

Corrections and ground coordinates of the tie points are the unknowns of one adjustment. Where all scenes together lie
is not seen by tie points: an a-priori sigma of the corrections keeps them near zero, as a free network (Grodecki and
Dial 2003, with a-priori values of the producer).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.estimation.blunders.data_snooping import chance_errors
from geomosaic.estimation.network import Network, Observations
from geomosaic.estimation.solver import Problem, Stopping, Unknowns, solve
from geomosaic.estimation.statistics import median_variance
from geomosaic.sensor.solve import image_to_height
from geomosaic.types import BoolArray, FloatArray, IntArray
from geomosaic_rpc.model import KINDS, NAMES, WGS84, RpcModel

# Degrees and metres that count as one: each about a metre on the ground.
UNITS = np.array([1e-5, 1e-5, 1.0])
# Reweighted rounds before wrong tie points are identified: weights of least absolute residuals settle in about ten.
ROBUST_ROUNDS = 12
# Probability below which the residuals of a tie point are no chance.
ALPHA = 1e-4


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


@dataclass(frozen=True)
class TieCorrection:
    """Scenes corrected by tie points, with the tie points' ground and residuals.

    Attributes
    ----------
    models : tuple of RpcModel
    sigmas : array (K, 6)
        Standard deviations of their parameters in pixels, with respect to the mean of all scenes.
    ground : array (T, 3)
        Tie points: longitude, latitude, ellipsoidal height; NaN where a line of sight reaches no ground.
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
    ties: TieMeasurements,
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
    ties : TieMeasurements
    kind : str
        'shift', 'drift' or 'affine'.
    sigma_px : float
        Standard deviation of a measurement, pixels.
    sigma_correction : float
        A-priori standard deviation of every correction, pixels.
    sigma_height : float
        Standard deviation of the tie points' heights about that of the scenes' seeds, metres; it decides only where
        lines of sight are nearly parallel.
    fixed : sequence of int
        Scenes that keep their corrections, because they have been refined with control.

    Raises
    ------
    SolveError
        No tie point is seen in two scenes, or there is no convergence.
    """
    scenes = tuple(model.freed(kind) for model in models)
    sigmas = np.zeros((len(scenes), len(NAMES)))
    sigmas[[index for index in range(len(scenes)) if index not in fixed], : KINDS[kind]] = sigma_correction
    values = np.concatenate([scene.parameters.values for scene in scenes])
    unknowns = Unknowns(len(values) * ("",), values, np.ones_like(values), sigmas.ravel())
    problem = _TieProblem(ties, unknowns, sigma_px, float(np.mean([model.seed[2] for model in models])), sigma_height)
    start = problem.intersected(scenes, problem.first_ground(scenes))
    used = (np.bincount(ties.point, minlength=ties.points) > 1) & (start.weights > 0.0)
    if not used.any() or not unknowns.free.any():
        raise SolveError(
            "no tie point is seen in two scenes, or every scene is held fixed",
            hint="give tie points where the scenes overlap, and leave one scene free",
        )
    # Nearly least absolute residuals first: wrong points do not pull harder than good ones.
    robust = replace(problem, reweighted=True)
    first = robust.refreshed(replace(start, weights=used.astype(np.float64)))
    state = solve(robust, first, Stopping(rounds=ROBUST_ROUNDS)).state
    squares, redundancy = problem.point_squares(state), problem.point_redundancy
    unit = max(median_variance(squares[used], redundancy[used]), (1e-6 / sigma_px) ** 2)
    good = used & chance_errors(squares, redundancy, ALPHA, unit)
    solution = solve(problem, replace(state, weights=good.astype(np.float64)))
    state = solution.required("check the tie points, or choose a correction of fewer parameters").state
    sigmas[sigmas > 0.0] = np.sqrt(np.diag(problem.linearise(state).parameter_cofactors()))
    final = problem.intersected(state.scenes, state.ground)

    def rms(of: _TieState, points: BoolArray) -> float:
        return float(np.sqrt((of.residuals[points[ties.point]] ** 2).sum(axis=1).mean()))

    return TieCorrection(
        state.scenes, sigmas, final.ground, final.residuals, good, rms(start, used), rms(final, good)
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _TieState:
    """Scenes, ground (T, 3) of the tie points, residuals (M, 2) in pixels, weights (T,): 0 for points left out."""

    scenes: tuple[RpcModel, ...]
    ground: FloatArray
    residuals: FloatArray
    weights: FloatArray


@dataclass(frozen=True, eq=False)
class _TieProblem(Problem[_TieState]):
    """Image positions of tie points; corrections of the scenes and ground of the points are unknown."""

    ties: TieMeasurements
    unknowns: Unknowns
    sigma_px: float
    height: float
    sigma_height: float
    reweighted: bool = False

    def first_ground(self, scenes: Sequence[RpcModel]) -> FloatArray:
        """Ground (T, 3) of the first measurement of each point, at the mean height of the seeds."""
        ground = np.full((self.ties.points, 3), np.nan)
        for index in reversed(range(len(scenes))):
            rows = self.ties.image == index
            if rows.any():
                ground[self.ties.point[rows]] = image_to_height(
                    scenes[index], self.ties.colrow[rows], self.height, WGS84
                )
        return ground

    def intersected(self, scenes: tuple[RpcModel, ...], start: FloatArray) -> _TieState:
        """Lines of sight of all points intersected, the scenes held; weight 0 where there is no ground."""
        held = replace(self, unknowns=replace(self.unknowns, sigmas=np.zeros_like(self.unknowns.sigmas)))
        first = self.at(scenes, start, np.ones(len(start)))
        lost = np.unique(self.ties.point[~np.isfinite(first.residuals).all(axis=1)])
        first.ground[lost], first.weights[lost] = np.nan, 0.0
        return solve(held, first).state

    def at(self, scenes: tuple[RpcModel, ...], ground: FloatArray, weights: FloatArray) -> _TieState:
        residuals = np.full_like(self.ties.colrow, np.nan)
        for index, scene in enumerate(scenes):
            rows = self.ties.image == index
            residuals[rows] = self.ties.colrow[rows] - scene.ground_to_image(ground[self.ties.point[rows]])
        return _TieState(scenes, ground, residuals, weights)

    def values(self, state: _TieState) -> FloatArray:
        return np.concatenate([scene.parameters.values for scene in state.scenes])

    def linearise(self, state: _TieState) -> Network:
        """Linearisation at a state, of the points with a weight."""
        part, free = state.weights > 0.0, self.unknowns.free
        rows = np.flatnonzero(part[self.ties.point])
        image, point = self.ties.image[rows], self.ties.point[rows]
        by_parameters, by_ground = np.zeros((len(rows), 2, len(NAMES))), np.zeros((len(rows), 2, 3))
        for index, scene in enumerate(state.scenes):
            mine = image == index
            by_parameters[mine], by_ground[mine] = scene.jacobian(state.ground[point[mine]])
        columns = np.where(free, np.cumsum(free) - 1, -1).reshape(-1, len(NAMES))[image]
        root = np.sqrt(state.weights[part])
        given, sigma = np.zeros((len(root), 3)), np.full((len(root), 3), np.inf)
        given[:, 2], sigma[:, 2] = self.height - state.ground[part, 2], self.sigma_height / root
        whiten = np.sqrt(state.weights[point]) / self.sigma_px
        views = Observations(
            (np.cumsum(part) - 1)[point],
            columns,
            by_parameters * whiten[:, None, None],
            by_ground * UNITS * whiten[:, None, None],
            state.residuals[rows] * whiten[:, None],
        )
        away = (self.unknowns.start - self.values(state))[free]
        priors = Observations.of_parameters(away, self.unknowns.sigmas[free])
        blocks = np.concatenate([[0], np.cumsum(free)])[:: len(NAMES)]
        return Network((views, Observations.of_coordinates(given, sigma), priors), blocks, sigma > 0.0)

    def point_squares(self, state: _TieState) -> FloatArray:
        """Sum of squares (T,) of each point's residuals in standard deviations, that of its height among them."""
        views = (state.residuals**2).sum(axis=1) / self.sigma_px**2
        height = (state.ground[:, 2] - self.height) / self.sigma_height
        return np.bincount(self.ties.point, views, self.ties.points) + height**2

    def squares(self, state: _TieState) -> float:
        part = state.weights > 0.0
        priors = self.unknowns.a_priori_misclosure(self.values(state))
        return float(state.weights[part] @ self.point_squares(state)[part] + priors @ priors)

    def moved(self, state: _TieState, step: FloatArray) -> _TieState:
        count, ground = int(self.unknowns.free.sum()), state.ground.copy()
        values = self.unknowns.moved(self.values(state), step[:count]).reshape(-1, len(NAMES))
        ground[state.weights > 0.0] += step[count:].reshape(-1, 3) * UNITS
        scenes = tuple(scene.with_values(row) for scene, row in zip(state.scenes, values, strict=True))
        return self.at(scenes, ground, state.weights)

    @property
    def point_redundancy(self) -> IntArray:
        """Redundancy (T,) of each point: 2·n observations in n images and one of its height, for three unknowns."""
        return np.maximum(2 * np.bincount(self.ties.point, minlength=self.ties.points) - 2, 0)

    def misfits(self, state: _TieState) -> FloatArray:
        """RMS residual (T,) of each point per redundant observation, in standard deviations; 0 for points left out."""
        size = np.sqrt(self.point_squares(state) / np.maximum(self.point_redundancy, 1))
        return np.where(state.weights > 0.0, size, 0.0)

    def refreshed(self, state: _TieState) -> _TieState:
        """Weights over the residuals, so that the sum of their absolute values becomes least (reweighting)."""
        if not self.reweighted:
            return state
        size, part = self.misfits(state), state.weights > 0.0
        # Not below a twentieth of the median: a point that happens to fit exactly would otherwise hold everything.
        weights = 1.0 / np.maximum(np.maximum(size, 0.05 * np.median(size[part])), 1e-9)
        return replace(state, weights=np.where(part, weights, 0.0))
