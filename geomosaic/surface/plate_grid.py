"""Thin plate over a grid of any size: patches one after the other, each on what those before it left.

A patch is solved with a margin of data beyond it, to the right and below; what lies above and to the left is solved
already, and its outermost two rows and columns are held: the surface and its slope go on without a seam, and no height
is averaged. What a patch cannot see, where data are far apart, comes from the same problem on a grid four times as
wide, which is solved first in the same way.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.surface.thin_plate import Folds, Heights, solve_plate
from geomosaic.types import FloatArray, IntArray

# Nodes of a patch along each side, of the margin beyond it, and of the grid that is solved in one piece.
PATCH, MARGIN, WHOLE = 256, 48, 352
# Times as wide as a grid the one above it is.
COARSER = 4
# Nodes that are held of what is solved already: with two the slope goes on.
HELD = 2
# Weight that draws the far border of a margin to the coarser grid: less than data, more than none.
BORDER_PULL = 0.1


@dataclass(frozen=True, eq=False)
class PlateData:
    """What the thin plate goes through, on a grid whose first node is (0, 0).

    Attributes
    ----------
    observed : Heights
        Heights that are met as well as their weights ask for.
    spots : Heights
        Those that are to be judged by leaving them out; `observed` has none of them.
    folds : array (S, 2, 2)
        Segments, at most half a step long, across which the slope may break; (col, row).
    held : callable or None
        Heights (rows, cols) of nodes that are given, from (col, row) of the first and the shape; NaN elsewhere.
    """

    observed: Heights
    spots: Heights
    folds: FloatArray
    held: HeldNodes | None = None

    def coarser(self) -> PlateData:
        """The same on the next wider grid: one mean observation in each cell."""
        both = Heights(
            np.vstack([self.observed.colrow, self.spots.colrow]),
            np.concatenate([self.observed.height, self.spots.height]),
            np.concatenate([self.observed.weight, self.spots.weight]),
        )
        nothing = Heights(np.empty((0, 2)), np.empty(0), np.empty(0))
        folds = self.folds / COARSER
        held = None if self.held is None else replace(self.held, step=self.held.step * COARSER)
        return PlateData(_mean_of_cells(replace(both, colrow=both.colrow / COARSER)), nothing, folds, held)


@dataclass(frozen=True, eq=False)
class HeldNodes:
    """Nodes that lie in areas of one level.

    Attributes
    ----------
    areas : sequence of (shapely geometry, float)
        In node coordinates (col, row) of the finest grid, with their levels.
    step : int
        Distance of the nodes in it.
    """

    areas: tuple[tuple[object, float], ...]
    step: int = 1

    def of(self, first: tuple[int, int], shape: tuple[int, int]) -> FloatArray:
        """Heights (rows, cols) of a patch; NaN of nodes in no area."""
        import shapely

        col, row = (np.arange(n) + start for n, start in zip(shape[::-1], first, strict=True))
        x, y = np.meshgrid(col * float(self.step), row * float(self.step))
        out = np.full(shape, np.nan)
        frame = shapely.box(x[0, 0], y[0, 0], x[-1, -1], y[-1, -1])
        for area, level in self.areas:
            if shapely.intersects(frame, area):
                out[shapely.intersects_xy(area, x, y)] = level
        return out


@dataclass(frozen=True, eq=False)
class Band:
    """Rows of a solved grid.

    Attributes
    ----------
    row : int
        The first of them.
    heights : array (rows, cols)
    left_out : array (N,)
        Height minus prediction without it of each spot height that begins in these rows; NaN of others.
    """

    row: int
    heights: FloatArray
    left_out: FloatArray


def solve_grid(data: PlateData, shape: tuple[int, int]) -> Iterator[Band]:
    """Thin plate on a grid, from the top down.

    Parameters
    ----------
    data : PlateData
    shape : tuple of int
        Rows and columns, two at least.

    Yields
    ------
    Band
        Of up to some hundred rows. Memory holds one of them, and a grid of a sixteenth of the nodes.
    """
    above = None
    if max(shape) > WHOLE:
        rows, cols = (-(-(n - 1) // COARSER) + 1 for n in shape)
        above = np.vstack([band.heights for band in solve_grid(data.coarser(), (max(rows, 2), max(cols, 2)))])
    far = _far_field(data) if above is None else 0.0
    everything = Heights(
        np.vstack([data.observed.colrow, data.spots.colrow]),
        np.concatenate([data.observed.height, data.spots.height]),
        np.concatenate([data.observed.weight, data.spots.weight]),
    )
    order = np.argsort(everything.colrow[:, 1], kind="stable")
    by_row = everything.part(order)
    fold_order = np.argsort(data.folds[:, 0, 1], kind="stable")
    folds = data.folds[fold_order]
    row_edges, col_edges = _edges(shape[0]), _edges(shape[1])
    before = np.empty((0, shape[1]))
    for top, bottom in itertools.pairwise(row_edges):
        kept = len(before)
        last = shape[0] if bottom == shape[0] else min(bottom + MARGIN, shape[0])
        band = np.full((kept + last - top, shape[1]), np.nan)
        band[:kept] = before
        left_out = np.full(len(data.spots.height), np.nan)
        near = _rows(by_row.colrow[:, 1], top - kept, last - 1)
        cut = _rows(folds[:, 0, 1], top - kept - 1, last)
        strip, strip_folds = by_row.part(near), folds[cut]
        for left, right in itertools.pairwise(col_edges):
            first = max(left - HELD, 0), top - kept
            end = shape[1] if right == shape[1] else min(right + MARGIN, shape[1])
            held = band[:, first[0] : end].copy()
            held[kept + bottom - top :] = np.nan
            size = held.shape
            if data.held is not None:
                given = data.held.of(first, size)
                held = np.where(np.isnan(held), given, held)
            drawn, pull = _background(above, far, first, size, (end < shape[1], last < shape[0]))
            inside = strip.part(strip.within(first, size))
            local = replace(inside, colrow=inside.colrow - first)
            plate = solve_plate(local, Folds.of(strip_folds, size, first), held, drawn, pull)
            start = left - first[0]
            core = slice(kept, kept + bottom - top)
            band[core, left:right] = plate.heights[core, start : start + right - left]
            own = _own_spots(data.spots, (left, top), (right, bottom), (end, last))
            if len(own):
                spots = data.spots.part(own)
                left_out[own] = plate.left_out(replace(spots, colrow=spots.colrow - first))
        solved = band[kept : kept + bottom - top]
        before = solved[-HELD:].copy()
        yield Band(top, solved, left_out)


def _edges(count: int) -> list[int]:
    """Borders of patches of about the same size."""
    pieces = 1 if count <= WHOLE else max(1, round(count / PATCH))
    return [round(k * count / pieces) for k in range(pieces + 1)]


def _rows(sorted_rows: FloatArray, low: float, high: float) -> slice:
    """Those of sorted values that lie between two."""
    return slice(int(np.searchsorted(sorted_rows, low, "left")), int(np.searchsorted(sorted_rows, high, "right")))


def _own_spots(spots: Heights, low: tuple[int, int], high: tuple[int, int], end: tuple[int, int]) -> IntArray:
    """Spot heights that a patch judges: those of its own cells, as far as it sees them whole."""
    cell = np.floor(spots.colrow)
    own = np.asarray((cell >= low) & (cell < high) & (spots.colrow <= np.array(end) - 1)).all(axis=1)
    return np.flatnonzero(own)


def _background(
    above: FloatArray | None, far: float, first: tuple[int, int], size: tuple[int, int], open_: tuple[bool, bool]
) -> tuple[FloatArray, FloatArray]:
    """What nodes are drawn to, and how much: the far border of a margin (right, below) to the coarser grid."""
    pull = np.zeros(size)
    if above is None:
        return np.full(size, far), pull
    from scipy.ndimage import map_coordinates

    row, col = ((np.arange(n) + start) / COARSER for n, start in zip(size, first[::-1], strict=True))
    places = np.stack(np.meshgrid(row, col, indexing="ij"))
    drawn = map_coordinates(above, places, order=1, mode="nearest")
    if open_[0]:
        pull[:, -HELD:] = BORDER_PULL
    if open_[1]:
        pull[-HELD:] = BORDER_PULL
    return drawn, pull


def _far_field(data: PlateData) -> float:
    """Mean height, which nodes are drawn to that nothing else determines."""
    heights = np.concatenate([data.observed.height, data.spots.height])
    return float(heights.mean()) if len(heights) else 0.0


def _mean_of_cells(all_: Heights) -> Heights:
    """Weighted mean place and height of the observations in each cell of one step."""
    cell = np.floor(all_.colrow).astype(np.int64)
    _, group = np.unique(cell, axis=0, return_inverse=True)
    group = group.ravel()
    weight = np.bincount(group, all_.weight)
    means = [np.bincount(group, all_.weight * value) / weight for value in (*all_.colrow.T, all_.height)]
    return Heights(np.column_stack(means[:2]), means[2], np.asarray(weight, dtype=np.float64))
