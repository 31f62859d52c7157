"""A correction that depends on value and place: gains on a coarse net over the output, and between."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from geomosaic.types import AnyArray, FloatArray

STEPS = 4096
"""Steps of a curve over the range of values; between them it is straight."""


@dataclass(frozen=True, eq=False)
class Shade:
    """corrected = net(place) · curve(value + dark − haze · path(place)) + offset, per band.

    Attributes
    ----------
    net : array (rows, cols, bands)
        Gains at nodes; at least 2 × 2 of them.
    origin : (float, float)
        Column and row of the first node, in output pixels (the centre of the first pixel is 0.5, 0.5).
    spacing : (float, float)
        Output pixels between nodes, across and down.
    dark, offset : array (bands,)
    curve : array (bands, STEPS + 1)
        Values for dark-corrected ones of 0, reach / STEPS, ... reach; (bands, 0) where they stay as they are.
    reach : float
    path : array (rows, cols)
        At the nodes of the net; (0, 0) where there is no haze.
    haze : array (bands,)
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
    ) -> Shade:
        """Tabulate curves of a power that leaves `pivot` as it is; `net` holds all gains."""
        bands = len(dark)
        curve = np.zeros((bands, 0))
        if (gamma != 1.0).any():
            curve = pivot * (reach / pivot * np.arange(STEPS + 1) / STEPS)[None, :] ** gamma[:, None]
        return cls(np.ascontiguousarray(net, dtype=np.float64), origin, spacing, dark, np.zeros(bands), curve, reach)

    def then(self, gain: FloatArray, offset: FloatArray) -> Shade:
        """Gain · corrected + offset."""
        return replace(self, net=np.ascontiguousarray(self.net * gain), offset=self.offset * gain + offset)

    def at(self, col: float, row: float) -> tuple[float, float]:
        """Place in the net, in nodes, of a place in output pixels."""
        return (col - self.origin[0]) / self.spacing[0], (row - self.origin[1]) / self.spacing[1]

    def __call__(self, values: AnyArray, cols: FloatArray, rows: FloatArray) -> FloatArray:
        """Correct values (R, C, bands) of a raster whose columns (C,) and rows (R,) lie there in output pixels."""
        i, u = between((cols - self.origin[0]) / self.spacing[0], self.net.shape[1])
        j, v = between((rows - self.origin[1]) / self.spacing[1], self.net.shape[0])
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
        at = np.maximum(plain * (STEPS / self.reach), 0.0)
        step = np.minimum(at.astype(np.int64), STEPS - 1)
        band = np.arange(self.curve.shape[0])
        low, high = self.curve[band, step], self.curve[band, step + 1]
        return np.asarray(low + (high - low) * (at - step))

    def line(self) -> tuple[FloatArray, FloatArray]:
        """Gain and offset (bands,) that the correction comes to in the middle of values and places."""
        mean = self.net.mean(axis=(0, 1))
        ends = np.stack([np.full(len(self.dark), self.reach / 4), np.full(len(self.dark), self.reach / 2)])
        veil = self.haze * self.path.mean() if self.path.size else 0.0
        low, high = mean * self.tone(ends - veil) + self.offset
        gain = (high - low) / (ends[1] - ends[0])
        return gain, low - gain * ends[0]

    def digest(self) -> bytes:
        """All that decides about values."""
        numbers = np.array([*self.origin, *self.spacing, self.reach])
        return b"".join(
            part.tobytes() for part in (self.net, numbers, self.dark, self.offset, self.curve, self.path, self.haze)
        )


def between(at: FloatArray, count: int) -> tuple[AnyArray, FloatArray]:
    """Node before each place and the part of the way to the next, within the net."""
    inside = np.minimum(np.maximum(at, 0.0), count - 1.0)
    node = np.minimum(inside.astype(np.int64), count - 2)
    return node, inside - node
