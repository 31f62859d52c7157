"""Symmetric matrices within an envelope: where their tiles lie, Cholesky factor, solution, inverse in the envelope.

The envelope of a matrix is what lies, row by row, between its first number that is not zero and the diagonal; a
Cholesky factor stays within it, and so does the part of the inverse that Takahashi's recursion gives (Takahashi, Fagan
and Chin 1973): all cofactors of unknowns that share an observation. Tiles make both of them products of small dense
matrices; each number is a sum in one order, so that threads and vector instructions do not change a byte.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from geomosaic.kernels.library import native
from geomosaic.kernels.threads import bounds, sharing
from geomosaic.types import FloatArray, IntArray

# The same as in kernels/envelope.hpp.
TILE = 32
# Tiles below which threads cost more than they save.
WORTH_THREADS = 500

_factor_column = native("factor_column", "lldiii")
_solve_factored = native("solve_factored", "lldd")
_prepare_column = native("prepare_column", "lldlid")
_invert_column = native("invert_column", "lldlidii")
_invert_diagonal = native("invert_diagonal", "llddlid")


@dataclass(frozen=True, eq=False)
class Envelope:
    """Places of the tiles of symmetric matrices of M rows.

    Attributes
    ----------
    size : int
        M.
    first : int array (T,)
        First column of tiles of each row of tiles.
    """

    size: int
    first: IntArray

    @classmethod
    def of(cls, lowest: IntArray) -> Envelope:
        """Envelope of matrices whose rows (M,) begin at the column `lowest`, each at most its own number."""
        edges = np.arange(0, len(lowest), TILE)
        return cls(len(lowest), np.minimum.reduceat(lowest, edges) // TILE if len(edges) else np.zeros(0, np.int64))

    @cached_property
    def offset(self) -> IntArray:
        """Number (T + 1,) of the first tile of each row of tiles; the last is that of all."""
        rows = np.arange(len(self.first))
        return np.concatenate([[0], np.cumsum(rows - self.first + 1)])

    @property
    def products(self) -> float:
        """Products of tiles in a factorisation, about."""
        return float((np.diff(self.offset).astype(np.float64) ** 2).sum() / 2.0)

    @cached_property
    def diagonal(self) -> IntArray:
        """Place (M,) of each diagonal number among all."""
        row = np.arange(self.size)
        return (self.offset[row // TILE + 1] - 1) * TILE**2 + row % TILE * (TILE + 1)

    def zeros(self) -> FloatArray:
        """Tiles (K, TILE, TILE) of a matrix of zeros, padded with a unit diagonal."""
        tiles = np.zeros((int(self.offset[-1]), TILE, TILE))
        for row in range(self.size % TILE, TILE if self.size % TILE else 0):
            tiles[-1, row, row] = 1.0
        return tiles

    def factor(self, tiles: FloatArray) -> int:
        """Cholesky factor of a matrix, in its place; returns the row whose pivot is not positive, or -1."""
        count = len(self.first)
        with sharing(len(tiles) > WORTH_THREADS) as shared:
            for column in range(count):
                wrong = _factor_column(self.first, self.offset, tiles, column, column, column + 1)
                if wrong >= 0:
                    return wrong
                end = int(self.below[column][-1]) + 1 if len(self.below[column]) else column + 1
                part = partial(_factor_column, self.first, self.offset, tiles, column)
                shared(part, bounds(column + 1, end))
        return -1

    def solve(self, factor: FloatArray, right: FloatArray) -> FloatArray:
        """Solutions (N, M) of right-hand sides (N, M)."""
        padded = np.zeros((len(right), len(self.first) * TILE))
        padded[:, : self.size] = right
        _solve_factored(self.first, self.offset, factor, padded)
        return padded[:, : self.size]

    def inverse(self, factor: FloatArray) -> FloatArray:
        """Tiles of the inverse within the envelope."""
        found = np.empty_like(factor)
        with sharing(len(factor) > WORTH_THREADS) as shared:
            for column in reversed(range(len(self.first))):
                below = self.below[column]
                scaled = np.empty((len(below), TILE, TILE))
                _prepare_column(self.first, self.offset, factor, below, column, scaled)
                part = partial(_invert_column, self.first, self.offset, found, below, column, scaled)
                shared(part, bounds(0, len(below)))
                _invert_diagonal(self.first, self.offset, factor, found, below, column, scaled)
        return found

    def block(self, tiles: FloatArray, rows: IntArray, cols: IntArray) -> FloatArray | None:
        """Numbers (P, Q) of a symmetric matrix; None where they are not all in the envelope.

        Parameters
        ----------
        tiles : array (tiles, TILE, TILE)
            Symmetric matrix within the envelope.
        rows : int array (P,)
        cols : int array (Q,)
        """
        row, col = np.maximum.outer(rows, cols), np.minimum.outer(rows, cols)
        within = col // TILE - self.first[row // TILE]
        if (within < 0).any():
            return None
        found: FloatArray = tiles[self.offset[row // TILE] + within, col % TILE, row % TILE]
        return found

    @cached_property
    def below(self) -> list[IntArray]:
        """Rows of tiles under the diagonal that have each column."""
        rows = np.arange(len(self.first))
        return [rows[(rows > column) & (self.first <= column)] for column in rows]
