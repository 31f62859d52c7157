"""Cost rasters of the seams on a coarse grid: image differences, raised objects, lines to follow, areas to avoid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.units import metres_per_unit
from geomosaic.mosaicking.colour.balance import cell_count, thumbnail
from geomosaic.mosaicking.colour.corrections import Correction, corrected
from geomosaic.mosaicking.provenance import view_raster
from geomosaic.mosaicking.seams.cost_terms import (
    Features,
    edge_proximity,
    features,
    image_difference,
    raised_objects,
)
from geomosaic.options.mosaic import SeamWeights
from geomosaic.options.render import RenderOptions
from geomosaic.raster.validity import rasterized
from geomosaic.raster.vector import layer_names
from geomosaic.render.areas import AREAS, LINES, note_elsewhere, read_shapes
from geomosaic.render.photo import Photo
from geomosaic.render.photos import Photos
from geomosaic.render.workers import in_order
from geomosaic.sensor.map_to_image import Ground
from geomosaic.types import AnyArray, BoolArray, Float32Array, FloatArray, IntArray

# Nodes along each side of a footprint between which view angles, which change slowly, are interpolated.
NODES = 17
# View angle in degrees of a full angle term.
REFERENCE_ANGLE = 45.0


@dataclass(frozen=True)
class SeamCost:
    """Cost of the cells of a grid, split as in graph cuts into a pairwise and a unary part.

    Attributes
    ----------
    pairwise : float32 array (rows, cols)
        Of a seam through the cell.
    unary : float32 array (ranks, rows, cols)
        Of each candidate image showing the cell.
    """

    pairwise: Float32Array
    unary: Float32Array


def seam_cost(
    photos: Photos,
    grid: Grid,
    candidates: IntArray,
    colours: Sequence[Correction],
    weights: SeamWeights,
    layers: SeamLayers,
    options: RenderOptions,
) -> SeamCost:
    """Cost of seams through all cells, and of the candidate images that may show them.

    Parameters
    ----------
    photos : Photos
    grid : Grid
        Coarse grid of the cells.
    candidates : int array (ranks, rows, cols)
        Images that may show each cell, -1 where there are no more; see `voronoi.nearest_images`.
    colours : sequence of Correction
        Of all images: they are compared as they will be seen.
    weights : SeamWeights
    layers : SeamLayers
    options : RenderOptions
        Threads and progress.

    Returns
    -------
    SeamCost
    """
    windows = [grid.window_of(outline.bounds) for outline in photos.outlines]
    pairwise, unary = np.zeros(grid.shape, dtype=np.float32), np.zeros(candidates.shape, dtype=np.float32)
    # From north to south, each image held only until its last neighbour has come: memory is that of a strip.
    neighbours = _overlapping_images(candidates)
    order = sorted(neighbours, key=lambda i: (windows[i].row, i))
    held: dict[int, Features] = {}
    cells = cell_count([windows[i] for i in order])

    def terms(i: int) -> tuple[Features, FloatArray]:
        return _image_terms(photos, i, grid, windows[i], cells, colours[i], weights)

    for done, (i, (found, cost)) in enumerate(in_order(terms, order, options.threads, ahead=1)):
        held[i] = found
        unary[:, *_slices(windows[i])] += np.where(candidates[:, *_slices(windows[i])] == i, cost, 0)
        for j in sorted(neighbours[i] & held.keys()):
            _add_difference(i, j, held, windows, candidates, weights, pairwise)
            neighbours[i].discard(j)
            neighbours[j].discard(i)
            if not neighbours[j]:
                del held[j]
        if not neighbours[i]:
            del held[i]
        options.report(done + 1, len(photos), "seams")
    return SeamCost(_with_site_terms(pairwise, photos, grid, weights, layers), unary)


def _overlapping_images(candidates: IntArray) -> dict[int, set[int]]:
    """Images that are candidates of the same cells, by image."""
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


def _image_terms(
    photos: Photos, index: int, grid: Grid, window: Window, cells: int, colour: Correction, weights: SeamWeights
) -> tuple[Features, FloatArray]:
    """Features of an image on its window, and its unary cost (rows, cols) there."""
    with photos.using(index) as photo:
        piece = thumbnail(photo, photos.block.surface, grid, window, "average", "float32", cells)
        angle = _angles(photo, photos, grid, window) if weights.angle else np.zeros(piece.valid.shape)
    valid = piece.valid > 0
    values = corrected(colour, piece.values, window, grid, photos.grid)
    price = weights.angle * np.minimum(angle / REFERENCE_ANGLE, 1) + weights.edge * edge_proximity(valid)
    return features(values, valid), price


def _angles(photo: Photo, photos: Photos, grid: Grid, window: Window) -> FloatArray:
    """View angles (rows, cols) in degrees; 90 where the model cannot see the ground."""
    return np.nan_to_num(view_raster(photo, photos, grid, window, NODES)[..., 0], nan=90.0)


def _add_difference(
    i: int,
    j: int,
    held: dict[int, Features],
    windows: Sequence[Window],
    candidates: IntArray,
    weights: SeamWeights,
    seam: Float32Array,
) -> None:
    """Difference of two images, entered in place into the cost of the cells that both may show."""
    common = windows[i].intersection(windows[j])
    if common.empty:
        return
    ranked = candidates[:, *_slices(common)]
    shared: BoolArray = (ranked == i).any(axis=0) & (ranked == j).any(axis=0)
    one, other = (_cropped(held[k], windows[k], common) for k in (i, j))
    cost = seam[_slices(common)]
    # Where three images or more may show a cell it is not known yet which two meet there: the worst pair counts.
    cost[shared] = np.maximum(cost, image_difference(one, other, weights))[shared]


def _cropped(found: Features, window: Window, part: Window) -> Features:
    inside = part.slices_in(window)
    return Features(
        found.values[inside], found.valid[inside], found.slope[inside], found.texture[inside], found.contrast
    )


def _with_site_terms(
    seam: Float32Array, photos: Photos, grid: Grid, weights: SeamWeights, layers: SeamLayers
) -> Float32Array:
    """Pairwise cost with all terms that no image decides: length, raised objects, lines to follow, areas to avoid."""
    from scipy.ndimage import maximum_filter

    # The worst of the neighbourhood: a seam is resolved to a cell, and pixels next to the difference count too.
    total: AnyArray = maximum_filter(seam, 3) + np.float32(weights.length)
    if weights.heights:
        metres = float(metres_per_unit(grid.crs, np.array(grid.xy(np.array([[0.0, 0.0]]))[0]))[1]) * grid.resolution[1]
        total = total + np.float32(weights.heights) * raised_objects(cell_heights(photos, grid), metres)
    # Lines and areas are widened by a cell, so that none slips between cell centres.
    cell = grid.resolution[0]
    if layers.follow:
        along = rasterized([(shape.buffer(cell), 1) for shape in layers.follow], grid) == 1
        total[along] *= np.float32(weights.follow)
    if layers.avoid:
        total[rasterized([(shape.buffer(cell), 1) for shape in layers.avoid], grid) == 1] += np.float32(weights.avoid)
    return np.asarray(total, dtype=np.float32)


def cell_heights(photos: Photos, grid: Grid) -> Float32Array:
    """Heights of the surface at the cell centres of a grid.

    Parameters
    ----------
    photos : Photos
        Of a block with or without a surface.
    grid : Grid

    Returns
    -------
    float32 array (rows, cols)
        Metres, bilinear between the posts of the DEM; NaN where unknown, or where the block has no surface.
    """
    from scipy.ndimage import map_coordinates

    heights = np.full(grid.shape, np.nan, dtype=np.float32)
    ground = Ground.under(grid, photos.block.surface)
    if ground.to_surface is None:
        return heights
    for part in grid.window.split(512, 512):
        patch = ground.block(part)
        if patch.patch is None or patch.unknown:
            continue
        c, r = np.meshgrid(np.arange(part.col, part.stop_col) + 0.5, np.arange(part.row, part.stop_row) + 0.5)
        xy: Any = ground.to_surface(grid.xy(np.column_stack([c.ravel(), r.ravel()])))
        t = patch.patch.transform
        col, row = t.a * xy[:, 0] + t.b * xy[:, 1] + t.c - 0.5, t.d * xy[:, 0] + t.e * xy[:, 1] + t.f - 0.5
        z = map_coordinates(patch.patch.heights, [row, col], order=1, mode="constant", cval=np.nan)
        heights[_slices(part)] = z.reshape(part.height, part.width)
    return heights


@dataclass(frozen=True)
class SeamLayers:
    """Lines and areas that seams follow or avoid, in the output map.

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
    """Lines and areas that seams follow or avoid, from all layers of vector files.

    Parameters
    ----------
    follow, avoid : sequence of Path
        Files of lines or areas to follow, and of areas to avoid.
    grid : Grid
        Of the output, to whose map they are transformed.

    Returns
    -------
    SeamLayers

    Raises
    ------
    InputError
        A layer without CRS, points, lines among the areas to avoid, an area that crosses itself.
    """
    return SeamLayers(_read(follow, grid, (*LINES, *AREAS)), _read(avoid, grid, AREAS))


def _read(paths: Sequence[Path], grid: Grid, kinds: tuple[str, ...]) -> list[Any]:
    found: list[Any] = []
    for path in paths:
        shapes = [shape for layer in layer_names(path) for shape in read_shapes(path, layer, grid.crs, kinds)]
        note_elsewhere(path, shapes, grid)
        found += shapes
    return found
