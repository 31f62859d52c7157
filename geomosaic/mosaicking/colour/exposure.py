"""Gains from recorded exposures: one parameter for a block whose overlaps determine no gain of each photo.

A camera that exposes by itself writes exposure time t, f-number F and sensitivity S into its tags. A rendered photo
shows light by a tone curve, about a power s of it, so that values of the same ground differ by

    log (vᵢ / vⱼ) = s·(Hᵢ − Hⱼ),   H = log (t·S / F²)

with one s for the whole block, by weighted least squares from the means of all overlaps. Light that falls across photos
and crowns that show their shady side change the ratios of single overlaps, and add up to ramps where each photo has a
gain of its own; they do not follow the exposures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geomosaic.errors import GeomosaicError
from geomosaic.radiometry.gain_offset import Balance, rms_difference, standardised_major_axis
from geomosaic.radiometry.overlaps import MIN_SIGMA, Overlap
from geomosaic.raster.image_metadata import read_photo_tags, tag_number
from geomosaic.types import FloatArray

# Range of log exposures below which photos are exposed alike, and the power of tone curves: 0.45 (sRGB) with more or
# less contrast, 1 of raw values.
LEAST_RANGE, POWERS = 0.1, (0.2, 1.2)
# Standard deviations that the power must be off 0, and part of the differences that may be left.
SURE, CLEARLY_BETTER = 4.0, 0.9
_SENSITIVITY = ("ISOSpeedRatings", "PhotographicSensitivity", "ISOSpeed")


def exposure_balance(photos: Sequence[str], bands: int, overlaps: Sequence[Overlap]) -> Balance | None:
    """Gains that follow the recorded exposures of photos, their geometric mean 1.

    Parameters
    ----------
    photos : sequence of str
        Files of the photos (images,).
    bands : int
    overlaps : sequence of Overlap
        Those that are registered.

    Returns
    -------
    Balance or None
        None where a photo records no exposure, or the overlaps do not follow the exposures.
    """
    used = [pair for pair in overlaps if len(pair.a) and pair.second < len(photos)]
    exposures = _log_exposures(photos)
    if exposures is None or not used or np.ptp(exposures) < LEAST_RANGE:
        return None
    power = _tone_power(exposures, used)
    if power is None:
        return None
    gain = np.exp(-power * (exposures - exposures.mean()))
    gains = np.repeat(gain[:, None], bands, axis=1)
    offsets = np.zeros_like(gains)
    before, after = (rms_difference(used, each, offsets) for each in (np.ones_like(gains), gains))
    if np.linalg.norm(after) > CLEARLY_BETTER * np.linalg.norm(before):
        return None
    found = Balance(gains, offsets, before, after, len(used))
    note = f"gains follow the exposures in the photos' tags: values grow with the power {power:.2f} of the light"
    return replace(found, notes=(note,))


def _log_exposures(photos: Sequence[str]) -> FloatArray | None:
    """Logarithms (images,) of exposure times sensitivity over aperture; None where a photo does not tell."""
    found = []
    for path in photos:
        try:
            exif = read_photo_tags(path).exif
        except GeomosaicError:
            return None
        time, aperture = (_number(exif.get(name, "")) for name in ("ExposureTime", "FNumber"))
        sensitivity = next((value for name in _SENSITIVITY if (value := _number(exif.get(name, "")))), None)
        if not time or not aperture or not sensitivity:
            return None
        found.append(time * sensitivity / aperture**2)
    return np.log(found)


def _number(text: str) -> float | None:
    value = tag_number(text.strip().strip("()"))
    return value if value is not None and value > 0.0 else None


def _tone_power(exposures: FloatArray, overlaps: Sequence[Overlap]) -> float | None:
    """Power of the tone curve; None where the ratios of the overlaps do not tell it."""
    rows = []
    for pair in overlaps:
        axis, apart = standardised_major_axis(pair.a, pair.b), exposures[pair.first] - exposures[pair.second]
        for a, b, one, other, correlation, count in zip(
            axis.mean_a, axis.mean_b, axis.spread_a, axis.spread_b, axis.correlation, axis.count, strict=True
        ):
            if min(a, b) > 0.0:
                noise = 2.0 * one * other * (1.0 - correlation) / (count * a * b)
                rows.append((np.log(a / b), apart, 1.0 / (noise + MIN_SIGMA**2)))
    ratio, apart, weight = np.array(rows).reshape(-1, 3).T
    normal = float((weight * apart**2).sum())
    if len(rows) < 3 or normal <= 0.0:
        return None
    power = float((weight * apart * ratio).sum()) / normal
    # What light and crowns do to the ratios is in their scatter.
    scatter = float((weight * (ratio - power * apart) ** 2).sum()) / (len(rows) - 1)
    sure = power > SURE * np.sqrt(scatter / normal)
    return power if sure and POWERS[0] <= power <= POWERS[1] else None
