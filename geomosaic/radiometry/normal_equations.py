"""Normal equations of one band of the colour model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from geomosaic.estimation.normal_equations import solve_normal_equations
from geomosaic.radiometry import corrections as bases
from geomosaic.radiometry.overlaps import SIGMA_RATIO, PairedSamples, normal_entries
from geomosaic.types import BoolArray, FloatArray, IntArray

MAX_ITERATIONS = 10

# Standard deviation of the logarithm of a photo's median level about that of its neighbours: the ground differs.
SIGMA_LEVEL = 0.15
# Standard deviations of the priors; of the dark offset and of haze in mean grey values.
SIGMA_GAIN, SIGMA_DARK, SIGMA_GAMMA, SIGMA_HAZE = 1.0, 0.1, 0.3, 0.1
# Parameters of a band beyond which the normal equations are kept sparse.
MAX_DENSE = 1500
# Smallest value after the dark offset, in parts of the range, so that powers exist.
MIN_LIGHT = 1e-3


@dataclass(frozen=True)
class ColourSetting:
    """Images, cameras and terms of a colour model to be solved.

    Attributes
    ----------
    images, cameras : int
    camera : int array (images,)
        Of each image; below 0 for one that no camera of the block took, whose values stay in proportion.
    terms : frozenset of str
        See `bases.TERMS`.
    reach : float
        Range of values.
    level : array (images, bands), optional
        Median of all that each image shows, NaN where unknown: after correction they are about equal.
    rounds : int
        Largest number of Gauss-Newton steps.
    middle : float
        Value that powers leave unchanged, so that they change no level; `reach` unless given.
    """

    images: int
    cameras: int
    camera: IntArray
    terms: frozenset[str]
    reach: float
    level: FloatArray | None = None
    rounds: int = MAX_ITERATIONS
    middle: float = 0.0

    @property
    def pivot(self) -> float:
        """Value that powers leave unchanged."""
        return self.middle or self.reach


def image_levels(setting: ColourSetting, bands: int) -> FloatArray:
    """Median levels of the images that gains are expected to make equal.

    Parameters
    ----------
    setting : ColourSetting
    bands : int

    Returns
    -------
    array (images, bands)
        NaN for images of no positive level and those that no camera of the block took; for all, if only one is left.
    """
    level = np.full((setting.images, bands), np.nan)
    if setting.level is not None:
        known = np.isfinite(setting.level).all(axis=1) & (setting.level > 0).all(axis=1) & (setting.camera >= 0)
        if np.count_nonzero(known) > 1:
            level[known] = setting.level[known]
    return level


# Logarithm of the gain, dark offset, gamma and haze, each (images,), and the shared coefficients (width,).
StateParts = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]


class BandResiduals(NamedTuple):
    """Differences of the corrected values of both views of a band, in grey values.

    Attributes
    ----------
    difference, mean : array (P, K)
    by_a, by_b : list of array (P, K)
        Derivatives of the difference by the parameters of the first and of the second image, kind by kind.
    """

    difference: FloatArray
    mean: FloatArray
    by_a: list[FloatArray]
    by_b: list[FloatArray]


@dataclass(frozen=True, eq=False)
class BandState:
    """Parameters of a band, the residuals there, and their weights (P, K): inverse variances times robust weights."""

    values: StateParts
    residuals: BandResiduals
    weight: FloatArray


@dataclass(frozen=True)
class BandProblem:
    """Samples, positions and fixed parameters of one band.

    Attributes
    ----------
    views : PairedSamples
    setting : ColourSetting
    shared_a, shared_b : array (P, K, width)
        Values of the shared functions.
    a, b : array (P, K)
        Values of the band.
    fixed_gamma : bool array (images,)
        Whether gamma is fixed to 1.
    near : list of int array
        Neighbourhoods over which drift is bounded.
    level : array (images,)
        Median levels of the images; NaN where unknown.
    path_a, path_b : array (P, K)
        Excess of the path through the air.
    """

    views: PairedSamples
    setting: ColourSetting
    shared_a: FloatArray
    shared_b: FloatArray
    a: FloatArray
    b: FloatArray
    fixed_gamma: BoolArray
    near: list[IntArray]
    level: FloatArray
    path_a: FloatArray
    path_b: FloatArray

    @property
    def kinds(self) -> list[int]:
        """Kinds of parameters of single images that are solved, as numbers in the state: gain, dark, gamma, haze."""
        return [0, 1, *([] if self.fixed_gamma.all() else [2]), *([3] if "haze" in self.setting.terms else [])]

    def split(self, change: FloatArray) -> StateParts:
        """Parts of a change (U,) of the unknowns, image by image and shared ones last; 0 for those not solved."""
        images, kinds = self.setting.images, self.kinds
        mine = change[: images * len(kinds)].reshape(images, len(kinds))
        own = [mine[:, kinds.index(kind)] if kind in kinds else np.zeros(images) for kind in range(4)]
        return own[0], own[1], own[2], own[3], change[images * len(kinds) :]

    def residuals(self, state: StateParts) -> BandResiduals:
        """Differences of both views, with their derivatives."""
        gain, dark, gamma, haze, shared = state
        reach, shown, light, slope = self.setting.pivot, [], [], []
        for number, values, base, path in (
            (self.views.first, self.a, self.shared_a, self.path_a),
            (self.views.second, self.b, self.shared_b, self.path_b),
        ):
            factor = np.exp(gain[number][:, None] + base @ shared)
            clear = values + dark[number][:, None] - haze[number][:, None] * path
            plain = np.maximum(clear / reach, MIN_LIGHT)
            power = gamma[number][:, None]
            shown.append(factor * reach * plain**power)
            slope.append(factor * power * plain ** (power - 1))
            light.append(plain)
        # The derivative of a difference by the logarithm of a gain is taken as the mean of both views: like the
        # standardised major axis it treats both alike, and noise, which mean and difference do not share, does not pull
        # gains towards 0 (J. Riggs et al., Fitting straight lines when both variables are subject to error, Life Sci.
        # 22, 1978).
        mean = (shown[0] + shown[1]) / 2
        curve = mean * np.log((light[0] + light[1]) / 2)
        by_a = [mean, slope[0], curve, -slope[0] * self.path_a]
        by_b = [-mean, -slope[1], -curve, slope[1] * self.path_b]
        return BandResiduals(shown[0] - shown[1], mean, by_a, by_b)


@dataclass(frozen=True)
class Prior:
    """Weights of the prior observations of each image's own parameters and of the shared ones.

    Attributes
    ----------
    own : array (4, images)
        Inverse variances of the logarithm of the gain (about 0), dark offset (0), gamma (1) and haze (0).
    shared : array (width, width)
        See `corrections.prior_normal_matrix`.
    rows, cols : int array (entries,)
        Images of the entries that bound drift, see `overlaps.normal_entries`.
    held : array (entries,)
        Values of these entries.
    """

    own: FloatArray
    shared: FloatArray
    rows: IntArray
    cols: IntArray
    held: FloatArray

    @classmethod
    def of(cls, band: BandProblem) -> Prior:
        """Weights for a band."""
        setting, images = band.setting, band.setting.images
        known = band.views.known
        grey = float(np.abs(band.a[known]).mean() + np.abs(band.b[known]).mean()) / 2 if known.any() else 1.0
        own = np.empty((4, images))
        own[0], own[1] = SIGMA_GAIN**-2, (SIGMA_DARK * max(grey, 1e-12)) ** -2
        # A weight beyond all others fixes gamma at 1 and keeps the unknowns of all images in the same order.
        own[2] = np.where(band.fixed_gamma, 1e16, SIGMA_GAMMA**-2)
        own[3] = (SIGMA_HAZE * max(grey, 1e-12)) ** -2
        # Overlaps cannot tell a ramp of gains from a trend: with bounded drift, long ramps go to the trend.
        strength = (SIGMA_RATIO * 0.1) ** -2
        return cls(
            own,
            bases.prior_normal_matrix(setting.terms & set(bases.SHARED), setting.cameras),
            *normal_entries(band.near, strength),
        )


@dataclass(frozen=True, eq=False)
class BandEquations:
    """Linearised equations of one band, whose normal equations are summed over all samples.

    Attributes
    ----------
    band : BandProblem
    prior : Prior
    state : BandState
        Where they are linearised.
    """

    band: BandProblem
    prior: Prior
    state: BandState

    def residuals(self, step: FloatArray) -> FloatArray:
        """Weighted residuals (P·K,) of the differences after a step (U,)."""
        views, own = self.band.views, self.state.residuals
        *parts, shared = self.band.split(step)
        moved = own.difference + (own.mean[..., None] * (self.band.shared_a - self.band.shared_b)) @ shared
        for part, by_a, by_b in zip(parts, own.by_a, own.by_b, strict=True):
            moved = moved + by_a * part[views.first][:, None] + by_b * part[views.second][:, None]
        return np.asarray((np.sqrt(self.state.weight) * moved).ravel())

    def step(self, damping: float = 0.0) -> FloatArray:
        """Changes (U,) of the unknowns, image by image, shared ones last; damped after Marquardt."""
        band, prior, state, weight = self.band, self.prior, self.state.values, self.state.weight
        difference, mean, by_a, by_b = self.state.residuals
        views, images, shared, chosen = band.views, band.setting.images, state[4], band.kinds
        kinds, size = len(chosen), shared.size
        first = views.first[:, None] * kinds + np.arange(kinds)
        second = views.second[:, None] * kinds + np.arange(kinds)
        number = np.concatenate([first, second], axis=1)  # (P, 2·kinds)
        jacobian = np.stack([by[kind] for by in (by_a, by_b) for kind in chosen], axis=1)  # (P, 2·kinds, K)
        weighted = jacobian * weight[:, None, :]
        own = weighted @ jacobian.transpose(0, 2, 1)
        total = images * kinds + size
        rows, cols = (
            np.broadcast_to(number[:, :, None], own.shape).ravel(),
            np.broadcast_to(number[:, None, :], own.shape).ravel(),
        )
        values: FloatArray = own.ravel()
        observed = (weighted @ difference[..., None])[..., 0].ravel()
        right = -np.asarray(np.bincount(number.ravel(), observed, total), dtype=np.float64)
        at = np.arange(images * kinds).reshape(images, kinds)
        deviation, known = [state[0], state[1], state[2] - 1.0, state[3]], prior.own[chosen].T
        right[at] -= known * np.stack([deviation[kind] for kind in chosen], axis=1)
        held = np.zeros(images)
        np.add.at(held, prior.rows, prior.held * state[0][prior.cols])
        right[at[:, 0]] -= held
        parts = [(rows, cols, values), (at.ravel(), at.ravel(), known.ravel())]
        parts.append((prior.rows * kinds, prior.cols * kinds, prior.held))
        with_level, off, by_dark = _level_residuals(band.level, state, band.setting.pivot)
        if len(with_level):
            weight_of = np.full(len(with_level), SIGMA_LEVEL**-2)
            right[at[with_level, 0]] -= weight_of * off
            right[at[with_level, 1]] -= weight_of * off * by_dark
            gain_at, dark_at = at[with_level, 0], at[with_level, 1]
            parts += [(gain_at, gain_at, weight_of), (dark_at, dark_at, weight_of * by_dark**2)]
            parts += [(gain_at, dark_at, weight_of * by_dark), (dark_at, gain_at, weight_of * by_dark)]
        if size:
            across = mean[..., None] * (band.shared_a - band.shared_b)
            flat = (weight[..., None] * across).reshape(-1, size)
            both = flat.T @ across.reshape(-1, size) + prior.shared
            right[images * kinds :] = -(flat.T @ difference.ravel()) - prior.shared @ shared
            mixed = weighted @ across  # (P, 2·kinds, size)
            here = np.arange(images * kinds, total)
            r, c = np.broadcast_to(number[:, :, None], mixed.shape).ravel(), np.broadcast_to(here, mixed.shape).ravel()
            parts += [(r, c, mixed.ravel()), (c, r, mixed.ravel())]
            parts.append((np.repeat(here, size), np.tile(here, size), both.ravel()))
        rows, cols, values = (np.concatenate([part[k] for part in parts]) for k in range(3))
        if damping:
            own_diagonal = rows == cols
            rows, cols, values = (np.concatenate([a, a[own_diagonal]]) for a in (rows, cols, values))
            values[len(values) - int(own_diagonal.sum()) :] *= damping
        return solve_normal_equations(rows, cols, values, right, MAX_DENSE)


def _level_residuals(level: FloatArray, state: StateParts, pivot: float) -> tuple[IntArray, FloatArray, FloatArray]:
    """Images of known level, deviation of its corrected logarithm from the mean, and derivatives by dark offset."""
    known = np.flatnonzero(np.isfinite(level))
    # Early steps may take away more than the level itself: a logarithm has to exist.
    light = np.maximum(level[known] + state[1][known], 0.05 * level[known])
    reached = state[0][known] + state[2][known] * np.log(light / pivot)
    return known, reached - np.log(level[known] / pivot).mean() if len(known) else reached, state[2][known] / light
