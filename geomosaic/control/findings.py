"""Findings on control points: code, severity, points and how to go on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.control.points import ControlPoints
from geomosaic.types import AnyArray, FloatArray

SEVERITIES = ("error", "warning", "note")


@dataclass(frozen=True)
class Advice:
    """A finding.

    Attributes
    ----------
    code : str
        Short and constant, such as 'collinear'.
    severity : str
        'error': a fit would be undetermined or meaningless; 'warning': it would be weak or may be wrong; 'note'.
    what : str
        One sentence.
    points : tuple of str
        Names of the points it is about; empty where it is about all or none.
    hint : str
        What to do.
    """

    code: str
    severity: str
    what: str
    points: tuple[str, ...]
    hint: str

    def __str__(self) -> str:
        return f"{self.severity} ({self.code}): {self.what}\n  hint: {self.hint}"


def named(control: ControlPoints, which: AnyArray | Sequence[int]) -> tuple[str, ...]:
    """Return names by mask or index."""
    chosen = np.asarray(which)
    return tuple(control.names[i] for i in (np.flatnonzero(chosen) if chosen.dtype == np.bool_ else chosen))


def listed(names: Sequence[str], most: int = 6) -> str:
    """Join names for a sentence, not too many."""
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")


def leave_out(names: Sequence[str]) -> str:
    """How points are left out, as a hint says it: the parameter `without`, once for each."""
    return " ".join(f"`without={name}`" for name in names)


def plane(control: ControlPoints) -> FloatArray:
    """Return ground (N, 2) from its mean, degrees of longitude as long as those of latitude; units of the CRS."""
    xy: FloatArray = control.xy - control.xy.mean(axis=0)
    if control.crs.is_geographic:
        latitude = float(np.median(control.xy[:, 1]))
        if abs(latitude) < 90.0:
            xy = xy * np.array([np.cos(np.radians(latitude)), 1.0])
    return xy
