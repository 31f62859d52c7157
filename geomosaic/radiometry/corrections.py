"""Corrections of an image's values: rising tone curves, and fields by place and value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from geomosaic.interpolation import interval
from geomosaic.types import AnyArray, FloatArray

# Intervals of a tabulated curve over the range of values; linear in between.
CURVE_STEPS = 4096


@dataclass(frozen=True, eq=False)
class CorrectionField:
    """Correction by place and value, per band: net(place) · curve(value + dark − haze · path(place)) + offset.

    Attributes
    ----------
    net : array (rows, cols, bands)
        Gains at nodes; at least 2 × 2 of them.
    origin : (float, float)
        Column and row of the first node, in output pixels (the centre of the first pixel is 0.5, 0.5).
    spacing : (float, float)
        Output pixels between nodes, across and down.
    dark, offset : array (bands,)
    curve : array (bands, CURVE_STEPS + 1)
        Values for dark-corrected ones of 0, reach / CURVE_STEPS, ... reach; (bands, 0) where they stay as they are.
    reach : float
        Range of values.
    path : array (rows, cols)
        Excess air path at the nodes of the net; (0, 0) where there is no haze.
    haze : array (bands,)
        Grey values in the corners.
    """

    net: FloatArray
    origin: tuple[float, float]
    spacing: tuple[float, float]
    dark: FloatArray
    offset: FloatArray
    curve: FloatArray
    reach: float
    path: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    haze: FloatArray = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(
        cls,
        net: FloatArray,
        origin: tuple[float, float],
        spacing: tuple[float, float],
        dark: FloatArray,
        gamma: FloatArray,
        reach: float,
        pivot: float,
    ) -> CorrectionField:
        """Field with tabulated powers that leave `pivot` unchanged; `net` holds all gains."""
        bands = len(dark)
        curve = np.zeros((bands, 0))
        if (gamma != 1.0).any():
            curve = pivot * (reach / pivot * np.arange(CURVE_STEPS + 1) / CURVE_STEPS)[None, :] ** gamma[:, None]
        return cls(np.ascontiguousarray(net, dtype=np.float64), origin, spacing, dark, np.zeros(bands), curve, reach)

    def then(self, gain: FloatArray, offset: FloatArray) -> CorrectionField:
        """Field followed by gain · corrected + offset."""
        return replace(self, net=np.ascontiguousarray(self.net * gain), offset=self.offset * gain + offset)

    def at(self, col: float, row: float) -> tuple[float, float]:
        """Position in the net, in nodes, of a position in output pixels."""
        return (col - self.origin[0]) / self.spacing[0], (row - self.origin[1]) / self.spacing[1]

    def __call__(self, values: AnyArray, cols: FloatArray, rows: FloatArray) -> FloatArray:
        """Corrected values of a raster (R, C, bands) with columns (C,) and rows (R,) in output pixels."""
        i, u = interval((cols - self.origin[0]) / self.spacing[0], self.net.shape[1])
        j, v = interval((rows - self.origin[1]) / self.spacing[1], self.net.shape[0])
        lines = self.net[j] + (self.net[j + 1] - self.net[j]) * v[:, None, None]
        gain = lines[:, i] + (lines[:, i + 1] - lines[:, i]) * u[None, :, None]
        clear = np.asarray(values, dtype=np.float64)
        if self.path.size:
            ways = self.path[j] + (self.path[j + 1] - self.path[j]) * v[:, None]
            clear = clear - self.haze * (ways[:, i] + (ways[:, i + 1] - ways[:, i]) * u)[..., None]
        return np.asarray(gain * self.tone(clear) + self.offset)

    def tone(self, values: FloatArray) -> FloatArray:
        """Values (..., bands) of the curve."""
        plain = values + self.dark
        if not self.curve.shape[1]:
            return plain
        at = np.maximum(plain * (CURVE_STEPS / self.reach), 0.0)
        step = np.minimum(at.astype(np.int64), CURVE_STEPS - 1)
        band = np.arange(self.curve.shape[0])
        low, high = self.curve[band, step], self.curve[band, step + 1]
        return np.asarray(low + (high - low) * (at - step))

    def line(self) -> tuple[FloatArray, FloatArray]:
        """Gain and offset (bands,) of the correction at the mean of the net, from a quarter to half of the range."""
        mean = self.net.mean(axis=(0, 1))
        ends = np.stack([np.full(len(self.dark), self.reach / 4), np.full(len(self.dark), self.reach / 2)])
        veil = self.haze * self.path.mean() if self.path.size else 0.0
        low, high = mean * self.tone(ends - veil) + self.offset
        gain = (high - low) / (ends[1] - ends[0])
        return gain, low - gain * ends[0]

    def digest(self) -> bytes:
        """Bytes of all that decides about values."""
        numbers = np.array([*self.origin, *self.spacing, self.reach])
        return b"".join(
            part.tobytes() for part in (self.net, numbers, self.dark, self.offset, self.curve, self.path, self.haze)
        )


@dataclass(frozen=True, eq=False)
class ToneCurve:
    """Rising curve per band: linear between its knots, of one slope beyond them.

    Attributes
    ----------
    knots : sequence of (x, y)
        One pair of arrays (K,) per band, x rising.
    slope : float
        Beyond them.
    """

    knots: Sequence[tuple[FloatArray, FloatArray]]
    slope: float = 1.0

    @classmethod
    def identity(cls, bands: int) -> ToneCurve:
        """Curve that leaves values as they are."""
        return cls([(np.zeros(1), np.zeros(1))] * bands)

    def __call__(self, values: AnyArray) -> FloatArray:
        """Values (..., bands) of the curve."""
        out = np.empty(values.shape, dtype=np.float64)
        for band, (x, y) in enumerate(self.knots):
            plain = np.asarray(values[..., band], dtype=np.float64)
            beyond = np.minimum(plain - x[0], 0.0) + np.maximum(plain - x[-1], 0.0)
            out[..., band] = np.interp(plain, x, y) + self.slope * beyond
        return out

    def line(self) -> tuple[FloatArray, FloatArray]:
        """Gain and offset (bands,) of the straight line between the quarters of the knots."""
        gain, offset = np.ones(len(self.knots)), np.zeros(len(self.knots))
        for band, (x, y) in enumerate(self.knots):
            low, high = len(x) // 4, (3 * (len(x) - 1)) // 4 if len(x) > 3 else len(x) - 1
            if x[high] > x[low]:
                gain[band] = (y[high] - y[low]) / (x[high] - x[low])
            offset[band] = np.mean(y) - gain[band] * np.mean(x)
        return gain, offset
