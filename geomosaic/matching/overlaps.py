"""Pairs of images that can show the same: after their footprints, their positions, or their pictures alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from geomosaic.matching.features import UNIT, Features
from geomosaic.types import Float32Array, FloatArray, IntArray

if TYPE_CHECKING:
    from shapely import Polygon

# Number of images up to which all pairs are tried where nothing is known of their places.
ALL_PAIRS = 60
# Centres of clusters of descriptors, uint8 (64, 128), made by data/make_vocabulary.py. Words of the images themselves
# would be others with one photo more, and a quarter of all pairs with them.
VOCABULARY = Path(__file__).with_name("vocabulary.npy")
# Images that are held against all others at once: memory grows with the images, not with their square.
BLOCK = 256


def all_pairs(count: int) -> IntArray:
    """All pairs (P, 2) of images.

    Parameters
    ----------
    count : int
        Number of images.

    Returns
    -------
    int array (P, 2)
        Numbers of two images, the lower one first.
    """
    return np.stack(np.triu_indices(count, 1), axis=1).astype(np.int64)


def pairs_of_neighbours(places: FloatArray, neighbours: int) -> IntArray:
    """Pairs (P, 2) of images whose cameras are neighbours.

    Parameters
    ----------
    places : array (M, 2)
        Camera positions, metres.
    neighbours : int
        Images that each is paired with.
    """
    count = min(neighbours, len(places) - 1)
    _, near = cKDTree(places).query(places, k=count + 1)
    pairs = np.stack([np.repeat(np.arange(len(places)), count + 1), near.ravel()], axis=1)
    return np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)


def pairs_of_outlines(outlines: Sequence[Polygon], neighbours: int) -> IntArray:
    """Pairs (P, 2) of images whose footprints overlap.

    Parameters
    ----------
    outlines : sequence of Polygon
        In one map.
    neighbours : int
        Images that each is paired with at least: those with which it shares the largest part of the smaller of both.
    """
    from shapely import STRtree, area, intersection

    shapes = np.array(outlines, dtype=object)
    one, other = STRtree(shapes).query(shapes, predicate="intersects")
    one, other = one[one != other], other[one != other]
    size = area(shapes)
    shared = area(intersection(shapes[one], shapes[other])) / np.minimum(size[one], size[other])
    order = np.lexsort((other, -shared, one))
    starts = np.searchsorted(one[order], np.arange(len(shapes)))
    rank = np.arange(len(order)) - starts[one[order]]
    kept = order[(rank < neighbours) & (shared[order] > 0.0)]
    pairs: IntArray = np.unique(np.sort(np.stack([one[kept], other[kept]], axis=1), axis=1), axis=0)
    return pairs.astype(np.int64)


def similar_pairs(features: Sequence[Features], count_similar: int) -> IntArray:
    """Pairs (P, 2) of images whose features look alike.

    Each image is described by one vector, the sums of its descriptors' differences from the nearest of a few visual
    words (VLAD: Jégou et al., 2010), and paired with those of the most similar vectors. The words are always the same,
    so that the vector of an image depends on nothing but the image.

    Parameters
    ----------
    features : sequence of Features
    count_similar : int
        Images that each is paired with.
    """
    # Beside images that show nothing in common, one without features would pass for alike.
    some = np.flatnonzero([len(each) for each in features])
    if len(some) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    vectors = _described([features[k] for k in some.tolist()])
    count = min(count_similar, len(some) - 1)
    nearest = np.empty((len(some), count), dtype=np.int64)
    for first in range(0, len(some), BLOCK):
        apart = -vectors[first : first + BLOCK] @ vectors.T
        np.fill_diagonal(apart[:, first:], np.inf)
        nearest[first : first + BLOCK] = np.argpartition(apart, count - 1, axis=1)[:, :count]
    pairs = some[np.stack([np.repeat(np.arange(len(some)), count), nearest.ravel()], axis=1)]
    return np.unique(np.sort(pairs, axis=1), axis=0)


def _described(features: Sequence[Features]) -> Float32Array:
    """Unit vectors (M, words · 128), one for each image."""
    words = np.load(VOCABULARY, allow_pickle=False).astype(np.float32)
    vectors = np.zeros((len(features), words.size), dtype=np.float32)
    for vector, each in zip(vectors, features, strict=True):
        values, by_word = each.descriptors.astype(np.float32), vector.reshape(words.shape)
        nearest = _nearest_words(values, words)
        np.add.at(by_word, nearest, (values - words[nearest]) / np.float32(UNIT))
        # Each word by itself, then the whole: what repeats over an image (waves, crops) must not outweigh the rest.
        by_word /= np.maximum(np.linalg.norm(by_word, axis=1, keepdims=True), 1e-12)
        vector /= np.maximum(np.linalg.norm(vector), 1e-12)
    return vectors


def _nearest_words(values: Float32Array, words: Float32Array) -> IntArray:
    """Number (N,) of the nearest word (W, 128) of each descriptor (N, 128)."""
    nearest: IntArray = np.argmin((words**2).sum(axis=1) - 2.0 * values @ words.T, axis=1)
    return nearest
