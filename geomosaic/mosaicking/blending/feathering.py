"""Feathering by exact distances: over overlaps, along the edges of images laid on each other, along cut lines.

Edge and cut-line feathering are those of Jensen (2004): at the edge of the upper image, or on one side of the buffer
around a line, none of an image is taken, at the given distance all of it, halfway half; the rest is the other image's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.mosaicking.blending.weights import interpolated
from geomosaic.types import AnyArray, FloatArray, IntArray

# Pixels between nodes of distances, which are linear but near corners and midlines; window sizes are multiples.
_NODES = 32
# Nodes across a ramp whose line may bend anywhere.
_NODES_OF_A_RAMP = 16
# Pixels by which distances to one line differ by rounding alone.
_SAME = 1e-6


def edge_distance(outline: Any, grid: Grid, window: Window, width: float, edge: Any = None) -> FloatArray:
    """Signed distance of pixel centres to an edge, exact for straight ones.

    Parameters
    ----------
    outline : Polygon or MultiPolygon
        In the output map.
    grid : Grid
        Of the output.
    window : Window
        Pixels; width and height are multiples of 32.
    width : float
        Distance in pixels up to which bends of the edge matter; infinite where they need not.
    edge : geometry, optional
        Part of the outline's boundary that counts; all of it unless given.

    Returns
    -------
    array (rows, cols)
        Pixels, positive on the outline's side of the edge; infinite where there is no edge.
    """
    shape = window.height, window.width
    if outline.is_empty or (edge is not None and edge.is_empty):
        return np.full(shape, -math.inf if outline.is_empty else math.inf)
    edges = _Edges(outline, outline.boundary, edge)
    step, coarse = _NODES, _at_nodes(edges, grid, window, _NODES)
    if math.isfinite(width):
        while step > 1 and step * _NODES_OF_A_RAMP > width:
            step //= 2
    if step == _NODES:
        return _between_nodes(coarse, _NODES, shape)
    # Bends are followed where the ramp is; beyond it only the side matters.
    at = [np.arange(0, size + 1, step) / _NODES for size in shape]
    nodes = _linear(coarse, at)
    near = np.abs(nodes) < width + _NODES
    if near.any():
        nodes[near] = _at_nodes(edges.within(grid, window, width + 2 * _NODES), grid, window, step, near)
    return _between_nodes(nodes, step, shape)


@dataclass(frozen=True)
class _Edges:
    """Outline, its boundary, and the part of it that counts, if not all does."""

    outline: Any
    boundary: Any
    part: Any

    def within(self, grid: Grid, window: Window, margin: float) -> _Edges:
        """The same with the lines near a window alone: those of seams by graph cut have thousands of vertices."""
        import shapely

        by = math.ceil(margin)
        wide = window.grown(by)
        box = grid.crop(wide).bounds
        part = None if self.part is None else shapely.clip_by_rect(self.part, *box)
        return _Edges(self.outline, shapely.clip_by_rect(self.boundary, *box), part)


def _at_nodes(edges: _Edges, grid: Grid, window: Window, step: int, chosen: AnyArray | None = None) -> FloatArray:
    """Signed distance in pixels at corners of pixels every `step` pixels; of the chosen ones, else of all."""
    import shapely

    cols, rows = window.width // step + 1, window.height // step + 1
    c, r = np.meshgrid(window.col + step * np.arange(cols), window.row + step * np.arange(rows))
    if chosen is not None:
        c, r = c[chosen], r[chosen]
    points = shapely.points(grid.xy(np.column_stack([c.ravel(), r.ravel()]).astype(np.float64)))
    pixel = math.sqrt(grid.resolution[0] * grid.resolution[1])
    shapely.prepare([one for one in (edges.outline, edges.boundary, edges.part) if one is not None])
    distance = to_rim = shapely.distance(edges.boundary, points)
    if edges.part is not None:
        distance = shapely.distance(edges.part, points)
    # Beyond the part of the boundary that does not count, such as the block's own edge, nothing ends.
    outside = ~shapely.contains(edges.outline, points) & (distance <= to_rim + _SAME * pixel)
    signed: FloatArray = np.where(outside, -distance, distance) / pixel
    return signed.reshape(c.shape)


def _between_nodes(nodes: FloatArray, step: int, shape: tuple[int, int]) -> FloatArray:
    """Values at pixel centres, linear between nodes."""
    return _linear(nodes, [(np.arange(size) + 0.5) / step for size in shape])


def _linear(nodes: FloatArray, at: Sequence[AnyArray]) -> FloatArray:
    """Values at rows and columns, counted in nodes; the last node is one of them."""
    padded = np.pad(nodes, ((0, 1), (0, 1)), mode="edge")
    values: FloatArray = interpolated(interpolated(padded, at[0], 0), at[1], 1)
    return values


def edge_weights(depths: Sequence[FloatArray], valid: Sequence[AnyArray], order: Sequence[int]) -> list[FloatArray]:
    """Weights of images that lie on each other: none at an image's edge, all at a distance of 1 inside it.

    Parameters
    ----------
    depths : sequence of array (rows, cols)
        Distance inside the edge of each image, in widths of the ramp; negative outside.
    valid : sequence of bool array (rows, cols)
        Pixels that the images show.
    order : sequence of int
        Positions of the images, the uppermost first.

    Returns
    -------
    list of array (rows, cols)
        0 to 1. Each image takes of what those above it leave as much as its own edge allows: two of them make exactly
        the ramp of the upper one unless they share less than its width, and no edge is ever seen as a step.
    """
    weights = [np.zeros(depth.shape) for depth in depths]
    rest = np.ones(depths[0].shape) if depths else np.zeros(())
    for k in order:
        weights[k] = np.minimum(rest, np.clip(depths[k], 0.0, 1.0)) * valid[k]
        rest = rest - weights[k]
    return weights


def cutline_weights(sides: Sequence[FloatArray], depths: Sequence[FloatArray]) -> list[FloatArray]:
    """Weights of images along the lines between them: half on the line, none and all at half a width from it.

    Parameters
    ----------
    sides : sequence of array (rows, cols)
        Distance inside the seam polygon of each image, in widths of the ramp; negative outside.
    depths : sequence of array (rows, cols)
        The same inside the edge of each image.

    Returns
    -------
    list of array (rows, cols)
        0 to 1. A ramp that fits into what two images share is exactly linear; another ends at the images' edges.
    """
    return [np.clip(np.minimum(0.5 + side, depth), 0.0, 1.0) for side, depth in zip(sides, depths, strict=True)]


def normalised(raw: Sequence[AnyArray], local: IntArray) -> list[AnyArray]:
    """Weights divided by their sum; where that is nothing, all of the pixel's own image.

    Parameters
    ----------
    raw : sequence of array (rows, cols)
    local : int array (rows, cols)
        Position of the own image.

    Returns
    -------
    list of float32 array (rows, cols)
    """
    total = np.sum(raw, axis=0, dtype=np.float64)
    return [
        np.where(total > 0, weight / np.where(total > 0, total, 1), local == position).astype(np.float32)
        for position, weight in enumerate(raw)
    ]
