"""Pairs of very different view or scale: both images are rectified to the ground by their models, and compared there.

Descriptors bear a change of scale and direction, and little tilt. On the ground both are alike; matches are carried
back through the same map, good to a pixel of it, and least squares matching starts from the derivatives of the models.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from geomosaic.block import OrientedImage, footprint
from geomosaic.block_adjustment.start import StartBlock
from geomosaic.errors import GeomosaicError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.grid import Window
from geomosaic.geo.transform import Transform
from geomosaic.matching.features import detect
from geomosaic.matching.predicted import match_predicted
from geomosaic.matching.tracks import PairMatches
from geomosaic.matching.two_view import match_pair
from geomosaic.sensor.plugin import HasPose
from geomosaic.sensor.solve import image_to_ground, image_to_height
from geomosaic.surface.model import Surface
from geomosaic.tie_points.footprints import MARGIN, predicted_places, surface_of
from geomosaic.tie_points.grey_images import GreyImages
from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray

# Ratio of scales, and of the axes of a circle of one image as the other shows it, from which descriptors lose.
SCALE, STRETCH = 2.5, 1.5
# Pixels of the rectified images between places whose maps are computed.
NODE = 16
# Pixels of an image over which derivatives are taken.
STEP = 4.0
# Pixels of the rectified images beside what they show where features are those of the edge.
EDGE = 8
# Matches of the images as they are that need no more.
ENOUGH = 200


@dataclass(frozen=True, eq=False)
class RectifiedMatches:
    """Matches of two images, M of them, found on the ground.

    Attributes
    ----------
    one, other : array (M, 2)
        Places in the first and second image, pixels.
    cost : array (M,)
        The less, the surer.
    reach : array (2,)
        Pixels of each image that one of the rectified images covers.
    """

    one: FloatArray
    other: FloatArray
    cost: FloatArray
    reach: FloatArray


@dataclass(frozen=True, eq=False)
class Places:
    """Places of an image that matches refer to: those of its features, then those found on the ground.

    Attributes
    ----------
    colrow : array (N, 2)
        Pixels.
    reach : array (N,)
        Pixels that they may be wrong.
    features : int
        Number of those of features.
    """

    colrow: FloatArray
    reach: FloatArray
    features: int

    def including(self, colrow: FloatArray, reach: float) -> tuple[Places, IntArray]:
        """With further places (M, 2), and the numbers (M,) of these: of one that is there already, where it is near."""
        number = len(self.colrow) + np.arange(len(colrow))
        if self.features:
            away, near = cKDTree(self.colrow[: self.features]).query(colrow)
            number = np.where(away < 0.5 * reach, near, number)
        more = replace(
            self, colrow=np.vstack([self.colrow, colrow]), reach=np.append(self.reach, np.full(len(colrow), reach))
        )
        return more, number.astype(np.int64)


def dissimilar_pairs(
    start: StartBlock, pairs: IntArray, matched: Mapping[tuple[int, int], PairMatches]
) -> list[tuple[int, int]]:
    """Pairs with few matches, of which models say that they show the ground very differently.

    Parameters
    ----------
    start : StartBlock
    pairs : int array (P, 2)
    matched : mapping of (int, int) to PairMatches
        Of the images as they are.
    """
    few = [(i, j) for i, j in pairs.tolist() if (i, j) not in matched or len(matched[i, j].places) < ENOUGH]
    views: dict[int, FloatArray | None] = {}
    for image in sorted({image for pair in few for image in pair}):
        middle = np.array([start.scenes[image].model.size]) / 2.0
        views[image] = ground_frames(start, image, middle)[0] if _can_rectify(start, image) else None
    found = []
    for i, j in few:
        one, other = views[i], views[j]
        if one is None or other is None or not np.isfinite([one, other]).all():
            continue
        large, small = np.linalg.svd(other @ np.linalg.inv(one), compute_uv=False)
        scale = np.sqrt(large * small)
        if large > STRETCH * small or max(scale, 1.0 / scale) > SCALE:
            found.append((i, j))
    return found


def _can_rectify(start: StartBlock, image: int) -> bool:
    """Whether an image's model, and the ground, are known well enough to rectify it."""
    return bool(start.oriented[image]) and (
        start.surface is not None or not isinstance(start.scenes[image].model, HasPose)
    )


def ground_frames(start: StartBlock, image: int, colrow: FloatArray) -> FloatArray:
    """Derivatives (N, 2, 2) of places (N, 2) of an image by those on the level ground, pixels per metre; NaN if none.

    Parameters
    ----------
    start : StartBlock
    image : int
    colrow : array (N, 2)
    """
    model = start.scenes[image].model
    surface = surface_of(start, model)
    height = image_to_ground(model, colrow, surface)[:, 2]
    known = np.isfinite(height)
    frames = np.full((len(colrow), 2, 2), np.nan)
    if not known.any():
        return frames
    to_map = Transform(horizontal(surface.crs), horizontal(start.ground))
    moved = [colrow[known] + step for step in ([0.0, 0.0], [STEP, 0.0], [0.0, STEP])]
    at, right, down = (to_map(image_to_height(model, each, height[known], surface.crs)[:, :2]) for each in moved)
    by_pixel = np.stack([right - at, down - at], axis=-1) / STEP
    usable: BoolArray = np.asarray(np.isfinite(by_pixel).all(axis=(1, 2)))
    usable[usable] = np.abs(np.linalg.det(by_pixel[usable])) > 1e-12
    rows = np.flatnonzero(known)[usable]
    frames[rows] = np.linalg.inv(by_pixel[usable])
    return frames


def seen_ground(start: StartBlock, image: int) -> tuple[FloatArray, FloatArray]:
    """Image places (N, 2) spread over an image, and the ground (N, 3) there: what matches on the ground depend on.

    Parameters
    ----------
    start : StartBlock
    image : int
    """
    model = start.scenes[image].model
    share = (np.arange(16) + 0.5) / 16.0
    places = np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2) * model.size
    return places, image_to_ground(model, places, surface_of(start, model))


def match_rectified(
    start: StartBlock, i: int, j: int, longest: int, most: int, tolerance: float
) -> RectifiedMatches | None:
    """Matches of two images on the ground; None where they show nothing in common there.

    Parameters
    ----------
    start : StartBlock
    i, j : int
        Numbers of the images.
    longest : int
        Most pixels along a side of the rectified images.
    most : int
        Features of each.
    tolerance : float
        Pixels of the rectified images from the epipolar line beyond which no match is right.
    """
    surface, crs = surface_of(start, start.scenes[i].model), horizontal(start.ground)
    try:
        outlines = [footprint(start.scenes[k], surface, crs) for k in (i, j)]
    except GeomosaicError:
        return None
    shapes = [each.polygon.buffer(MARGIN * np.sqrt(each.polygon.area), quad_segs=2) for each in outlines]
    common = shapes[0].intersection(shapes[1])
    if common.is_empty:
        return None
    left, low, right, high = common.bounds
    pixel = max(max(each.sampling for each in outlines), max(right - left, high - low) / longest)
    cells = int((right - left) / pixel) + 1, int((high - low) / pixel) + 1
    nodes = [NODE * np.arange(-(-count // NODE) + 1) for count in cells]
    x, y = np.meshgrid(left + pixel * nodes[0], high - pixel * nodes[1])
    ground = _on_surface(np.column_stack([x.ravel(), y.ravel()]), surface, start)
    found, steps = [], []
    for k in (i, j):
        model = start.scenes[k].model
        there = model.ground_to_image(Transform(surface.crs, model.crs)(ground)).reshape(*x.shape, 2)
        inside = (there >= 0.0).all(axis=2) & (there <= model.size).all(axis=2)
        if not inside.any():
            return None
        down, right_of = np.gradient(there, axis=0), np.gradient(there, axis=1)
        step = np.sqrt(np.abs(np.linalg.det(np.stack([right_of, down], axis=-1)))) / NODE
        steps.append(float(np.nanmedian(step[inside])))
        picture, wanted = _picture(start.scenes[k], there, cells, steps[-1])
        features = detect(picture, most, wanted)
        found.append(replace(features, colrow=_between(there, features.colrow)))
    in_pixels = tolerance * max(steps)
    predicted = predicted_places(start, i, j, found[0].colrow)
    if predicted is None:
        pair = match_pair(found[0], found[1], in_pixels)
        matches = None if pair is None else pair.matches
    else:
        matches = match_predicted(found[0], found[1], predicted, in_pixels)
    if matches is None:
        return None
    one, other = matches.T
    apart = found[0].descriptors[one].astype(np.float64) - found[1].descriptors[other]
    return RectifiedMatches(
        found[0].colrow[one], found[1].colrow[other], np.linalg.norm(apart, axis=1), np.array(steps)
    )


def _on_surface(xy: FloatArray, surface: Surface, start: StartBlock) -> FloatArray:
    """Places (N, 2) of the map on a surface (N, 3); in holes and beyond its border at its median height."""
    places = Transform(horizontal(start.ground), horizontal(surface.crs))(xy)
    height = surface.height(places)
    known = np.isfinite(height)
    height[~known] = np.median(height[known]) if known.any() else np.mean(surface.range)
    return np.column_stack([places, height])


def _picture(
    scene: OrientedImage, nodes: FloatArray, cells: tuple[int, int], step: float
) -> tuple[AnyArray, BoolArray]:
    """Rectified image (rows, cols), and where it shows ground well within its border."""
    import cv2

    # Means of the pixels that one of the rectified image covers.
    shrink = max(1, int(step))
    col, row = ((np.arange(count) + 0.5) / NODE for count in cells)
    places = _rows_between(_rows_between(nodes, row).transpose(1, 0, 2), col).transpose(1, 0, 2) / shrink
    with GreyImages([scene]) as pictures:
        whole = Window(0, 0, *pictures.size(0, shrink))
        inside: BoolArray = np.asarray(((places >= 0.0) & (places < (whole.width, whole.height))).all(axis=2))
        if not inside.any():
            return np.zeros(inside.shape, dtype=np.uint8), inside
        low, high = (np.floor(edge).astype(int) for edge in (places[inside].min(axis=0), places[inside].max(axis=0)))
        window = Window(int(low[0]), int(low[1]), int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1)
        grey = pictures.window(0, shrink, window.intersection(whole))
    # OpenCV counts from the centre of the first pixel.
    at = np.where(inside[..., None], places - low - 0.5, -1e4).astype(np.float32)
    values = cv2.remap(grey.values, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    if grey.valid is not None:
        seen = cv2.remap(grey.valid.astype(np.uint8), at[..., 0], at[..., 1], cv2.INTER_NEAREST)
        inside &= seen != 0
    values[~inside] = 0
    around = np.ones((2 * EDGE + 1, 2 * EDGE + 1), dtype=np.uint8)
    well = cv2.erode(inside.astype(np.uint8), around, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return values, np.asarray(well != 0)


def _rows_between(nodes: FloatArray, at: FloatArray) -> FloatArray:
    """Values (len(at), ...) between rows of nodes, at fractions of their spacing."""
    first = np.clip(np.floor(at).astype(np.int64), 0, len(nodes) - 2)
    share = (at - first).reshape(-1, *(1,) * (nodes.ndim - 1))
    between: FloatArray = (1.0 - share) * nodes[first] + share * nodes[first + 1]
    return between


def _between(nodes: FloatArray, colrow: FloatArray) -> FloatArray:
    """Places (N, 2) of the image that places (N, 2) of the rectified image show, as `_picture` took them."""
    at = colrow / NODE
    first = np.clip(np.floor(at).astype(np.int64), 0, np.array(nodes.shape[1::-1]) - 2)
    (col, row), (across, down) = first.T, (at - first).T[:, :, None]
    upper = (1.0 - across) * nodes[row, col] + across * nodes[row, col + 1]
    lower = (1.0 - across) * nodes[row + 1, col] + across * nodes[row + 1, col + 1]
    places: FloatArray = (1.0 - down) * upper + down * lower
    return places
