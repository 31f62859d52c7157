"""Geometry of a radar image: rows over azimuth time, columns over slant range or ground range, and the orbit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import comb
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from geomosaic.types import FloatArray
from geomosaic_sar.orbit import Orbit, StateVectors

LIGHT = 299792458.0


class RangeAxis(Protocol):
    """Columns over slant range."""

    kind: ClassVar[str]

    def columns(self, ranges: FloatArray, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Columns (N,) of slant ranges (N,) in metres at times (N,), and derivatives by range and by time.

        Columns are pixels, 0.5 the middle of the first one.
        """

    def ranges(self, columns: FloatArray, times: FloatArray) -> FloatArray:
        """Slant ranges (N,) in metres of columns (N,) at times (N,)."""

    def cut(self, col: float) -> Self:
        """The same for an image that begins at a column."""

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Axis of a state, as `to_dict` gives it."""


@dataclass(frozen=True)
class SlantRange:
    """Columns at equal steps of slant range.

    Attributes
    ----------
    near : float
        Slant range of the middle of the first column, metres.
    spacing : float
        From one column to the next, metres.
    """

    near: float
    spacing: float
    kind: ClassVar[str] = "slant"

    def columns(self, ranges: FloatArray, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Columns (N,), and derivatives by range and by time; see `RangeAxis`."""
        return (
            (ranges - self.near) / self.spacing + 0.5,
            np.full(len(ranges), 1.0 / self.spacing),
            np.zeros(len(ranges)),
        )

    def ranges(self, columns: FloatArray, times: FloatArray) -> FloatArray:
        """Slant ranges (N,) of columns (N,)."""
        return self.near + (columns - 0.5) * self.spacing

    def cut(self, col: float) -> Self:
        """The same for an image that begins at a column."""
        return replace(self, near=self.near + col * self.spacing)

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"near": self.near, "spacing": self.spacing}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Axis of a state, as `to_dict` gives it."""
        return cls(state["near"], state["spacing"])


@dataclass(frozen=True, eq=False)
class GroundRange:
    """Columns at equal steps of ground range, which is a polynomial of slant range at some azimuth times.

    Between two of these times ground ranges are interpolated linearly, before the first and after the last one they are
    those of that time.

    Attributes
    ----------
    times : array (T,)
        Azimuth times of the polynomials, seconds from the epoch of the scene, growing.
    origins : array (T,)
        Slant range from which each counts, metres.
    coefficients : array (T, K)
        Lowest power first: ground range in metres is Σ c_k (R − origin)^k.
    first : float
        Ground range of the middle of the first column, metres.
    spacing : float
        From one column to the next, metres.
    reach : tuple of float
        Least and greatest slant range of the scene, metres. Far outside, where a polynomial runs away, its tangent at
        a tenth of the swath beyond goes on.
    """

    times: FloatArray
    origins: FloatArray
    coefficients: FloatArray
    first: float
    spacing: float
    reach: tuple[float, float]
    kind: ClassVar[str] = "ground"

    @cached_property
    def _scale(self) -> tuple[float, float]:
        """Middle of the slant ranges and half their extent, metres."""
        low, high = self.reach
        return 0.5 * (low + high), 0.5 * (high - low)

    @cached_property
    def _scaled(self) -> FloatArray:
        """Coefficients (T, K), highest power first, over (R − middle) / half extent."""
        # Polynomials of different origins can only be interpolated by their coefficients where they count from one:
        # (d + h·u)^k = Σ_j C(k, j) d^(k−j) h^j u^j, d the distance from the origin to the middle.
        middle, half = self._scale
        away = middle - self.origins
        count = self.coefficients.shape[1]
        out = np.zeros_like(self.coefficients)
        for k in range(count):
            for j in range(k + 1):
                out[:, j] += self.coefficients[:, k] * comb(k, j) * away ** (k - j) * half**j
        return out[:, ::-1]

    def columns(self, ranges: FloatArray, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Columns (N,), and derivatives by range and by time; see `RangeAxis`."""
        middle, half = self._scale
        wide = (ranges - middle) / half
        u = np.clip(wide, -1.2, 1.2)
        last = len(self.times) - 1
        first = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, max(last - 1, 0))
        after = np.minimum(first + 1, last)
        gap = np.where(after > first, self.times[after] - self.times[first], 1.0)
        share = (times - self.times[first]) / gap
        inside = (share >= 0.0) & (share <= 1.0) & (after > first)
        share = np.clip(share, 0.0, 1.0)
        values, slopes = [], []
        for which in (first, after):
            value, slope = np.zeros(len(ranges)), np.zeros(len(ranges))
            for power in range(self._scaled.shape[1]):
                slope = slope * u + value
                value = value * u + self._scaled[which, power]
            values.append(value + slope * (wide - u))
            slopes.append(slope)
        ground = values[0] + share * (values[1] - values[0])
        by_range = (slopes[0] + share * (slopes[1] - slopes[0])) / half
        by_time = np.where(inside, (values[1] - values[0]) / gap, 0.0)
        return (ground - self.first) / self.spacing + 0.5, by_range / self.spacing, by_time / self.spacing

    def ranges(self, columns: FloatArray, times: FloatArray) -> FloatArray:
        """Slant ranges (N,) of columns (N,) at times (N,), by Newton's method."""
        out = np.full(len(columns), self._scale[0])
        for _ in range(50):
            found, by_range, _ = self.columns(out, times)
            step = (columns - found) / by_range
            out = out + step
            if not (np.abs(step) > 1e-8).any():
                break
        return out

    def cut(self, col: float) -> Self:
        """The same for an image that begins at a column."""
        return replace(self, first=self.first + col * self.spacing)

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            "times": self.times.tolist(),
            "origins": self.origins.tolist(),
            "coefficients": self.coefficients.tolist(),
            "first": self.first,
            "spacing": self.spacing,
            "reach": list(self.reach),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Axis of a state, as `to_dict` gives it."""
        low, high = state["reach"]
        times, origins, coefficients = (np.array(state[name]) for name in ("times", "origins", "coefficients"))
        return cls(times, origins, coefficients, state["first"], state["spacing"], (low, high))


RANGE_AXES: dict[str, type[SlantRange] | type[GroundRange]] = {axis.kind: axis for axis in (SlantRange, GroundRange)}


@dataclass(frozen=True, eq=False)
class ImageGeometry:
    """Geometry of a radar image.

    Attributes
    ----------
    orbit : Orbit
    side : int
        1 where the sensor looks to the right of its flight, -1 to the left.
    first_row : float
        Zero-Doppler time of the middle of the first row, seconds from the epoch of the scene.
    row_interval : float
        From one row to the next, seconds.
    axis : RangeAxis
        Columns.
    """

    orbit: Orbit
    side: int
    first_row: float
    row_interval: float
    axis: SlantRange | GroundRange

    def rows(self, times: FloatArray) -> FloatArray:
        """Rows (N,) of times (N,); 0.5 is the middle of the first row."""
        return (times - self.first_row) / self.row_interval + 0.5

    def times(self, rows: FloatArray) -> FloatArray:
        """Times (N,) of rows (N,)."""
        return self.first_row + (rows - 0.5) * self.row_interval

    def cut(self, col: float, row: float) -> ImageGeometry:
        """Geometry of an image whose upper-left corner is at (col, row) of this one."""
        return replace(self, first_row=self.first_row + row * self.row_interval, axis=self.axis.cut(col))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            "orbit": self.orbit.states.to_dict(),
            "side": self.side,
            "first_row": self.first_row,
            "row_interval": self.row_interval,
            "range": self.axis.kind,
            "axis": self.axis.to_dict(),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Geometry of a state, as `to_dict` gives it."""
        return cls(
            Orbit.through(StateVectors.from_dict(state["orbit"])),
            state["side"],
            state["first_row"],
            state["row_interval"],
            RANGE_AXES[state["range"]].from_dict(state["axis"]),
        )
