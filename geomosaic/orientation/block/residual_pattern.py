"""Pattern of residuals over the format of a camera: what lenses, film and sensors leave behind.

Errors of points are as often to the left as to the right; what a camera does wrong it does in each image at the same
place, so that it stays in the mean of many residuals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_distribution

from geomosaic.types import FloatArray, IntArray

# Residuals that a cell has on average at least, and cells along the longer side at most.
PER_CELL, MOST_CELLS = 40, 16
# Cells of the test along the longer side: what lenses do is smooth, and would drown in the freedom of finer cells.
TESTED_CELLS = 6
# Residuals below which the mean of a cell says nothing.
LEAST = 3
# Probability below which a pattern is no chance.
PATTERN_ALPHA = 1e-3


@dataclass(frozen=True, eq=False)
class ResidualPattern:
    """Mean residuals in cells over the format of a camera.

    Attributes
    ----------
    size : tuple of int
        Width and height of the format, pixels.
    count : int array (H, W)
        Residuals in each cell.
    mean : array (H, W, 2)
        Their means, pixels; NaN of cells with fewer than 3.
    rms : float
        RMS length of the residuals, pixels.
    probability : float
        Of means that differ as much by chance (analysis of variance over the cells); NaN of too few residuals.
    """

    size: tuple[int, int]
    count: IntArray
    mean: FloatArray
    rms: float
    probability: float

    @property
    def systematic(self) -> bool:
        """Whether chance does not explain the pattern."""
        return self.probability < PATTERN_ALPHA

    @property
    def mean_rms(self) -> float:
        """RMS length of the cells' means, over their residuals, pixels; NaN without any cell."""
        known = np.isfinite(self.mean).all(axis=2)
        weight = self.count[known]
        squares = (self.mean[known] ** 2).sum(axis=1)
        return float(np.sqrt(weight @ squares / weight.sum())) if weight.sum() else float("nan")


def residual_pattern(colrow: FloatArray, residuals: FloatArray, size: tuple[int, int]) -> ResidualPattern:
    """Pattern of the residuals of all images of one camera.

    Parameters
    ----------
    colrow : array (N, 2)
        Image positions, pixels.
    residuals : array (N, 2)
        Measured minus computed, pixels.
    size : tuple of int
        Width and height of the format, pixels.
    """
    longer = max(1, min(MOST_CELLS, int(np.sqrt(len(colrow) / PER_CELL * max(size) / min(size)))))
    count, total = _cells(colrow, residuals, size, longer)
    with np.errstate(invalid="ignore"):
        mean = np.where((count >= LEAST)[..., None], total / count[..., None], np.nan)
    return ResidualPattern(
        size, count, mean,
        float(np.sqrt((residuals**2).sum(axis=1).mean())) if len(residuals) else float("nan"),
        _probability(residuals, *_cells(colrow, residuals, size, min(longer, TESTED_CELLS))),
    )  # fmt: skip


def _cells(
    colrow: FloatArray, residuals: FloatArray, size: tuple[int, int], longer: int
) -> tuple[IntArray, FloatArray]:
    """Number (H, W) and sum (H, W, 2) of the residuals in each cell, `longer` of them along the longer side."""
    across, down = (max(1, round(longer * side / max(size))) for side in size)
    # What was measured beyond the edge counts for the cell at the edge.
    col = np.clip((colrow[:, 0] / size[0] * across).astype(np.int64), 0, across - 1)
    row = np.clip((colrow[:, 1] / size[1] * down).astype(np.int64), 0, down - 1)
    cell, cells = row * across + col, across * down
    total: FloatArray = np.column_stack([np.bincount(cell, axis, cells) for axis in residuals.T]).astype(np.float64)
    return np.bincount(cell, minlength=cells).reshape(down, across), total.reshape(down, across, 2)


def _probability(residuals: FloatArray, count: IntArray, total: FloatArray) -> float:
    """Probability of means of both axes as different from 0 as these, by the F test."""
    used = count > 0
    between, within = 2 * int(used.sum()), 2 * (len(residuals) - int(used.sum()))
    if within < 2 * between:
        return float("nan")
    explained = float((total[used] ** 2 / count[used, None]).sum())
    left = float((residuals**2).sum()) - explained
    return float(f_distribution.sf(explained / between / max(left / within, 1e-300), between, within))
