"""Blunders of tie and control points in the simultaneous adjustment of a planar block."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.estimation.blunders.findings import (
    BlunderReport,
    MeasurementKey,
    MeasurementLabel,
    candidate_shifts,
    combined,
)
from geomosaic.estimation.blunders.mean_shift import MeanShifts, search_shifts
from geomosaic.estimation.network import Network, Observations
from geomosaic.orientation.planar.determinacy import check_plausible
from geomosaic.orientation.planar.measurements import PlanarBlock, Tie
from geomosaic.orientation.planar.observation_equations import GROUND, PlanarProblem, mean_positions, views_of
from geomosaic.orientation.planar.simultaneous import (
    TILT_WORST_CONDITION,
    TiltTrial,
    adjust_unchecked,
    likeliest_tilts,
    missing_terms,
)
from geomosaic.orientation.planar.solution import PlanarSolution, image_residuals
from geomosaic.orientation.planar.transformations import (
    Frame,
    PlanarTransform,
    by_parameters,
    by_photo,
    half,
    photo_coordinates,
)
from geomosaic.orientation.planar.uncontrolled import as_ties, middle
from geomosaic.types import FloatArray, IntArray


def mean_shifts_of(
    block: PlanarBlock,
    solution: PlanarSolution,
    fixed: Mapping[str, PlanarTransform],
    left: Sequence[MeasurementKey] = (),
    tilted: frozenset[str] = frozenset(),
) -> tuple[MeanShifts, list[MeasurementLabel], list[MeasurementKey]]:
    """Mean shifts of a block at a solution of most of it, with their labels and keys.

    Parameters
    ----------
    block : PlanarBlock
    solution : PlanarSolution
        Of the block, or of it without some measurements.
    fixed : mapping of str to PlanarTransform
        Photos that are held.
    left : sequence of MeasurementKey
        What the solution is without.
    tilted : frozenset of str
        Photos with unknowns for what the kind of the solution lacks: the last ones, in the order of the block.
    """
    views, kind, values = views_of(block), solution.kind, solution.values
    problem = PlanarProblem(block, kind, views, solution.frame, fixed)
    names = [None if i == GROUND else block.photos[i].name for i in views.photo]
    out = set(left)
    off = np.array([(views.ids[p], name) in out for p, name in zip(views.point, names, strict=True)])
    inside = problem.in_photo
    sigma = np.where(off, np.inf, problem.sigma_ground(values, views.xy))
    points = mean_positions(views, problem.positions(values, views.xy), sigma)
    errors = image_residuals(problem, values, points)[inside]
    at, photo, point = problem.adjusted(values, points)[inside], views.photo[inside], views.point[inside]
    own = values[photo]
    turn = np.array([1.0, -1.0]) / problem.half[photo, None]
    by_point = np.linalg.inv(by_photo(kind, own, at) * turn[:, None, :])
    slopes = -by_point @ by_parameters(kind, own, at)

    given, given_sigma = np.zeros((len(views.ids), 2)), np.full(len(views.ids), np.inf)
    ground = np.flatnonzero(~inside)
    known = views.point[ground]
    given[known] = problem.ground[ground] - points[known]
    given_sigma[known] = views.sigma[ground] / problem.frame.scale
    held = given_sigma[point] == 0.0  # linearised where the photos put it, but held where it is given
    errors[held] -= np.einsum("nij,nj->ni", by_point[held], given[point[held]])

    seen = np.bincount(point, minlength=len(views.ids))
    used = (seen[point] > 1) | np.isfinite(given_sigma[point])
    numbers = np.unique(point[used], return_inverse=True)[1]
    chosen = np.unique(point[used])
    first = problem.first[photo[used]]
    columns = np.where(first[:, None] >= 0, first[:, None] + np.arange(problem.count), -1)
    columns, slopes, sizes = _with_tilt(problem, tilted, at[used], photo[used], columns, slopes[used])
    sigma, given_sigma = views.sigma[inside][used], np.repeat(given_sigma[chosen, None], 2, axis=1)
    whiten = 1.0 / sigma[:, None, None]
    measured = Observations(numbers, columns, slopes * whiten, by_point[used] * whiten, errors[used] / sigma[:, None])
    blocks = np.concatenate([[0], np.cumsum(sizes)])
    network = Network((measured, Observations.of_coordinates(given[chosen], given_sigma)), blocks, given_sigma > 0.0)
    images = [block.photos[int(k)].name for k in photo[used]]
    ids = [views.ids[k] for k in chosen]
    lines = [block.by_photo[name][ids[k]].where for name, k in zip(images, numbers, strict=True)]
    return candidate_shifts(network, (sigma, given_sigma), ids, images, lines, "tie point")


def tilt_shifts(block: PlanarBlock, kind: str, tilted: frozenset[str], unknowns: FloatArray) -> dict[str, float]:
    """Largest shift in pixels, at the points of each tilted photo, by the unknowns (U,) that the kind lacks.

    Parameters
    ----------
    block : PlanarBlock
    kind : str
        'conformal', 'affine' or 'projective'.
    tilted : frozenset of str
        Photos taken as tilted.
    unknowns : array (U,)
        Unknowns of all photos; those that the kind lacks come last.
    """
    names = [photo.name for photo in block.photos if photo.name in tilted]
    count = missing_terms(kind, np.zeros((1, 2))).shape[-1]
    own = unknowns[len(unknowns) - count * len(names) :].reshape(len(names), count)
    found = {}
    for name, values in zip(names, own, strict=True):
        size = block.photo(name).size
        colrow = np.array([[p.col, p.row] for p in block.by_photo[name].values()])
        moved = missing_terms(kind, photo_coordinates(size, colrow)) @ values * half(size)
        found[name] = float(np.hypot(*moved.T).max())
    return found


def _with_tilt(
    problem: PlanarProblem,
    tilted: frozenset[str],
    at: FloatArray,
    photo: IntArray,
    columns: IntArray,
    slopes: FloatArray,
) -> tuple[IntArray, FloatArray, IntArray]:
    """Columns and slopes of the views with those of what the kind lacks, and how many unknowns each block has."""
    sizes = np.full(problem.unknowns // problem.count, problem.count)
    if not tilted:
        return columns, slopes, sizes
    terms = missing_terms(problem.kind, at) * (np.array([1.0, -1.0]) * problem.half[photo, None])[:, :, None]
    count = terms.shape[-1]
    own = np.array([one.name in tilted for one in problem.block.photos])
    first = np.where(own, problem.unknowns + (np.cumsum(own) - 1) * count, -1)[photo]
    further = np.where(first[:, None] >= 0, first[:, None] + np.arange(count), -1)
    return (
        np.hstack([columns, further]),
        np.concatenate([slopes, terms], axis=2),
        np.concatenate([sizes, np.full(len(tilted), count)]),
    )


# Adjustments without what was found, until nothing else is: the search is linear, transformations need not be.
ROUNDS = 8


@dataclass(frozen=True, eq=False)
class SearchedBlock:
    """Block after a search for blunders.

    Attributes
    ----------
    findings : BlunderReport
    block : PlanarBlock
        Without what was found.
    whole : PlanarBlock
    solved : tuple, optional
        Adjustment of the whole block, and the affine one it started from; None where it fails.
    """

    findings: BlunderReport
    block: PlanarBlock
    whole: PlanarBlock
    solved: tuple[PlanarSolution, PlanarSolution | None] | None = None

    def enforced(self, where: str, policy: str) -> tuple[PlanarBlock, BlunderReport]:
        """Block to go on with and report under a policy; see `BlunderReport.enforce`."""
        self.findings.enforce(where, policy)
        return self.block if policy == "leave" else self.whole, replace(self.findings, policy=policy)


def adjust_checked(
    block: PlanarBlock,
    kind: str,
    fixed: Mapping[str, PlanarTransform] | None = None,
    *,
    policy: str = "stop",
    where: str = "tie and control points",
) -> tuple[PlanarSolution, BlunderReport]:
    """Simultaneous adjustment after a search for blunders; see `simultaneous.adjust` and `BlunderReport.enforce`.

    Parameters
    ----------
    block : PlanarBlock
    kind : str
        'conformal', 'affine' or 'projective'.
    fixed : mapping of str to PlanarTransform, optional
        Photos that are held, by name.
    policy : str
        One of `findings.POLICIES`.
    where : str, optional
        Named in errors.

    Raises
    ------
    InputError
        A point is grossly wrong and the policy is 'stop'.
    SolveError
    """
    held = dict(fixed or {})
    looked = search_block(block, kind, held)
    used, found = looked.enforced(where, policy)
    known = looked.solved if looked.solved and not found.blunders else None
    solution, start = known or adjust_unchecked(used, kind, held, None)
    check_plausible(solution, start, None)
    return solution, found


def search_block(block: PlanarBlock, kind: str, fixed: Mapping[str, PlanarTransform] | None = None) -> SearchedBlock:
    """Search for blunders in a simultaneous adjustment.

    Parameters
    ----------
    block : PlanarBlock
    kind : str
        'conformal', 'affine' or 'projective'.
    fixed : mapping of str to PlanarTransform
        Photos that are held, by name.

    Raises
    ------
    SolveError
        The block cannot be adjusted, and no wrong point is to blame.
    """
    # Where a projective adjustment fails, a wrong point may be why: it is then looked for in the affine one.
    held, left = dict(fixed or {}), list[MeasurementKey]()
    report, out, tilted = BlunderReport(), list[MeasurementKey](), frozenset[str]()
    whole: tuple[PlanarSolution, PlanarSolution | None] | None = None
    for _ in range(ROUNDS):
        try:
            solution, start = adjust_unchecked(without_measurements(block, left), kind, held, None)
            whole = whole or (None if left else (solution, start))
        except SolveError:
            if left:  # what remains no longer holds the photos: what was found stands
                break
            if kind != "projective":
                raise
            solution, _ = adjust_unchecked(block, "affine", held, None)
        free = frozenset(photo.name for photo in block.photos if photo.name not in held)
        trial = likeliest_tilts(_searches(block, solution, held, left), solution.kind, tilted, free)
        tilted = trial.tilted
        report, before = trial.report(), set(left)
        left, out = [trial.keys[k] for k in trial.found.included], [trial.keys[each.shift] for each in report.blunders]
        if set(left) == before:
            if solution.kind != kind:  # neither kind has a wrong point to blame: let the error say what it is
                adjust_unchecked(block, kind, held, None)
            break
    return SearchedBlock(report, without_measurements(block, out), block, whole)


def search_any_adjustment(block: PlanarBlock, kind: str, uncontrolled: bool) -> SearchedBlock:
    """Search in the first simultaneous adjustment that is possible: `kind` or conformal, on control or on ties.

    On ties alone the photo in the middle is held. Where no adjustment is possible, nothing is found: what needs the
    points will say why.

    Parameters
    ----------
    block : PlanarBlock
    kind : str
        'conformal', 'affine' or 'projective'.
    uncontrolled : bool
        Whether the mosaic is made of ties alone.
    """
    start = block.photo(middle(block))
    step = half(start.size)
    held = {start.name: PlanarTransform(start, "conformal", Frame(), np.array([step, 0.0, 0.0, 0.0]))}
    ways: list[tuple[PlanarBlock, dict[str, PlanarTransform]]] = [(block, {})]
    if uncontrolled:
        ways.append((PlanarBlock(block.photos, as_ties(block)), held))
    for model in dict.fromkeys((kind, "conformal")):
        for measured, fixed in ways:
            with suppress(SolveError):
                found = search_block(measured, model, fixed)
                own = {(p.id, p.photo) for p in found.block.measurements}
                places = {p.id for p in measured.control} - {p.id for p in found.block.control}
                gone = [(p.id, p.photo) for p in block.measurements if (p.id, p.photo) not in own]
                return SearchedBlock(
                    found.findings, without_measurements(block, [*gone, *((name, None) for name in places)]), block
                )
    return SearchedBlock(BlunderReport(), block, block)


def search_each_photo(block: PlanarBlock, kind: str) -> SearchedBlock:
    """Search in each photo by itself, adjusted to its own control.

    Parameters
    ----------
    block : PlanarBlock
    kind : str
        'conformal', 'affine' or 'projective'.
    """
    report, left = list[BlunderReport](), list[MeasurementKey]()
    for photo in block.photos:
        own = PlanarBlock((photo,), (), tuple(point for point in block.control if point.photo == photo.name))
        with suppress(SolveError):  # too few or badly spread: the fit itself will say so
            found = search_block(own, kind)
            report.append(found.findings)
            kept = {point.id for point in found.block.control}
            left += [(point.id, photo.name) for point in own.control if point.id not in kept]
    with suppress(SolveError):  # ties take no part, but gaps at them are reported, so blunders are named
        of_ties = [
            each for each in search_block(block, kind).findings.blunders if each.label.name.startswith("tie point")
        ]
        report.append(BlunderReport(tuple(replace(each, gross=False) for each in of_ties)))
    return SearchedBlock(combined(report), without_measurements(block, left), block)


def without_measurements(block: PlanarBlock, left: Sequence[MeasurementKey]) -> PlanarBlock:
    """Block without some measurements; points whose coordinates are left out become tie points.

    Parameters
    ----------
    block : PlanarBlock
    left : sequence of MeasurementKey
        Measurements to leave out.
    """
    out, places = set(left), {name for name, photo in left if photo is None}
    ties = [tie for tie in block.ties if (tie.id, tie.photo) not in out]
    control = [point for point in block.control if (point.id, point.photo) not in out]
    ties += [Tie(p.id, p.photo, p.col, p.row, p.sigma, p.where) for p in control if p.id in places]
    return PlanarBlock(block.photos, tuple(ties), tuple(p for p in control if p.id not in places))


def _searches(
    block: PlanarBlock, solution: PlanarSolution, fixed: Mapping[str, PlanarTransform], left: Sequence[MeasurementKey]
) -> Callable[[frozenset[str]], TiltTrial | None]:
    """The search in the block at a solution, as a function of the photos that are taken as tilted."""

    def search_with(tilted: frozenset[str]) -> TiltTrial | None:
        shifts, labels, keys = mean_shifts_of(block, solution, fixed, left, tilted)
        if tilted and not shifts.network.condition()[0] < TILT_WORST_CONDITION:
            return None
        index = {key: k for k, key in enumerate(keys)}
        found = search_shifts(shifts, [index[key] for key in left if key in index])
        size = tilt_shifts(block, solution.kind, tilted, shifts.unknowns(found.included))
        return TiltTrial(size, shifts, labels, keys, found)

    return search_with
