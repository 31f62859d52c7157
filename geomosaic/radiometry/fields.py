"""Colour model of a block: gain, dark offset and gamma of each image, and fields of light that images share.

    corrected = field(place) · gain · R · ((value + dark − haze · path(place)) / R)^gamma

R is a middle value, `field` the exponential of the sum that `bases` describes, `path` the excess of the path through
the air over that at the nadir: the light of haze is added to that of the ground, where a field multiplies it. The
parameters make corrected values of the same ground alike. They are found by Gauss-Newton steps with Tukey's biweight,
so that clouds, cars and water that only one image shows have no weight. How the steps treat noise in both views: see
`normal_equations`.

What overlaps cannot determine is settled by priors: a common gain, offset and gamma of all images; and a trend across
all footprints against a ramp of gains over the block, which make the same differences. The trend, one number, is the
likelier cause of a long ramp, single gains that of jumps. What all of an image shows tells them apart: an image of
more light is brighter all over, one that light falls across from the side is not. So gains are expected to make the
medians of whole images alike, as far as ground differs from photo to photo.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from geomosaic.radiometry import bases, drift
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
from geomosaic.radiometry.regression import BIWEIGHT_LIMIT, MAD_TO_SIGMA
from geomosaic.types import BoolArray, FloatArray

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
