"""Sub-pixel places of tie points: least squares matching of each against the image that shows it best."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.spatial import cKDTree

from geomosaic.geo.grid import Window
from geomosaic.matching.least_squares import HALF, PatchMatches, match_patches
from geomosaic.matching.tracks import Tracks
from geomosaic.tie_points.cache import Arrays
from geomosaic.tie_points.grey_images import GreyImages
from geomosaic.types import BoolArray, FloatArray, IntArray

# Correlation of values below which a patch shows something else, and the largest standard deviation that helps.
LEAST_CORRELATION, LARGEST_SIGMA = 0.7, 0.25
# Norm of the change of a patch's affine transformation, as a share of it, beyond which it was bent to fit what is not
# the same: on ground with known places most of the matches that are wrong by pixels, and 1 % of the others.
LARGEST_SHAPE_CHANGE = 0.3
# What matching does not know of (parallax within a patch, lens, rolling shutter) adds to each place, pixels.
FLOOR = 0.1
# Pixels of two images that are compared at once.
LARGEST = 48_000_000
# Neighbours from whose places the local affine transformation between two images comes.
NEIGHBOURS = 10


@dataclass(frozen=True, eq=False)
class Approximations:
    """First places of the rays of tracks, as features give them.

    Attributes
    ----------
    colrow : array (N, 2)
        Pixels of the files, corner-based.
    frames : array (N, 2, 2)
        Scale and direction of each feature.
    reach : array (N,)
        Pixels that a place may be wrong.
    """

    colrow: FloatArray
    frames: FloatArray
    reach: FloatArray

    def select(self, rows: IntArray) -> Approximations:
        """Some of them."""
        return Approximations(self.colrow[rows], self.frames[rows], self.reach[rows])


@dataclass(frozen=True, eq=False)
class RefinedTracks:
    """Tracks with places of sub-pixel accuracy.

    Attributes
    ----------
    tracks : Tracks
    colrow : array (N, 2)
        Pixels, corner-based.
    covariance : array (N, 2, 2)
        Square pixels.
    """

    tracks: Tracks
    colrow: FloatArray
    covariance: FloatArray

    def select(self, rays: BoolArray) -> RefinedTracks:
        """Some rays; points of fewer than two are dropped."""
        count = np.bincount(self.tracks.point[rays], minlength=int(self.tracks.point.max(initial=-1)) + 1)
        kept = rays & (count[self.tracks.point] > 1)
        return RefinedTracks(self.tracks.select(kept), self.colrow[kept], self.covariance[kept])


@dataclass(frozen=True, eq=False)
class PointsOfPair:
    """Points that are to be measured in an image, with their templates in another.

    Attributes
    ----------
    first, second : int
        Numbers of the images; templates are of the first.
    centres : array (K, 2)
        Middles of the templates.
    one, other : Approximations
        Of the rays of both images.
    """

    first: int
    second: int
    centres: FloatArray
    one: Approximations
    other: Approximations

    @property
    def known(self) -> tuple[FloatArray, ...]:
        """All that their places depend on, but for the images."""
        return self.centres, self.one.colrow, self.one.frames, self.other.colrow, self.other.frames, self.other.reach

    def measured(self, pictures: GreyImages) -> Arrays:
        """Places and covariances in the second image, `colrow` and `covariance`; NaN where lost."""
        places, covariance = _match(self.centres, self.one, self.other, pictures, (self.first, self.second))
        return {"colrow": places, "covariance": covariance}


def refine(
    tracks: Tracks,
    approximate: Approximations,
    sizes: IntArray,
    measured: Callable[[Sequence[PointsOfPair]], Iterator[Arrays]],
) -> RefinedTracks:
    """Refined places of tracks.

    Parameters
    ----------
    tracks : Tracks
        N rays.
    approximate : Approximations
    sizes : int array (M, 2)
        Width and height of each image.
    measured : callable
        Gives what `PointsOfPair.measured` gives, of each in their order.

    Returns
    -------
    RefinedTracks
        Without rays whose patch is not found in the image.
    """
    template = template_rays(tracks, approximate, sizes)
    base = template[tracks.point]
    mine = base == np.arange(len(tracks))
    # The middle of a template is the middle of a pixel, which is taken as it is.
    found = np.where(mine[:, None], np.floor(approximate.colrow) + 0.5, np.nan)
    covariance = np.full((len(tracks), 2, 2), np.nan)
    others = np.flatnonzero(~mine)
    if not len(others):
        return _kept(tracks, found, covariance, mine)
    pair = tracks.image[base[others]] * len(sizes) + tracks.image[others]
    # Points of two images in an order that further images do not change.
    order = np.lexsort((tracks.place[base[others]], pair))
    groups = np.split(others[order], np.flatnonzero(np.diff(pair[order])) + 1)
    images = tracks.image[np.array([(base[rows[0]], rows[0]) for rows in groups])]
    groups = [groups[k] for k in neighbours_together(images).tolist()]
    pairs = [
        PointsOfPair(
            int(tracks.image[base[rows[0]]]), int(tracks.image[rows[0]]), found[base[rows]],
            approximate.select(base[rows]), approximate.select(rows),
        )
        for rows in groups
    ]  # fmt: skip
    for rows, arrays in zip(groups, measured(pairs), strict=True):
        found[rows], covariance[rows] = arrays["colrow"], arrays["covariance"]
    return _kept(tracks, found, covariance, mine)


def neighbours_together(pairs: IntArray) -> IntArray:
    """Order (P,) of pairs of images in which those that share images stand near each other.

    Few images need to be held then: strips are gone through side by side (reverse Cuthill-McKee), in whatever order
    images are named. One strip after the other, each image would be decoded again for every strip beside its own.

    Parameters
    ----------
    pairs : int array (P, 2)
        Numbers of images.
    """
    count = int(pairs.max()) + 1
    graph = sparse.csr_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    rank = np.argsort(reverse_cuthill_mckee(graph + graph.T, symmetric_mode=True))[pairs]
    order: IntArray = np.lexsort((rank.min(axis=1), rank.max(axis=1)))
    return order


def _kept(tracks: Tracks, found: FloatArray, covariance: FloatArray, mine: BoolArray) -> RefinedTracks:
    """Rays that were found, and templates that any ray was found for, with what each has of the noise."""
    good = np.isfinite(covariance).all(axis=(1, 2))
    points = int(tracks.point.max(initial=-1)) + 1
    # Noise of the template is in all of its matches: half of each variance is its own.
    sums, count = np.zeros((points, 2, 2)), np.bincount(tracks.point[good], minlength=points)
    np.add.at(sums, tracks.point[good], covariance[good])
    means = sums / np.maximum(count, 1)[:, None, None]
    share = 0.5 * np.where(mine[:, None, None], means[tracks.point], covariance) + FLOOR**2 * np.eye(2)
    kept = good | (mine & (count[tracks.point] > 0))
    return RefinedTracks(tracks.select(kept), found[kept], share[kept])


def template_rays(tracks: Tracks, approximate: Approximations, sizes: IntArray) -> IntArray:
    """Ray (S,) of each point that is its template: of the coarsest images the one nearest to an image's middle.

    Of all those whose patch lies within its image, where there are such.

    Parameters
    ----------
    tracks : Tracks
    approximate : Approximations
    sizes : int array (M, 2)
    """
    # A finer template would be sought between the pixels of coarser images; the other way round loses nothing.
    scale = np.sqrt(np.abs(np.linalg.det(approximate.frames)))
    smallest = np.full(int(tracks.point.max(initial=-1)) + 1, np.inf)
    np.minimum.at(smallest, tracks.point, scale)
    finer = scale > 1.3 * smallest[tracks.point]
    size = sizes[tracks.image]
    away = np.linalg.norm(approximate.colrow - size / 2.0, axis=1) / np.linalg.norm(size, axis=1)
    pixel = np.floor(approximate.colrow)
    cut = ((pixel < HALF + 1) | (pixel > size - HALF - 2)).any(axis=1)
    order = np.lexsort((tracks.image, away, finer, cut, tracks.point))
    chosen: IntArray = order[np.flatnonzero(np.diff(tracks.point[order], prepend=-1))]
    return chosen


def _match(
    centres: FloatArray,
    one: Approximations,
    other: Approximations,
    pictures: GreyImages,
    images: tuple[int, int],
) -> tuple[FloatArray, FloatArray]:
    """Places (K, 2) and covariances (K, 2, 2) in the other image of templates about `centres`; NaN where lost."""
    own = other.frames @ np.linalg.inv(one.frames)
    affine, known = _local_affine(one.colrow, other.colrow)
    affine = np.where(known[:, None, None], affine, own)
    # The other image is reduced until its pixels are about as large on the ground as the template's.
    scale = np.sqrt(np.abs(np.linalg.det(affine)))
    shrink = np.clip(2 ** np.rint(np.log2(np.maximum(scale, 1.0))).astype(np.int64), 1, 8)
    places, covariance = np.full(centres.shape, np.nan), np.full((len(centres), 2, 2), np.nan)
    for each in np.unique(shrink).tolist():
        for start in (affine, own):
            rows = np.flatnonzero((shrink == each) & np.isnan(places[:, 0]))
            if not len(rows):
                break
            pixels = np.floor(centres[rows]).astype(np.int64)
            begin = other.colrow[rows] + np.einsum("nij,nj->ni", start[rows], centres[rows] - one.colrow[rows])
            reach = 1.0 + float(other.reach[rows].max()) / each
            match = _matched(pictures, images, each, _Begin(pixels, begin / each, start[rows] / each, reach))
            sigma = each * np.sqrt(np.trace(match.covariance, axis1=1, axis2=2) / 2.0)
            change = np.linalg.norm(match.affine @ np.linalg.inv(start[rows] / each) - np.eye(2), axis=(1, 2))
            with np.errstate(invalid="ignore"):
                good = match.found & (match.correlation >= LEAST_CORRELATION) & (sigma <= LARGEST_SIGMA)
                good &= change <= LARGEST_SHAPE_CHANGE
            places[rows[good]] = each * match.colrow[good]
            covariance[rows[good]] = each**2 * match.covariance[good]
    return places, covariance


@dataclass(frozen=True, eq=False)
class _Begin:
    """First places, K of them, of templates in a reduced image, with their affine transformations."""

    pixels: IntArray
    colrow: FloatArray
    affine: FloatArray
    reach: float

    def select(self, rows: BoolArray) -> _Begin:
        """Some of them."""
        return replace(self, pixels=self.pixels[rows], colrow=self.colrow[rows], affine=self.affine[rows])

    def windows(self) -> tuple[Window, Window]:
        """What matching may look at in both images."""
        # A patch turned by 45°, and cubic convolution about it.
        wide = float(np.abs(self.affine).sum(axis=2).max()) * HALF + self.reach + 3.0
        return _around(self.pixels, HALF + 2.0), _around(self.colrow, max(wide, HALF + 2.0))


def _around(places: FloatArray | IntArray, margin: float) -> Window:
    """Window about places (K, 2)."""
    low = np.floor(places.min(axis=0) - margin).astype(np.int64)
    size = np.ceil(places.max(axis=0) + margin).astype(np.int64) + 1 - low
    return Window(int(low[0]), int(low[1]), int(size[0]), int(size[1]))


def _matched(pictures: GreyImages, images: tuple[int, int], shrink: int, begin: _Begin) -> PatchMatches:
    """Least squares matches, of parts of the images where they are large."""
    whole = [Window(0, 0, *pictures.size(image, by)) for image, by in zip(images, (1, shrink), strict=True)]
    needed = list(whole)
    if max(each.width * each.height for each in whole) > LARGEST:
        needed = [own.intersection(all_of) for own, all_of in zip(begin.windows(), whole, strict=True)]
        areas = [max(each.width, 0) * max(each.height, 0) for each in needed]
        if min(areas) == 0:
            lost = np.full((len(begin.pixels), 2, 2), np.nan)
            return PatchMatches(lost[:, 0], lost, lost, lost[:, 0, 0])
        if max(areas) > LARGEST and len(begin.pixels) > 1:
            return _halves(pictures, images, shrink, begin, (begin.pixels, begin.colrow)[int(np.argmax(areas))])
    first, second = needed
    found = match_patches(
        pictures.window(images[0], 1, first).values, pictures.window(images[1], shrink, second).values,
        begin.pixels - (first.col, first.row), begin.colrow - (second.col, second.row), begin.affine, begin.reach,
    )  # fmt: skip
    return replace(found, colrow=found.colrow + np.array([second.col, second.row]))


def _halves(
    pictures: GreyImages, images: tuple[int, int], shrink: int, begin: _Begin, places: FloatArray | IntArray
) -> PatchMatches:
    """Matches of both halves of places (K, 2) along their longer side."""
    along = places[:, int(np.argmax(np.ptp(places, axis=0)))]
    upper = np.zeros(len(along), dtype=bool)
    upper[np.argsort(along, kind="stable")[len(along) // 2 :]] = True
    low, high = (_matched(pictures, images, shrink, begin.select(half)) for half in (~upper, upper))
    order = np.argsort(np.concatenate([np.flatnonzero(~upper), np.flatnonzero(upper)]))
    return PatchMatches(
        np.concatenate([low.colrow, high.colrow])[order], np.concatenate([low.affine, high.affine])[order],
        np.concatenate([low.covariance, high.covariance])[order],
        np.concatenate([low.correlation, high.correlation])[order],
    )  # fmt: skip


def _local_affine(one: FloatArray, other: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Derivatives (K, 2, 2) of places in another image by those in the first (K, 2), of the matches around each.

    With them whether there are enough of these (K,), and they fit an affine transformation.
    """
    count = min(NEIGHBOURS, len(one))
    if count < 6:
        return np.tile(np.eye(2), (len(one), 1, 1)), np.zeros(len(one), dtype=bool)
    _, near = cKDTree(one).query(one, k=count)
    base, image = (
        one[near] - one[near].mean(axis=1, keepdims=True),
        other[near] - other[near].mean(axis=1, keepdims=True),
    )
    normal = np.einsum("nki,nkj->nij", base, base)
    usable = np.linalg.cond(normal) < 400.0
    affine = np.tile(np.eye(2), (len(one), 1, 1))
    affine[usable] = np.einsum("nki,nkj->nij", image[usable], base[usable]) @ np.linalg.inv(normal[usable])
    left = np.linalg.norm(image - base @ affine.transpose(0, 2, 1), axis=2)
    span = np.sqrt(np.trace(normal, axis1=1, axis2=2) / count)
    # Crowns and roofs beside the ground: a transformation over them is that of neither.
    known: BoolArray = usable & (np.median(left, axis=1) < 0.1 * span)
    return affine, known
