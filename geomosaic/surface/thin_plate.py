"""Thin plate through scattered heights on a grid: least bending, folds along breaklines, nodes that are held.

The heights h of the nodes make least, in units of the nodes' distance (Briggs 1974: minimum curvature; Terzopoulos
1988: folds where bending costs nothing),

    sum (h_xx² + 2 h_xy² + h_yy²)  +  sum w (h(x, y) - z)²,

h(x, y) bilinear between nodes, as every user of a DEM interpolates. The normal equations are sparse and solved
directly: there is no iteration that could end too early. Of a factorisation of one patch also comes what each
observation would be predicted as without itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from geomosaic.types import BoolArray, FloatArray, IntArray

# Share of its cost that bending keeps across a fold: enough to hold what nothing else does.
FOLDED = 1e-4
# Weight that draws every node to the background: far below that of any observation, it settles what none touches.
FAINT = 1e-9
# Observations that are left out at a time: bounds the memory.
TOGETHER = 32


@dataclass(frozen=True, eq=False)
class Heights:
    """Heights observed on a grid.

    Attributes
    ----------
    colrow : array (N, 2)
        Node coordinates: (0, 0) is the first node.
    height : array (N,)
        Metres.
    weight : array (N,)
        Of the squared misfit, beside the bending of nodes at distance 1.
    """

    colrow: FloatArray
    height: FloatArray
    weight: FloatArray

    def part(self, rows: BoolArray | IntArray | slice) -> Heights:
        """Some of the observations."""
        return Heights(self.colrow[rows], self.height[rows], self.weight[rows])

    def within(self, first: tuple[int, int], shape: tuple[int, int]) -> BoolArray:
        """Which observations lie between the nodes of a patch (rows, cols) whose first node is (col, row)."""
        low = np.asarray(first, dtype=np.float64)
        return np.asarray(((self.colrow >= low) & (self.colrow <= low + np.array(shape[::-1]) - 1)).all(axis=1))


@dataclass(frozen=True, eq=False)
class Plate:
    """Solved patch.

    Attributes
    ----------
    heights : array (rows, cols)
    factor : SuperLU
        Of the normal equations of the free nodes.
    free : int array (rows * cols,)
        Number of each node among the free ones, -1 of a held one.
    """

    heights: FloatArray
    factor: Any
    free: IntArray

    def left_out(self, observed: Heights) -> FloatArray:
        """Height minus what all others predict there (N,), of observations that took part; NaN where all is held.

        Deleting row i of a least squares problem changes its residual r to r / (1 - w b' N⁻¹ b), b its derivatives.
        """
        rows = _interpolation(observed.colrow, self.heights.shape)
        residual = observed.height - rows @ self.heights.ravel()
        rows = rows.tocsc()[:, np.flatnonzero(self.free >= 0)].T.tocsc()
        out = np.full(len(residual), np.nan)
        for start in range(0, len(residual), TOGETHER):
            part = slice(start, start + TOGETHER)
            some = rows[:, part].toarray()
            share = 1.0 - observed.weight[part] * np.einsum("ik,ik->k", some, self.factor.solve(some))
            known = some.any(axis=0) & (share > 1e-12)
            out[part] = np.where(known, residual[part] / np.where(known, share, 1.0), np.nan)
        return out


def solve_plate(observed: Heights, folds: Folds, held: FloatArray, drawn: FloatArray, pull: FloatArray) -> Plate:
    """Thin plate of one patch.

    Parameters
    ----------
    observed : Heights
        Within the patch.
    folds : Folds
    held : array (rows, cols)
        Heights of nodes that are given, metres; NaN elsewhere.
    drawn, pull : array (rows, cols)
        Heights that nodes are drawn to, and the weight of each; besides, all are drawn faintly.
    """
    from scipy.sparse import csc_array, diags_array
    from scipy.sparse.linalg import splu

    shape = held.shape
    bending, kept = _bending(shape), _bending_weights(folds)
    rows = _interpolation(observed.colrow, shape)
    weight = np.maximum(pull, FAINT).ravel()
    normal = (
        bending.T @ diags_array(kept) @ bending + rows.T @ diags_array(observed.weight) @ rows + diags_array(weight)
    )
    right = rows.T @ (observed.weight * observed.height) + weight * drawn.ravel()
    known = np.isfinite(held).ravel()
    free = np.where(known, -1, np.cumsum(~known) - 1)
    heights = np.where(known, held.ravel(), 0.0)
    normal = csc_array(normal)
    open_nodes = np.flatnonzero(~known)
    right = (right - normal @ heights)[open_nodes]
    reduced = csc_array(normal[:, open_nodes][open_nodes])
    factor = splu(reduced, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    heights[open_nodes] = factor.solve(right)
    return Plate(heights.reshape(shape), factor, free)


@dataclass(frozen=True, eq=False)
class Folds:
    """Where the slope of a patch may break, arrays (rows, cols).

    Attributes
    ----------
    across, down : bool array
        Nodes at which the profile along their row, and along their column, has a break.
    cells : bool array
        Cells that a breakline crosses, by their first node.
    """

    across: BoolArray
    down: BoolArray
    cells: BoolArray

    @classmethod
    def of(cls, lines: FloatArray, shape: tuple[int, int], first: tuple[int, int] = (0, 0)) -> Folds:
        """Folds along segments, each at the nodes nearest to where a segment crosses their row and column.

        A surface that is bilinear between nodes can break at nodes only: held to the height of a breakline within a
        cell, with the slopes of both sides up to it, it would be drawn off on one of them.

        Parameters
        ----------
        lines : array (S, 2, 2)
            Segments in node coordinates (col, row), none longer than half a step.
        shape : tuple of int
            Rows and columns of the patch.
        first : tuple of int
            Column and row of its first node.
        """
        ends = lines - np.asarray(first, dtype=np.float64)
        return cls(
            _crossings(ends, shape),
            _crossings(ends[..., ::-1], shape[::-1]).T,
            _marked(np.floor(ends.mean(axis=1)), shape),
        )


def _crossings(ends: FloatArray, shape: tuple[int, int]) -> BoolArray:
    """Nodes (rows, cols) nearest to where segments (S, 2, 2) cross their rows."""
    start, end = ends[:, 0], ends[:, 1]
    # A line of nodes between the two ends; an end upon it belongs to the segment that leads down from it.
    row = np.ceil(np.minimum(start[:, 1], end[:, 1]))
    hit = row < np.maximum(start[:, 1], end[:, 1])
    share = (row - start[:, 1])[hit] / (end[:, 1] - start[:, 1])[hit]
    col = start[hit, 0] + share * (end[hit, 0] - start[hit, 0])
    return _marked(np.column_stack([np.round(col), row[hit]]), shape)


def _marked(colrow: FloatArray, shape: tuple[int, int]) -> BoolArray:
    """Array (rows, cols) that is true at whole places (N, 2), as far as they lie in it."""
    out = np.zeros(shape, dtype=bool)
    inside = ((colrow >= 0) & (colrow < shape[::-1])).all(axis=1)
    col, row = colrow[inside].astype(np.int64).T
    out[row, col] = True
    return out


@lru_cache(maxsize=4)
def _bending(shape: tuple[int, int]) -> Any:
    """Derivatives of the second order of all nodes: h_xx, h_yy, and the root of two times h_xy of each cell."""
    from scipy.sparse import csr_array, diags_array, eye_array, kron, vstack

    down, across = shape

    def differences(count: int, stencil: list[float]) -> Any:
        size = (max(count - len(stencil) + 1, 0), count)
        return diags_array([np.float64(value) for value in stencil], offsets=range(len(stencil)), shape=size)

    second, first = [1.0, -2.0, 1.0], [-1.0, 1.0]
    h_xx = kron(eye_array(down), differences(across, second))
    h_yy = kron(differences(down, second), eye_array(across))
    h_xy = kron(differences(down, first), differences(across, first)) * np.sqrt(2.0)
    return csr_array(vstack([h_xx, h_yy, h_xy]))


def _bending_weights(folds: Folds) -> FloatArray:
    """Weights of the rows of `_bending`: little where the slope may break."""
    parts = folds.across[:, 1:-1], folds.down[1:-1], folds.cells[:-1, :-1]
    return np.where(np.concatenate([part.ravel() for part in parts]), FOLDED, 1.0)


def _interpolation(colrow: FloatArray, shape: tuple[int, int]) -> Any:
    """Bilinear interpolation (N, rows * cols) at node coordinates."""
    from scipy.sparse import csr_array

    low = np.clip(np.floor(colrow), 0, np.array([shape[1] - 2, shape[0] - 2])).astype(np.int64)
    share = colrow - low
    weights = np.stack([(1 - share[:, 0]) * (1 - share[:, 1]), share[:, 0] * (1 - share[:, 1]),
                        (1 - share[:, 0]) * share[:, 1], share[:, 0] * share[:, 1]], axis=1)  # fmt: skip
    corner = low[:, 1] * shape[1] + low[:, 0]
    nodes = corner[:, None] + np.array([0, 1, shape[1], shape[1] + 1])
    row = np.repeat(np.arange(len(colrow)), 4)
    return csr_array((weights.ravel(), (row, nodes.ravel())), shape=(len(colrow), shape[0] * shape[1]))
