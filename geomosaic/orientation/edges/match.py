"""Edge matching: photos adjusted to the ground and to each other, blunders found, then joined exactly."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pyproj import CRS

from geomosaic.block import ControlPoint, OrientedImage
from geomosaic.errors import InputError, SolveError
from geomosaic.estimation.blunders.findings import BlunderReport, MeasurementKey, candidate_shifts, report_of
from geomosaic.estimation.blunders.mean_shift import search_shifts
from geomosaic.estimation.expected_errors import ExpectedErrors
from geomosaic.estimation.statistics import variance_factor
from geomosaic.orientation.edges.adjustment import CommonPoint, EdgeProblem, EdgeSolution, Stations, adjust, map_crs
from geomosaic.orientation.edges.distributed_corrections import spread
from geomosaic.orientation.edges.initial_values import Misfit, common_ground, extended_to_neighbours, misfit, own_fits
from geomosaic.sensor.corrected import Corrected, CorrectionGrid
from geomosaic.sensor.plugin import SensorModel
from geomosaic.sensor.solve import expected_errors
from geomosaic.types import BoolArray, FloatArray


def _search_blunders(problem: EdgeProblem, solution: EdgeSolution) -> tuple[BlunderReport, list[MeasurementKey]]:
    """Blunders in a solution, and their keys (point, photo), None for coordinates."""
    s = problem.stations
    images = [problem.photos[k] for k in s.photo]
    shifts, labels, keys = candidate_shifts(
        solution.network, (s.sigma_px, problem.given_sigma), s.ids, images, s.where, "common point"
    )
    report = report_of(shifts, search_shifts(shifts), labels, bent=True)
    return report, [keys[each.shift] for each in report.blunders]


def _without_measurements(
    control: Sequence[ControlPoint], common: Sequence[CommonPoint], left: Sequence[MeasurementKey]
) -> tuple[list[ControlPoint], list[CommonPoint]]:
    """Points without blunders; control with rejected coordinates becomes common, a lone common point goes too."""
    out, places = set(left), {name for name, image in left if image is None}
    points = [p for p in control if (p.id, p.image) not in out]
    shared = [p for p in common if (p.id, p.image) not in out]
    shared += [CommonPoint(p.id, p.image, p.colrow, p.sigma_px, p.xyz[2]) for p in points if p.id in places]
    seen = Counter(p.id for p in shared)
    return [p for p in points if p.id not in places], [p for p in shared if seen[p.id] > 1]


# Reach of a correction, in largest gaps between neighbouring points of one edge: it sags little between them.
FADES = 3.0
# Reach of a correction, in lengths of the largest one: a large one takes its way to fade.
FLATTEST = 10.0
# Adjustments without wrong points until no other is found.
ROUNDS = 4
# Reach of the correction of a single point, in widths of the photo.
ALONE = 0.125


@dataclass(frozen=True)
class EdgeMatch:
    """Photos joined at their edges.

    Attributes
    ----------
    photos : tuple of OrientedImage
        With the models of the exact join; `photos[i].model` is `models[i]`.
    models : tuple of SensorModel
        Adjusted and joined: a `Corrected` model where a photo shares points, the adjusted one elsewhere.
    adjusted : tuple of SensorModel
        After the adjustment, before the exact join.
    grids : tuple of CorrectionGrid or None
        The correction of each photo.
    stations : Stations
        What was measured; `residuals` has its order.
    ground : array (S, 3)
        Adjusted places of the stations in `crs`; where photos join.
    ground_covariance : array (S, 2, 2)
        Of their x and y; 0 where held.
    residuals : array (N, 2)
        Measured minus computed after the adjustment, pixels.
    sigma0 : float
        Standard deviation of unit weight, about 1 where the sigmas describe the residuals; NaN without redundancy.
    redundancy : int
    covariance : array (P, P)
        Cofactors from the sigmas given, of all parameters photo after photo (0 for those held fixed). The sigmas are
        taken as true; multiply by sigma0² where only their ratios are known.
    names : tuple of str (P,)
        'photo: parameter'.
    before, after, joined : Misfit
        At the shared points: each photo by its own control alone (NaN where that does not determine it); after the
        adjustment; after the exact join.
    crs : CRS
        Map of ground and misfits.
    iterations : int
    condition : float
    findings : BlunderReport
    """

    photos: tuple[OrientedImage, ...]
    models: tuple[SensorModel, ...]
    adjusted: tuple[SensorModel, ...]
    grids: tuple[CorrectionGrid | None, ...]
    stations: Stations
    ground: FloatArray
    ground_covariance: FloatArray
    residuals: FloatArray
    sigma0: float
    redundancy: int
    covariance: FloatArray
    names: tuple[str, ...]
    before: Misfit
    after: Misfit
    joined: Misfit
    crs: CRS
    iterations: int
    condition: float
    findings: BlunderReport

    @property
    def expected(self) -> ExpectedErrors:
        """Errors to be expected at the corners and in the middle of the mosaic; of models without heights."""
        factor, first, found = variance_factor(self.sigma0, self.redundancy), 0, []
        for model in self.adjusted:
            own = slice(first, first + len(model.parameters))
            found.append(expected_errors(model, factor * self.covariance[own, own], 0.0, self.crs))
            first = own.stop
        places, sigmas = zip(*found, strict=True)
        fits = [(self.redundancy, 2 * len(self.residuals))]
        return ExpectedErrors.of([photo.name for photo in self.photos], np.array(places), np.array(sigmas), fits)


def match_edges(
    photos: Sequence[OrientedImage],
    control: Sequence[ControlPoint],
    common: Sequence[CommonPoint],
    *,
    crs: CRS | None = None,
    reach: float | None = None,
    policy: str = "stop",
    tables: str = "control and common points",
) -> EdgeMatch:
    """Edge matching: photos adjusted to control and common points together, and joined exactly at shared points.

    The adjustment is the combined least squares of Bellman, Deakin and Rollings: residuals on the image coordinates,
    weighted by their sigmas, control and common points together, for any sensor model with its Jacobian. Each photo
    starts from a fit to its own control, or to its neighbours' common points; where neither suffices, from the values
    it comes with. Parameters with sigma 0 are held: a photo with nothing free is a reference for the others.

    The exact join takes the adjusted place of every point that several photos show and corrects each photo by its
    residual there, so that two photos of one quality share the misfit halves; a measurement of smaller sigma gives
    less. Between the points the correction goes smoothly, and with the distance from them it fades away.

    Parameters
    ----------
    photos : sequence of OrientedImage
        Names, sensors and start models.
    control : sequence of ControlPoint
        With coordinates in `crs`; a sigma_xy above 0 lets their x and y be adjusted. Check points take no part.
    common : sequence of CommonPoint
    crs : CRS, optional
        Map of the control; that of the models unless given.
    reach : float, optional
        Pixels from a common point to where its correction has faded away. By default three times the largest gap
        between neighbouring points of an edge (an eighth of the photo's width where an edge has one point), but at
        least ten times the largest correction.
    policy : str
        What is done with blunders: 'stop' where one is gross, 'leave' all of them out, or 'keep' them.
    tables : str
        What messages call the tables.

    Raises
    ------
    InputError
        A point is grossly wrong. Points of photos that are not there, measured twice, without coordinates, ...
    SolveError
        The points do not determine the photos, or contradict each other so closely that no smooth correction helps.
    """
    if len({photo.name for photo in photos}) < len(photos) or not photos:
        raise InputError("edge matching needs photos of different names", hint="rename one")
    if reach is not None and not 0.0 < reach < np.inf:
        raise InputError(
            f"a reach of {reach} pixels is not a positive number", hint="give pixels above 0, or leave it out"
        )
    map_ = map_crs(photos, crs)
    problem, alone, fitted, solution = _solved(photos, control, common, map_)
    found, left = _search_blunders(problem, solution)
    found.enforce(tables, policy)
    for _ in range(ROUNDS if policy == "leave" else 0):
        if not left:
            break
        control, common = _without_measurements(control, common, left)
        problem, alone, fitted, solution = _solved(photos, control, common, map_)
        more, left = _search_blunders(problem, solution)  # what the gross ones hid
        more.enforce(tables, policy)
        found = replace(more, blunders=(*found.blunders, *more.blunders))
    grids = _grids(problem, solution, reach)
    joined = [
        model if grid is None else Corrected.of(model, grid, photo.sensor)
        for photo, model, grid in zip(photos, solution.models, grids, strict=True)
    ]
    return EdgeMatch(
        photos=tuple(replace(photo, model=model) for photo, model in zip(photos, joined, strict=True)),
        models=tuple(joined),
        adjusted=tuple(solution.models),
        grids=tuple(grids),
        stations=problem.stations,
        ground=solution.ground,
        ground_covariance=solution.ground_cofactors,
        residuals=solution.residuals,
        sigma0=solution.sigma0,
        redundancy=solution.redundancy,
        covariance=solution.cofactors,
        names=problem.unknowns.names,
        before=misfit(problem, alone, fitted),
        after=misfit(problem, solution.models),
        joined=misfit(problem, joined),
        crs=map_,
        iterations=solution.iterations,
        condition=solution.condition,
        findings=replace(found, policy=policy),
    )


def _solved(
    photos: Sequence[OrientedImage], control: Sequence[ControlPoint], common: Sequence[CommonPoint], crs: CRS
) -> tuple[EdgeProblem, list[SensorModel], BoolArray, EdgeSolution]:
    """Adjustment, with the photos fitted to their own control alone, and which of them that determines."""
    given = [photo.model for photo in photos]
    names = tuple(photo.name for photo in photos)
    problem = EdgeProblem.of(names, given, Stations.of(photos, control, common), crs)
    alone, fitted = own_fits(problem, given)
    start = extended_to_neighbours(problem, alone, fitted)
    ground = common_ground(problem, start, np.ones(len(photos), dtype=bool))
    return problem, alone, fitted, adjust(problem, start, ground)


def _grids(problem: EdgeProblem, solution: EdgeSolution, reach: float | None) -> list[CorrectionGrid | None]:
    """Correction grids of each photo's residuals at shared stations."""
    s, grids = problem.stations, list[CorrectionGrid | None]()
    at_shared = s.shared[s.station]
    for index, model in enumerate(solution.models):
        mine = at_shared & (s.photo == index)
        if not mine.any():
            grids.append(None)
            continue
        # A grid is added to the ideal position: its places are the measured ones less the residuals.
        values = solution.residuals[mine]
        far = reach or max(
            _largest_gap(problem, index, mine) * FADES or ALONE * model.size[0],
            FLATTEST * float(np.linalg.norm(values, axis=1).max()),
        )
        names = tuple(s.ids[k] for k in s.station[mine])
        try:
            grids.append(spread(s.colrow[mine] - values, values, far, names))
        except SolveError as error:
            error.where = problem.photos[index]
            raise
    return grids


def _largest_gap(problem: EdgeProblem, index: int, mine: BoolArray) -> float:
    """Longest edge of the shortest trees through the points a photo shares with each other one; 0 if all are alone."""
    s, longest = problem.stations, 0.0
    for other in range(len(problem.photos)):
        if other != index:
            with_other = np.isin(s.station, s.station[s.photo == other])
            longest = max(longest, _longest_edge(s.colrow[mine & with_other]))
    return longest


def _longest_edge(points: FloatArray) -> float:
    """Longest edge of the shortest tree through points (K, 2), grown from the first (Prim); 0 for fewer than two."""
    if len(points) < 2:
        return 0.0
    outside = np.linalg.norm(points - points[0], axis=1)
    outside[0] = np.inf
    longest = 0.0
    for _ in range(len(points) - 1):
        nearest = int(np.argmin(outside))
        longest = max(longest, float(outside[nearest]))
        reached = np.isinf(outside)
        outside = np.minimum(outside, np.linalg.norm(points - points[nearest], axis=1))
        outside[reached] = np.inf
        outside[nearest] = np.inf
    return longest
