"""Combined adjustment of edge matching: photos and stations unknown together, by Gauss-Newton with cofactors.

Each measurement is one equation p + v = f(Δ; X): image position, its residual, the photo's map ground → image with
parameters Δ, the station's place. Eliminating X from those of one station leaves the conditions "the photos of a common
point meet" of the edge matching of Bellman, Deakin and Rollings (equations 6 to 9, A v + B Δ = f, cofactors A Q Aᵀ).
Here that is left to the sparse factorisation of all unknowns, see `network.linear`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic.errors import SolveError
from geomosaic.estimation.linear_network import Network
from geomosaic.geo.transform import Transform
from geomosaic.orientation.edges.observations import Stations
from geomosaic.sensor.model import SensorModel
from geomosaic.sensor.solve.derivatives import jacobian, pixel_step
from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Problem:
    """Stations, and photos whose parameters are free.

    Attributes
    ----------
    photos : tuple of str
    names : tuple of str (P,)
        All parameters, as 'photo: parameter', for errors.
    stations : Stations
    crs : CRS
        Map of the stations.
    to_model : tuple of Transform
        To the CRS of each photo's model.
    offsets : int array (photos + 1,)
        Where each photo's parameters begin in the vector of all.
    free : bool array (P,)
        Which of all parameters are estimated.
    priors : array (P,)
        A-priori sigmas of the free ones, inf for none.
    start : array (P,)
        Values the priors refer to.
    steps : array (P,)
    """

    photos: tuple[str, ...]
    names: tuple[str, ...]
    stations: Stations
    crs: CRS
    to_model: tuple[Transform, ...]
    offsets: IntArray
    free: BoolArray
    priors: FloatArray
    start: FloatArray
    steps: FloatArray

    @classmethod
    def of(cls, photos: tuple[str, ...], models: list[SensorModel], stations: Stations, crs: CRS) -> Problem:
        """Put the parameters of all photos into one vector."""
        parameters = [model.parameters for model in models]
        sigmas = np.concatenate([p.sigmas for p in parameters])
        return cls(
            photos,
            tuple(f"{photo}: {name}" for photo, p in zip(photos, parameters, strict=True) for name in p.names),
            stations,
            crs,
            tuple(Transform(crs, model.crs) for model in models),
            np.cumsum([0, *map(len, parameters)]),
            sigmas > 0.0,
            sigmas,
            np.concatenate([p.values for p in parameters]),
            np.concatenate([p.steps for p in parameters]),
        )

    def residuals(self, models: list[SensorModel], ground: FloatArray) -> FloatArray:
        """Measured minus computed (N, 2) in pixels; NaN where a photo cannot see a station of `ground` (S, 3)."""
        s = self.stations
        left = np.full_like(s.colrow, np.nan)
        for index, model in enumerate(models):
            mine = s.photo == index
            left[mine] = s.colrow[mine] - model.ground_to_image(self.to_model[index](ground[s.station[mine]]))
        return left

    def cost(self, residuals: FloatArray, ground: FloatArray, values: FloatArray) -> float:
        """Weighted sum of squares: image residuals, given coordinates, a-priori values."""
        s = self.stations
        total = float(((residuals / s.sigma_px[:, None]) ** 2).sum())
        known = (s.sigma > 0.0) & np.isfinite(s.sigma)
        total += float((((ground - s.xyz)[known, :2] / s.sigma[known, None]) ** 2).sum())
        held = self.free & np.isfinite(self.priors)
        return total + float((((values - self.start)[held] / self.priors[held]) ** 2).sum())

    def network(
        self, models: list[SensorModel], residuals: FloatArray, ground: FloatArray, values: FloatArray
    ) -> Network:
        """Linearise at the present values and ground; unknowns are the free parameters, photo after photo."""
        s = self.stations
        most = int(np.diff(self.offsets).max())
        by_values, columns = np.zeros((len(s.photo), 2, most)), np.full((len(s.photo), most), -1, dtype=np.int64)
        by_xy = np.zeros((len(s.photo), 2, 2))
        number = np.where(self.free, np.cumsum(self.free) - 1, -1)
        for index, model in enumerate(models):
            mine = np.flatnonzero(s.photo == index)
            if len(mine):
                own = slice(self.offsets[index], self.offsets[index + 1])
                count = own.stop - own.start
                by_values[mine, :, :count], by_xy[mine] = self._derivatives(index, model, ground[s.station[mine]])
                columns[mine, :count] = number[own]
        given = np.where(np.isfinite(s.sigma)[:, None], s.xyz[:, :2] - ground[:, :2], 0.0)
        priors, from_start = self.priors[self.free], (self.start - values)[self.free]
        return Network(s.station, columns, by_values, by_xy, residuals, s.sigma_px, given, s.sigma, priors, from_start)

    def _derivatives(self, index: int, model: SensorModel, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of image coordinates by the photo's parameters (n, 2, P) and by map x, y (n, 2, 2)."""
        way = self.to_model[index]
        by_values, by_model = jacobian(model, way(ground))
        if self.crs == model.crs:
            return by_values, by_model[:, :, :2]

        def image(xy: FloatArray) -> FloatArray:
            return model.ground_to_image(way(np.column_stack([xy, np.full(len(xy), ground[0, 2])])))

        step = pixel_step(image, ground[0, :2], 1.0 if self.crs.is_projected else 1e-5)
        turn = []
        for axis in range(2):
            high, low = ground.copy(), ground.copy()
            high[:, axis] += 0.5 * step
            low[:, axis] -= 0.5 * step
            turn.append((way(high) - way(low)) / (high - low)[:, axis, None])
        return by_values, by_model @ np.stack(turn, axis=2)


ROUNDS = 50
HALVINGS = 20
GOAL = 1e-9
WORST_CONDITION = 1e7
"""Of the design. Beyond it half of the digits of a solution are noise."""


@dataclass(frozen=True)
class Solution:
    """What the adjustment found.

    Attributes
    ----------
    models : list of SensorModel
    ground : array (S, 3)
        Adjusted stations in the map CRS.
    ground_cofactors : array (S, 2, 2)
        Of x and y; 0 for stations that are held.
    residuals : array (N, 2)
        Measured minus computed, pixels.
    cofactors : array (P, P)
        Of all parameters, photo after photo; 0 for those held fixed.
    sigma0 : float
        NaN without redundancy.
    redundancy : int
    iterations : int
    condition : float
        Of the design of all unknowns, columns of unit length.
    network : Network
        Linearised there.
    """

    models: list[SensorModel]
    ground: FloatArray
    ground_cofactors: FloatArray
    residuals: FloatArray
    cofactors: FloatArray
    sigma0: float
    redundancy: int
    iterations: int
    condition: float
    network: Network


def solve(problem: Problem, models: list[SensorModel], ground: FloatArray) -> Solution:
    """Adjust from a start.

    Parameters
    ----------
    problem : Problem
    models : list of SensorModel
        Start values.
    ground : array (S, 3)
        Start of the stations, in the map CRS.

    Raises
    ------
    SolveError
        The points do not determine the parameters (it names them), or there is no convergence.
    """
    free = problem.free
    labels = np.array(problem.names)[free]
    values = np.concatenate([model.parameters.values for model in models])
    residuals = problem.residuals(models, ground)
    _need_seen(problem, residuals)
    cost = problem.cost(residuals, ground, values)
    for iteration in range(1, ROUNDS + 1):
        network = problem.network(models, residuals, ground, values)
        _need_determined(network, labels)
        step, shift = network.changes()
        factor = 1.0
        for _ in range(HALVINGS):
            trial_values, trial_ground = values.copy(), ground.copy()
            trial_values[free] += factor * step
            trial_ground[:, :2] += factor * shift
            trial_models = _with(problem, models, trial_values)
            trial_residuals = problem.residuals(trial_models, trial_ground)
            trial_cost = problem.cost(trial_residuals, trial_ground, trial_values)
            if trial_cost <= cost * (1.0 + 1e-12) + 1e-20:
                break
            factor *= 0.5
        moved = float(np.max(np.abs(step) / problem.steps[free], initial=0.0))
        if trial_cost <= cost * (1.0 + 1e-12) + 1e-20:
            done = moved < GOAL or (cost - trial_cost <= 1e-14 * cost and moved < 1e-5)
            values, ground, models, residuals, cost = (
                trial_values, trial_ground, trial_models, trial_residuals, trial_cost,
            )  # fmt: skip
        else:
            done = moved < 1e-4  # nothing better within reach: rounding, not failure
        if done:
            return _solution(problem, models, residuals, ground, values, cost, iteration, labels)
        if factor < 1e-5:
            break
    raise SolveError(
        "the edge matching does not converge",
        hint="check the start values of the photos, and the points for wrong measurements",
    )


def _with(problem: Problem, models: list[SensorModel], values: FloatArray) -> list[SensorModel]:
    ends = problem.offsets
    return [model.with_values(values[ends[i] : ends[i + 1]]) for i, model in enumerate(models)]


def _need_seen(problem: Problem, residuals: FloatArray) -> None:
    lost = np.flatnonzero(~np.isfinite(residuals).all(axis=1))
    if len(lost):
        s = problem.stations
        raise SolveError(
            f"the photo does not see point '{s.ids[s.station[lost[0]]]}' where it starts",
            where=problem.photos[s.photo[lost[0]]],
            hint="check the point's coordinates and the start values of the photo",
        )


def _need_determined(network: Network, labels: AnyArray) -> float:
    """Condition number; refuse a design whose columns depend on each other."""
    condition, direction = network.normals.condition() if sum(network.design.shape[1:]) else (1.0, np.zeros(0))
    if network.redundancy < 0 or not condition < WORST_CONDITION:
        share = np.abs(direction[: network.unknowns])
        together = labels[share > 0.1 * share.max(initial=0.0)]
        raise SolveError(
            f"control and common points do not determine {', '.join(together)}",
            hint="add control or common points, spread over the photos, or choose a simpler model",
        )
    return condition


def _solution(
    problem: Problem,
    models: list[SensorModel],
    residuals: FloatArray,
    ground: FloatArray,
    values: FloatArray,
    cost: float,
    iterations: int,
    labels: AnyArray,
) -> Solution:
    network = problem.network(models, residuals, ground, values)
    condition = _need_determined(network, labels)
    small, of_ground = network.cofactors()
    cofactors = np.zeros((len(problem.free), len(problem.free)))
    cofactors[np.ix_(problem.free, problem.free)] = small
    redundancy = network.redundancy
    sigma0 = float(np.sqrt(cost / redundancy)) if redundancy > 0 else float("nan")
    return Solution(models, ground, of_ground, residuals, cofactors, sigma0, redundancy, iterations, condition, network)
