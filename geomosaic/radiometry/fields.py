"""One solution for the block: gain, dark offset and gamma of each image, and the fields of light that images share.

    corrected = field(place) · gain · R · ((value + dark) / R)^gamma

R is the range of values, `field` the exponential of the sum that `bases` describes. The parameters make corrected
values of the same ground alike. They are found by Gauss-Newton steps with Tukey's biweight, so that clouds, cars and
water that only one image shows count for nothing. The derivative of a difference D = c_a − c_b by the logarithm of a gain
is taken as the mean M = (c_a + c_b) / 2 of both views: like the standardised major axis of `relation` it treats both
alike, and noise, which M and D do not share, does not pull gains towards 0 (J. Riggs et al., Fitting straight lines when
both variables are subject to error, Life Sci. 22, 1978).

What overlaps cannot tell is settled by priors: a common gain, offset and gamma of all images, and a trend across all
footprints against a ramp of gains over the block (both make the same differences): the trend, one number, is the likelier
cause of a long ramp, single gains that of jumps.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from geomosaic.radiometry import bases, drift
from geomosaic.radiometry.relation import BIWEIGHT, TO_SIGMA
from geomosaic.radiometry.views import Views
from geomosaic.types import BoolArray, FloatArray, IntArray

ROUNDS = 10
CLOSE_ENOUGH = 2e-5
"""Of the logarithm of a gain."""
LEAST_SIGMA = 0.003
"""With which one overlap is believed at best, as in `gain_offset`."""
SIGMA_GAIN, SIGMA_DARK, SIGMA_GAMMA = 1.0, 0.1, 0.3
"""Priors; of the dark offset in mean grey values."""
MOST_DENSE = 1500
"""Parameters of a band beyond which the normal equations are kept sparse."""
LEAST_LIGHT = 1e-3
"""Of the range: values after the dark offset are no less, so that powers exist."""


@dataclass(frozen=True)
class Setting:
    """What is to be solved.

    Attributes
    ----------
    images, cameras : int
    camera : int array (images,)
        Of each image; below 0 for one that no camera of the block took, whose values stay in proportion.
    terms : frozenset of str
        See `bases.TERMS`.
    reach : float
        R, the range of values.
    """

    images: int
    cameras: int
    camera: IntArray
    terms: frozenset[str]
    reach: float


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
    dodging : array (images, nodes², bands), optional
        Logarithms at the nodes of a net over each image.
    """

    setting: Setting
    gain: FloatArray
    dark: FloatArray
    gamma: FloatArray
    shared: FloatArray
    level: FloatArray
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
        return _tone(values, self.gain[index], self.dark[index], self.gamma[index], self.setting.reach)

    def correct(self, index: int, values: FloatArray, image: FloatArray, view: FloatArray) -> FloatArray:
        """Corrected values (N, bands)."""
        return self.tone(index, values) * np.exp(self.log_field(index, image, view))

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
    solved = [
        _solve_band(
            _Band(views, setting, sides[0], sides[1], views.a[..., m], views.b[..., m], firm, near),
            np.log(np.maximum(gain[:, m], 1e-6)), offset[:, m] / np.maximum(gain[:, m], 1e-6),
        )
        for m in range(bands)
    ]  # fmt: skip
    log_gain, dark, gamma, shared = (np.stack(part, axis=-1) for part in zip(*solved, strict=True))
    fields = np.concatenate([side[views.known] for side in sides]) @ shared
    level = fields.mean(axis=0) if len(fields) else np.zeros(bands)
    return Fields(setting, log_gain, dark, gamma, shared, level)


@dataclass(frozen=True)
class _Band:
    """What one band is solved from."""

    views: Views
    setting: Setting
    shared_a: FloatArray
    shared_b: FloatArray
    a: FloatArray
    b: FloatArray
    firm: BoolArray
    near: list[IntArray]

    def look(self, state: list[FloatArray]) -> tuple[FloatArray, FloatArray, list[FloatArray], list[FloatArray]]:
        """Difference and mean of both views (P, K), and derivatives of each by its image's own parameters."""
        gain, dark, gamma, shared = state
        reach, shown, light, slope = self.setting.reach, [], [], []
        for number, values, base in (
            (self.views.first, self.a, self.shared_a),
            (self.views.second, self.b, self.shared_b),
        ):
            factor = np.exp(gain[number][:, None] + base @ shared)
            plain = np.maximum((values + dark[number][:, None]) / reach, LEAST_LIGHT)
            power = gamma[number][:, None]
            shown.append(factor * reach * plain**power)
            slope.append(factor * power * plain ** (power - 1))
            light.append(plain)
        mean = (shown[0] + shown[1]) / 2
        curve = mean * np.log((light[0] + light[1]) / 2)
        return shown[0] - shown[1], mean, [mean, slope[0], curve], [-mean, -slope[1], -curve]


def _solve_band(
    band: _Band, gain: FloatArray, dark: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    images, size = band.setting.images, band.shared_a.shape[2]
    state = [gain, dark, np.ones(images), np.zeros(size)]
    own_prior = _Prior.of(band)
    for _ in range(ROUNDS):
        difference, mean, by_a, by_b = band.look(state)
        weight = _weights(difference, mean, band.views.known)
        step = _step(band, state, own_prior, weight, difference, mean, by_a, by_b)
        for k, change in enumerate(step):
            state[k] = state[k] + change
        state[2] = np.clip(state[2], 0.2, 5.0)
        if max(np.abs(step[0]).max(initial=0.0), np.abs(step[3]).max(initial=0.0)) < CLOSE_ENOUGH:
            break
    return state[0], state[1], state[2], state[3]


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


@dataclass(frozen=True)
class _Prior:
    """Weights of what is known beforehand of each image's own parameters and of the shared ones."""

    own: FloatArray
    shared: FloatArray
    rows: IntArray
    cols: IntArray
    held: FloatArray

    @classmethod
    def of(cls, band: _Band) -> _Prior:
        setting, images = band.setting, band.setting.images
        known = band.views.known
        grey = float(np.abs(band.a[known]).mean() + np.abs(band.b[known]).mean()) / 2 if known.any() else 1.0
        own = np.empty((3, images))
        own[0], own[1] = SIGMA_GAIN**-2, (SIGMA_DARK * max(grey, 1e-12)) ** -2
        own[2] = np.where(band.firm, 1e16, SIGMA_GAMMA**-2)
        # Overlaps cannot tell a ramp of gains from a trend: held gains leave long ramps to the trend.
        strength = (drift.FIRM * 0.1) ** -2
        return cls(
            own, bases.prior(setting.terms & set(bases.SHARED), setting.cameras), *drift.entries(band.near, strength)
        )


def _step(
    band: _Band,
    state: list[FloatArray],
    prior: _Prior,
    weight: FloatArray,
    difference: FloatArray,
    mean: FloatArray,
    by_a: list[FloatArray],
    by_b: list[FloatArray],
) -> list[FloatArray]:
    """Changes of gain, dark, gamma and shared coefficients; parameters are ordered image by image, shared ones last."""
    views, images = band.views, band.setting.images
    kinds = 3 if not band.firm.all() else 2
    size = state[3].size
    first = views.first[:, None] * kinds + np.arange(kinds)
    second = views.second[:, None] * kinds + np.arange(kinds)
    number = np.concatenate([first, second], axis=1)  # (P, 2·kinds)
    jacobian = np.stack([*by_a[:kinds], *by_b[:kinds]], axis=1)  # (P, 2·kinds, K)
    weighted = jacobian * weight[:, None, :]
    own = weighted @ jacobian.transpose(0, 2, 1)
    total = images * kinds + size
    rows, cols = (
        np.broadcast_to(number[:, :, None], own.shape).ravel(),
        np.broadcast_to(number[:, None, :], own.shape).ravel(),
    )
    values = own.ravel()
    pull = -np.bincount(number.ravel(), (weighted @ difference[..., None])[..., 0].ravel(), total)
    at = np.arange(images * kinds).reshape(images, kinds)
    beforehand = np.stack([state[0], state[1], state[2] - 1.0][:kinds], axis=1)
    pull[at] -= prior.own[:kinds].T * beforehand
    held = np.zeros(images)
    np.add.at(held, prior.rows, prior.held * state[0][prior.cols])
    pull[at[:, 0]] -= held
    parts = [(rows, cols, values), (at.ravel(), at.ravel(), prior.own[:kinds].T.ravel())]
    parts.append((prior.rows * kinds, prior.cols * kinds, prior.held))
    if size:
        across = mean[..., None] * (band.shared_a - band.shared_b)
        flat = (weight[..., None] * across).reshape(-1, size)
        both = flat.T @ across.reshape(-1, size) + prior.shared
        pull[images * kinds :] = -(flat.T @ difference.ravel()) - prior.shared @ state[3]
        mixed = weighted @ across  # (P, 2·kinds, size)
        here = np.arange(images * kinds, total)
        r, c = np.broadcast_to(number[:, :, None], mixed.shape).ravel(), np.broadcast_to(here, mixed.shape).ravel()
        parts += [(r, c, mixed.ravel()), (c, r, mixed.ravel())]
        parts.append((np.repeat(here, size), np.tile(here, size), both.ravel()))
    change = _solution(total, parts, pull)
    mine = change[: images * kinds].reshape(images, kinds)
    bend = mine[:, 2] if kinds == 3 else np.zeros(images)
    return [mine[:, 0], mine[:, 1], bend, change[images * kinds :]]


def _solution(total: int, parts: list[tuple[IntArray, IntArray, FloatArray]], pull: FloatArray) -> FloatArray:
    rows, cols, values = (np.concatenate([part[k] for part in parts]) for k in range(3))
    if total <= MOST_DENSE:
        normal = np.bincount(rows * total + cols, values, total * total).reshape(total, total)
        return np.asarray(np.linalg.solve(normal, pull))
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import spsolve

    return np.asarray(spsolve(coo_matrix((values, (rows, cols)), shape=(total, total)).tocsc(), pull))
