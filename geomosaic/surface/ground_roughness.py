"""Roughness of a ground that samples show: how far it departs from triangles between them, and beyond their rim.

The variance of a height between points has three parts. Their own errors, which are independent, and errors that they
share follow from their covariances. What the ground does between them is that of a self-affine surface: with weights λ
of the interpolation (1 for the place, minus those of the points), which annihilate planes,

    v = ∓c·Σᵢⱼ λᵢ·λⱼ·|pᵢ − pⱼ|^2H     − for H < 1, + for 1 < H < 2

(J.-P. Chilès, P. Delfiner: Geostatistics, 2nd ed., 2012, ch. 4: generalised covariances). Exponent H and roughness c
are those under which heights of points that are left out in turn are met best; c follows the ground from place to
place. Beyond the rim of the points the trend of all goes on, with an error that points left out at the rim calibrate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from geomosaic.surface.triangles import Interpolation, Plane, Samples, TriangulatedSurface
from geomosaic.types import BoolArray, FloatArray, IntArray, Map

# Parts of the points that are left out in turn, and directions from which the rim is cut.
FOLDS, SIDES = 5, 8
# Exponents that are tried; 1 itself is excluded, as planes cost nothing there.
EXPONENTS = np.array([0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 1.1, 1.25, 1.4, 1.6, 1.8])
# Points that tell the exponent, and those around a place that tell the roughness there.
SAMPLE, AROUND = 2000, 16
# Points above which some of them stand for all where laws are found.
LARGE = 20_000
# And those above which all that stand for them may be left out at once.
DENSE = 10 * LARGE
# Share of the normal distribution within one standard deviation.
WITHIN = 0.6827


@dataclass(frozen=True, eq=False)
class Roughness:
    """How far the ground departs from triangles between samples, and from the trend beyond them.

    Attributes
    ----------
    sheet : TriangulatedSurface
    exponent, level : float
        H and c of the head of this file.
    local : array (N,)
        Factor of c at each sample.
    rim : (float, float)
        Exponent and factor of the variance by the distance beyond the rim.
    residual : float
        RMS of what left out samples are missed by.
    """

    sheet: TriangulatedSurface
    exponent: float
    level: float
    local: FloatArray
    rim: tuple[float, float]
    residual: float

    @classmethod
    def of(cls, sheet: TriangulatedSurface, each: Map) -> Roughness:
        """Law under which samples that are left out in turn are met; `each` calls a function of units of work."""
        samples, random = sheet.samples, np.random.default_rng(0)
        order = random.permutation(len(samples.z))
        # All of them where that is quick; of many a part, as long as the others are about as dense without it.
        some, parts = (order, FOLDS) if len(order) <= LARGE else (order[: LARGE // 2], 2 if len(order) < DENSE else 1)
        held = [rows for rows in np.array_split(some, parts) if len(rows)]
        rows, at = np.concatenate(held), Interpolation.joined(list(each(_LeftOut(samples), held)))
        within = at.gap == 0.0
        rows, at = rows[within], at.part(within)
        off = samples.z[rows] - at.height
        noise = at.noise + samples.own[rows]
        some = random.permutation(len(rows))[:SAMPLE]
        tried = at.part(some)
        shapes = np.array([tried.shape(exponent) for exponent in EXPONENTS])
        best, level = _likeliest(off[some] ** 2, noise[some], shapes)
        exponent = float(EXPONENTS[best])
        shape = level * at.shape(exponent)
        # Lawns and trees of one block: the squares around a place say how rough it is there, each by at most 9.
        square = np.minimum(off**2 / np.maximum(noise + shape, 1e-300), 9.0)
        tree, count = cKDTree(samples.xy[rows]), min(AROUND, len(rows) - 1)
        near = tree.query(samples.xy[rows], count + 1)[1][:, 1:]
        around = _shrunk(square[near])
        factor = _calibrated(off, noise, around * shape)
        local = _shrunk(square[tree.query(samples.xy, count + 1)[1]])
        law = cls(sheet, exponent, factor * level, local, (1.0, 0.0), float(np.sqrt((off**2).mean())))
        return law._with_rim(each)

    def _with_rim(self, each: Map) -> Roughness:
        """Law with that beyond the rim, from samples cut off at each side in turn."""
        found, random = [], np.random.default_rng(0)
        rows = random.permutation(len(self.local))[:LARGE]
        law, samples = replace(self, local=self.local[rows]), self.sheet.samples.part(rows)
        sides = []
        for angle in 2.0 * np.pi * np.arange(SIDES) / SIDES:
            ahead = samples.xy[:, 0] * np.cos(angle) + samples.xy[:, 1] * np.sin(angle)
            sides.append(np.flatnonzero(ahead > np.quantile(ahead, 0.85)))
        for rows, at in zip(sides, each(_LeftOut(samples), sides), strict=True):
            at, rows = at.part(at.gap > 0.0), rows[at.gap > 0.0]
            found.append((at.gap, (samples.z[rows] - at.height) ** 2, law._within(at) + samples.own[rows]))
        gap, square, noise = (np.concatenate(parts) for parts in zip(*found, strict=True))
        some = random.permutation(len(gap))[:SAMPLE]
        gap, square, noise = gap[some], square[some], noise[some]
        exponents = np.array([0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0])
        best, level = _likeliest(square, noise, gap ** (2.0 * exponents[:, None]))
        level *= _calibrated(np.sqrt(square), noise, level * gap ** (2.0 * exponents[best]))
        return replace(self, rim=(float(exponents[best]), level))

    def at(self, xy: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Heights (N,) at places (N, 2), their variances, and whether the places lie beyond the samples."""
        at, (exponent, level) = self.sheet.weights(xy), self.rim
        return at.height, self._within(at) + level * at.gap ** (2.0 * exponent), at.gap > 0.0

    def _within(self, at: Interpolation) -> FloatArray:
        local: FloatArray = (np.abs(at.weight) * self.local.take(at.index)).sum(axis=1)
        return at.noise + self.level * local * at.shape(self.exponent)


@dataclass(frozen=True, eq=False)
class _LeftOut:
    """Places of samples that are left out as the others tell them, by rows."""

    samples: Samples

    def __call__(self, rows: IntArray) -> Interpolation:
        rest = np.setdiff1d(np.arange(len(self.samples.z)), rows)
        others = self.samples.part(rest)
        at = TriangulatedSurface.of(others, Plane.through(others)).weights(self.samples.xy[rows])
        return replace(at, index=rest[at.index])


def _shrunk(squares: FloatArray) -> FloatArray:
    """Means of squares (N, K) of standardised values, drawn towards 1 as four values would."""
    found: FloatArray = (squares.sum(axis=1) + 4.0) / (squares.shape[1] + 4.0)
    return found


def _likeliest(square: FloatArray, noise: FloatArray, shapes: FloatArray) -> tuple[int, float]:
    """Shape (E, N) and its factor under which squared errors (N,) are likeliest, as of Student's t, 4 degrees."""
    best, found = np.inf, (0, 0.0)
    for index, shape in enumerate(shapes):
        middle = float(np.median(square)) / max(float(np.median(shape)), 1e-300)
        for factor in middle * np.geomspace(1e-4, 1e3, 71):
            variance = np.maximum(noise + factor * shape, 1e-300)
            loss = float((0.5 * np.log(variance) + 2.5 * np.log1p(square / (4.0 * variance))).sum())
            if loss < best:
                best, found = loss, (index, float(factor))
    return found


def _calibrated(off: FloatArray, noise: FloatArray, variance: FloatArray) -> float:
    """Factor of a variance with which 68 % of the errors (N,) lie within one standard deviation."""
    low, high = 1e-4, 1e4
    for _ in range(40):
        middle = np.sqrt(low * high)
        inside = (off**2 <= noise + middle * variance).mean()
        low, high = (low, middle) if inside > WITHIN else (middle, high)
    return float(np.sqrt(low * high))
