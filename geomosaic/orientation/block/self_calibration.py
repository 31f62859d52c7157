"""Self-calibration that a block can bear: which held parameters of the interior orientation its residuals ask for.

The score test (Rao 1948): at the minimum with B held, freeing B changes it by δ and the sum of squares by −bᵀδ,

    δ = S⁻¹·b,   b = Bᵀv,   S = BᵀB − BᵀA·Q·AᵀB,   Q the cofactors of all other unknowns, A their design

and Q becomes Q + G·S⁻¹·Gᵀ, with covariances −G·S⁻¹ against B, G = Q·AᵀB. Nothing is adjusted again.

A wrong focal length makes good camera positions, or good control, look wrong. Where a large share of such a kind was
left out, all of it counts again here, linearised: v is then w − A·dx of one more step.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, pairwise
from typing import Any, cast

import numpy as np

from geomosaic.estimation.network import Network
from geomosaic.estimation.statistics import sigma0_of, variance_factor
from geomosaic.orientation.block.adjustment import BlockAdjustment
from geomosaic.orientation.block.observations import ImagePositions, rescaled
from geomosaic.orientation.block.solution import HIGH_CORRELATION, BlockSolution
from geomosaic.sensor.plugin import HasInterior, Parameters
from geomosaic.types import FloatArray, IntArray

# Standard deviations that a parameter must be off: about the probability at which a measurement is left out.
WORTH = 4.0
# Share of a column that other unknowns leave, below which it may be rounding.
EXPLAINED = 1e-9
# Share of a kind of observations, left out, from which on they accuse the camera: blunders are a tenth at most.
MANY = 0.25


@dataclass(frozen=True, eq=False)
class Offer:
    """Held parameters of a camera that a block would change, and determines.

    Attributes
    ----------
    images : int array
        That the camera took.
    names, units : tuple of str
    change, sigmas : array (F,)
        What freeing all of them would change them by, and its standard deviation.
    sigma0 : tuple of float
        Now and then, of the measurements that count here: more than in the adjustment where `restored`.
    restored : bool
        Whether measurements count that the adjustment has left out.
    """

    images: IntArray
    names: tuple[str, ...]
    units: tuple[str, ...]
    change: FloatArray
    sigmas: FloatArray
    sigma0: tuple[float, float]
    restored: bool

    def facts(self, images: Sequence[str]) -> dict[str, Any]:
        """Plain values, with the names of all images (M,)."""
        rows = zip(self.names, self.units, self.change.tolist(), self.sigmas.tolist(), strict=True)
        return {
            "images": [images[index] for index in self.images.tolist()],
            "parameters": [{"name": n, "unit": u, "change": c, "sigma": s} for n, u, c, s in rows],
            "sigma0_before": self.sigma0[0],
            "sigma0": self.sigma0[1],
            "restored": self.restored,
        }


@dataclass(frozen=True, eq=False)
class ScoreTest:
    """Normal equations of held parameters, reduced by all other unknowns; in steps of about a pixel.

    Attributes
    ----------
    normal : array (F, F)
        Of the F parameters.
    right : array (F,)
        Right-hand side.
    by_others : array (U, F)
        Changes of the U other unknowns by those of the parameters.
    variances : array (U,)
        Cofactors of the others.
    squares : float
        Weighted sum of squares with all of the parameters held.
    redundancy : int
        The same.
    needs : mapping of int to tuple of int
        Parameters that are freed with another: see `needs_of`.
    largest_correlation : float
        With another parameter or unknown, from which on one cannot be told apart.
    """

    normal: FloatArray
    right: FloatArray
    by_others: FloatArray
    variances: FloatArray
    squares: float
    redundancy: int
    needs: Mapping[int, tuple[int, ...]] = field(default_factory=dict)
    largest_correlation: float = HIGH_CORRELATION

    def freed(self, which: list[int]) -> tuple[FloatArray, FloatArray, float]:
        """Change and cofactors of some parameters that are freed together, and what the sum of squares loses."""
        cofactors = np.asarray(np.linalg.inv(self.normal[np.ix_(which, which)]), dtype=np.float64)
        change = cofactors @ self.right[which]
        return change, cofactors, float(change @ self.right[which])

    def afterwards(self, gain: float, count: int) -> tuple[float, float]:
        """Factor from cofactors to covariances, and sigma0, where so many freed parameters gain so much."""
        redundancy = self.redundancy - count
        sigma0 = sigma0_of(max(self.squares - gain, 0.0), redundancy)
        return variance_factor(sigma0, redundancy), sigma0

    def worthwhile(self) -> list[int]:
        """Parameters that the residuals ask for and that can be told apart, the fewest that do, with their needs."""
        # Freed all together, k1 to k4 would hide each other; one by one, k2 would do the work of k1 and focal length:
        # all pairs are tried, and after each addition to the best others may take the place of what was chosen.
        every = range(len(self.right))
        chosen, _ = self._best([*combinations(every, 2)])
        if not chosen:
            return self._best([(each,) for each in every])[0]
        while True:
            best, more = self._best([(*chosen, each) for each in self._without(chosen)])
            if not best:
                return chosen
            while best:
                chosen, gain = best, more
                rest = self._without(chosen)
                best, more = self._best([(*(n for n in chosen if n != out), each) for out in chosen for each in rest])
                if more <= gain * (1.0 + 1e-9):
                    break

    def _without(self, chosen: list[int]) -> list[int]:
        return [each for each in range(len(self.right)) if each not in chosen]

    def _closed(self, which: Iterable[int]) -> list[int]:
        """Parameters with all that they need (marginality, Nelder 1977)."""
        found = {*which}
        while more := {need for each in found for need in self.needs.get(each, ())} - found:
            found |= more
        return sorted(found)

    def _best(self, sets: Iterable[Iterable[int]]) -> tuple[list[int], float]:
        """The most effective of some sets of parameters that can be told apart, and its gain; none and 0 without."""
        closed = [list(each) for each in dict.fromkeys(tuple(self._closed(each)) for each in sets)]
        gains = [self.freed(each)[2] for each in closed]
        for index in sorted(range(len(closed)), key=lambda index: -gains[index]):
            if self._significant(closed[index]) and self.separable(closed[index]):
                return closed[index], gains[index]
        return [], 0.0

    def _significant(self, which: list[int]) -> bool:
        """Whether each of them is off by more than chance, or is needed by one that is."""
        change, cofactors, gain = self.freed(which)
        factor, _ = self.afterwards(gain, len(which))
        off = change**2 >= WORTH**2 * factor * np.diag(cofactors)
        without = {*which} - {*self._closed(one for one, wrong in zip(which, off.tolist(), strict=True) if wrong)}
        return not without

    def separable(self, which: list[int]) -> bool:
        """Whether none of them would correlate highly with another or with any other unknown."""
        cofactors = self.freed(which)[1]
        sigmas = np.sqrt(np.diag(cofactors))
        among = np.abs(cofactors / (sigmas[:, None] * sigmas)) - np.eye(len(which))
        covariance = self.by_others[:, which] @ cofactors
        others = np.sqrt(self.variances + (covariance * self.by_others[:, which]).sum(axis=1))
        against = np.abs(covariance) / (np.where(others > 0.0, others, np.inf)[:, None] * sigmas)
        return bool(max(among.max(), against.max(initial=0.0)) < self.largest_correlation)


def needs_of(names: Sequence[str]) -> dict[int, tuple[int, ...]]:
    """Parameters without which others of a lens mean nothing, by their places.

    A radial term needs that of the next lower order (k2 beside a wrong k1 would do the work of both), and the two of
    decentring stand for one displacement, whose direction is arbitrary.

    Parameters
    ----------
    names : sequence of str
    """
    radial = sorted((int(name[1:]), place) for place, name in enumerate(names) if name[0] == "k" and name[1:].isdigit())
    found: dict[int, tuple[int, ...]] = {place: (lower,) for (_, lower), (_, place) in pairwise(radial)}
    if "p1" in names and "p2" in names:
        one, other = names.index("p1"), names.index("p2")
        found |= {one: (other,), other: (one,)}
    return found


def offers(
    solution: BlockSolution,
    camera: IntArray,
    without: Collection[str] = (),
    largest_correlation: float = HIGH_CORRELATION,
) -> list[Offer]:
    """Held parameters of interior orientations that the residuals ask for and the block determines.

    Parameters
    ----------
    solution : BlockSolution
    camera : int array (M,)
        Camera of each image.
    without : collection of str
        Parameters that stay held.
    largest_correlation : float
        With another parameter or unknown, from which on one cannot be told apart.

    Returns
    -------
    list of Offer
        One for each camera that should not be held as it is; by camera.
    """
    adjustment = solution.adjustment
    # Of a block too large for cofactors nobody knows what could be told apart.
    if not (adjustment.state.weights[0] > 0.0).any() or adjustment.redundancy < 2 or adjustment.network.approximate:
        return []
    found, with_all = [], _with_all(adjustment)
    for number in np.unique(camera).tolist():
        images = np.flatnonzero(camera == number)
        interior = _shared(solution, images)
        if interior is None:
            continue
        held = np.flatnonzero((interior.sigmas == 0.0) & ~np.isin(interior.names, [*without]))
        if len(held):
            offer = _offer(solution, images, interior, held, with_all, largest_correlation)
            found.append(offer)
    return [each for each in found if each is not None]


def _with_all(adjustment: BlockAdjustment) -> tuple[Network, int, bool]:
    """Network in which all of a kind counts of which much was left out, its redundancy, and whether there was any."""
    state, groups, weights = adjustment.state, list(adjustment.problem.groups), list(adjustment.state.weights)
    # Image positions that scatter more than was declared do so here as well.
    wrong = {each.index: each for each in adjustment.wrong_groups if each.index}
    unobserved = 0
    for index, (group, weight, out) in enumerate(zip(groups, weights, adjustment.rejected, strict=True)):
        many = not isinstance(group, ImagePositions) and len(out) and out.mean() > MANY
        if index not in wrong and not many:
            continue
        # As a whole for another datum or scatter: it counts as it was given.
        if index in wrong:
            groups[index] = rescaled(group, 1.0 / wrong[index].scatter)
        back = (weight == 0.0) & group.placed(state.moving)
        weights[index] = np.where(back, 1.0, weight)
        unobserved += int((~group.observed[back]).sum())
    if all(a is b for a, b in zip(weights, state.weights, strict=True)):
        return adjustment.network, adjustment.redundancy, False
    problem = replace(adjustment.problem, groups=tuple(groups))
    network = problem.linearise(replace(state, weights=tuple(weights)))
    more = network.misclosure.size - adjustment.network.misclosure.size - unobserved
    return network, adjustment.redundancy + more, True


def _offer(
    solution: BlockSolution,
    images: IntArray,
    interior: Parameters,
    held: IntArray,
    counted: tuple[Network, int, bool],
    largest_correlation: float,
) -> Offer | None:
    network, redundancy, restored = counted
    score, held = score_test(network, redundancy, interior_design(solution, images, interior, held), held)
    needs = needs_of([interior.names[index] for index in held.tolist()])
    chosen = replace(score, needs=needs, largest_correlation=largest_correlation).worthwhile()
    if not chosen:
        return None
    change, cofactors, gain = score.freed(chosen)
    factor, sigma0 = score.afterwards(gain, len(chosen))
    both = (score.afterwards(0.0, 0)[1], sigma0)
    which, steps = held[chosen], interior.steps[held[chosen]]
    names, units = (tuple(own[index] for index in which.tolist()) for own in (interior.names, interior.units))
    return Offer(
        images,
        names,
        units,
        change * steps,
        np.sqrt(np.diag(cofactors) * factor) * steps,
        both,
        restored,
    )


def _shared(solution: BlockSolution, images: IntArray) -> Parameters | None:
    """Interior orientation of a camera; None where its images have none, or several."""
    models = [solution.models[index] for index in images.tolist()]
    if not all(isinstance(model, HasInterior) for model in models):
        return None
    one, *others = (cast(HasInterior, model).interior for model in models)
    alike = all(each.names == one.names and np.allclose(each.values, one.values, rtol=1e-12) for each in others)
    return one if alike else None


def interior_design(solution: BlockSolution, images: IntArray, interior: Parameters, held: IntArray) -> FloatArray:
    """Whitened derivatives (N, 2, F) of the image positions that take part by held parameters, in their steps.

    Parameters
    ----------
    solution : BlockSolution
    images : int array (M,)
        Images of the camera.
    interior : Parameters
        Its interior orientation.
    held : int array (F,)
        Places of the parameters in it.

    Returns
    -------
    array (N, 2, F)
        Zero for positions in images of other cameras.
    """
    problem, state = solution.adjustment.problem, solution.adjustment.state
    views, weight = problem.views, state.weights[0]
    design = np.zeros((len(views), 2, len(held)))
    for image in images.tolist():
        model, rows = state.models[image], views.slice_of(image)
        ground = problem.frame.places(model.crs, state.points[views.points[rows]])
        slopes = cast(HasInterior, model).interior_jacobian(ground)[:, :, held] * interior.steps[held]
        design[rows] = views.root[rows] @ slopes * np.sqrt(weight[rows])[:, None, None]
    return design[weight > 0.0]


def score_test(network: Network, redundancy: int, design: FloatArray, held: IntArray) -> tuple[ScoreTest, IntArray]:
    """Score test (Lagrange multiplier test) of held parameters: what freeing them would change, without a solution.

    Parameters
    ----------
    network : Network
        Linearised at the solution with the parameters held.
    redundancy : int
        Of it.
    design : array (N, 2, F)
        Of `interior_design`.
    held : int array (F,)
        Places of the parameters in their interior orientation.

    Returns
    -------
    test : ScoreTest
    known : int array (K,)
        Those of `held` that other unknowns do not explain.
    """
    sides = np.column_stack([_turned(network, design[:, :, index]) for index in range(len(held))])
    by_others, residuals = network.solve(sides), network.residuals(network.step())
    flat = design.reshape(-1, len(held))
    own = flat.T @ flat
    normal = own - sides.T @ by_others
    known = np.diag(normal) > EXPLAINED * np.diag(own)
    right = flat.T @ residuals[: len(flat)]
    score = ScoreTest(
        (normal + normal.T)[np.ix_(known, known)] / 2.0, right[known],
        by_others[: network.parameters, known], network.parameter_variances(),
        float(residuals @ residuals), redundancy,
    )  # fmt: skip
    return score, held[known]


def _turned(network: Network, values: FloatArray) -> FloatArray:
    """Aᵀ·v (unknowns,) of values (N, 2) of the image positions."""
    # Those of the normal equations leave out the parameters that they hold for a free datum.
    group, (points, axes) = network.groups[0], network.moving.shape
    by_parameters = np.einsum("nkp,nk->np", group.by_parameters, values)
    free = group.columns >= 0
    parameters = np.bincount(group.columns[free], by_parameters[free], network.parameters)
    by_point = np.einsum("nkd,nk->nd", group.by_point, values)
    seen = group.point >= 0
    own = [np.bincount(group.point[seen], by_point[seen, axis], points) for axis in range(axes)]
    return np.concatenate([parameters, np.stack(own, axis=1)[network.moving]])
