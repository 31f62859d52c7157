"""Gather what overlapping images show of the same ground, and solve their colour balance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.product.options import RenderOptions
from geomosaic.product.photo import pull
from geomosaic.product.photos import Photos
from geomosaic.product.pool import in_order
from geomosaic.radiometry.gain_offset import Balance, Overlap, solve
from geomosaic.resample.warp import Colour, engine_for, value_range
from geomosaic.sensor.ground import Ground
from geomosaic.sensor.lattice import BLOCK_HEIGHT, BLOCK_WIDTH
from geomosaic.types import AnyArray, ByteArray

CELLS = 96
"""Cells across a footprint at which images are compared: coarse, so that small misfits of geometry do not count."""
LEAST_CELLS = 25
"""An overlap of fewer cells says nothing."""
NEAR_ENOUGH = 0.1
"""Cells that the geometry may be off where only colours are compared."""
MOST_SAMPLES = 3
"""Samples along each side of a cell; the image is reduced on reading until they cover it."""


@dataclass(frozen=True)
class Thumbnail:
    """One image on the coarse grid.

    Attributes
    ----------
    window : Window
        Of the coarse grid.
    values : float32 array (rows, cols, bands)
    valid : uint8 array (rows, cols)
    """

    window: Window
    values: AnyArray
    valid: ByteArray


def balance(photos: Photos, options: RenderOptions) -> Balance:
    """Solve gain and offset of all photos over their overlaps."""
    grid = comparison_grid(photos)
    bands = photos.info.bands
    pieces: list[Thumbnail] = []
    indices = range(len(photos))
    rendered = in_order(lambda i: _thumbnail(photos, i, grid, options), indices, options.threads, ahead=1)
    for done, (_, piece) in enumerate(rendered):
        pieces.append(piece)
        options.report(done + 1, len(photos), "balance")
    low, high, whole = value_range(photos.info.dtype)
    return solve(len(photos), bands, overlaps(pieces, (low, high) if whole else None))


def comparison_grid(photos: Photos) -> Grid:
    """Output grid coarsened until a footprint is about `CELLS` across."""
    areas = [np.prod(np.ptp(outline.ring, axis=0)) for outline in photos.outlines]
    cell = np.sqrt(float(np.median(areas))) / CELLS
    return photos.grid.coarser(max(1, round(cell / photos.grid.resolution[0])))


def _thumbnail(photos: Photos, index: int, grid: Grid, options: RenderOptions) -> Thumbnail:
    bands = photos.info.bands
    window = grid.window_of(photos.outlines[index].bounds)
    values = np.zeros((max(window.height, 0), max(window.width, 0), bands), dtype=np.float32)
    valid = np.zeros(values.shape[:2], dtype=np.uint8)
    if window.empty:
        return Thumbnail(window, values, valid)
    engine, colour = engine_for(4 * valid.size), Colour.identity(bands)
    below = Ground.under(grid, photos.block.surface)
    # The window itself is cut into blocks, not the grid: only the heights below the photo are read.
    for part in window.split(BLOCK_WIDTH, BLOCK_HEIGHT):
        ground = below.block(part)
        rows, cols = part.row - window.row, part.col - window.col
        here = slice(rows, rows + part.height), slice(cols, cols + part.width)
        with photos.using(index) as photo:
            pull(
                engine, photo, grid, ground, "average", NEAR_ENOUGH, colour, values[here], valid[here],
                most_samples=MOST_SAMPLES,
            )  # fmt: skip
    return Thumbnail(window, values, valid)


def overlaps(pieces: list[Thumbnail], clipped: tuple[float, float] | None = None) -> list[Overlap]:
    """Pairs of images with the values both have; values at the ends of the range (`clipped`) are left out."""
    found = []
    order = sorted(range(len(pieces)), key=lambda i: pieces[i].window.row)
    active: list[int] = []
    for j in order:
        active = [i for i in active if pieces[i].window.stop_row > pieces[j].window.row]
        for i in sorted(active):
            pair = _overlap(min(i, j), max(i, j), pieces, clipped)
            if pair is not None:
                found.append(pair)
        active.append(j)
    return sorted(found, key=lambda pair: (pair.first, pair.second))


def _overlap(i: int, j: int, pieces: list[Thumbnail], clipped: tuple[float, float] | None) -> Overlap | None:
    common = pieces[i].window.intersection(pieces[j].window)
    if common.empty:
        return None
    views = []
    for piece in (pieces[i], pieces[j]):
        rows = slice(common.row - piece.window.row, common.stop_row - piece.window.row)
        cols = slice(common.col - piece.window.col, common.stop_col - piece.window.col)
        views.append((piece.values[rows, cols], piece.valid[rows, cols] > 0))
    (a, seen_a), (b, seen_b) = views
    both = seen_a & seen_b
    if clipped is not None:
        for values in (a, b):
            both &= (values > clipped[0] + 0.5).all(axis=2) & (values < clipped[1] - 0.5).all(axis=2)
    if np.count_nonzero(both) < LEAST_CELLS:
        return None
    return Overlap(i, j, a[both], b[both])
