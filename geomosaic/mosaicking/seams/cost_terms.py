"""Terms of the seam cost of a cell, each from 0 (free) to 1 (worst), and their weights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.options.mosaic import SeamWeights
from geomosaic.types import AnyArray, BoolArray, Float32Array

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

    Differences are in units of the images' own contrast, so the measure is the same for bytes and reflectances, and
    depends on these two images alone.

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

    What a morphological opening of the heights removes stands out of the ground. Windows of several sizes find small
    houses on ridges and large halls in plains (the progressive filter of Zhang and others, 2003). On a ridge as narrow
    as the window, the height that its flanks explain is subtracted. A jump within three cells is a wall.

    K. Zhang and others, *A progressive morphological filter for removing nonground measurements from airborne lidar
    data*, IEEE Transactions on Geoscience and Remote Sensing 41, 2003.

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
