"""Radial corrections of a calibration certificate: a table, or a polynomial of the radius.

Both give g(r), the millimetres to be added to the radius of a measured image point, and go on linearly where the table
ends or the polynomial starts to run away.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from geomosaic.types import FloatArray

STRAIGHT = 0.2
"""|dg/dr| up to which a polynomial is believed."""


class Radial(Protocol):
    """Correction of a radius in mm."""

    @property
    def end(self) -> float:
        """Radius in mm from which on the correction goes on linearly; inf without end."""

    def correction(self, r: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return g in mm and dg/dr at radii (N,) in mm."""

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""


@dataclass(frozen=True)
class RadialTable:
    """Corrections at radii, with a cubic spline between them.

    The spline is odd, g(−r) = −g(r), as the correction of a lens is, and natural at the last radius.

    Attributes
    ----------
    radii : tuple of float
        mm, rising; without 0.
    values : tuple of float
        mm, to be added to the measured radius.
    """

    radii: tuple[float, ...]
    values: tuple[float, ...]
    _x: FloatArray = field(init=False, repr=False, compare=False)
    _y: FloatArray = field(init=False, repr=False, compare=False)
    _bend: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        x, y = np.array([0.0, *self.radii]), np.array([0.0, *self.values])
        h = np.diff(x)
        rise = np.diff(y) / h
        # Second derivatives of the natural cubic spline; 0 in the middle of an odd function too.
        system, right = np.eye(len(x)), np.zeros(len(x))
        for i in range(1, len(x) - 1):
            system[i, i - 1 : i + 2] = h[i - 1], 2.0 * (h[i - 1] + h[i]), h[i]
            right[i] = 6.0 * (rise[i] - rise[i - 1])
        for name, value in (("_x", x), ("_y", y), ("_bend", np.linalg.solve(system, right))):
            object.__setattr__(self, name, value)

    @property
    def end(self) -> float:
        """Last radius of the table in mm."""
        return self.radii[-1]

    def correction(self, r: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return g in mm and dg/dr at radii (N,) in mm."""
        x, y, bend = self._x, self._y, self._bend
        inside = np.minimum(r, self.end)
        i = np.clip(np.searchsorted(x, np.nan_to_num(inside)) - 1, 0, len(x) - 2)
        h = x[i + 1] - x[i]
        a, b = (x[i + 1] - inside) / h, (inside - x[i]) / h
        g = a * y[i] + b * y[i + 1] + ((a**3 - a) * bend[i] + (b**3 - b) * bend[i + 1]) * h**2 / 6.0
        slope = (y[i + 1] - y[i]) / h + ((3.0 * b**2 - 1.0) * bend[i + 1] - (3.0 * a**2 - 1.0) * bend[i]) * h / 6.0
        return g + slope * (r - inside), slope

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"kind": "table", "radii": list(self.radii), "values": list(self.values)}


@dataclass(frozen=True)
class RadialPolynomial:
    """g(r) = k0·r + k1·r³ + k2·r⁵ + ...

    Attributes
    ----------
    k : tuple of float
        k0 without unit, k1 in mm⁻², k2 in mm⁻⁴, ...
    """

    k: tuple[float, ...]
    _end: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        r = np.geomspace(1e-2, 1e5, 4001)
        wild = np.abs(self._polynomial(r)[1]) > STRAIGHT
        object.__setattr__(self, "_end", float(r[np.argmax(wild)]) if wild.any() else np.inf)

    def _polynomial(self, r: FloatArray) -> tuple[FloatArray, FloatArray]:
        u = r * r
        total, slope = np.zeros_like(r), np.zeros_like(r)
        for power in range(len(self.k) - 1, -1, -1):
            total = total * u + self.k[power]
            slope = slope * u + (2 * power + 1) * self.k[power]
        return total * r, slope

    @property
    def end(self) -> float:
        """Radius in mm beyond which the polynomial is not believed."""
        return self._end

    def correction(self, r: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return g in mm and dg/dr at radii (N,) in mm."""
        inside = np.minimum(r, self._end)
        g, slope = self._polynomial(inside)
        return (g + slope * (r - inside) if np.isfinite(self._end) else g), slope

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"kind": "polynomial", "k": list(self.k)}


def radial_from_dict(state: Mapping[str, Any]) -> Radial:
    """Rebuild from `to_dict`."""
    if state["kind"] == "table":
        return RadialTable(tuple(state["radii"]), tuple(state["values"]))
    return RadialPolynomial(tuple(state["k"]))
