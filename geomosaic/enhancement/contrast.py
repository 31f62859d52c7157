"""Contrast and light of a picture: grey value curves, local equalisation (CLAHE), sharpening, hillshade."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.errors import InputError
from geomosaic.limits import POSITIVE
from geomosaic.types import AnyArray, ByteArray, FloatArray


@dataclass(frozen=True, eq=False)
class Curve:
    """Tone curve from values to 0 ... 255, linear between its nodes and constant beyond them.

    Attributes
    ----------
    values, levels : array (N,), rising nodes
    """

    values: FloatArray
    levels: FloatArray

    def __call__(self, values: AnyArray) -> FloatArray:
        """Levels of values, not rounded."""
        # Nine decimals remove the noise of interpolation, so that exact halves are rounded the same way everywhere.
        return np.round(np.interp(values, self.values, self.levels), 9)


def percentile_limits(values: AnyArray, low: float, high: float) -> tuple[float, float]:
    """Percentiles `low` and `high` (0 to 100) of values.

    Parameters
    ----------
    values : array (N,)
    low, high : float
        Percent.
    """
    if not 0 <= low < high <= 100:
        raise InputError(f"percentiles {low:g} and {high:g} enclose nothing", hint="give them from 0 to 100, rising")
    if not values.size:
        return 0.0, 255.0
    first, last = np.percentile(values, (low, high))
    return float(first), float(last)


def linear(low: float, high: float, gamma: float = 1.0) -> Curve:
    """255 · ((v - low) / (high - low))^(1 / gamma): gamma above 1 brightens the middle.

    Parameters
    ----------
    low, high : float, values that become 0 and 255
    gamma : float
    """
    POSITIVE.check(gamma, "`gamma`")
    high = high if high > low else low + 1.0
    # With gamma 1 the curve is exact; others are drawn through 1025 nodes, closer where the curve is steep at its
    # start.
    share = np.array([0.0, 1.0]) if gamma == 1.0 else np.linspace(0.0, 1.0, 1025) ** max(1.0, gamma)
    return Curve(low + share * (high - low), 255.0 * share ** (1.0 / gamma))


def equalised(values: AnyArray) -> Curve:
    """Histogram equalisation: equal numbers of values on equal steps, 255 · (rank - first) / (last - first).

    Parameters
    ----------
    values : array (N,)
    """
    if not values.size:
        return linear(0.0, 255.0)
    known, counts = np.unique(values, return_counts=True)
    # A value stands at the middle of the ranks that it has, so that equal histograms stay as they are.
    middle = np.cumsum(counts) - counts / 2.0
    if len(known) == 1:
        return Curve(np.array([known[0] - 1.0, known[0]]), np.array([127.5, 127.5]))
    levels = 255.0 * (middle - middle[0]) / (middle[-1] - middle[0])
    return Curve(known.astype(np.float64), levels)


# Weights of red, green and blue in luminance (ITU-R BT.601).
_WEIGHTS = np.array([0.299, 0.587, 0.114])


def luminance(rgb: ByteArray) -> FloatArray:
    """Luminance (rows, cols), 0 to 255, of colours (rows, cols, 3).

    Parameters
    ----------
    rgb : array (rows, cols, 3 or more)
    """
    found: FloatArray = rgb[..., :3].astype(np.float64) @ _WEIGHTS
    return found


@dataclass(frozen=True, eq=False)
class Clahe:
    """Contrast limited adaptive histogram equalisation (Zuiderveld, Graphics Gems IV, 1994).

    A table of levels for each part of the picture, made once; between the middles of the parts tables are mixed, so
    that a window of the picture is treated as in the whole.

    Attributes
    ----------
    tables : array (P, Q, 256)
    """

    tables: FloatArray

    @classmethod
    def of(cls, grey: FloatArray, valid: ByteArray, clip: float, parts: int = 8) -> Clahe:
        """Tables of a picture, which may be a reduced one.

        Parameters
        ----------
        grey : array (rows, cols), 0 to 255
        valid : array (rows, cols) of 1 and 0
        clip : float, no level may have more than so many times the mean count; 1 leaves all as it is
        parts : int, along each side
        """
        tables = np.empty((parts, parts, 256))
        rows, cols = (np.linspace(0, n, parts + 1).astype(int) for n in grey.shape)
        for p in range(parts):
            for q in range(parts):
                cell = slice(rows[p], rows[p + 1]), slice(cols[q], cols[q + 1])
                seen = np.clip(np.round(grey[cell][valid[cell] > 0]), 0, 255).astype(np.int64)
                tables[p, q] = _table(np.bincount(seen, minlength=256).astype(np.float64), clip)
        return cls(tables)

    def __call__(self, grey: FloatArray, y: FloatArray, x: FloatArray) -> FloatArray:
        """Levels of a picture (rows, cols) whose rows and columns lie at shares y and x (0 to 1) of the whole."""
        parts = self.tables.shape[0]
        down, right = (np.clip(v * parts - 0.5, 0, parts - 1) for v in (y, x))
        r, c = (np.minimum(v.astype(int), parts - 2) for v in (down, right))
        fy, fx = (down - r)[:, None], (right - c)[None, :]
        level = np.clip(grey, 0, 255)
        first = np.minimum(level.astype(int), 254)
        part = level - first
        out = np.zeros(grey.shape)
        for dr, wy in ((0, 1 - fy), (1, fy)):
            for dc, wx in ((0, 1 - fx), (1, fx)):
                table = self.tables[(r + dr)[:, None], (c + dc)[None, :], first]
                after = self.tables[(r + dr)[:, None], (c + dc)[None, :], first + 1]
                out += wy * wx * (table + part * (after - table))
        return out


def _table(counts: FloatArray, clip: float) -> FloatArray:
    """Levels (256,) from counts (256,); the excess over the clip limit is spread in proportion to free capacity."""
    total = counts.sum()
    if not total:
        return np.arange(256.0)
    limit = max(1.0, clip) * total / 256.0
    over = np.maximum(counts - limit, 0.0).sum()
    counts = np.minimum(counts, limit)
    capacity = limit - counts
    counts = counts + over * capacity / max(capacity.sum(), 1e-300)
    middle = np.cumsum(counts) - counts / 2.0
    levels: FloatArray = 255.0 * (middle - middle[0]) / (middle[-1] - middle[0])
    return levels


def with_luminance(rgb: ByteArray, before: FloatArray, after: FloatArray) -> ByteArray:
    """Colours with their luminance changed from `before` to `after`, differences between bands kept.

    Parameters
    ----------
    rgb : uint8 array (rows, cols, 3 or more)
    before, after : array (rows, cols), 0 to 255
    """
    moved = rgb[..., :3] + (after - before)[..., None]
    return np.clip(np.floor(moved + 0.5), 0, 255).astype(np.uint8)


def sharpened(rgb: ByteArray, valid: ByteArray, radius: float, amount: float) -> ByteArray:
    """Unsharp mask on the luminance: L + amount · (L - L blurred), which moves no colour.

    Parameters
    ----------
    rgb : uint8 array (rows, cols, 3)
    valid : array (rows, cols) of 1 and 0, validity; invalid pixels do not blur into valid ones
    radius : float, standard deviation of the blur, pixels
    amount : float
    """
    from scipy.ndimage import gaussian_filter

    light = luminance(rgb)
    # Normalised convolution: invalid pixels do not blur into valid ones.
    weight = gaussian_filter(valid.astype(np.float64), radius, truncate=3.0, mode="nearest")
    blurred = gaussian_filter(light * valid, radius, truncate=3.0, mode="nearest") / np.maximum(weight, 1e-9)
    made = with_luminance(rgb, light, light + amount * (light - blurred))
    return np.where(valid[..., None] > 0, made, rgb[..., :3])


def hillshade(
    heights: AnyArray, step: tuple[float, float], azimuth: float = 315.0, altitude: float = 45.0
) -> FloatArray:
    """Cosine of the angle between the sun and the normal of the ground, not below 0: level ground has sin(altitude).

    Parameters
    ----------
    heights : array (rows, cols), rows southwards; NaN where unknown, which makes NaN around it too
    step : tuple of float, distance of columns and rows in the unit of the heights
    azimuth, altitude : float, direction of the sun, degrees: clockwise from north, and above the horizon

    Returns
    -------
    array (rows, cols), 0 to 1
    """
    # Slopes after Horn (Proc. IEEE 69(1), 1981): central differences over 3 x 3 nodes, weighted 1, 2, 1.
    z = np.pad(np.asarray(heights, dtype=np.float64), 1, mode="edge")
    # Linear extrapolation by one node: with repeated edge nodes slopes would halve along the border.
    z[0], z[-1] = 2 * z[1] - z[2], 2 * z[-2] - z[-3]
    z[:, 0], z[:, -1] = 2 * z[:, 1] - z[:, 2], 2 * z[:, -2] - z[:, -3]
    east = (
        (z[:-2, 2:] + 2 * z[1:-1, 2:] + z[2:, 2:]) - (z[:-2, :-2] + 2 * z[1:-1, :-2] + z[2:, :-2])
    ) / (8 * step[0])  # fmt: skip
    north = (
        (z[:-2, :-2] + 2 * z[:-2, 1:-1] + z[:-2, 2:]) - (z[2:, :-2] + 2 * z[2:, 1:-1] + z[2:, 2:])
    ) / (8 * step[1])  # fmt: skip
    a, h = np.radians(azimuth), np.radians(altitude)
    sun = np.sin(a) * np.cos(h), np.cos(a) * np.cos(h), np.sin(h)
    light = (sun[2] - east * sun[0] - north * sun[1]) / np.sqrt(1 + east**2 + north**2)
    # Central differences leave out the node itself: the product makes NaN where it is unknown.
    found: FloatArray = np.maximum(light, 0.0) + 0.0 * z[1:-1, 1:-1]
    return found


def shaded(rgb: ByteArray, shade: FloatArray, level: float, strength: float) -> ByteArray:
    """Image multiplied by the hillshade, with level ground unchanged.

    Parameters
    ----------
    rgb : uint8 array (rows, cols, 3)
    shade : array (rows, cols), hillshade 0 to 1; NaN leaves the image as it is
    level : float, hillshade of level ground, sin(altitude)
    strength : float, 0 (no effect) to 1 (full)
    """
    factor = np.where(np.isnan(shade), 1.0, 1.0 + strength * (shade / level - 1.0))
    made: ByteArray = np.clip(np.floor(rgb[..., :3] * factor[..., None] + 0.5), 0, 255).astype(np.uint8)
    return made
