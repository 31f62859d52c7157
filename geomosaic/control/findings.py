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
    """Finding on control points: its code, severity, points and remedy.

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


def point_names(control: ControlPoints, which: AnyArray | Sequence[int]) -> tuple[str, ...]:
    """Names of points by mask (N,) or by indices."""
    chosen = np.asarray(which)
    return tuple(control.names[i] for i in (np.flatnonzero(chosen) if chosen.dtype == np.bool_ else chosen))


def listed(names: Sequence[str], most: int = 6) -> str:
    """Names joined for a sentence, at most `most` of them written out."""
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")


def leave_out(names: Sequence[str]) -> str:
    """Hint for leaving points out: the parameter `without`, once for each."""
    return " ".join(f"`without={name}`" for name in names)


def plane_coordinates(control: ControlPoints) -> FloatArray:
    """Ground coordinates (N, 2) about their mean, units of the CRS; longitudes are scaled by cos(latitude)."""
    xy: FloatArray = control.xy - control.xy.mean(axis=0)
    if control.crs.is_geographic:
        latitude = float(np.median(control.xy[:, 1]))
        if abs(latitude) < 90.0:
            xy = xy * np.array([np.cos(np.radians(latitude)), 1.0])
    return xy
