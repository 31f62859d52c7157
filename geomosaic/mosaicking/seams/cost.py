"""Cost of a seam at each cell of a raster, and the terms it is weighed by."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from geomosaic.execution.units import map_units
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.units import metres_per_unit
from geomosaic.mosaicking.colour.balance import thumbnail
from geomosaic.mosaicking.colour.corrections import Correction, corrected
from geomosaic.mosaicking.provenance import view_raster
from geomosaic.mosaicking.seams.seam_layers import SeamLayers
from geomosaic.options.mosaic import SeamWeights
from geomosaic.options.render import RenderOptions
from geomosaic.raster.validity import rasterized
from geomosaic.render.photo import Photo
from geomosaic.render.photos import Photos
from geomosaic.sensor.map_to_image import Ground
from geomosaic.types import AnyArray, BoolArray, Float32Array, FloatArray, IntArray

# Side in cells of the window whose standard deviation is the texture of an image.
TEXTURE_WINDOW = 5
# Width of the zone along a footprint's edge in which the edge term falls from 1 to 0, as a part of its side.
EDGE_ZONE = 0.08
# Slope in degrees, and height in metres above the surrounding ground, of a full object term.
STEEP_SLOPE, OBJECT_HEIGHT = 45.0, 2.5
# Sides in metres of the morphological openings: narrower raised objects are buildings or trees.
OPENING_WINDOWS = (15.0, 30.0, 60.0)
# Steeper flanks are walls, not terrain: they must not excuse the height of what stands between them.
_MAX_GROUND_SLOPE = 0.5
# Cells around an object that belong to it: relief displacement moves its outline differently in each image.
OBJECT_MARGIN = 1


@dataclass(frozen=True)
class Features:
    """Values, gradients and texture of one image on the cells of its window.

    Attributes
    ----------
    values : float32 array (rows, cols, bands)
        Colour-corrected values; 0 where not valid.
    valid : bool array (rows, cols)
    slope : float32 array (rows, cols, 2)
        Gradient of the mean over bands along columns and rows, per cell.
    texture : float32 array (rows, cols)
        Standard deviation in a window of `TEXTURE_WINDOW` cells.
    contrast : float
        Standard deviation of all valid cells: the unit of all comparisons.
    """

    values: Float32Array
    valid: BoolArray
    slope: Float32Array
    texture: Float32Array
    contrast: float

    def cropped(self, window: Window, part: Window) -> Features:
        """Features of a part of the window.

        Parameters
        ----------
        window : Window
            Of these features.
        part : Window
        """
        own = part.slices_in(window)
        return Features(self.values[own], self.valid[own], self.slope[own], self.texture[own], self.contrast)


def features(values: AnyArray, valid: BoolArray) -> Features:
    """Values, gradients and texture of an image, prepared for comparison.

    Parameters
    ----------
    values : array (rows, cols, bands)
        Colour-corrected values.
    valid : bool array (rows, cols)

    Returns
    -------
    Features
        With a contrast of 0 where nothing is valid.
    """
    from scipy.ndimage import uniform_filter

    values = np.where(valid[..., None], values, 0).astype(np.float32)
    if min(valid.shape) < 2 or not valid.any():
        empty = np.zeros(valid.shape, dtype=np.float32)
        return Features(values, valid, np.zeros((*valid.shape, 2), dtype=np.float32), empty, 0.0)
    grey = values.mean(axis=2)
    level = float(grey[valid].mean())
    # Missing cells take the mean, so that the edge of an image is no gradient. Centred before squaring: in float32
    # the variance of values far from zero would be lost in rounding.
    grey = np.where(valid, grey - level, 0).astype(np.float32)
    down, right = np.gradient(grey)
    mean = uniform_filter(grey, TEXTURE_WINDOW)
    spread = np.sqrt(np.maximum(uniform_filter(grey**2, TEXTURE_WINDOW) - mean**2, 0))
    return Features(values, valid, np.stack([right, down], axis=-1), spread, float(grey[valid].std()))


def image_difference(one: Features, other: Features, weights: SeamWeights) -> Float32Array:
    """Difference of two images per cell: weighted sum of the colour, gradient and texture terms.

    Parameters
    ----------
    one, other : Features
        Of the same window.
    weights : SeamWeights

    Returns
    -------
    float32 array (rows, cols)
        0 where either image has no value.
    """
    # Differences are in units of the images' own contrast, so the measure is the same for bytes and reflectances, and
    # depends on these two images alone.
    unit = max((one.contrast + other.contrast) / 2, 1e-12)
    colour = np.sqrt(((one.values - other.values) ** 2).mean(axis=-1))
    slope = np.sqrt(((one.slope - other.slope) ** 2).sum(axis=-1))
    texture = np.abs(one.texture - other.texture)
    total = (
        # Each term is capped at 1: one glaring difference (a car, glint) costs no more than a clear mismatch.
        weights.colour * np.minimum(colour / unit, 1)
        + weights.gradient * np.minimum(slope / unit, 1)
        + weights.texture * np.minimum(texture / unit, 1)
    )
    return np.where(one.valid & other.valid, total, 0).astype(np.float32)


def edge_proximity(shown: BoolArray) -> Float32Array:
    """Proximity of the edge of a footprint: 1 at the edge and outside, 0 from `EDGE_ZONE` of its side inwards.

    Parameters
    ----------
    shown : bool array (rows, cols)
        Cells that the image shows.

    Returns
    -------
    float32 array (rows, cols)
    """
    from scipy.ndimage import distance_transform_edt

    zone = EDGE_ZONE * max(1.0, float(np.sqrt(shown.sum())))
    # Padded: the border of the array is an edge too.
    distance = distance_transform_edt(np.pad(shown, 1))[1:-1, 1:-1]
    proximity: Float32Array = np.clip(1 - distance / zone, 0, 1).astype(np.float32)
    return proximity


def raised_objects(heights: AnyArray, cell: float) -> Float32Array:
    """Raised objects (roofs, walls, trees) in a height raster: 0 on the ground to 1.

    Parameters
    ----------
    heights : array (rows, cols)
        Metres; NaN where unknown.
    cell : float
        Size of a cell in metres.

    Returns
    -------
    float32 array (rows, cols)
        0 where the height is unknown.
    """
    # What a morphological opening of the heights removes stands out of the ground. Windows of several sizes find small
    # houses on ridges and large halls in plains (the progressive filter of Zhang and others, 2003). On a ridge as
    # narrow as the window, the height that its flanks explain is subtracted. A jump within three cells is a wall.
    # K. Zhang and others, *A progressive morphological filter for removing nonground measurements from airborne lidar
    # data*, IEEE Transactions on Geoscience and Remote Sensing 41, 2003.
    from scipy.ndimage import grey_opening, maximum_filter, minimum_filter, uniform_filter

    known = np.isfinite(heights)
    if not known.any() or min(heights.shape) < 3:
        return np.zeros(heights.shape, dtype=np.float32)
    z = np.where(known, heights, np.median(heights[known])).astype(np.float32)
    down, right = np.gradient(z, cell)
    slope = np.hypot(down, right)
    jump = (maximum_filter(z, 3) - minimum_filter(z, 3) > OBJECT_HEIGHT) & (slope > np.tan(np.radians(STEEP_SLOPE)))
    term = jump.astype(np.float32)
    gentle = np.minimum(slope, _MAX_GROUND_SLOPE) / np.maximum(slope, 1e-9)
    for metres in OPENING_WINDOWS:
        # Odd, so that the window has a centre; at most what one reflection of the array can pad.
        size = min(round(metres / cell) | 1, 2 * (min(z.shape) - 1) - 1)
        if size < 3:
            continue
        # Odd reflection continues the slope beyond the edge; even reflection would make ridges and pits there.
        wide = np.pad(z, size // 2, mode="reflect", reflect_type="odd")
        inner = slice(size // 2, -(size // 2))
        raised = z - grey_opening(wide, size=size)[inner, inner]
        ridge = np.zeros_like(z)
        for along in (down * gentle, right * gentle):
            # Mean of |slope| minus |mean slope| is what rises and falls again within the window: a ridge.
            ridge += (uniform_filter(np.abs(along), size) - np.abs(uniform_filter(along, size))) * size * cell / 2
        term = np.maximum(term, np.clip((raised - ridge) / OBJECT_HEIGHT - 0.5, 0, 1))
    return np.where(known, maximum_filter(term, 2 * OBJECT_MARGIN + 1), 0).astype(np.float32)


# Nodes along each side of a footprint between which view angles, which change slowly, are interpolated.
NODES = 17
# Cells of an image whose contrast and edge are taken from these cells themselves; larger ones are looked at in coarser
# cells, so that one scene below a thousand photos is not read whole at the photos' cells.
MAX_CELLS = 1_000_000
# Cells beyond a window whose heights tell its raised objects from the ground, at most.
MAX_SURROUNDINGS = 320
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
    part: Window,
    candidates: IntArray,
    colours: Sequence[Correction],
    weights: SeamWeights,
    layers: SeamLayers,
    options: RenderOptions,
) -> SeamCost:
    """Cost of seams through the cells of a window, and of the candidate images that may show them.

    Parameters
    ----------
    photos : Photos
    grid : Grid
        Coarse grid of the cells.
    part : Window
        Cells (rows, cols) of it.
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
    pairwise, unary = np.zeros(candidates.shape[1:], dtype=np.float32), np.zeros(candidates.shape, dtype=np.float32)
    # From north to south, each image held only until its last neighbour has come: memory is that of a strip.
    neighbours = _overlapping_images(candidates)
    order = sorted(neighbours, key=lambda i: (grid.window_of(photos.outlines[i].bounds).row, i))
    held: dict[int, tuple[Window, Features]] = {}
    terms = partial(_image_terms, photos, grid, part, colours, weights)
    for done, (i, (found, price)) in enumerate(map_units(terms, order, options, ahead=1)):
        own = grid.window_of(photos.outlines[i].bounds).intersection(part)
        held[i], place = (own, found), own.slices_in(part)
        unary[:, *place] += np.where(candidates[:, *place] == i, price, 0)
        for j in sorted(neighbours[i] & held.keys()):
            _add_difference(i, j, held, part, candidates, weights, pairwise)
            neighbours[i].discard(j)
            neighbours[j].discard(i)
            if not neighbours[j]:
                del held[j]
        if not neighbours[i]:
            del held[i]
        options.report(done + 1, len(order), "seams")
    return SeamCost(_with_site_terms(pairwise, photos, grid, part, weights, layers), unary)


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


def _image_terms(
    photos: Photos, grid: Grid, part: Window, colours: Sequence[Correction], weights: SeamWeights, index: int
) -> tuple[Features, FloatArray]:
    """Features of an image where its window meets a part of the grid, and its unary cost (rows, cols) there."""
    bounds = photos.outlines[index].bounds
    window = grid.window_of(bounds)
    own = window.intersection(part)
    # Contrast and edge are those of the whole image, so that they are the same in each part.
    factor = math.ceil(math.sqrt(window.width * window.height / MAX_CELLS))
    coarse = grid.coarser(factor)
    with photos.using(index) as photo:
        whole = _features_of(photo, photos, coarse, coarse.window_of(bounds), colours[index])
        found = _features_of(photo, photos, grid, own, colours[index]) if factor > 1 else whole.cropped(window, own)
        angle = _angles(photo, photos, grid, own) if weights.angle else np.zeros((own.height, own.width))
    rows, cols = np.arange(own.row, own.stop_row) // factor, np.arange(own.col, own.stop_col) // factor
    edge = edge_proximity(whole.valid)[np.ix_(rows - window.row // factor, cols - window.col // factor)]
    price = weights.angle * np.minimum(angle / REFERENCE_ANGLE, 1) + weights.edge * edge
    return replace(found, contrast=whole.contrast), price


def _features_of(photo: Photo, photos: Photos, grid: Grid, window: Window, correction: Correction) -> Features:
    """Features of an image in a window of a coarse grid."""
    piece = thumbnail(photo, photos.surface, grid, window, "average", "float32")
    return features(corrected(correction, piece.values, window, grid, photos.grid), piece.valid > 0)


def _angles(photo: Photo, photos: Photos, grid: Grid, window: Window) -> FloatArray:
    """View angles (rows, cols) in degrees; 90 where the model cannot see the ground."""
    return np.nan_to_num(view_raster(photo, photos, grid, window, NODES)[..., 0], nan=90.0)


def _add_difference(
    i: int,
    j: int,
    held: Mapping[int, tuple[Window, Features]],
    part: Window,
    candidates: IntArray,
    weights: SeamWeights,
    seam: Float32Array,
) -> None:
    """Difference of two images, entered in place into the cost of the cells that both may show."""
    (of_one, one), (of_other, other) = held[i], held[j]
    common = of_one.intersection(of_other)
    if common.empty:
        return
    place = common.slices_in(part)
    ranked = candidates[:, *place]
    shared: BoolArray = (ranked == i).any(axis=0) & (ranked == j).any(axis=0)
    cost = seam[place]
    # Where three images or more may show a cell it is not known yet which two meet there: the worst pair counts.
    difference = image_difference(one.cropped(of_one, common), other.cropped(of_other, common), weights)
    cost[shared] = np.maximum(cost, difference)[shared]


def _with_site_terms(
    seam: Float32Array, photos: Photos, grid: Grid, part: Window, weights: SeamWeights, layers: SeamLayers
) -> Float32Array:
    """Pairwise cost with all terms that no image decides: length, raised objects, lines to follow, areas to avoid."""
    from scipy.ndimage import maximum_filter

    # The worst of the neighbourhood: a seam is resolved to a cell, and pixels next to the difference count too.
    total: AnyArray = maximum_filter(seam, 3) + np.float32(weights.length)
    if weights.heights:
        total = total + np.float32(weights.heights) * _raised_objects_in(photos, grid, part)
    # Lines and areas are widened by a cell, so that none slips between cell centres.
    own, cell = grid.crop(part), grid.resolution[0]
    near = layers.near(own.bounds, 2 * cell)
    if near.follow:
        along = rasterized([(shape.buffer(cell), 1) for shape in near.follow], own) == 1
        total[along] *= np.float32(weights.follow)
    if near.avoid:
        total[rasterized([(shape.buffer(cell), 1) for shape in near.avoid], own) == 1] += np.float32(weights.avoid)
    return np.asarray(total, dtype=np.float32)


def _raised_objects_in(photos: Photos, grid: Grid, part: Window) -> Float32Array:
    """Raised objects (rows, cols) in a window of a grid, told from the ground around it: the same in all windows."""
    corner = grid.xy(np.zeros((1, 2)))[0]
    metres = float(metres_per_unit(grid.crs, corner)[1]) * grid.resolution[1]
    by = min(math.ceil(max(OPENING_WINDOWS) / metres) + 2, MAX_SURROUNDINGS)
    wide = part.grown(by).intersection(grid.window)
    return raised_objects(_cell_heights(photos, grid.crop(wide)), metres)[part.slices_in(wide)]


def _cell_heights(photos: Photos, grid: Grid) -> Float32Array:
    """Heights (rows, cols) of the surface at the cells of a grid, metres, bilinear between posts; NaN where unknown."""
    from scipy.ndimage import map_coordinates

    heights = np.full(grid.shape, np.nan, dtype=np.float32)
    ground = Ground.under(grid, photos.surface)
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
        heights[part.slices_in(grid.window)] = z.reshape(part.height, part.width)
    return heights
