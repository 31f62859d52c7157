"""Correction fields over an image, and dodging: local gains for slow differences that no other term explains.

Residual differences of corrected views, relative to their mean, are log dᵢ − log dⱼ at the place of the sample, each
log d bilinear between the nodes of a net over its image. Nodes are drawn to 0 and to each other, so that the net
follows what overlaps show, fades where there are none, and adds no drift.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from geomosaic.interpolation import interval
from geomosaic.radiometry import bases
from geomosaic.radiometry.fields import BIWEIGHT_LIMIT, MAD_TO_SIGMA, ColourModel
from geomosaic.radiometry.normal_equations import MIN_SIGMA
from geomosaic.radiometry.overlap_samples import PairedSamples
from geomosaic.types import AnyArray, FloatArray

CURVE_STEPS = 4096
"""Intervals of a tabulated curve over the range of values; linear in between."""


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


NODES = 6
"""Nodes along each side of the net over an image."""
SIGMA_NODE, SIGMA_ROUGHNESS = 0.1, 0.05
"""Prior standard deviations of a node, and of a second difference of nodes."""
ITERATIONS = 3


def solve_dodging(fields: ColourModel, views: PairedSamples) -> ColourModel:
    """Colour model with dodging nets solved from its residual differences.

    Parameters
    ----------
    fields : ColourModel
        Solved without dodging.
    views : PairedSamples
        The samples to explain; those of images that no camera of the block took pull on no net.

    Returns
    -------
    ColourModel
        `fields` with `dodging`.
    """
    from scipy.sparse import block_diag, coo_matrix, csr_matrix
    from scipy.sparse.linalg import cg

    images, size = fields.setting.images, NODES * NODES
    one, other = fields.corrected(views)
    known = views.known
    number_a, weight_a = bases.bilinear_weights(views.image_a[known], NODES)
    number_b, weight_b = bases.bilinear_weights(views.image_b[known], NODES)
    index_a = np.broadcast_to(views.first[:, None], known.shape)[known]
    index_b = np.broadcast_to(views.second[:, None], known.shape)[known]
    camera = fields.setting.camera
    count = len(index_a)
    cols = np.concatenate([number_a + size * index_a[:, None], number_b + size * index_b[:, None]], axis=1)
    values = np.concatenate(
        [weight_a * (camera[index_a] >= 0)[:, None], -weight_b * (camera[index_b] >= 0)[:, None]], axis=1
    )
    rows = np.repeat(np.arange(count), 8)
    design = csr_matrix(coo_matrix((values.ravel(), (rows, cols.ravel())), shape=(count, images * size)))
    smooth = np.eye(size) / SIGMA_NODE**2 + bases.roughness(NODES, NODES) / SIGMA_ROUGHNESS**2
    prior = csr_matrix(block_diag([smooth] * images))
    per_overlap = np.repeat(known.sum(axis=1), known.sum(axis=1))
    nets = np.zeros((images, size, one.shape[2]))
    for band in range(one.shape[2]):
        a, b = one[..., band][known], other[..., band][known]
        left = (b - a) / np.maximum((np.abs(a) + np.abs(b)) / 2, 1e-9)
        net: FloatArray = np.zeros(images * size)
        for _ in range(ITERATIONS):
            off = left - design @ net
            sigma = max(MAD_TO_SIGMA * float(np.median(np.abs(off))), 1e-4)
            weight = np.maximum(1 - (off / (BIWEIGHT_LIMIT * sigma)) ** 2, 0.0) ** 2 / sigma**2
            # Samples of one overlap share the errors of the model: together they count as a few observations of
            # `MIN_SIGMA`, however many they are.
            weight = np.minimum(weight, 4 / (MIN_SIGMA**2 * per_overlap))
            normal = (design.T @ design.multiply(weight[:, None]) + prior).tocsr()
            scale = normal.diagonal()
            # Iterative, from the last net: weights change little from round to round.
            net, _ = cg(normal, design.T @ (weight * left), x0=net, rtol=1e-6, M=_diagonal(scale))
        nets[:, :, band] = net.reshape(images, size)
    return replace(fields, dodging=nets)


def _diagonal(scale: FloatArray) -> Any:
    from scipy.sparse import diags

    return diags(1 / scale)
