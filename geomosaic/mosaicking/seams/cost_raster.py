"""What seams cost on the cells of a coarse grid: what images show there, what stands there, and what the user drew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.units import metres_per_unit
from geomosaic.mosaicking.colour.balance import cells_in, thumbnail
from geomosaic.mosaicking.colour.corrections import Correction, corrected
from geomosaic.mosaicking.records.provenance import between
from geomosaic.mosaicking.seams.cost_terms import (
    Features,
    SeamWeights,
    disagreement,
    features,
    nearness_of_edge,
    standing_out,
)
from geomosaic.raster.validity import burn
from geomosaic.raster.vector import layer_names
from geomosaic.render.areas import AREAS, LINES, note_elsewhere, read_shapes
from geomosaic.render.options import RenderOptions
from geomosaic.render.photo import Photo
from geomosaic.render.photos import Photos
from geomosaic.render.workers import in_order
from geomosaic.sensor.map_to_image import Ground
from geomosaic.types import AnyArray, BoolArray, Float32Array, FloatArray, IntArray

NODES = 17
"""View angles change slowly: so many along each side of a footprint, and straight lines between."""
FULL_ANGLE = 45.0
"""Degrees that count in full."""


@dataclass(frozen=True)
class SeamCost:
    """Of the cells of a grid: of a seam there (rows, cols), and of its being shown by each candidate (ranks, …)."""

    seam: Float32Array
    own: Float32Array


def seam_cost(
    photos: Photos,
    grid: Grid,
    candidates: IntArray,
    colours: Sequence[Correction],
    weights: SeamWeights,
    layers: SeamLayers,
    options: RenderOptions,
) -> SeamCost:
    """Compare the candidates (ranks, rows, cols) of all cells, and add what does not depend on images.

    Images come in the order of their northern edges, and each is kept only until its last neighbour has come.
    """
    windows = [grid.window_of(outline.bounds) for outline in photos.outlines]
    seam, own = np.zeros(grid.shape, dtype=np.float32), np.zeros(candidates.shape, dtype=np.float32)
    waiting = _pairs(candidates)
    order = sorted(waiting, key=lambda i: (windows[i].row, i))
    here: dict[int, Features] = {}
    cells = cells_in([windows[i] for i in order])

    def look(i: int) -> tuple[Features, FloatArray]:
        return _seen(photos, i, grid, windows[i], cells, colours[i], weights)

    seen = in_order(look, order, options.threads, ahead=1)
    for done, (i, (found, price)) in enumerate(seen):
        here[i] = found
        own[:, *_slices(windows[i])] += np.where(candidates[:, *_slices(windows[i])] == i, price, 0)
        for j in sorted(waiting[i] & here.keys()):
            _compare(i, j, here, windows, candidates, weights, seam)
            waiting[i].discard(j)
            waiting[j].discard(i)
            if not waiting[j]:
                del here[j]
        if not waiting[i]:
            del here[i]
        options.report(done + 1, len(photos), "seams")
    return SeamCost(_whole(seam, photos, grid, weights, layers), own)


def _pairs(candidates: IntArray) -> dict[int, set[int]]:
    """Images that share cells, by image."""
    pairs: dict[int, set[int]] = {}
    ranks = len(candidates)
    most = int(candidates.max(initial=0)) + 1
    for one in range(ranks):
        for two in range(one + 1, ranks):
            both = (candidates[one] >= 0) & (candidates[two] >= 0)
            keys = np.unique(candidates[one][both].astype(np.int64) * most + candidates[two][both])
            for key in keys.tolist():
                i, j = divmod(key, most)
                pairs.setdefault(i, set()).add(j)
                pairs.setdefault(j, set()).add(i)
    return pairs


def _slices(window: Window) -> tuple[slice, slice]:
    return slice(window.row, window.stop_row), slice(window.col, window.stop_col)


def _seen(
    photos: Photos, index: int, grid: Grid, window: Window, cells: int, colour: Correction, weights: SeamWeights
) -> tuple[Features, FloatArray]:
    """What an image shows of its window, and what it costs to show it."""
    with photos.using(index) as photo:
        piece = thumbnail(photo, photos.block.surface, grid, window, "average", "float32", cells)
        angle = _angles(photo, photos, grid, window) if weights.angle else np.zeros(piece.valid.shape)
    valid = piece.valid > 0
    values = corrected(colour, piece.values, window, grid, photos.grid)
    price = weights.angle * np.minimum(angle / FULL_ANGLE, 1) + weights.edge * nearness_of_edge(valid)
    return features(values, valid), price


def _angles(photo: Photo, photos: Photos, grid: Grid, window: Window) -> FloatArray:
    """View angles (rows, cols) in degrees; 90 where the model sees nothing."""
    return np.nan_to_num(between(photo, photos, grid, window, NODES)[..., 0], nan=90.0)


def _compare(
    i: int,
    j: int,
    here: dict[int, Features],
    windows: Sequence[Window],
    candidates: IntArray,
    weights: SeamWeights,
    seam: Float32Array,
) -> None:
    """Note how differently two images show the cells that both may show."""
    common = windows[i].intersection(windows[j])
    if common.empty:
        return
    near = candidates[:, *_slices(common)]
    both: BoolArray = (near == i).any(axis=0) & (near == j).any(axis=0)
    one, other = (_cropped(here[k], windows[k], common) for k in (i, j))
    part = seam[_slices(common)]
    part[both] = np.maximum(part, disagreement(one, other, weights))[both]


def _cropped(found: Features, window: Window, part: Window) -> Features:
    own = part.slices_in(window)
    return Features(found.values[own], found.valid[own], found.slope[own], found.texture[own], found.contrast)


def _whole(seam: Float32Array, photos: Photos, grid: Grid, weights: SeamWeights, layers: SeamLayers) -> Float32Array:
    """Add to what images show what stands on the ground, and what is to be followed or kept out of."""
    from scipy.ndimage import maximum_filter

    total: AnyArray = maximum_filter(seam, 3) + np.float32(weights.length)
    if weights.heights:
        metres = float(metres_per_unit(grid.crs, np.array(grid.xy(np.array([[0.0, 0.0]]))[0]))[1]) * grid.resolution[1]
        total = total + np.float32(weights.heights) * standing_out(heights_of(photos, grid), metres)
    cell = grid.resolution[0]
    if layers.follow:
        along = burn([(shape.buffer(cell), 1) for shape in layers.follow], grid) == 1
        total[along] *= np.float32(weights.follow)
    if layers.avoid:
        total[burn([(shape.buffer(cell), 1) for shape in layers.avoid], grid) == 1] += np.float32(weights.avoid)
    return np.asarray(total, dtype=np.float32)


def heights_of(photos: Photos, grid: Grid) -> Float32Array:
    """Heights (rows, cols) at the cells of a grid, NaN where unknown or where heights play no part."""
    from scipy.ndimage import map_coordinates

    found = np.full(grid.shape, np.nan, dtype=np.float32)
    below = Ground.under(grid, photos.block.surface)
    if below.to_surface is None:
        return found
    for part in grid.window.split(512, 512):
        ground = below.block(part)
        if ground.patch is None or ground.unknown:
            continue
        c, r = np.meshgrid(np.arange(part.col, part.stop_col) + 0.5, np.arange(part.row, part.stop_row) + 0.5)
        xy: Any = below.to_surface(grid.xy(np.column_stack([c.ravel(), r.ravel()])))
        t = ground.patch.transform
        col, row = t.a * xy[:, 0] + t.b * xy[:, 1] + t.c - 0.5, t.d * xy[:, 0] + t.e * xy[:, 1] + t.f - 0.5
        z = map_coordinates(ground.patch.heights, [row, col], order=1, mode="constant", cval=np.nan)
        found[_slices(part)] = z.reshape(part.height, part.width)
    return found


@dataclass(frozen=True)
class SeamLayers:
    """Geometries in the output map.

    Attributes
    ----------
    follow : sequence of geometry
        Roads and rivers, as lines or areas.
    avoid : sequence of Polygon or MultiPolygon
        Buildings, and whatever else is not to be cut.
    """

    follow: Sequence[Any] = ()
    avoid: Sequence[Any] = ()


def read_seam_layers(follow: Sequence[Path], avoid: Sequence[Path], grid: Grid) -> SeamLayers:
    """Read all layers of all files, in the map of a grid.

    Raises
    ------
    InputError
        A layer without CRS, points, lines to keep out of, an area that crosses itself.
    """
    return SeamLayers(_read(follow, grid, (*LINES, *AREAS)), _read(avoid, grid, AREAS))


def _read(paths: Sequence[Path], grid: Grid, kinds: tuple[str, ...]) -> list[Any]:
    found: list[Any] = []
    for path in paths:
        own = [shape for layer in layer_names(path) for shape in read_shapes(path, layer, grid.crs, kinds)]
        note_elsewhere(path, own, grid)
        found += own
    return found
