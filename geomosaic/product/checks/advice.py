"""Advice on check points: which of them are wrong themselves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomosaic.adjust.odd_checks import odd_checks
from geomosaic.control.finding import Advice
from geomosaic.types import FloatArray


def check_advice(
    names: Sequence[str], pixels: FloatArray, moved: FloatArray, unit: str, expected: float = 0.0
) -> list[Advice]:
    """Name check points that contradict the others, or the fit where they are too few to contradict each other.

    Parameters
    ----------
    names : sequence of str
    pixels : array (N, 2)
        Errors in the image or raster, pixels.
    moved : array (N, 2)
        The same on the map, found minus true, in `unit`.
    unit : str
    expected : float
        RMS length of errors that the fit leads one to expect, pixels; 0 where there is none.
    """
    if not np.isfinite(pixels).all() or not len(pixels):
        return []
    expected = expected if np.isfinite(expected) else 0.0
    found = odd_checks(pixels, expected)
    chosen = np.flatnonzero(found.odd)
    if not len(chosen):
        return []
    chosen = chosen[np.argsort(-np.hypot(*pixels[chosen].T), kind="stable")]
    order = chosen.tolist()
    wrong = tuple(names[i] for i in order)
    told = "; ".join(
        f"{names[i]} by {np.hypot(*pixels[i]):.1f} px ({np.hypot(*moved[i]):.3g} {unit}: "
        f"x {moved[i, 0]:+.3g}, y {moved[i, 1]:+.3g})"
        for i in order[:6]
    )
    told += f"; and {len(wrong) - 6} more" if len(wrong) > 6 else ""
    who = f"{len(wrong)} of {len(names)} check points" if len(names) > 1 else "the check point"
    what = f"{who} {'is' if len(wrong) == 1 else 'are'} off: {told}"
    rest = moved[~found.odd]
    if len(rest) >= 2:
        x, y = rest.mean(axis=0)
        what += f", where the others agree: RMS {found.rms:.2f} px without, mean shift x {x:+.3g}, y {y:+.3g} {unit}"
    else:
        what += f", where the control leads one to expect {expected:.2f} px (leave-one-out)"
    mend = (
        "look whether their coordinates and their places in the image are right; if not, correct them or leave them "
        f"out: --without {' --without '.join(wrong[:6])}"
    )
    return [Advice("check-point", "warning", what, wrong, mend)]
