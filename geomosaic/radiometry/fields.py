"""One solution for the block: gain, dark offset and gamma of each image, and the fields of light that images share.

    corrected = field(place) · gain · R · ((value + dark − haze · path(place)) / R)^gamma

R is a middle value, `field` the exponential of the sum that `bases` describes, `path` how much more air there is
than at the nadir: the light of haze is added to that of the ground, where a field multiplies it. The parameters make
corrected values of the same ground alike. They are found by Gauss-Newton steps with Tukey's biweight, so that clouds,
cars and water that only one image shows count for nothing. How the steps treat noise in both views: see `steps`.

What overlaps cannot tell is settled by priors: a common gain, offset and gamma of all images; and a trend across all
footprints against a ramp of gains over the block, which make the same differences. The trend, one number, is the
likelier cause of a long ramp, single gains that of jumps. What all of an image shows tells them apart: an image of
more light is brighter all over, one that light falls across from the side is not. So gains are expected to make the
medians of whole images alike, as far as ground differs from photo to photo.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from geomosaic.radiometry import bases, drift
from geomosaic.radiometry.normal_equations import LEAST_LIGHT, LEAST_SIGMA, Band, Prior, Setting, change_of, levels_of
from geomosaic.radiometry.overlap_samples import Views
from geomosaic.radiometry.regression import BIWEIGHT, TO_SIGMA
from geomosaic.types import BoolArray, FloatArray

CLOSE_ENOUGH = 2e-5
"""Of the logarithm of a gain."""


@dataclass(frozen=True)
class Fields:
    """The solution; logarithms of gains, offsets before gains.

    Attributes
    ----------
    setting : Setting
    gain, dark, gamma : array (images, bands)
        The logarithm of the gain.
    shared : array (width, bands)
        Coefficients of `bases.shared`.
    level : array (bands,)
        Taken off the logarithm of the field, so that its mean over all samples is 0.
    haze : array (images, bands), optional
        Grey values in the corners.
    dodging : array (images, nodes², bands), optional
        Logarithms at the nodes of a net over each image.
    """

    setting: Setting
    gain: FloatArray
    dark: FloatArray
    gamma: FloatArray
    shared: FloatArray
    level: FloatArray
    haze: FloatArray | None = None
    dodging: FloatArray | None = None

    def log_field(self, index: int, image: FloatArray, view: FloatArray) -> FloatArray:
        """Logarithm (N, bands) of the field of an image at places (N, 2) in it and on the ground."""
        own = self.setting
        camera = np.full(len(image), own.camera[index])
        log = bases.shared(own.terms, own.cameras, camera, image, view) @ self.shared - self.level
        if own.camera[index] < 0:
            return np.zeros_like(log)
        if self.dodging is not None:
            node, weight = bases.hats(image, round(self.dodging.shape[1] ** 0.5))
            log += (self.dodging[index][node] * weight[..., None]).sum(axis=1)
        return log

    def tone(self, index: int, values: FloatArray) -> FloatArray:
        """Values (..., bands) without their place: gain · R · ((value + dark) / R)^gamma."""
        return _tone(values, self.gain[index], self.dark[index], self.gamma[index], self.setting.pivot)

    def correct(self, index: int, values: FloatArray, image: FloatArray, view: FloatArray) -> FloatArray:
        """Corrected values (N, bands)."""
        clear = values if self.haze is None else values - self.haze[index] * bases.path(view)[:, None]
        return self.tone(index, clear) * np.exp(self.log_field(index, image, view))

    def corrected(self, views: Views) -> tuple[FloatArray, FloatArray]:
        """Both views (P, K, bands), corrected."""
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
    light = np.maximum((values + dark) / reach, LEAST_LIGHT)
    return np.asarray(np.exp(gain) * reach * np.where(gamma == 1.0, (values + dark) / reach, light**gamma))


def solve_fields(
    views: Views, setting: Setting, gain: FloatArray, offset: FloatArray, linear: Collection[int] = ()
) -> Fields:
    """Solve all parameters, band by band.

    Parameters
    ----------
    views : Views
    setting : Setting
    gain, offset : array (images, bands)
        To start from: corrected = gain · value + offset, without fields.
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
        flat = bases.shared(terms, setting.cameras, camera, image.reshape(-1, 2), view.reshape(-1, 2))
        sides.append(flat.reshape(*views.known.shape, -1))
    bent = "gamma" in setting.terms
    firm = np.array([(i in linear) or setting.camera[i] < 0 or not bent for i in range(setting.images)])
    near = drift.neighbourhoods(setting.images, views.first, views.second)
    level = levels_of(setting, bands)
    solved = [
        _solve_band(
            Band(
                views, setting, sides[0], sides[1], views.a[..., m], views.b[..., m], firm, near, level[:, m],
                bases.path(views.view_a), bases.path(views.view_b),
            ),
            np.log(np.maximum(gain[:, m], 1e-6)), offset[:, m] / np.maximum(gain[:, m], 1e-6),
        )
        for m in range(bands)
    ]  # fmt: skip
    log_gain, dark, gamma, haze, shared = (np.stack(part, axis=-1) for part in zip(*solved, strict=True))
    fields = np.concatenate([side[views.known] for side in sides]) @ shared
    level = fields.mean(axis=0) if len(fields) else np.zeros(bands)
    return Fields(setting, log_gain, dark, gamma, shared, level, haze if "haze" in setting.terms else None)


def _solve_band(
    band: Band, gain: FloatArray, dark: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    images, size = band.setting.images, band.shared_a.shape[2]
    state = [gain, dark, np.ones(images), np.zeros(images), np.zeros(size)]
    own_prior = Prior.of(band)
    for _ in range(band.setting.rounds):
        difference, mean, by_a, by_b = band.look(state)
        weight = _weights(difference, mean, band.views.known)
        step = change_of(band, state, own_prior, weight, difference, mean, by_a, by_b)
        for k, change in enumerate(step):
            state[k] = state[k] + change
        state[2] = np.clip(state[2], 0.2, 5.0)
        if max(np.abs(step[0]).max(initial=0.0), np.abs(step[4]).max(initial=0.0)) < CLOSE_ENOUGH:
            break
    return state[0], state[1], state[2], state[3], state[4]


def _weights(difference: FloatArray, mean: FloatArray, known: BoolArray) -> FloatArray:
    """Weights (P, K): inverse variances with the biweight; an overlap tells a gain no better than `LEAST_SIGMA`."""
    masked = np.where(known, np.abs(difference), np.nan)
    with np.errstate(all="ignore"):
        sigma = TO_SIGMA * np.nanmedian(masked, axis=1, keepdims=True) if known.any() else np.ones((len(known), 1))
    level = np.where(known, np.abs(mean), 0.0).sum(axis=1, keepdims=True) / np.maximum(
        known.sum(axis=1, keepdims=True), 1
    )
    sigma = np.maximum(np.nan_to_num(sigma), 1e-4 * level + 1e-12)
    tukey = np.where(known, np.maximum(1 - (difference / (BIWEIGHT * sigma)) ** 2, 0.0) ** 2, 0.0)
    weight = tukey / sigma**2
    told = (weight * mean**2).sum(axis=1, keepdims=True)
    return np.asarray(weight * np.minimum(1.0, 1 / (LEAST_SIGMA**2 * np.maximum(told, 1e-12))))
