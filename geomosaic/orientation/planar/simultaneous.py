"""Simultaneous least squares adjustment of all photos of a planar block, and photos tilted beyond its model.

A conformal or affine adjustment lays the tilt of a photo to its points, and the search for wrong points would blame
those. So each photo may have what the model lacks as unknowns of its own, in its image and to the first order:

    affine       (x² , x·y), (x·y, y²)                    perspective
    conformal    (x, −y), (y, x) besides                  two scales and a shear

and of two explanations of the same contradictions, the likelier one is taken.

The equations (9-3) and (9-4) are linear for conformal and affine transformations. Projective ones are linearised by
Taylor's series, started from the affine solution. What is measured, and errs, are image coordinates, which stand in the
coefficients of the equations: these are taken at the adjusted places, the measurements less their residuals (adjustment
of observations and parameters combined, Mikhail 1976), and the weights at the scale that the photos come to have. So a
linear adjustment too takes some rounds. At their end the sum of squared residuals in the images is least.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.estimation.blunders.findings import BlunderReport, MeasurementKey, MeasurementLabel, report_of
from geomosaic.estimation.blunders.mean_shift import ALPHA, MeanShifts, ShiftSearch
from geomosaic.estimation.network import Network
from geomosaic.estimation.solver import Linearised, Outcome, Problem, Solution, Stopping, solve
from geomosaic.estimation.statistics import sigma0_of
from geomosaic.orientation.planar.determinacy import check_determined, check_plausible, ill_conditioned
from geomosaic.orientation.planar.measurements import PlanarBlock
from geomosaic.orientation.planar.observation_equations import (
    PlanarProblem,
    frame_of,
    mean_positions,
    views_of,
    weights_of_pairs,
)
from geomosaic.orientation.planar.solution import PlanarSolution, cofactor_blocks, image_residuals, standardised
from geomosaic.orientation.planar.transformations import PlanarTransform
from geomosaic.types import FloatArray

# Unknowns of a photo that a projective transformation has and this one has not.
MISSING = {"conformal": 4, "affine": 2, "projective": 0}
# Photos tried one by one, those with the most contradictions.
TRIED = 3
# Sum of squares that is as good as none.
TINY = 1e-12
# Condition number from which on the points do not hold a photo's further unknowns.
TILT_WORST_CONDITION = 1e6


@dataclass(frozen=True, eq=False)
class TiltTrial:
    """Search for blunders with some photos taken as tilted.

    Attributes
    ----------
    sizes : dict of str to float
        Photos that are taken as tilted, and by how much that shifts their points at most, pixels.
    shifts : MeanShifts
    labels : list of MeasurementLabel
        Of the shifts.
    keys : list
        What each shift is of.
    found : ShiftSearch
    """

    sizes: dict[str, float]
    shifts: MeanShifts
    labels: list[MeasurementLabel]
    keys: list[MeasurementKey]
    found: ShiftSearch

    @property
    def tilted(self) -> frozenset[str]:
        """Photos that are taken as tilted."""
        return frozenset(self.sizes)

    def report(self) -> BlunderReport:
        """Report of the blunders and of the tilted photos."""
        tilted = sorted(self.sizes.items(), key=lambda each: -each[1])
        return replace(report_of(self.shifts, self.found, self.labels), tilted=tuple(tilted))

    def gain(self, other: TiltTrial, kind: str, photos: int) -> float:
        """Twice the logarithm of how much likelier this explanation is than another; above 0 it is the better one.

        Parameters
        ----------
        other : TiltTrial
        kind : str
        photos : int
        """
        # The sums of squares are compared as the search compares them (the scale is not known), and each shift and each
        # tilt is charged what chance would gain by picking the best of as many, times a hundred.
        each = {"shift": 2.0 * np.log(len(self.shifts) / ALPHA), "tilt": 2.0 * np.log(photos / ALPHA) + MISSING[kind]}
        charge = each["shift"] * (len(self.found.included) - len(other.found.included))
        charge += each["tilt"] * (len(self.sizes) - len(other.sizes))
        mine, theirs = self.found.state, other.found.state
        freedom = min(mine.redundancy, theirs.redundancy)
        return float(freedom * np.log(max(theirs.squares, TINY) / max(mine.squares, TINY)) - charge)


def likeliest_tilts(
    search: Callable[[frozenset[str]], TiltTrial | None], kind: str, tilted: frozenset[str], photos: frozenset[str]
) -> TiltTrial:
    """Search with those photos taken as tilted for which that is likelier than so many blunders.

    Parameters
    ----------
    search : function of the photos that are taken as tilted
        None where the points do not hold their unknowns.
    kind : str
        Of the adjustment.
    tilted : frozenset of str
        To begin with; must be possible.
    photos : frozenset of str
        That may be.
    """
    best = search(tilted)
    if best is None:
        raise RuntimeError("photos whose unknowns are not held")
    while MISSING[kind] and best.tilted != photos:
        blamed = Counter(image for shift in best.found.included for image in best.labels[shift].images)
        # One photo, all that are blamed, or all of them: not every choice, whose number doubles with each photo.
        suspects = [image for image, _ in blamed.most_common() if image in photos - best.tilted]
        ways = [*(frozenset({image}) for image in suspects[:TRIED]), frozenset(suspects), photos]
        chosen = dict.fromkeys(best.tilted | way for way in ways if way)
        trials = [trial for trial in map(search, chosen) if trial is not None]
        gains = [trial.gain(best, kind, len(photos)) for trial in trials]
        if not gains or not max(gains) > 0.0:
            break
        best = trials[int(np.argmax(gains))]
    return best


def missing_terms(kind: str, xy: FloatArray) -> FloatArray:
    """Shifts (N, 2, K) of (x, y) in the image by what a kind lacks, at photo coordinates (N, 2).

    Parameters
    ----------
    kind : str
        'conformal', 'affine' or 'projective'.
    xy : array (N, 2)
        Normalised photo coordinates: from the middle, to the right and upwards.
    """
    x, y = xy.T
    perspective = np.array([[x * x, x * y], [x * y, y * y]])
    scales = np.array([[x, y], [-y, x]])
    terms = {"projective": [np.zeros((2, 0, len(x)))], "affine": [perspective], "conformal": [perspective, scales]}[
        kind
    ]
    return np.moveaxis(np.concatenate(terms, axis=1), -1, 0)


# Movements are those of measured points, pixels. Near the solution the sum of squares may rise by a hair from round to
# round: the places at which it is taken are not yet those of the step.
RULES = Stopping(rounds=40, step=1e-9, near=1e-6, gain=None, rise=0.1)
# Of the design. Beyond it half of the digits of a solution are noise.
WORST_CONDITION = 1e7


def adjust(
    block: PlanarBlock, kind: str, fixed: Mapping[str, PlanarTransform] | None = None, where: str | None = None
) -> PlanarSolution:
    """Simultaneous adjustment of all photos of a block.

    Parameters
    ----------
    block : PlanarBlock
    kind : str
        'conformal', 'affine' or 'projective'.
    fixed : mapping of str to PlanarTransform, optional
        Photos whose place is given and held; they take the part of control. What a kind of fewer parameters cannot
        say of them is dropped.
    where : str, optional
        Named in errors.

    Raises
    ------
    SolveError
        Too few points or control, a block in pieces, points on a line; or, with projective transformations, an
        ill-conditioned or divergent solution, as strong relief causes it.
    """
    held = {name: transform for name, transform in (fixed or {}).items() if name in block.index}
    solution, start = adjust_unchecked(block, kind, held, where)
    check_plausible(solution, start, where)
    return solution


def adjust_unchecked(
    block: PlanarBlock, kind: str, fixed: Mapping[str, PlanarTransform], where: str | None
) -> tuple[PlanarSolution, PlanarSolution | None]:
    """Simultaneous adjustment, unchecked, and the affine one that a projective one started from.

    Parameters
    ----------
    block : PlanarBlock
    kind : str
        'conformal', 'affine' or 'projective'.
    fixed : mapping of str to PlanarTransform
        Photos that are held, by name.
    where : str, optional
        Named in errors.
    """
    if kind != "projective":
        return _solve(block, kind, fixed, None, where), None
    check_determined(block, kind, fixed, where)
    # Projective equations are not linear: from the affine solution, which needs no start, they converge.
    start = _solve(block, "affine", fixed, None, where)
    return _solve(block, kind, fixed, start, where), start


def _solve(
    block: PlanarBlock,
    kind: str,
    fixed: Mapping[str, PlanarTransform],
    start: PlanarSolution | None,
    where: str | None,
) -> PlanarSolution:
    check_determined(block, kind, fixed, where)
    problem = PlanarProblem(block, kind, views_of(block), frame_of(block, fixed), fixed)
    values = problem.start.copy()
    if start is not None:
        values[~problem.held, :6] = start.values[~problem.held]
    adjustment = _Adjustment(problem, where)
    first = _State(values, problem.views.xy, problem.sigma_ground(None if start is None else values, problem.views.xy))
    solution = solve(adjustment, first, RULES)
    if solution.outcome is not Outcome.CONVERGED:
        raise adjustment.ill_conditioned(solution.state)
    return _finish(adjustment, solution)


@dataclass(frozen=True, eq=False)
class _State:
    """Parameters (K, P), places (N, 2) of linearisation in the photos, standard deviations (N,) on the ground."""

    values: FloatArray
    at: FloatArray
    sigma: FloatArray


@dataclass(frozen=True, eq=False)
class _Adjustment(Problem[_State]):
    """The equations of pairs, whose places and weights are taken anew after each step."""

    block: PlanarProblem
    where: str | None

    def linearise(self, state: _State) -> Network:
        network = self.network(state)
        if not network.condition()[0] < WORST_CONDITION:
            raise self.ill_conditioned(state, network)
        return network

    def network(self, state: _State) -> Network:
        return self.block.network(state.values, state.at, weights_of_pairs(self.block.views, state.sigma))

    def squares(self, state: _State) -> float:
        weights = weights_of_pairs(self.block.views, state.sigma)
        return float((weights[:, None] * self.block.misclosure(state.values, state.at) ** 2).sum())

    def moved(self, state: _State, step: FloatArray) -> _State:
        return replace(state, values=self.block.moved(state.values, step))

    def movement(self, state: _State, trial: _State, equations: Linearised, step: FloatArray) -> float:
        """Largest shift of a measured point on the ground, in pixels of its photo."""
        inside, at = self.block.in_photo, state.at
        pixel = self.block.sigma_ground(trial.values, at)[inside] / self.block.views.sigma[inside]
        change = np.abs(self.block.positions(trial.values, at) - self.block.positions(state.values, at))[inside]
        return float((change / pixel[:, None]).max())

    def refreshed(self, state: _State) -> _State:
        """Weights at the scale the photos have now, and places at the measurements less their residuals."""
        sigma = self.block.sigma_ground(state.values, state.at)
        points = mean_positions(self.block.views, self.block.positions(state.values, state.at), sigma)
        at = self.block.adjusted(state.values, points)
        if not np.isfinite(at).all():
            raise self.ill_conditioned(state)
        return _State(state.values, at, sigma)

    def ill_conditioned(self, state: _State, network: Network | None = None) -> SolveError:
        """Error that names the photo determined worst."""
        condition, worst = (network or self.network(state)).condition()
        return ill_conditioned(self.block.block, self.block.kind, condition, self.block.photo_of(worst), self.where)


def _finish(adjustment: _Adjustment, solution: Solution[_State]) -> PlanarSolution:
    """Cofactors and residuals at the solution."""
    problem, values, at = adjustment.block, solution.state.values, solution.state.at
    views = problem.views
    sigma = problem.sigma_ground(values, at)
    final = _State(values, at, sigma)
    # At the final places and weights: those of the last round are one step old.
    network, squares = adjustment.network(final), adjustment.squares(final)
    cofactors = cofactor_blocks(problem, network)
    points = mean_positions(views, problem.positions(values, at), sigma)
    residuals = image_residuals(problem, values, points)
    redundancy = views.redundancy_of_points - problem.unknowns
    return PlanarSolution(
        block=problem.block,
        kind=problem.kind,
        frame=problem.frame,
        values=values,
        cofactors=cofactors,
        views=views,
        points=problem.frame.map(points),
        residuals=residuals,
        standardised=standardised(problem, values, at, sigma, cofactors, residuals),
        sigma0=sigma0_of(squares, redundancy),
        redundancy=redundancy,
        equations=2 * len(views.pairs),
        condition=network.condition()[0],
        rounds=solution.rounds,
    )
