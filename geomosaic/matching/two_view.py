"""Two images of one scene: which matches agree with one geometry, and where it says that further ones lie.

Corresponding places satisfy an epipolar equation, whatever the heights (Hartley and Zisserman, Multiple View Geometry,
chapter 9); MAGSAC (Barath et al., 2019) finds the matches that do, without a sharp bound between right and wrong. Where
a place is expected follows from the matches around it: a local affine transformation.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from geomosaic.matching.descriptors import Expected, match_descriptors
from geomosaic.matching.features import Features
from geomosaic.types import BoolArray, FloatArray, IntArray

# Matches that agree by chance: fewer are no evidence that two images show the same.
LEAST_MATCHES = 15
# Features of an image that find the geometry.
COARSE = 1500
# Matches around a place from which its affine transformation comes.
NEIGHBOURS = 12
CONFIDENCE, ROUNDS = 0.9999, 20_000


@dataclass(frozen=True, eq=False)
class Pair:
    """Matches of two images that agree with one epipolar geometry.

    Attributes
    ----------
    matches : int array (M, 2)
        Indices of features of the first and the second image.
    fundamental : array (3, 3)
        F with (x₂, y₂, 1)·F·(x₁, y₁, 1)ᵀ = 0.
    """

    matches: IntArray
    fundamental: FloatArray


def match_pair(first: Features, second: Features, tolerance: float) -> Pair | None:
    """Matches of two images.

    Some of the features find the geometry; all of them are then matched where it expects them.

    Parameters
    ----------
    first, second : Features
    tolerance : float
        Pixels from the epipolar line beyond which no match is right.

    Returns
    -------
    Pair or None
        None where too few matches agree.
    """
    large = [large_features(features) for features in (first, second)]
    some = match_descriptors(first.select(large[0]), second.select(large[1]))
    matches = np.stack([large[0][some[:, 0]], large[1][some[:, 1]]], axis=1)
    rough = agreeing(first, second, matches, 2.0 * tolerance)
    if rough is None:
        return None
    size = float(np.ptp(second.colrow, axis=0).max(initial=1.0))
    expected = expected_places(first.colrow, first.colrow[rough.matches[:, 0]], second.colrow[rough.matches[:, 1]])
    lines = epipolar_lines(rough.fundamental, first.colrow)
    guided = match_descriptors(first, second, Expected(expected, lines, 0.06 * size, 3.0 * tolerance))
    return agreeing(first, second, guided, tolerance) or rough


def agreeing(first: Features, second: Features, matches: IntArray, tolerance: float) -> Pair | None:
    """Those of some matches (M, 2) that agree with one epipolar geometry; None where too few do.

    Parameters
    ----------
    first, second : Features
        Of the two images.
    matches : int array (M, 2)
        Indices of features of the first and the second image.
    tolerance : float
        Pixels from the epipolar line.
    """
    if len(matches) < LEAST_MATCHES:
        return None
    one, other = first.colrow[matches[:, 0]], second.colrow[matches[:, 1]]
    found = _robust_fundamental(one, other, tolerance)
    if found is None:
        return None
    matrix, kept = found
    if kept.sum() < LEAST_MATCHES:
        return None
    kept[kept] = ~far_from_neighbours(one[kept], other[kept], 0.1 * float(np.ptp(other, axis=0).max()))
    pairs = distinct(first, second, matches[kept])
    if len(pairs) < LEAST_MATCHES:
        return None
    return Pair(pairs, matrix)


def _robust_fundamental(one: FloatArray, other: FloatArray, tolerance: float) -> tuple[FloatArray, BoolArray] | None:
    """Fundamental matrix (3, 3) of matches, and those (M,) within pixels of its lines; None where there is none."""
    import cv2

    return _robust(
        lambda a, b, method: cv2.findFundamentalMat(a, b, method, tolerance, CONFIDENCE, ROUNDS),
        lambda matrix, first, second: np.linalg.inv(second).T @ matrix @ np.linalg.inv(first),
        (one, other),
    )


def robust_homography(one: FloatArray, other: FloatArray, tolerance: float) -> tuple[FloatArray, BoolArray] | None:
    """Homography (3, 3) of matches, and those (M,) that agree with it; None where there is none.

    Parameters
    ----------
    one, other : array (M, 2)
    tolerance : float
        Pixels of the other.
    """
    import cv2

    found = _robust(
        lambda a, b, method: cv2.findHomography(a, b, method, tolerance, maxIters=ROUNDS, confidence=CONFIDENCE),
        lambda matrix, first, second: second @ matrix @ np.linalg.inv(first),
        (one, other),
    )
    if found is None or abs(found[0][2, 2]) < 1e-9:
        return None
    return found[0] / found[0][2, 2], found[1]


def _robust(
    find: Callable[[FloatArray, FloatArray, int], tuple[Any, Any]],
    moved: Callable[[FloatArray, FloatArray, FloatArray], FloatArray],
    places: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, BoolArray] | None:
    """Matrix that OpenCV finds about the middles of both images, moved to their origins, and which matches agree."""
    import cv2

    # About their middle: coordinates of thousands of pixels would cost digits.
    middles = [each.mean(axis=0) for each in places]
    one, other = (each - middle for each, middle in zip(places, middles, strict=True))
    # Where many geometries fit (flat ground, two copies of one photo) MAGSAC of OpenCV 5 may end with an error.
    for method in (cv2.USAC_MAGSAC, cv2.RANSAC):
        with suppress(cv2.error):
            matrix, mask = find(one, other, method)
            if matrix is None or mask is None or matrix.shape != (3, 3):
                return None
            first, second = (np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]]) for x, y in middles)
            return moved(matrix, first, second), mask.ravel().astype(bool)
    return None


def large_features(features: Features) -> IntArray:
    """Indices of the features of the largest scale, which other views show as well.

    Parameters
    ----------
    features : Features

    Returns
    -------
    int array (N,)
    """
    return np.argsort(-features.scale, kind="stable")[:COARSE]


def distinct(first: Features, second: Features, pairs: IntArray) -> IntArray:
    """Matches (M, 2) without those of other directions of the same two places.

    Parameters
    ----------
    first, second : Features
    pairs : int array (M, 2)
        Indices of features of the first and the second image.

    Returns
    -------
    int array (K, 2)
    """
    places = np.stack([first.place[pairs[:, 0]], second.place[pairs[:, 1]]], axis=1)
    _, once = np.unique(places, axis=0, return_index=True)
    return pairs[np.sort(once)]


def far_from_neighbours(one: FloatArray, other: FloatArray, reach: float) -> BoolArray:
    """Matches (M,) that lie far from where the matches around them would put them.

    Along its epipolar line a wrong match may lie anywhere; steps of the surface, crowns above the ground, stay within
    `reach` pixels.

    Parameters
    ----------
    one, other : array (M, 2)
        Places (col, row) of the matches in both images, pixels.
    reach : float
        Pixels of the second image.

    Returns
    -------
    bool array (M,)
    """
    expected = expected_places(one, one, other, itself=False)
    far: BoolArray = np.linalg.norm(other - expected, axis=1) > reach
    return far


def expected_places(colrow: FloatArray, one: FloatArray, other: FloatArray, itself: bool = True) -> FloatArray:
    """Places (N, 2) in a second image, after the matches nearest to them in the first.

    Parameters
    ----------
    colrow : array (N, 2)
        Places in the first image.
    one, other : array (M, 2)
        Matches.
    itself : bool
        Whether a match may count for its own place.

    Returns
    -------
    array (N, 2)
    """
    count = min(NEIGHBOURS, len(one) - (not itself))
    skip = 0 if itself else 1
    _, near = cKDTree(one).query(colrow, k=list(range(1 + skip, count + 1 + skip)))
    there = other[near]  # (N, K, 2)
    # Medians of what each neighbour says withstand wrong ones; its part of the transformation is that of all matches.
    affine = _affine(one, other)
    moved = there + (colrow[:, None, :] - one[near]) @ affine.T
    expected: FloatArray = np.median(moved, axis=1)
    return expected


def _affine(one: FloatArray, other: FloatArray) -> FloatArray:
    """Derivatives (2, 2) of an affine transformation through matches, by medians of pairs that lie apart."""
    random = np.random.default_rng(0)
    triples = random.integers(0, len(one), (500, 3))
    base, image = (x[triples[:, 1:]] - x[triples[:, :1]] for x in (one, other))
    area = np.abs(np.linalg.det(base))
    wide = area > 0.5 * np.median(area)
    every = np.linalg.solve(base[wide], image[wide]).transpose(0, 2, 1)
    return np.median(every, axis=0)


def epipolar_lines(fundamental: FloatArray, colrow: FloatArray) -> FloatArray:
    """Epipolar lines (N, 3), normalised, in the second image of places (N, 2) in the first.

    Parameters
    ----------
    fundamental : array (3, 3)
        Fundamental matrix F, with x'ᵀ·F·x = 0 for places x, x' of the first and second image.
    colrow : array (N, 2)
        Places in the first image, pixels.

    Returns
    -------
    array (N, 3)
        a, b, c of a·col + b·row + c = 0, with a² + b² = 1.
    """
    lines = np.column_stack([colrow, np.ones(len(colrow))]) @ fundamental.T
    length = np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    unit: FloatArray = lines / np.maximum(length, 1e-300)
    return unit
