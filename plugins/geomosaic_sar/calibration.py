"""Radiometric calibration of a radar scene: beta, sigma or gamma nought of the amplitudes in its pixels.

    beta0  = (DN² − η) · k            radar brightness: power per area of the slant range plane
    sigma0 = beta0 · sin θ            per area of level ground
    gamma0 = beta0 · tan θ            per area across the line of sight

with the amplitudes DN, the power of thermal noise η in their units, and the incidence angle θ on the ellipsoid.
Products of Sentinel-1 give the root of 1 / k as a table of its own for each of the three.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Self

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import AnyArray, FloatArray, IntArray

QUANTITIES = ("beta0", "sigma0", "gamma0")
FLATTENED = "gamma0-flattened"
CALIBRATIONS = ("none", *QUANTITIES, FLATTENED)
NAMES = {
    "beta0": "beta nought",
    "sigma0": "sigma nought",
    "gamma0": "gamma nought",
    FLATTENED: "terrain-flattened gamma nought",
}
# Nodes of all tables of a scene together: annotations have some ten thousand.
MOST_NODES = 4_000_000


@dataclass(frozen=True, eq=False)
class PixelTable:
    """Values over an image, bilinear between nodes and held beyond them.

    Attributes
    ----------
    cols : array (C,)
        Of the nodes, growing, pixels; 0.5 is the middle of the first.
    rows : array (R,)
    values : array (R, C)
    """

    cols: FloatArray
    rows: FloatArray
    values: FloatArray

    @classmethod
    def constant(cls, value: float) -> Self:
        """The same value everywhere.

        Parameters
        ----------
        value : float
        """
        return cls(np.zeros(1), np.zeros(1), np.array([[value]]))

    @classmethod
    def of_lines(cls, rows: Sequence[float], lines: Sequence[tuple[FloatArray, FloatArray]], where: str) -> Self:
        """Table of lines that have columns of their own.

        Parameters
        ----------
        rows : sequence of float
        lines : sequence of (columns, values)
            Columns grow.
        where : str
            Named in errors.

        Raises
        ------
        InputError
            Rows do not grow, or there are too many nodes.
        """
        if not len(rows) or not (np.diff(rows) > 0.0).all():
            raise InputError("the lines of a calibration table do not grow", where=where, hint=None)
        cols = np.unique(np.concatenate([columns for columns, _ in lines]))
        if len(cols) * len(lines) > MOST_NODES:
            raise InputError(f"a table has {len(lines)} x {len(cols)} nodes", where=where, hint=None)
        values = np.array([np.interp(cols, columns, line) for columns, line in lines])
        return cls(cols, np.array(rows, dtype=np.float64), values)

    def at(self, cols: FloatArray, rows: FloatArray) -> AnyArray:
        """Values (M, N) as float32, or fewer that are broadcast, at columns (N,) and rows (M,), both growing.

        Parameters
        ----------
        cols : array (N,)
        rows : array (M,)
        """
        if self.values.size == 1:
            return self.values.astype(np.float32)
        row, lower = _interval(self.rows, rows)
        # Lines of the nodes about these rows, at all columns.
        near = self.values[row[0] : row[-1] + 2] if len(rows) else self.values
        col, right = _interval(self.cols, cols)
        lines = near[:, col] * (1.0 - right) + near[:, np.minimum(col + 1, len(self.cols) - 1)] * right
        lines = lines.astype(np.float32)
        if len(self.rows) == 1:
            return np.asarray(lines)
        out = np.empty((len(rows), len(cols)), dtype=np.float32)
        ends = np.searchsorted(row, np.arange(row[0], row[-1] + 2)).tolist() if len(rows) else list[int]()
        for number, (first, stop) in enumerate(pairwise(ends)):
            part = lower[first:stop, None].astype(np.float32)
            np.multiply(part, lines[number + 1] - lines[number], out=out[first:stop])
            out[first:stop] += lines[number]
        return out

    def cut(self, col: float, row: float) -> Self:
        """Table of an image whose upper-left corner is at (col, row) of this one."""
        return replace(self, cols=self.cols - col, rows=self.rows - row)

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"cols": self.cols.tolist(), "rows": self.rows.tolist(), "values": self.values.tolist()}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Table of a state, as `to_dict` gives it."""
        return cls(*(np.array(state[name], dtype=np.float64) for name in ("cols", "rows", "values")))


def _interval(nodes: FloatArray, at: FloatArray) -> tuple[IntArray, FloatArray]:
    """Node before each place, and the part of the way to the next; held beyond the ends."""
    if len(nodes) == 1:
        return np.zeros(len(at), dtype=np.int64), np.zeros(len(at))
    first = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 2)
    return first, np.clip((at - nodes[first]) / (nodes[first + 1] - nodes[first]), 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class NoiseBlock:
    """Factor of the noise along the rows of a part of the image.

    Attributes
    ----------
    cols, rows : tuple of float
        Left and right edge, upper and lower edge, pixels.
    factor : PixelTable
    """

    cols: tuple[float, float]
    rows: tuple[float, float]
    factor: PixelTable


@dataclass(frozen=True, eq=False)
class ThermalNoise:
    """Power of the thermal noise in the units of squared amplitudes: range profiles, scaled along azimuth by parts.

    Attributes
    ----------
    profiles : PixelTable
    blocks : tuple of NoiseBlock
        Outside of all of them the factor is 1.
    """

    profiles: PixelTable
    blocks: tuple[NoiseBlock, ...] = ()

    def at(self, cols: FloatArray, rows: FloatArray) -> AnyArray:
        """Power (M, N), or fewer values that are broadcast, at columns (N,) and rows (M,)."""
        power = self.profiles.at(cols, rows)
        for block in self.blocks:
            (left, right), (top, bottom) = block.cols, block.rows
            c0, c1 = np.searchsorted(cols, [left, right])
            r0, r1 = np.searchsorted(rows, [top, bottom])
            if c0 == c1 or r0 == r1:
                continue
            if power.shape != (len(rows), len(cols)) or not power.flags.writeable:
                power = np.array(np.broadcast_to(power, (len(rows), len(cols))))
            power[r0:r1, c0:c1] *= block.factor.at(cols[c0:c1], rows[r0:r1])
        return power

    def cut(self, col: float, row: float) -> Self:
        """Noise of an image whose upper-left corner is at (col, row) of this one."""
        blocks = tuple(
            NoiseBlock(
                (one.cols[0] - col, one.cols[1] - col), (one.rows[0] - row, one.rows[1] - row),
                one.factor.cut(col, row),
            )
            for one in self.blocks
        )  # fmt: skip
        return replace(self, profiles=self.profiles.cut(col, row), blocks=blocks)

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        blocks = [
            {"cols": list(one.cols), "rows": list(one.rows), "factor": one.factor.to_dict()} for one in self.blocks
        ]
        return {"profiles": self.profiles.to_dict(), "blocks": blocks}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Noise of a state, as `to_dict` gives it."""
        blocks = [
            NoiseBlock(tuple(one["cols"]), tuple(one["rows"]), PixelTable.from_dict(one["factor"]))
            for one in state["blocks"]
        ]
        return cls(PixelTable.from_dict(state["profiles"]), tuple(blocks))


@dataclass(frozen=True, eq=False)
class SarCalibration:
    """Calibration of the amplitudes of a scene; see `geomosaic.sensor.plugin.Calibration`.

    Attributes
    ----------
    kind : str
        One of `CALIBRATIONS` but 'none'.
    amplitude : PixelTable
        A: the quantity is (DN² − noise) / A².
    noise : ThermalNoise, optional
    """

    kind: str
    amplitude: PixelTable
    noise: ThermalNoise | None = None

    @property
    def quantity(self) -> str:
        """Name of the quantity."""
        return NAMES[self.kind]

    @property
    def unit(self) -> str:
        """Power by area."""
        return "m2/m2"

    @property
    def flattened(self) -> bool:
        """Whether it is beta nought, to be divided by the area that is lit."""
        return self.kind == FLATTENED

    def at(self, cols: FloatArray, rows: FloatArray) -> tuple[AnyArray, AnyArray]:
        """Factor of the squares and offset (M, N) at columns (N,) and rows (M,), both growing."""
        amplitude = self.amplitude.at(cols, rows)
        factor = np.reciprocal(np.square(amplitude, out=amplitude), out=amplitude)
        return factor, np.zeros((1, 1), dtype=np.float32) if self.noise is None else -factor * self.noise.at(cols, rows)

    def cut(self, col: float, row: float) -> Self:
        """Calibration of an image whose upper-left corner is at (col, row) of this one."""
        noise = None if self.noise is None else self.noise.cut(col, row)
        return replace(self, amplitude=self.amplitude.cut(col, row), noise=noise)

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        noise = None if self.noise is None else self.noise.to_dict()
        return {"kind": self.kind, "amplitude": self.amplitude.to_dict(), "noise": noise}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Calibration of a state, as `to_dict` gives it."""
        noise = None if state["noise"] is None else ThermalNoise.from_dict(state["noise"])
        return cls(state["kind"], PixelTable.from_dict(state["amplitude"]), noise)
