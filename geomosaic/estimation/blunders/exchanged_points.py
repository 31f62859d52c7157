"""Confusion of points: a measurement that lies where another point should be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomosaic.types import FloatArray, IntArray

# Distance in standard deviations, and pixels at least, within which a measurement is taken for that of another point.
NEAR_SIGMAS, NEAR_PIXELS = 5.0, 2.0
# A measurement nearer to another point than this share of its own error can be that of the other.
NEARER = 0.2


def confusion_radius(off: float, sigma: float) -> float:
    """Pixels within which a measurement is taken for that of another point.

    Parameters
    ----------
    off : float
        Its distance from where its own point lies, pixels; NaN where that is unknown.
    sigma : float
        Its standard deviation, pixels.
    """
    return min(max(NEAR_SIGMAS * sigma, NEAR_PIXELS), NEARER * off if np.isfinite(off) else np.inf)


def confusion_text(name: str, *, swapped: bool) -> str:
    """Cause in words: the measurement is that of another point, or two were exchanged.

    Parameters
    ----------
    name : str
        Of the other point.
    swapped : bool
        Whether the measurement of the other point lies where this one should.
    """
    return f"exchanged with point '{name}'" if swapped else f"it is where point '{name}' lies: wrong id"


def confusion_causes(
    names: Sequence[str], measured: FloatArray, computed: FloatArray, sigma: FloatArray, rows: IntArray
) -> list[str]:
    """Likely causes of wrong measurements in one image, in words; '' where nothing speaks for one.

    Parameters
    ----------
    names : sequence of str (N,)
        Of the points.
    measured, computed : array (N, 2)
        Where they were measured and where they should be, (col, row) in pixels.
    sigma : array (N,)
        Standard deviations of the measurements, pixels.
    rows : int array (K,)
        Numbers of the wrong ones.
    """
    other: dict[int, int] = {}
    causes: dict[int, str] = {}
    for row in rows.tolist():
        within = confusion_radius(float(np.linalg.norm(measured[row] - computed[row])), float(sigma[row]))
        away = np.linalg.norm(computed - measured[row], axis=1)
        away[row] = np.inf
        nearest = int(np.argmin(np.where(np.isfinite(away), away, np.inf)))
        if away[nearest] < within:
            other[row] = nearest
        elif np.linalg.norm(measured[row][::-1] - computed[row]) < within:
            causes[row] = "col and row are exchanged"
    for row, target in other.items():
        causes[row] = confusion_text(names[target], swapped=other.get(target) == row)
    return [causes.get(row, "") for row in rows.tolist()]
