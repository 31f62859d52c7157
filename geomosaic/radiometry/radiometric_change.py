"""Radiometric change by a colour balance: pixels clipped, spread of gains, broad trend, differences from the photos.

Overlaps that agree better are what a balance is for; they do not show what it costs elsewhere. These four numbers do,
from a sample of pixels of each photo where it is the nearest, with their values before and after:

- **clipped**: pixels that an end of the range cuts off in any band, and did not before;
- **spread of gains**: standard deviation of their logarithms;
- **trend**: range over the block of a quadratic surface through the logarithms of the ratio of values after and before:
  a ramp of gains shows in it, the removal of light that falls across each photo does not;
- **difference**: RMS of values after minus before.

Spread and trend are those of the worst band.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.types import AnyArray, FloatArray

# Pixels without which no trend is fitted.
MIN_PIXELS = 30


@dataclass(frozen=True)
class RadiometricChange:
    """Radiometric change by a colour balance.

    Attributes
    ----------
    clipped_percent : float
        Share of the pixels.
    gain_spread_percent : float
        Standard deviation of the logarithms of the gains.
    trend_percent : float
        Largest over least ratio of the trend, less 1.
    rms_difference : float
        In grey values.
    """

    clipped_percent: float = 0.0
    gain_spread_percent: float = 0.0
    trend_percent: float = 0.0
    rms_difference: float = 0.0

    @property
    def text(self) -> str:
        """One line of text."""
        return (
            f"against the unbalanced mosaic: {self.clipped_percent:.2f} % of pixels clipped, gains spread "
            f"by {self.gain_spread_percent:.1f} %, trend over the block {self.trend_percent:.1f} %, RMS difference "
            f"{self.rms_difference:.3g} grey values"
        )


def radiometric_change(
    places: AnyArray, before: AnyArray, after: FloatArray, gain: FloatArray, ends: tuple[float, float] | None
) -> RadiometricChange:
    """Radiometric change by the corrections of a block, from a sample of pixels.

    Parameters
    ----------
    places : array (N, 2)
        Column and row of each pixel, of any grid over the block.
    before, after : array (N, bands)
        Values of the photos, and corrected ones.
    gain : array (images, bands)
        Gains of the corrections on the whole.
    ends : (float, float), optional
        Ends of the range of whole numbers, to which corrected values are rounded and clipped.
    """
    spread = _percent(np.log(np.maximum(gain, 1e-6)).std(axis=0).max(initial=0.0))
    if not len(places):
        return RadiometricChange(gain_spread_percent=spread)
    plain, shown, clipped = np.asarray(before, dtype=np.float64), after, 0
    if ends is not None:
        shown = np.clip(np.floor(after + 0.5), *ends)
        at_end = ((shown == ends[0]) & (plain != ends[0])) | ((shown == ends[1]) & (plain != ends[1]))
        clipped = int(at_end.any(axis=1).sum())
    difference = float(np.sqrt(((shown - plain) ** 2).mean()))
    trend = np.expm1(_trend_range(places, plain, shown))
    return RadiometricChange(_percent(clipped / len(plain)), spread, _percent(trend), round(difference, 4))


def _percent(part: float) -> float:
    return round(100.0 * float(part), 4)


def _trend_range(places: AnyArray, before: FloatArray, after: FloatArray) -> float:
    """Range of a quadratic surface through the logarithm of after / before, of the worst band."""
    low, high = places.min(axis=0), places.max(axis=0)
    x, y = (2 * (places - low) / np.maximum(high - low, 1) - 1).T
    surface = np.stack([np.ones(len(x)), x, y, x * x, x * y, y * y], axis=1)
    found = 0.0
    for one, other in zip(before.T, after.T, strict=True):
        known = (one > 0) & (other > 0)
        if np.count_nonzero(known) < MIN_PIXELS:
            continue
        # Weighted by the values: the ratio of dark pixels is noise.
        weight = np.sqrt(one[known])[:, None]
        ratio = np.log(other[known] / one[known])
        fit = np.linalg.lstsq(weight * surface[known], weight[:, 0] * ratio, rcond=None)[0]
        found = max(found, float(np.ptp(surface[known] @ fit)))
    return found
