"""Combined adjustment of edge matching: photos and stations unknown together, by Gauss-Newton with cofactors.

Each measurement is one equation p + v = f(Δ; X): image position, its residual, the photo's map ground → image with
parameters Δ, the station's place. Eliminating X from those of one station leaves the conditions "the photos of a common
point meet" of the edge matching of Bellman, Deakin and Rollings (equations 6 to 9, A v + B Δ = f, cofactors A Q Aᵀ).
Here that is left to the sparse factorisation of all unknowns, see `estimation.network.Network`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic.block import ControlPoint, OrientedImage
from geomosaic.errors import InputError, SolveError
from geomosaic.estimation.network import Network, Observations
from geomosaic.estimation.solver import Linearised, Problem, Stopping, Unknowns, solve
from geomosaic.estimation.statistics import sigma0_of
from geomosaic.geo.crs import has_heights
from geomosaic.geo.transform import Transform
from geomosaic.sensor.plugin import SensorModel
from geomosaic.sensor.solve.newton import jacobian, pixel_step
from geomosaic.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class CommonPoint:
    """Image measurement of a point that several photos show and whose place on the ground is not known.

    Attributes
    ----------
    id : str
        The same in all photos that show the point.
    image : str
        Name of the photo.
    colrow : tuple of float
        Pixels, corner-based.
    sigma_px : float
        Standard deviation of the measurement, pixels.
    z : float
        Height of the point in the CRS of the control; needed only where a photo's model uses heights.
    where : str
        File and line, for messages.
    """

    id: str
    image: str
    colrow: tuple[float, float]
    sigma_px: float = 1.0
    z: float = float("nan")
    where: str = ""


@dataclass(frozen=True)
class Stations:
    """Stations: S points on the ground, measured N times in photos.

    Attributes
    ----------
    ids : tuple of str (S,)
    xyz : array (S, 3)
        Given coordinates in the map CRS; x and y are NaN for common points.
    sigma : array (S,)
        Of the given x and y: 0 held, inf unknown.
    photo, station : int arrays (N,)
        Which photo shows which station.
    colrow : array (N, 2)
        Where, in pixels.
    sigma_px : array (N,)
    where : tuple of str (N,)
        File and line, or empty.
    """

    ids: tuple[str, ...]
    xyz: FloatArray
    sigma: FloatArray
    photo: IntArray
    station: IntArray
    colrow: FloatArray
    sigma_px: FloatArray
    where: tuple[str, ...]

    @property
    def held(self) -> BoolArray:
        """Which stations (S,) are held at their given place."""
        held: BoolArray = self.sigma == 0.0
        return held

    @property
    def shared(self) -> BoolArray:
        """Which stations (S,) are measured in more than one photo."""
        counts: IntArray = np.bincount(self.station, minlength=len(self.ids))
        return counts > 1

    @classmethod
    def of(
        cls, photos: Sequence[OrientedImage], control: Sequence[ControlPoint], common: Sequence[CommonPoint]
    ) -> Stations:
        """Stations of control points (those of role 'check' are left out) and common points.

        Parameters
        ----------
        photos : sequence of OrientedImage
        control : sequence of ControlPoint
        common : sequence of CommonPoint

        Raises
        ------
        InputError
            A photo that is not there, a point measured twice in one, a common point in one photo only, or a number that
            is not finite.
        """
        number = {photo.name: index for index, photo in enumerate(photos)}
        heights = any(has_heights(photo.model.crs) for photo in photos)
        ids: dict[tuple[str, str], int] = {}
        xyz: list[tuple[float, float, float]] = []
        sigma: list[float] = []
        rows: list[tuple[int, int, float, float, float]] = []
        points: list[ControlPoint | CommonPoint] = [*(p for p in control if p.role == "control"), *common]
        for point in points:
            kind = "control" if isinstance(point, ControlPoint) else "common"
            where = f"{kind} point '{point.id}' in {point.image}"
            if point.image not in number:
                raise InputError("there is no such photo", where=where, hint=f"photos are: {', '.join(number)}")
            if not (np.isfinite(point.colrow).all() and 0.0 < point.sigma_px < np.inf):
                raise InputError(
                    "col, row or sigma_px is not a usable number", where=where, hint="give pixels, and a sigma above 0"
                )
            given = point.xyz if isinstance(point, ControlPoint) else (np.nan, np.nan, point.z if heights else 0.0)
            if not np.isfinite(given[2 if kind == "common" else 0 :]).all():
                raise InputError(
                    "the point has no usable coordinates or height", where=where, hint="give it a height z"
                )
            station = ids.setdefault((kind, point.id), len(ids))
            if station == len(xyz):
                xyz.append(given)
                sigma.append(point.sigma_xy if isinstance(point, ControlPoint) else np.inf)
            elif not np.array_equal(xyz[station], given, equal_nan=True):
                raise InputError(
                    "the point has other coordinates in another photo",
                    where=where,
                    hint="correct the one that is wrong, or rename one of the two points",
                )
            rows.append((number[point.image], station, *point.colrow, point.sigma_px))
        table = np.array(rows, dtype=np.float64).reshape(-1, 5)
        photo, index = table[:, 0].astype(np.int64), table[:, 1].astype(np.int64)
        names = tuple(name for _, name in ids)
        for (first, station), count in Counter(zip(photo.tolist(), index.tolist(), strict=True)).items():
            if count > 1:
                raise InputError(
                    f"point '{names[station]}' is measured twice",
                    where=photos[first].name,
                    hint="keep one of its measurements in this photo",
                )
        stations = cls(
            names,
            np.array(xyz).reshape(-1, 3),
            np.array(sigma),
            photo,
            index,
            table[:, 2:4],
            table[:, 4].copy(),
            tuple(point.where for point in points),
        )
        alone = np.isinf(stations.sigma) & ~stations.shared
        if alone.any():
            raise InputError(
                f"common point '{names[int(np.argmax(alone))]}' is measured in one photo only",
                hint="measure it in a second photo, or leave it out",
            )
        return stations


def map_crs(photos: Sequence[OrientedImage], crs: CRS | None) -> CRS:
    """CRS in which stations are adjusted: the one given, or that of the models where they share one map.

    Parameters
    ----------
    photos : sequence of OrientedImage
    crs : CRS, optional

    Raises
    ------
    InputError
        None is given and the models do not share a map CRS.
    """
    if crs is not None:
        return crs
    first = photos[0].model.crs
    if first.is_geocentric or any(photo.model.crs != first for photo in photos):
        raise InputError("the photos do not share a map CRS", hint="name the CRS of the control points")
    return first


@dataclass(frozen=True, eq=False)
class State:
    """Present values of an adjustment.

    Attributes
    ----------
    models : list of SensorModel
    ground : array (S, 3)
        Stations in the map CRS.
    residuals : array (N, 2)
        Measured minus computed, pixels.
    """

    models: list[SensorModel]
    ground: FloatArray
    residuals: FloatArray

    @property
    def values(self) -> FloatArray:
        """Parameters (P,) of all photos."""
        return np.concatenate([model.parameters.values for model in self.models])


@dataclass(frozen=True, eq=False)
class EdgeProblem(Problem[State]):
    """Stations, and photos whose parameters are free.

    Attributes
    ----------
    photos : tuple of str
    unknowns : Unknowns
        All parameters, photo after photo, named 'photo: parameter'.
    stations : Stations
    crs : CRS
        Map of the stations.
    to_model : tuple of Transform
        To the CRS of each photo's model.
    offsets : int array (photos + 1,)
        Where each photo's parameters begin.
    """

    photos: tuple[str, ...]
    unknowns: Unknowns
    stations: Stations
    crs: CRS
    to_model: tuple[Transform, ...]
    offsets: IntArray

    @classmethod
    def of(cls, photos: tuple[str, ...], models: list[SensorModel], stations: Stations, crs: CRS) -> EdgeProblem:
        """Problem with the parameters of all photos in one vector.

        Parameters
        ----------
        photos : tuple of str
        models : sequence of SensorModel
        stations : Stations
        crs : CRS
        """
        parameters = [model.parameters for model in models]
        groups = [
            Unknowns(tuple(f"{photo}: {name}" for name in p.names), p.values, p.steps, p.sigmas)
            for photo, p in zip(photos, parameters, strict=True)
        ]
        to_model = tuple(Transform(crs, model.crs) for model in models)
        return cls(photos, Unknowns.joined(groups), stations, crs, to_model, np.cumsum([0, *map(len, parameters)]))

    def at(self, models: list[SensorModel], ground: FloatArray) -> State:
        """State with its residuals; these are NaN where a photo cannot see a station."""
        return State(models, ground, self.residuals(models, ground))

    def moved(self, state: State, step: FloatArray) -> State:
        """Models and stations after a step."""
        count, ends = int(self.unknowns.free.sum()), self.offsets
        values, ground = self.unknowns.moved(state.values, step[:count]), state.ground.copy()
        ground[~self.stations.held, :2] += step[count:].reshape(-1, 2)
        return self.at([m.with_values(values[ends[i] : ends[i + 1]]) for i, m in enumerate(state.models)], ground)

    def movement(self, state: State, trial: State, equations: Linearised, step: FloatArray) -> float:
        """Largest change of a parameter, in steps of about a pixel."""
        return self.unknowns.movement(step[: int(self.unknowns.free.sum())])

    def linearise(self, state: State) -> Network:
        """Equations at a state, refused where they do not determine the parameters, which are named."""
        network = self.network(state)
        condition, direction = network.condition()
        if network.redundancy < 0 or not condition < WORST_CONDITION:
            share = np.abs(direction[: network.parameters])
            weak = np.array(self.unknowns.names)[self.unknowns.free][share > 0.1 * share.max(initial=0.0)]
            raise SolveError(
                f"control and common points do not determine {', '.join(weak)}",
                hint="add control or common points, spread over the photos, or choose a simpler model",
            )
        return network

    def residuals(self, models: list[SensorModel], ground: FloatArray) -> FloatArray:
        """Measured minus computed (N, 2) in pixels; NaN where a photo cannot see a station of `ground` (S, 3)."""
        s = self.stations
        left = np.full_like(s.colrow, np.nan)
        for index, model in enumerate(models):
            mine = s.photo == index
            left[mine] = s.colrow[mine] - model.ground_to_image(self.to_model[index](ground[s.station[mine]]))
        return left

    def squares(self, state: State) -> float:
        """Weighted sum of squares: image residuals, given coordinates, a-priori values."""
        s = self.stations
        total = float(((state.residuals / s.sigma_px[:, None]) ** 2).sum())
        known = (s.sigma > 0.0) & np.isfinite(s.sigma)
        total += float((((state.ground - s.xyz)[known, :2] / s.sigma[known, None]) ** 2).sum())
        return total + float((self.unknowns.a_priori_misclosure(state.values) ** 2).sum())

    def network(self, state: State) -> Network:
        """Linearisation at a state; unknowns are the free parameters, photo after photo, then the stations."""
        models, ground, free = state.models, state.ground, self.unknowns.free
        s = self.stations
        most = int(np.diff(self.offsets).max())
        by_values, columns = np.zeros((len(s.photo), 2, most)), np.full((len(s.photo), most), -1, dtype=np.int64)
        by_xy = np.zeros((len(s.photo), 2, 2))
        number = np.where(free, np.cumsum(free) - 1, -1)
        for index, model in enumerate(models):
            mine = np.flatnonzero(s.photo == index)
            if len(mine):
                own = slice(self.offsets[index], self.offsets[index + 1])
                count = own.stop - own.start
                by_values[mine, :, :count], by_xy[mine] = self._derivatives(index, model, ground[s.station[mine]])
                columns[mine, :count] = number[own]
        given = np.where(np.isfinite(s.sigma)[:, None], s.xyz[:, :2] - ground[:, :2], 0.0)
        priors, from_start = self.unknowns.sigmas[free], (self.unknowns.start - state.values)[free]
        weight = 1.0 / s.sigma_px[:, None, None]
        views = Observations(
            s.station, columns, by_values * weight, by_xy * weight, state.residuals / s.sigma_px[:, None]
        )
        groups = (
            views,
            Observations.of_coordinates(given, self.given_sigma),
            Observations.of_parameters(from_start, priors, 2),
        )
        return Network(groups, np.concatenate([[0], np.cumsum(free)])[self.offsets], self.given_sigma > 0.0)

    @property
    def given_sigma(self) -> FloatArray:
        """Standard deviations (S, 2) of the given coordinates of the stations."""
        return np.repeat(self.stations.sigma[:, None], 2, axis=1)

    def _derivatives(self, index: int, model: SensorModel, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of image coordinates by the photo's parameters (n, 2, P) and by map x, y (n, 2, 2)."""
        way = self.to_model[index]
        by_values, by_model = jacobian(model, way(ground))
        if self.crs == model.crs:
            return by_values, by_model[:, :, :2]

        def image(xy: FloatArray) -> FloatArray:
            return model.ground_to_image(way(np.column_stack([xy, np.full(len(xy), ground[0, 2])])))

        # The chain rule from the model's CRS to the map, by differences over about a pixel.
        step = pixel_step(image, ground[0, :2], 1.0 if self.crs.is_projected else 1e-5)
        turn = []
        for axis in range(2):
            high, low = ground.copy(), ground.copy()
            high[:, axis] += 0.5 * step
            low[:, axis] -= 0.5 * step
            turn.append((way(high) - way(low)) / (high - low)[:, axis, None])
        return by_values, by_model @ np.stack(turn, axis=2)


# Movements in pixels; 1e-9 is far below what the exact join meets, and about the last digit of map coordinates.
RULES = Stopping(rounds=50, step=1e-9, near=1e-5, gain=1e-14)
# Of the design. Beyond it half of the digits of a solution are noise.
WORST_CONDITION = 1e7


@dataclass(frozen=True)
class EdgeSolution:
    """Adjusted photos and stations with their cofactors.

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


def adjust(problem: EdgeProblem, models: list[SensorModel], ground: FloatArray) -> EdgeSolution:
    """Adjustment of photos and stations together.

    Parameters
    ----------
    problem : EdgeProblem
    models : list of SensorModel
        Start values.
    ground : array (S, 3)
        Start of the stations, in the map CRS.

    Raises
    ------
    SolveError
        The points do not determine the parameters (it names them), or there is no convergence.
    """
    start = problem.at(models, ground)
    lost = np.flatnonzero(~np.isfinite(start.residuals).all(axis=1))
    if len(lost):
        s = problem.stations
        raise SolveError(
            f"with its start values the photo does not see point '{s.ids[s.station[lost[0]]]}'",
            where=problem.photos[s.photo[lost[0]]],
            hint="check the point's coordinates and the start values of the photo",
        )
    solution = solve(problem, start, RULES).required(
        "check the start values of the photos, and the points for wrong measurements"
    )
    state, free = solution.state, problem.unknowns.free
    network = problem.network(state)
    of_parameters, of_ground = network.parameter_cofactors(), network.point_cofactors()
    cofactors = np.zeros((len(free), len(free)))
    cofactors[np.ix_(free, free)] = of_parameters
    redundancy = network.redundancy
    return EdgeSolution(
        models=state.models,
        ground=state.ground,
        ground_cofactors=of_ground,
        residuals=state.residuals,
        cofactors=cofactors,
        sigma0=sigma0_of(solution.squares, redundancy),
        redundancy=redundancy,
        iterations=solution.rounds,
        condition=network.condition()[0],
        network=network,
    )
