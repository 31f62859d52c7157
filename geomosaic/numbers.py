"""Round numbers: intervals, scales, and how they are written on maps."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from geomosaic.types import FloatArray

DECIMAL = (1.0, 2.0, 5.0, 10.0)
# Degrees: from a second of arc to 15 degrees, the steps in which maps are divided.
SEXAGESIMAL = tuple(
    value / 3600.0 for value in (1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 18000, 36000, 54000)
)

# Times a power of ten: denominators that a scale is chosen from.
SCALES = (1.0, 2.0, 2.5, 5.0)

_WIDTH_OF_SPACE = "\u202f"  # narrow and never broken


def nice_step(least: float, *, degrees: bool = False) -> float:
    """Smallest round interval that is not shorter than `least`: 1, 2, 5 times a power of ten, or minutes and seconds.

    Parameters
    ----------
    least : float
        Above 0.
    degrees : bool
        Degrees: minutes and seconds are round, too.

    Raises
    ------
    ValueError
        `least` is not a positive number.
    """
    if not (least > 0 and math.isfinite(least)):
        raise ValueError(f"{least} is not a positive length")
    if degrees and least >= SEXAGESIMAL[0]:
        return next((step for step in SEXAGESIMAL if step >= least * (1 - 1e-9)), 30.0)
    scale = 1.0 / 3600.0 if degrees else 1.0
    power = 10.0 ** math.floor(math.log10(least / scale) + 1e-12)
    return scale * next(power * step for step in DECIMAL if power * step * scale >= least * (1 - 1e-9))


def nice_scale(least: float) -> float:
    """Smallest round scale denominator that is not below `least`.

    Parameters
    ----------
    least : float
        Above 0.
    """
    power = 10.0 ** math.floor(math.log10(least) + 1e-12)
    steps = (*SCALES, 10.0)
    return next(power * step for step in steps if power * step >= least * (1 - 1e-9))


def round_below(most: float, steps: Sequence[float] = (1, 2, 5)) -> float:
    """Largest of some steps times a power of ten that is not above `most`.

    Parameters
    ----------
    most : float
        Above 0.
    steps : sequence of float
        From 1 to below 10.
    """
    # A hair of tolerance: a length of exactly one step must not fall to the next smaller one by rounding.
    power = 10.0 ** math.floor(math.log10(most) + 1e-12)
    return float(max(step * power for step in steps if step * power <= most * (1 + 1e-9)))


def multiples(low: float, high: float, step: float) -> FloatArray:
    """All whole multiples of `step` from `low` to `high`, both included within a billionth of a step.

    Parameters
    ----------
    low : float
    high : float
    step : float
    """
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return np.arange(first, last + 1, dtype=np.float64) * step


def decimals(step: float, most: int = 9) -> int:
    """Decimals that multiples of `step` need.

    Parameters
    ----------
    step : float
    most : int
    """
    return next((n for n in range(most) if abs(round(step, n) - step) < 1e-9 * abs(step)), most)


def grouped(value: float, digits: int = 0) -> str:
    """Number in groups of three digits with narrow spaces, as on maps: 5 500 000.

    Parameters
    ----------
    value : float
    digits : int
    """
    return f"{value:,.{digits}f}".replace(",", _WIDTH_OF_SPACE).replace("-", "−")


def angle_text(degrees: float, step: float = 1 / 3600, *, signs: str = "") -> str:
    """Degrees, minutes and seconds, as many parts as multiples of `step` need.

    Parameters
    ----------
    degrees : float
    step : float
        In degrees: 1/60 shows minutes; below a second decimals of seconds.
    signs : str
        Two letters for positive and negative, such as 'EW'; a minus sign without.
    """
    digits = decimals(step * 3600.0, 4) if step < 1 / 3600 - 1e-12 else 0
    units = round(abs(degrees) * 3600.0, digits)
    whole, rest = divmod(units, 3600.0)
    minutes, seconds = divmod(rest, 60.0)
    text = f"{whole:.0f}°"
    if decimals(step) > 0 or step < 1:
        text += f"{minutes:02.0f}′"
    if abs(step * 60.0 - round(step * 60.0)) > 1e-9:
        text += f"{seconds:0{2 if digits == 0 else 3 + digits}.{digits}f}″"
    if not signs:
        return text if degrees >= 0 or units == 0 else f"−{text}"
    return text if units == 0 else f"{text}{_WIDTH_OF_SPACE}{signs[0 if degrees > 0 else 1]}"


def quantile_breaks(values: FloatArray, count: int, method: str) -> Sequence[float]:
    """Inner limits of `count` classes: 'quantile' (as many values in each) or 'equal' (as wide).

    Parameters
    ----------
    values : array (N,)
        Those that are not finite do not count.
    count : int
    method : str
    """
    known = values[np.isfinite(values)]
    shares = np.arange(1, count) / count
    if method == "quantile":
        return sorted({float(v) for v in np.quantile(known, shares)})
    low, high = float(known.min()), float(known.max())
    return [low + float(share) * (high - low) for share in shares] if high > low else []
