"""Standardised major axis of two views: their linear relation with noise in both, robust against outliers.

Least squares of one view on the other takes the other for exact, so noise pulls its slope towards zero (regression
dilution). The **standardised major axis** (reduced major axis, geometric mean regression) treats both alike: its slope
is the ratio of the spreads, s_b / s_a. Its logarithm has the variance (1 − ρ²) / (n − 2) from sampling
(D. I. Warton et al., Bivariate line-fitting methods for allometry, Biol. Rev. 81, 2006). Where the noise of the views
is not in proportion to their spreads the slope is off, but never by more than the factor ρ either way: the true line
lies between the two regressions (R. Frisch, 1934). A uniform distribution over ± log ρ has the variance (log ρ)² / 3.

Means, spreads and correlation are weighted with Tukey's biweight of the standardised difference of the views, so that
cars, leaning houses and clipped values, which one view shows and the other does not, have no weight. The same weights
serve both views; exchanging them changes nothing but the sign.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from geomosaic.radiometry import bases
from geomosaic.radiometry import bases as drift
from geomosaic.radiometry.normal_equations import (
    MIN_LIGHT,
    MIN_SIGMA,
    BandProblem,
    ColourSetting,
    Prior,
    gauss_newton_step,
    image_levels,
)
from geomosaic.radiometry.overlap_samples import PairedSamples
from geomosaic.types import AnyArray, BoolArray, FloatArray

MAX_ITERATIONS = 20
AXIS_CONVERGED = 1e-4
"""Relative change of the spreads at which the iteration ends: far below their sampling error."""
BIWEIGHT_LIMIT = 4.685
"""Robust standard deviations beyond which a sample has no weight: 95 % efficient on normal noise."""
MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True)
class MajorAxis:
    """Robust means, spreads and correlation of two views a and b of the same ground; all arrays are (bands,).

    Attributes
    ----------
    mean_a, mean_b : array
        Robust means, in grey values.
    spread_a, spread_b : array
        Robust standard deviations, in grey values.
    correlation : array
        Between the views; 0 where a view shows one tone only.
    count : array
        Effective number of samples under the weights.
    """

    mean_a: FloatArray
    mean_b: FloatArray
    spread_a: FloatArray
    spread_b: FloatArray
    correlation: FloatArray
    count: FloatArray

    @property
    def log_ratio(self) -> FloatArray:
        """Logarithm of spread b over spread a; 0 where it is unknown."""
        known = self.correlation > 0
        ratio = np.divide(self.spread_b, self.spread_a, out=np.ones_like(self.spread_a), where=known)
        return np.asarray(np.log(ratio))

    @property
    def log_ratio_variance(self) -> FloatArray:
        """Variance of `log_ratio`; infinite where it is unknown."""
        known = self.correlation > 0
        rho = np.where(known, np.minimum(self.correlation, 1.0), 1.0)
        variance = (1 - rho**2) / np.maximum(self.count - 2, 1) + np.log(rho) ** 2 / 3
        return np.where(known, variance, np.inf)


def standardised_major_axis(a: AnyArray, b: AnyArray) -> MajorAxis:
    """Standardised major axis of two views, by iteratively reweighted moments.

    Parameters
    ----------
    a, b : array (N, bands)
        Values of the same places, finite; N at least 1.

    Returns
    -------
    MajorAxis
    """
    views = np.stack([a, b]).astype(np.float64)
    mean = np.median(views, axis=1)
    spread = MAD_TO_SIGMA * np.median(np.abs(views - mean[:, None]), axis=1)
    # Where more than half of the samples have one tone, the median deviation is 0, though the rest may vary.
    spread = np.where(spread > 0, spread, views.std(axis=1))
    least = 1e-9 * np.abs(views).max(axis=(0, 1)) + 1e-300
    one_tone = (spread <= least).any(axis=0)
    done, weight = np.zeros(one_tone.shape, dtype=bool), np.ones(views.shape[1:])
    for _ in range(MAX_ITERATIONS):
        unit = (views - mean[:, None]) / np.where(one_tone, 1.0, np.maximum(spread, least))[:, None]
        difference = unit[1] - unit[0]
        limit = BIWEIGHT_LIMIT * np.maximum(MAD_TO_SIGMA * np.median(np.abs(difference), axis=0), 1e-9)
        limit = np.where(one_tone, np.maximum(limit, least), limit)
        # A band that has converged stays as it is while others iterate: each gives what it would give alone.
        weight = np.where(done, weight, np.maximum(1 - (difference / limit) ** 2, 0.0) ** 2)
        total, before = weight.sum(axis=0), spread
        mean = np.where(done, mean, (weight * views).sum(axis=1) / total)
        centred = views - mean[:, None]
        spread = np.where(done, spread, np.sqrt((weight * centred**2).sum(axis=1) / total))
        one_tone = (spread <= least).any(axis=0)
        done = done | (np.abs(spread - before) <= AXIS_CONVERGED * spread + least).all(axis=0)
        if done.all():
            break
    product = (weight * centred[0] * centred[1]).sum(axis=0) / total
    scale = np.where(one_tone, 1.0, spread[0] * spread[1])
    correlation = np.where(one_tone, 0.0, product / scale)
    return MajorAxis(mean[0], mean[1], spread[0], spread[1], correlation, total**2 / (weight**2).sum(axis=0))


CONVERGED = 2e-5
"""Change of the logarithm of a gain at which the iteration ends."""


@dataclass(frozen=True)
class ColourModel:
    """Parameters of the colour model; gains as logarithms, offsets applied before gains.

    Attributes
    ----------
    setting : ColourSetting
    gain, dark, gamma : array (images, bands)
        Gain as its logarithm.
    shared : array (width, bands)
        Coefficients of `bases.shared_functions`.
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
        """Logarithm (N, bands) of the field of an image at positions (N, 2) in it and on the ground."""
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
        return _tone(values, self.gain[index], self.dark[index], self.gamma[index], self.setting.pivot)

    def correct(self, index: int, values: FloatArray, image: FloatArray, view: FloatArray) -> FloatArray:
        """Corrected values (N, bands) at positions (N, 2) in the image and on the ground."""
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


def _tone(values: FloatArray, gain: FloatArray, dark: FloatArray, gamma: FloatArray, reach: float) -> FloatArray:
    light = np.maximum((values + dark) / reach, MIN_LIGHT)
    return np.asarray(np.exp(gain) * reach * np.where(gamma == 1.0, (values + dark) / reach, light**gamma))


def solve_fields(
    views: PairedSamples, setting: ColourSetting, gain: FloatArray, offset: FloatArray, linear: Collection[int] = ()
) -> ColourModel:
    """Colour model without dodging, solved band by band.

    Parameters
    ----------
    views : PairedSamples
    setting : ColourSetting
    gain, offset : array (images, bands)
        Start values: corrected = gain · value + offset, without fields.
    linear : collection of int
        Images whose gamma is 1.

    Returns
    -------
    ColourModel
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
    near = drift.neighbourhoods(setting.images, views.first, views.second)
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
    return ColourModel(setting, log_gain, dark, gamma, shared, level, haze if "haze" in setting.terms else None)


def _solve_band(
    band: BandProblem, gain: FloatArray, dark: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    images, size = band.setting.images, band.shared_a.shape[2]
    state = [gain, dark, np.ones(images), np.zeros(images), np.zeros(size)]
    own_prior = Prior.of(band)
    for _ in range(band.setting.rounds):
        difference, mean, by_a, by_b = band.residuals(state)
        weight = _weights(difference, mean, band.views.known)
        step = gauss_newton_step(band, state, own_prior, weight, difference, mean, by_a, by_b)
        for k, change in enumerate(step):
            state[k] = state[k] + change
        # Early steps may overshoot; a negative gamma would turn the curve over.
        state[2] = np.clip(state[2], 0.2, 5.0)
        if max(np.abs(step[0]).max(initial=0.0), np.abs(step[4]).max(initial=0.0)) < CONVERGED:
            break
    return state[0], state[1], state[2], state[3], state[4]


def _weights(difference: FloatArray, mean: FloatArray, known: BoolArray) -> FloatArray:
    """Weights (P, K): inverse variances times the biweight; an overlap gives a gain no better than `MIN_SIGMA`."""
    masked = np.where(known, np.abs(difference), np.nan)
    with np.errstate(all="ignore"):
        sigma = MAD_TO_SIGMA * np.nanmedian(masked, axis=1, keepdims=True) if known.any() else np.ones((len(known), 1))
    level = np.where(known, np.abs(mean), 0.0).sum(axis=1, keepdims=True) / np.maximum(
        known.sum(axis=1, keepdims=True), 1
    )
    # Two copies of one image differ by nothing: without a floor their weight would be infinite.
    sigma = np.maximum(np.nan_to_num(sigma), 1e-4 * level + 1e-12)
    tukey = np.where(known, np.maximum(1 - (difference / (BIWEIGHT_LIMIT * sigma)) ** 2, 0.0) ** 2, 0.0)
    weight = tukey / sigma**2
    # Samples of one overlap share the errors of the model (relief, view angle), which more samples do not reduce.
    information = (weight * mean**2).sum(axis=1, keepdims=True)
    return np.asarray(weight * np.minimum(1.0, 1 / (MIN_SIGMA**2 * np.maximum(information, 1e-12))))
