"""Layover, shadow and foreshortening along profiles of a radar's lines of sight.

Ground points of one moment lie on a profile that leads away from the sensor. Shadow falls where an earlier point was
seen under a flatter angle; layover is where another point that is not in shadow has the same slant range: an earlier
one had already a longer range, or a later one has still a shorter one (Kropatsch and Strobl, The generation of SAR
layover and shadow maps from digital elevation models, IEEE Transactions on Geoscience and Remote Sensing 28(1), 1990).
"""

from __future__ import annotations

import numpy as np

from geomosaic.types import BoolArray, ByteArray, FloatArray

# Bits of a class; ground without heights, or that the sensor does not pass, has the last one.
LAYOVER, SHADOW, FORESHORTENING, UNKNOWN = 1, 2, 4, 128
# Share of level ground's growth of range, below which a slope is foreshortened.
FORESHORTENED = 0.5


def profile_classes(ranges: FloatArray, off_nadir: FloatArray, level: FloatArray) -> ByteArray:
    """Classes of ground points on profiles away from the sensor.

    Parameters
    ----------
    ranges : array (profiles, points)
        Slant ranges, metres; NaN where the ground is not known.
    off_nadir : array (profiles, points)
        What grows with the angle at the sensor between its nadir and the point, such as minus the cosine.
    level : array (profiles, points)
        Slant ranges of level ground at the same places, metres.

    Returns
    -------
    uint8 array (profiles, points)
        Bits `LAYOVER`, `SHADOW`, `FORESHORTENING`, `UNKNOWN`.
    """
    known = np.isfinite(ranges) & np.isfinite(off_nadir)
    shadow = shadowed(off_nadir, known)
    lit = known & ~shadow
    nearer = _before(np.where(lit, ranges, -np.inf))
    farther = -_before(np.where(lit, -ranges, -np.inf)[:, ::-1])[:, ::-1]
    layover = lit & ((ranges < nearer) | (ranges > farther))
    with np.errstate(invalid="ignore"):
        slow = np.gradient(ranges, axis=1) < FORESHORTENED * np.gradient(level, axis=1)
    foreshortened: BoolArray = lit & ~layover & slow
    out: ByteArray = np.where(known, 0, UNKNOWN).astype(np.uint8)
    out[layover] |= LAYOVER
    out[shadow] |= SHADOW
    out[foreshortened] |= FORESHORTENING
    return out


def shadowed(off_nadir: FloatArray, known: BoolArray) -> BoolArray:
    """Ground points that an earlier one on their profile hides from the sensor.

    Parameters
    ----------
    off_nadir : array (profiles, points)
        See `profile_classes`.
    known : bool array (profiles, points)
        Points that hide others and can be hidden.
    """
    hidden: BoolArray = known & (off_nadir < _before(np.where(known, off_nadir, -np.inf)))
    return hidden


def _before(values: FloatArray) -> FloatArray:
    """Largest of the values before each along the second axis; -inf before the first."""
    largest = np.maximum.accumulate(values, axis=1)
    out = np.full(values.shape, -np.inf)
    out[:, 1:] = largest[:, :-1]
    return out
