"""Consistency of the rays of tie points: with the matches around each, and with the epipolar geometry of each pair.

Lenses that are not known yet bend epipolar lines by some pixels, relief moves places along them by many. Both change
slowly over an image: what is compared with the points around a place, by a robust affine regression, needs neither
lens nor surface. The fundamental matrix comes from all matches by the normalised eight-point method with Sampson's
weights (Hartley and Zisserman, Multiple View Geometry, algorithm 11.1 and section 11.4.3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from geomosaic.estimation.statistics import MAD_TO_SIGMA
from geomosaic.matching.tracks import Tracks
from geomosaic.types import BoolArray, FloatArray, IntArray

# Points around one that say where it should be, and the fewest that can; rounds of their robust transformation.
AROUND, LEAST_AROUND, ROUNDS = 12, 7, 4
# How far a place may be from that: pixels that are always granted, and in units of the scatter of the points around it.
NEAR, FAR = 1.0, 4.0
# Variance of where they put a place, in units of that of one of them, above which it is extrapolated and tests nothing;
# pixels of distance granted above which it does not either: points around are too far away, or too few.
LARGEST_LEVERAGE, LARGEST_TOLERANCE = 1.0, 40.0
# The same for distances from epipolar lines; matches of a pair that determine them, with some to spare.
AROUND_LINE, NEAR_LINE, FAR_LINE, LEAST_FOR_LINES = 16, 0.7, 5.0, 20


def consistent_rays(tracks: Tracks, colrow: FloatArray) -> BoolArray:
    """Rays whose places the neighbouring points and the epipolar geometry bear out.

    A wrong match along its epipolar line satisfies the geometry of its two images. Here the points around it in each
    two images say where it should be. Of a point those rays stay that hang together by such agreement, the most if
    there are several sets, and each that agrees with more of the others than not. Across a lake or at the edge of an
    overlap the points around a place may all lie on one side of it: they say nothing then, for or against.

    What relief hides along the lines is seen across them: of each point then the ray goes that the largest share of the
    others contradicts there, one after the other.

    Parameters
    ----------
    tracks : Tracks
        N rays.
    colrow : array (N, 2)
        Pixels.

    Returns
    -------
    bool array (N,)
    """
    if not len(tracks):
        return np.zeros(0, dtype=bool)
    pairs = _RayPairs.of(tracks)
    vote, contradicted = np.zeros(len(pairs.one), dtype=np.int64), np.zeros(len(pairs.one), dtype=bool)
    for rows in pairs.by_images:
        one, other = colrow[pairs.one[rows]], colrow[pairs.other[rows]]
        if len(rows) > LEAST_AROUND:
            vote[rows] = agreement_with_neighbours(one, other)
        if len(rows) >= LEAST_FOR_LINES:
            contradicted[rows] = off_epipolar_lines(one, other)
    agree = vote > 0
    links = sparse.coo_array(
        (np.ones(int(agree.sum())), (pairs.one[agree], pairs.other[agree])), shape=(len(tracks), len(tracks))
    )
    _, label = connected_components(links, directed=False)
    # The largest set of each point, of equal ones that of its first ray.
    order = np.lexsort((label, -np.bincount(label)[label], tracks.point))
    best = label[order[np.flatnonzero(np.diff(tracks.point[order], prepend=-1))]]
    kept: BoolArray = label == best[tracks.point]
    kept &= pairs.sums(np.where(pairs.among(kept), vote, 0)) > 0
    while True:
        among = pairs.among(kept)
        share = pairs.sums(among & contradicted) / np.maximum(pairs.sums(among), 1.0)
        worst = np.zeros(len(tracks.rays))
        np.maximum.at(worst, tracks.point[kept], share[kept])
        gone = kept & (share > 0.0) & (share == worst[tracks.point])
        if not gone.any():
            return kept
        kept &= ~gone


@dataclass(frozen=True, eq=False)
class _RayPairs:
    """All pairs of rays of each point, P in all, and their rows by pairs of images."""

    one: IntArray
    other: IntArray
    by_images: list[IntArray]
    rays: int

    @classmethod
    def of(cls, tracks: Tracks) -> _RayPairs:
        # Rays lie point by point.
        after = np.cumsum(tracks.rays)[tracks.point] - np.arange(len(tracks)) - 1
        one = np.repeat(np.arange(len(tracks)), after)
        other = one + 1 + np.arange(len(one)) - (np.cumsum(after) - after)[one]
        images = tracks.image[one] * (int(tracks.image.max()) + 1) + tracks.image[other]
        order = np.argsort(images, kind="stable")
        return cls(one, other, np.split(order, np.flatnonzero(np.diff(images[order])) + 1), len(tracks))

    def among(self, rays: BoolArray) -> BoolArray:
        """Pairs whose rays are both among some."""
        return rays[self.one] & rays[self.other]

    def sums(self, values: IntArray | BoolArray) -> FloatArray:
        """Sum for each ray of the values of its pairs."""
        weights = values.astype(np.float64)
        total = np.bincount(self.one, weights, self.rays) + np.bincount(self.other, weights, self.rays)
        return np.asarray(total, dtype=np.float64)


def agreement_with_neighbours(one: FloatArray, other: FloatArray) -> IntArray:
    """Whether matches of two images lie where those around them would put them, after how well these agree.

    Parameters
    ----------
    one, other : array (M, 2)
        Places, pixels.

    Returns
    -------
    int array (M,)
        1 where they do, -1 where they do not, 0 where those around them tell nothing.
    """
    expected, scatter, leverage = _local_regression(one, other, AROUND)
    off = np.linalg.norm(other - expected, axis=1)
    tolerance = np.maximum(NEAR, FAR * scatter * np.sqrt(1.0 + leverage))
    silent = (leverage > LARGEST_LEVERAGE) | (tolerance > LARGEST_TOLERANCE)
    return np.where(off < tolerance, np.where(silent, 0, 1), -1)


def off_epipolar_lines(one: FloatArray, other: FloatArray) -> BoolArray:
    """Matches of two images that lie off their epipolar lines by other distances than the matches around them.

    Parameters
    ----------
    one, other : array (M, 2)
        Places, pixels, at least nine.

    Returns
    -------
    bool array (M,)
    """
    distance = _epipolar_distances(one, other)[:, None]
    expected, scatter, leverage = _local_regression(one, distance, AROUND_LINE)
    off = np.abs(distance - expected)[:, 0]
    return off > np.maximum(NEAR_LINE, FAR_LINE * MAD_TO_SIGMA * scatter * np.sqrt(1.0 + leverage))


def _epipolar_distances(one: FloatArray, other: FloatArray) -> FloatArray:
    """Signed distances (M,), pixels, of nine or more matches from the epipolar geometry that fits best (Sampson)."""
    (a, scale), (b, other_scale) = _normalised(one), _normalised(other)
    terms = (b[:, :, None] * a[:, None, :]).reshape(len(a), 9)
    weight = np.ones(len(a))
    for _ in range(2 * ROUNDS):
        weighed = terms * weight[:, None]
        matrix = np.linalg.eigh(weighed.T @ weighed)[1][:, 0].reshape(3, 3)
        left, singular, right = np.linalg.svd(matrix)
        matrix = left[:, :2] * singular[:2] @ right[:2]
        slope = np.concatenate([(a @ matrix.T)[:, :2] * other_scale, (b @ matrix)[:, :2] * scale], axis=1)
        steepness = np.maximum(np.linalg.norm(slope, axis=1), 1e-12)
        distance: FloatArray = np.sqrt(2.0) * np.einsum("ni,ij,nj->n", b, matrix, a) / steepness
        scatter = MAD_TO_SIGMA * np.median(np.abs(distance)) + 1e-6
        flat = np.maximum(steepness / np.median(steepness), 1e-3)
        weight = 1.0 / (flat * np.sqrt(1.0 + (distance / (3.0 * np.sqrt(2.0) * scatter)) ** 2))
    return distance


def _normalised(places: FloatArray) -> tuple[FloatArray, float]:
    """Homogeneous coordinates (M, 3) about the middle in units of their spread, and units per pixel."""
    about = places - places.mean(axis=0)
    scale = float(np.sqrt(2.0) / max(np.sqrt((about**2).sum(axis=1).mean()), 1e-9))
    return np.column_stack([scale * about, np.ones(len(about))]), scale


def _local_regression(places: FloatArray, values: FloatArray, around: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Values (M, K) at places (M, 2) as a robust affine function of the `around` others about each gives them.

    Returns what is expected (M, K); the median distance (M,) of the values around from the function, for the degrees of
    freedom that are left; and the variance (M,) of what is expected, in units of that of one value.
    """
    count = min(around, len(places) - 1)
    _, near = cKDTree(places).query(places, k=count + 1)
    near = near[:, 1:]
    away = places[near] - places[:, None, :]
    # In units of the neighbourhood's size, for the sake of the condition.
    size = np.maximum(np.sqrt((away**2).sum(axis=2).mean(axis=1)), 1e-9)
    design = np.concatenate([np.ones((*near.shape, 1)), away / size[:, None, None]], axis=2)
    sample, weight = values[near], np.ones(near.shape)
    for _ in range(ROUNDS):
        weighed = design * weight[:, :, None]
        normal = np.einsum("nki,nkj->nij", weighed, design) + 1e-6 * np.eye(3)
        affine = np.linalg.solve(normal, np.einsum("nki,nkj->nij", weighed, sample))
        left = np.linalg.norm(sample - design @ affine, axis=2)
        scatter = np.median(left, axis=1) * np.sqrt(count / (count - 3.0))
        weight = 1.0 / (1.0 + (left / np.maximum(2.0 * scatter, 0.1)[:, None]) ** 2)
    return affine[:, 0], scatter, np.linalg.inv(normal)[:, 0, 0]
