"""Colour model of a block: gains, offsets, gammas and fields solved band by band, dodging, and selection of terms.

corrected = field(place) · gain · R · ((value + dark − haze · path(place)) / R)^gamma
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geomosaic.estimation.solver import Problem, Stopping, solve
from geomosaic.estimation.statistics import BIWEIGHT_LIMIT, MAD_TO_SIGMA, biweight
from geomosaic.radiometry import corrections as bases
from geomosaic.radiometry.normal_equations import (
    MIN_LIGHT,
    BandEquations,
    BandProblem,
    BandState,
    ColourSetting,
    Prior,
    StateParts,
    image_levels,
)
from geomosaic.radiometry.overlaps import MIN_SIGMA, PairedSamples, neighbourhoods
from geomosaic.types import BoolArray, FloatArray

# Change of the logarithm of a gain at which the iteration ends.
CONVERGED = 2e-5


@dataclass(frozen=True)
class ColourModel:
    """Parameters of the colour model; gains as logarithms, offsets applied before gains.

    Attributes
    ----------
    setting : ColourSetting
    gain, dark, gamma : array (images, bands)
        Gain as its logarithm.
    shared : array (width, bands)
        Coefficients of `corrections.shared_functions`.
    level : array (bands,)
        Subtracted from the logarithm of the field, so that its mean over all samples is 0.
    haze : array (images, bands), optional
        Grey values in the corners.
    dodging : array (images, nodes², bands), optional
        Logarithms at the nodes of a net over each image.
    """

    setting: ColourSetting
    gain: FloatArray
    dark: FloatArray
    gamma: FloatArray
    shared: FloatArray
    level: FloatArray
    haze: FloatArray | None = None
    dodging: FloatArray | None = None

    def log_field(self, index: int, image: FloatArray, view: FloatArray) -> FloatArray:
        """Logarithm (N, bands) of the field of an image at positions (N, 2) in it and on the ground.

        Parameters
        ----------
        index : int
            Number of the image.
        image : array (N, 2)
            Positions in the image.
        view : array (N, 2)
            View of the ground there.
        """
        own = self.setting
        camera = np.full(len(image), own.camera[index])
        log = bases.shared_functions(own.terms, own.cameras, camera, image, view) @ self.shared - self.level
        if own.camera[index] < 0:
            return np.zeros_like(log)
        if self.dodging is not None:
            node, weight = bases.bilinear_weights(image, round(self.dodging.shape[1] ** 0.5))
            log += (self.dodging[index][node] * weight[..., None]).sum(axis=1)
        return log

    def tone(self, index: int, values: FloatArray) -> FloatArray:
        """Values (..., bands) corrected without their position: gain · R · ((value + dark) / R)^gamma."""
        pivot, gamma = self.setting.pivot, self.gamma[index]
        plain = (values + self.dark[index]) / pivot
        power = np.where(gamma == 1.0, plain, np.maximum(plain, MIN_LIGHT) ** gamma)
        return np.asarray(np.exp(self.gain[index]) * pivot * power)

    def correct(self, index: int, values: FloatArray, image: FloatArray, view: FloatArray) -> FloatArray:
        """Corrected values (N, bands) at positions (N, 2) in the image and on the ground.

        Parameters
        ----------
        index : int
            Number of the image.
        values : array (N, bands)
        image : array (N, 2)
            Positions in the image.
        view : array (N, 2)
            View of the ground there.
        """
        clear = values if self.haze is None else values - self.haze[index] * bases.excess_air_path(view)[:, None]
        return self.tone(index, clear) * np.exp(self.log_field(index, image, view))

    def corrected(self, views: PairedSamples) -> tuple[FloatArray, FloatArray]:
        """Corrected values (P, K, bands) of both images of each pair."""
        out = []
        sides = (
            (views.first, views.a, views.image_a, views.view_a),
            (views.second, views.b, views.image_b, views.view_b),
        )
        for number, values, image, view in sides:
            shown = np.empty_like(values)
            for p, index in enumerate(number.tolist()):
                shown[p] = self.correct(index, values[p], image[p], view[p])
            out.append(shown)
        return out[0], out[1]


def solve_colour_model(
    views: PairedSamples, setting: ColourSetting, gain: FloatArray, offset: FloatArray, linear: Collection[int] = ()
) -> ColourModel:
    """Colour model with the terms of a setting, solved band by band.

    Parameters
    ----------
    views : PairedSamples
    setting : ColourSetting
    gain, offset : array (images, bands)
        Start values: corrected = gain · value + offset, without fields.
    linear : collection of int
        Images whose gamma is 1.
    """
    bands, terms = views.a.shape[2], setting.terms & set(bases.SHARED)
    sides = []
    for number, image, view in (
        (views.first, views.image_a, views.view_a),
        (views.second, views.image_b, views.view_b),
    ):
        camera = np.repeat(setting.camera[number], views.known.shape[1])
        flat = bases.shared_functions(terms, setting.cameras, camera, image.reshape(-1, 2), view.reshape(-1, 2))
        sides.append(flat.reshape(*views.known.shape, -1))
    with_gamma = "gamma" in setting.terms
    fixed_gamma = np.array([(i in linear) or setting.camera[i] < 0 or not with_gamma for i in range(setting.images)])
    near = neighbourhoods(setting.images, views.first, views.second)
    level = image_levels(setting, bands)
    solved = [
        _solve_band(
            BandProblem(
                views, setting, sides[0], sides[1], views.a[..., m], views.b[..., m], fixed_gamma, near, level[:, m],
                bases.excess_air_path(views.view_a), bases.excess_air_path(views.view_b),
            ),
            np.log(np.maximum(gain[:, m], 1e-6)), offset[:, m] / np.maximum(gain[:, m], 1e-6),
        )
        for m in range(bands)
    ]  # fmt: skip
    log_gain, dark, gamma, haze, shared = (np.stack(part, axis=-1) for part in zip(*solved, strict=True))
    fields = np.concatenate([side[views.known] for side in sides]) @ shared
    level = fields.mean(axis=0) if len(fields) else np.zeros(bands)
    model = ColourModel(setting, log_gain, dark, gamma, shared, level, haze if "haze" in setting.terms else None)
    return _with_dodging(model, views) if "dodging" in setting.terms else model


def _solve_band(
    band: BandProblem, gain: FloatArray, dark: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    images, size = band.setting.images, band.shared_a.shape[2]
    problem = _BandSquares(band, Prior.of(band))
    start = problem.at((gain, dark, np.ones(images), np.zeros(images), np.zeros(size)))
    # Weights change from round to round, so that sums of squares cannot be compared: each step is taken whole.
    rules = Stopping(rounds=band.setting.rounds, step=CONVERGED, near=0.0, rise=1e300)
    return solve(problem, problem.refreshed(start), rules).state.values


@dataclass(frozen=True, eq=False)
class _BandSquares(Problem[BandState]):
    """Weighted differences of the views of one band, and the prior observations of its parameters."""

    band: BandProblem
    prior: Prior

    def at(self, values: StateParts) -> BandState:
        """State with the residuals of some values; its weights are still to be found."""
        residuals = self.band.residuals(values)
        return BandState(values, residuals, np.zeros_like(residuals.difference))

    def linearise(self, state: BandState) -> BandEquations:
        return BandEquations(self.band, self.prior, state)

    def squares(self, state: BandState) -> float:
        return float((state.weight * state.residuals.difference**2).sum())

    def moved(self, state: BandState, step: FloatArray) -> BandState:
        parts = self.band.split(step)
        gain, dark, gamma, haze, shared = (a + b for a, b in zip(state.values, parts, strict=True))
        # Early steps may overshoot; a negative gamma would turn the curve over.
        return replace(self.at((gain, dark, np.clip(gamma, 0.2, 5.0), haze, shared)), weight=state.weight)

    def movement(self, state: BandState, trial: BandState, equations: Any, step: FloatArray) -> float:
        """Largest change of the logarithm of a gain."""
        gain, *_, shared = self.band.split(step)
        return max(float(np.abs(gain).max(initial=0.0)), float(np.abs(shared).max(initial=0.0)))

    def refreshed(self, state: BandState) -> BandState:
        weight = _weights(state.residuals.difference, state.residuals.mean, self.band.views.known)
        return replace(state, weight=weight)


def _weights(difference: FloatArray, mean: FloatArray, known: BoolArray) -> FloatArray:
    """Weights (P, K): inverse variances times the biweight; an overlap gives a gain no better than `MIN_SIGMA`."""
    count = known.sum(axis=1, keepdims=True)
    level = np.where(known, np.abs(mean), 0.0).sum(axis=1, keepdims=True) / np.maximum(count, 1)
    # Medians by sorting: NumPy's of rows of unequal length take ten times as long, a quarter of the selection of terms.
    ordered = np.sort(np.where(known, np.abs(difference), np.inf), axis=1)
    middle = np.concatenate([np.maximum(count - 1, 0) // 2, np.minimum(count // 2, known.shape[1] - 1)], axis=1)
    medians = np.take_along_axis(ordered, middle, axis=1).mean(axis=1, keepdims=True)
    # Two copies of one image differ by nothing: without a floor their weight would be infinite.
    sigma = np.maximum(np.where(count > 0, MAD_TO_SIGMA * medians, 0.0), 1e-4 * level + 1e-12)
    tukey = np.where(known, biweight(difference / (BIWEIGHT_LIMIT * sigma)), 0.0)
    weight = tukey / sigma**2
    # Samples of one overlap share the errors of the model (relief, view angle), which more samples do not reduce.
    information = (weight * mean**2).sum(axis=1, keepdims=True)
    return np.asarray(weight * np.minimum(1.0, 1 / (MIN_SIGMA**2 * np.maximum(information, 1e-12))))


# Nodes along each side of a dodging net over an image.
NODES = 6
# Prior standard deviations of a node, and of a second difference of nodes.
SIGMA_NODE, SIGMA_ROUGHNESS = 0.1, 0.05
DODGING_ITERATIONS = 3


def _with_dodging(fields: ColourModel, views: PairedSamples) -> ColourModel:
    """Colour model with dodging: local gains for slow differences that no other term explains."""
    from scipy.sparse import block_diag, coo_matrix, csr_matrix, diags
    from scipy.sparse.linalg import cg

    # Residual differences of corrected views, relative to their mean, are log dᵢ − log dⱼ at the place of the sample,
    # each log d bilinear between the nodes of a net over its image. Nodes are drawn to 0 and to each other, so that the
    # net follows what overlaps show, fades where there are none, and adds no drift.
    images, size = fields.setting.images, NODES * NODES
    one, other = fields.corrected(views)
    known = views.known
    number_a, weight_a = bases.bilinear_weights(views.image_a[known], NODES)
    number_b, weight_b = bases.bilinear_weights(views.image_b[known], NODES)
    index_a = np.broadcast_to(views.first[:, None], known.shape)[known]
    index_b = np.broadcast_to(views.second[:, None], known.shape)[known]
    camera = fields.setting.camera
    count = len(index_a)
    cols = np.concatenate([number_a + size * index_a[:, None], number_b + size * index_b[:, None]], axis=1)
    values = np.concatenate(
        [weight_a * (camera[index_a] >= 0)[:, None], -weight_b * (camera[index_b] >= 0)[:, None]], axis=1
    )
    rows = np.repeat(np.arange(count), 8)
    design = csr_matrix(coo_matrix((values.ravel(), (rows, cols.ravel())), shape=(count, images * size)))
    smooth = np.eye(size) / SIGMA_NODE**2 + bases.roughness(NODES) / SIGMA_ROUGHNESS**2
    prior = csr_matrix(block_diag([smooth] * images))
    per_overlap = np.repeat(known.sum(axis=1), known.sum(axis=1))
    nets = np.zeros((images, size, one.shape[2]))
    for band in range(one.shape[2]):
        a, b = one[..., band][known], other[..., band][known]
        left = (b - a) / np.maximum((np.abs(a) + np.abs(b)) / 2, 1e-9)
        net: FloatArray = np.zeros(images * size)
        for _ in range(DODGING_ITERATIONS):
            off = left - design @ net
            sigma = max(MAD_TO_SIGMA * float(np.median(np.abs(off))), 1e-4)
            weight = biweight(off / (BIWEIGHT_LIMIT * sigma)) / sigma**2
            # Samples of one overlap share the errors of the model: together they count as a few observations of
            # `MIN_SIGMA`, however many they are.
            weight = np.minimum(weight, 4 / (MIN_SIGMA**2 * per_overlap))
            normal = (design.T @ design.multiply(weight[:, None]) + prior).tocsr()
            # Iterative, from the last net: weights change little from round to round. Unknowns are scaled to a diagonal
            # of ones, which is Jacobi's preconditioner without a product of its own.
            scale = 1 / np.sqrt(normal.diagonal())
            right = scale * (design.T @ (weight * left))
            net = scale * cg(diags(scale) @ normal @ diags(scale), right, x0=net / scale, rtol=1e-6)[0]
        nets[:, :, band] = net.reshape(images, size)
    return replace(fields, dodging=nets)


# Terms are selected by cross-validation. More parameters always fit the samples better that they were fitted to;
# whether they predict better has to be shown. So each overlap is cut into eight bands, the odd ones held back while the
# even ones are solved, and the other way round; a term is kept if it reduces the held-back differences by a given part.
# Part by which a term must reduce the held-back differences.
MIN_IMPROVEMENT = 0.03
# Samples of all overlaps without which no term is tried.
MIN_SAMPLES = 2000
# Terms that are only tried after another was kept, which explains part of the same effect.
PREREQUISITES = {"hotspot": "trend", "haze": "vignetting"}
# Gauss-Newton steps of a trial, which need not converge.
ITERATIONS = 4
# Robust standard deviations at which differences are capped: moving objects and clouds.
OUTLIER_LIMIT = 3.0


@dataclass(frozen=True)
class Trial:
    """Set of terms and how well it predicts.

    Attributes
    ----------
    terms : tuple of str
    held_back_rms : float
        Of differences of held-back samples after correction, relative to their mean.
    kept : bool
    """

    terms: tuple[str, ...]
    held_back_rms: float
    kept: bool


def select_terms(
    views: PairedSamples, setting: ColourSetting, gain: FloatArray, offset: FloatArray, linear: Collection[int] = ()
) -> tuple[frozenset[str], list[Trial]]:
    """Terms that improve the prediction of held-back samples, and all trials.

    Parameters
    ----------
    views, setting, gain, offset, linear
        As in `solve_colour_model`.

    Returns
    -------
    kept : frozenset of str
        Of `bases.TERMS`; empty where gain and offset are enough, or there are fewer than `MIN_SAMPLES` samples.
    trials : list of Trial
        In the order of `bases.TERMS`, the model without further terms first.
    """
    kept: frozenset[str] = frozenset()
    if np.count_nonzero(views.known) < MIN_SAMPLES:
        return kept, []
    halves = views.halves()
    limits = _limits(views, setting, gain, offset, linear)

    def score(terms: frozenset[str]) -> float:
        own = replace(setting, terms=terms, rounds=ITERATIONS)
        total, count = np.zeros(views.a.shape[2]), 0
        for learnt, asked in (halves, halves[::-1]):
            off = _differences(solve_colour_model(views.only(learnt), own, gain, offset, linear), views.only(asked))
            # Capped, not left out: a term must not look better by turning more samples into outliers.
            total += (np.minimum(np.abs(off), limits) ** 2).sum(axis=0)
            count += len(off)
        return float(np.sqrt(np.mean(total / max(count, 1))))

    best = score(kept)
    trials = [Trial((), best, True)]
    for term in bases.TERMS:
        if PREREQUISITES.get(term, term) not in kept | {term}:
            continue
        rms = score(kept | {term})
        good = rms < (1 - MIN_IMPROVEMENT) * best
        trials.append(Trial(tuple(t for t in bases.TERMS if t in kept | {term}), rms, good))
        if good:
            kept, best = kept | {term}, rms
    return kept, trials


def _limits(
    views: PairedSamples, setting: ColourSetting, gain: FloatArray, offset: FloatArray, linear: Collection[int]
) -> FloatArray:
    """Largest difference (bands,) that counts in full, from the model of gain and offset."""
    plain = solve_colour_model(views, replace(setting, terms=frozenset()), gain, offset, linear)
    return np.asarray(OUTLIER_LIMIT * MAD_TO_SIGMA * np.median(np.abs(_differences(plain, views)), axis=0) + 1e-12)


def _differences(fields: ColourModel, views: PairedSamples) -> FloatArray:
    """Differences (N, bands) of corrected values, relative to the mean value, over the slope of the correction."""
    # By the slope, as a correction that makes all values smaller makes noise smaller too, and is no better for it.
    known, step = views.known, 1e-3 * fields.setting.reach
    one, other = (side[known] for side in fields.corrected(views))
    # By differences: the model has no formula for its slope once dodging is in.
    more = fields.corrected(replace(views, a=views.a + step, b=views.b + step))
    slope = np.sqrt((((more[0][known] - one) / step) ** 2 + ((more[1][known] - other) / step) ** 2) / 2)
    level = np.abs(views.a + views.b)[known].mean(axis=0) / 2
    return np.asarray((one - other) / np.maximum(slope, 1e-9) / np.maximum(level, 1e-12))
