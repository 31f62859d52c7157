"""What a seam costs at a cell: terms from 0 (free) to 1 (as bad as it gets), and a weight for each."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import AnyArray, BoolArray, Float32Array

TEXTURE = 5
"""Cells across the neighbourhood whose spread is an image's texture."""
RIM = 0.08
"""Part of an image's side within which its edge is near."""
STEEP, HIGH = 45.0, 2.5
"""Slope in degrees, and metres above the ground around, that count in full."""
GROUND = (15.0, 30.0, 60.0)
"""Metres: what is narrower and stands out of the ground is a building or a tree."""
_GENTLE = 0.5
MARGIN = 1
"""Cells around a roof that belong to it: it leans differently in each image."""


@dataclass(frozen=True)
class SeamWeights:
    """How much each term counts against one cell of seam where all is well (`length`).

    Attributes
    ----------
    length : float
        Of every cell: keeps seams short where nothing else matters.
    colour : float
        Difference of both images' values, in units of their contrast.
    gradient : float
        Difference of their slopes: edges that do not meet.
    texture : float
        Difference of their local spread: sharp against blurred, leaves against none.
    angle : float
        View angle of the image that shows the cell, in units of 45 degrees; per cell of area.
    edge : float
        Nearness of the edge of the image that shows the cell; per cell of area.
    heights : float
        Slopes, and what stands out of the ground: roofs, trees, walls.
    avoid : float
        Inside polygons to keep out of.
    follow : float
        Part of the cost that is left along roads and rivers, 0 to 1.
    reach : float
        Part of the way between two centres, to both sides of the middle together, in which a seam may run.
    """

    length: float = 0.03
    colour: float = 1.0
    gradient: float = 0.5
    texture: float = 0.25
    angle: float = 0.004
    edge: float = 0.02
    heights: float = 3.0
    avoid: float = 100.0
    follow: float = 0.15
    reach: float = 0.6

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"the seam weight '{one.name}' is {value}", hint="give a number, 0 or more")
        if not self.length > 0:
            raise InputError("the seam weight 'length' is 0: seams would run anywhere", hint="give a small number")
        for name in ("follow", "reach"):
            if getattr(self, name) > 1:
                raise InputError(f"'{name}' of the seams is a part of a whole", hint="give a number from 0 to 1")


@dataclass(frozen=True)
class Features:
    """An image on the cells of its window, and what is compared of it.

    Attributes
    ----------
    values : float32 array (rows, cols, bands)
        Corrected; 0 where not valid.
    valid : bool array (rows, cols)
    slope : float32 array (rows, cols, 2)
        Of the mean over bands, per cell.
    texture : float32 array (rows, cols)
        Spread in the neighbourhood.
    contrast : float
        Spread of the whole, the unit of all comparisons.
    """

    values: Float32Array
    valid: BoolArray
    slope: Float32Array
    texture: Float32Array
    contrast: float


def features(values: AnyArray, valid: BoolArray) -> Features:
    """Find what is compared of an image: values (rows, cols, bands), valid (rows, cols)."""
    from scipy.ndimage import uniform_filter

    values = np.where(valid[..., None], values, 0).astype(np.float32)
    if min(valid.shape) < 2 or not valid.any():
        empty = np.zeros(valid.shape, dtype=np.float32)
        return Features(values, valid, np.zeros((*valid.shape, 2), dtype=np.float32), empty, 0.0)
    grey = values.mean(axis=2)
    level = float(grey[valid].mean())
    grey = np.where(valid, grey - level, 0).astype(np.float32)  # what is not seen is as bright as the mean
    down, right = np.gradient(grey)
    mean = uniform_filter(grey, TEXTURE)
    spread = np.sqrt(np.maximum(uniform_filter(grey**2, TEXTURE) - mean**2, 0))
    return Features(values, valid, np.stack([right, down], axis=-1), spread, float(grey[valid].std()))


def disagreement(one: Features, other: Features, weights: SeamWeights) -> Float32Array:
    """How differently two images show cells (rows, cols) of the same window; 0 where either sees nothing.

    Differences are counted in units of the images' own contrast, so the measure is the same for bytes and reflectances,
    and depends on these two images alone.
    """
    unit = max((one.contrast + other.contrast) / 2, 1e-12)
    colour = np.sqrt(((one.values - other.values) ** 2).mean(axis=-1))
    slope = np.sqrt(((one.slope - other.slope) ** 2).sum(axis=-1))
    texture = np.abs(one.texture - other.texture)
    total = (
        weights.colour * np.minimum(colour / unit, 1)
        + weights.gradient * np.minimum(slope / unit, 1)
        + weights.texture * np.minimum(texture / unit, 1)
    )
    return np.where(one.valid & other.valid, total, 0).astype(np.float32)


def nearness_of_edge(shown: BoolArray) -> Float32Array:
    """1 at the edge of what an image shows (rows, cols), falling to 0 at `RIM` of its side; 1 beyond."""
    from scipy.ndimage import distance_transform_edt

    rim = RIM * max(1.0, float(np.sqrt(shown.sum())))
    inside = distance_transform_edt(np.pad(shown, 1))[1:-1, 1:-1]
    near: Float32Array = np.clip(1 - inside / rim, 0, 1).astype(np.float32)
    return near


def standing_out(heights: AnyArray, cell: float) -> Float32Array:
    """How much a roof, a wall or a tree stands at each cell (rows, cols), 0 to 1.

    What a morphological opening of the heights takes away stands out of the ground. Windows of several sizes find small
    houses on ridges and large halls in plains (the progressive filter of Zhang and others, 2003); of a ridge as narrow
    as the window as much is allowed as its flanks explain. Where the height jumps within three cells there is a wall.

    K. Zhang and others, *A progressive morphological filter for removing nonground measurements from airborne lidar
    data*, IEEE Transactions on Geoscience and Remote Sensing 41, 2003.

    Parameters
    ----------
    heights : array (rows, cols)
        Metres; NaN where unknown.
    cell : float
        Metres per cell.
    """
    from scipy.ndimage import grey_opening, maximum_filter, minimum_filter, uniform_filter

    known = np.isfinite(heights)
    if not known.any() or min(heights.shape) < 3:
        return np.zeros(heights.shape, dtype=np.float32)
    z = np.where(known, heights, np.median(heights[known])).astype(np.float32)
    down, right = np.gradient(z, cell)
    slope = np.hypot(down, right)
    jump = (maximum_filter(z, 3) - minimum_filter(z, 3) > HIGH) & (slope > np.tan(np.radians(STEEP)))
    term = jump.astype(np.float32)
    gentle = np.minimum(slope, _GENTLE) / np.maximum(slope, 1e-9)
    for metres in GROUND:
        size = min(round(metres / cell) | 1, 2 * (min(z.shape) - 1) - 1)
        if size < 3:
            continue
        # Beyond the edge the ground goes on as it comes: no ridge is made there.
        wide = np.pad(z, size // 2, mode="reflect", reflect_type="odd")
        inner = slice(size // 2, -(size // 2))
        raised = z - grey_opening(wide, size=size)[inner, inner]
        ridge = np.zeros_like(z)
        for along in (down * gentle, right * gentle):
            ridge += (uniform_filter(np.abs(along), size) - np.abs(uniform_filter(along, size))) * size * cell / 2
        term = np.maximum(term, np.clip((raised - ridge) / HIGH - 0.5, 0, 1))
    return np.where(known, maximum_filter(term, 2 * MARGIN + 1), 0).astype(np.float32)
