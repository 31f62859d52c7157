"""One linear correction per image and band, from what overlapping images show of the same ground.

Corrected values are g·v + o. Over all overlaps the sum of squared differences (gᵢ·vᵢ + oᵢ) − (gⱼ·vⱼ + oⱼ) is made
small, with the mean gain held at 1 and the mean offset at 0 in every group of connected images: without that, making
everything black would be the best fit. Samples that disagree with the rest (moving things, leaning houses) lose their
weight by Huber's rule.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.types import FloatArray

ROUNDS = 6
HUBER = 1.345


@dataclass(frozen=True)
class Overlap:
    """The same ground in two images.

    Attributes
    ----------
    first, second : int
        Numbers of the images.
    a, b : array (N, bands)
        Values in the first and in the second.
    """

    first: int
    second: int
    a: FloatArray
    b: FloatArray


@dataclass(frozen=True)
class Balance:
    """The solution.

    Attributes
    ----------
    gain, offset : array (images, bands)
    before, after : array (bands,)
        Root mean square difference over all overlaps without and with the correction; NaN without overlaps.
    overlaps : int
        Pairs of images used.
    """

    gain: FloatArray
    offset: FloatArray
    before: FloatArray
    after: FloatArray
    overlaps: int


def solve(images: int, bands: int, overlaps: list[Overlap]) -> Balance:
    """Solve gains and offsets of all images, band by band.

    An image without overlaps keeps gain 1 and offset 0.
    """
    gain, offset = np.ones((images, bands)), np.zeros((images, bands))
    before, after = np.full(bands, np.nan), np.full(bands, np.nan)
    used = [overlap for overlap in overlaps if len(overlap.a)]
    for band in range(bands):
        if not used:
            break
        gain[:, band], offset[:, band] = _solve_band(images, used, band)
        plain, mended = [], []
        for pair in used:
            i, j, a, b = pair.first, pair.second, pair.a[:, band], pair.b[:, band]
            plain.append(a - b)
            mended.append(gain[i, band] * a + offset[i, band] - gain[j, band] * b - offset[j, band])
        before[band] = float(np.sqrt(np.mean(np.concatenate(plain) ** 2)))
        after[band] = float(np.sqrt(np.mean(np.concatenate(mended) ** 2)))
    return Balance(gain, offset, before, after, len(used))


def _solve_band(images: int, overlaps: list[Overlap], band: int) -> tuple[FloatArray, FloatArray]:
    scale = max(1e-12, float(np.mean([np.abs(pair.a[:, band]).mean() for pair in overlaps])))
    pairs = [(p.first, p.second, p.a[:, band] / scale, p.b[:, band] / scale) for p in overlaps]
    groups = _groups(images, pairs)
    weights = [np.ones(len(a)) for _, _, a, _ in pairs]
    gain, offset = np.ones(images), np.zeros(images)
    for _ in range(ROUNDS):
        gain, offset = _least_squares(images, pairs, weights, groups)
        residuals = [gain[i] * a + offset[i] - gain[j] * b - offset[j] for i, j, a, b in pairs]
        spread = 1.4826 * float(np.median(np.abs(np.concatenate(residuals))))
        if spread < 1e-9:
            break
        weights = [np.minimum(1.0, HUBER * spread / np.maximum(np.abs(r), 1e-30)) for r in residuals]
    if not (np.isfinite(gain).all() and np.isfinite(offset).all()):
        raise SolveError("the colour balance has no solution", mend="run with --no-balance")
    return gain, offset * scale


def _least_squares(
    images: int, pairs: list[tuple[int, int, FloatArray, FloatArray]], weights: list[FloatArray], groups: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Weighted normal equations, bordered by the two conditions of each group."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import splu

    rows, cols, values = [], [], []
    for (i, j, a, b), w in zip(pairs, weights, strict=True):
        terms = ((2 * i, a), (2 * i + 1, np.ones_like(a)), (2 * j, -b), (2 * j + 1, -np.ones_like(b)))
        for p, x in terms:
            for q, y in terms:
                rows.append(p)
                cols.append(q)
                values.append(float(np.sum(w * x * y)))
    number = int(groups.max()) + 1
    size = 2 * images
    # Where an overlap shows one tone only, gain and offset cannot be told apart: a whisper of a prior decides.
    total = sum(float(w.sum()) for w in weights)
    prior = 1e-11 * total / max(1, len(pairs))
    right = np.zeros(size + 2 * number)
    for k in range(images):
        rows += [2 * k, 2 * k + 1]
        cols += [2 * k, 2 * k + 1]
        values += [prior, prior]
        right[2 * k] = prior
        border = size + 2 * int(groups[k])
        for row, col in ((border, 2 * k), (border + 1, 2 * k + 1)):
            rows += [row, col]
            cols += [col, row]
            values += [1.0, 1.0]
        right[border] += 1.0
    matrix = coo_matrix((values, (rows, cols)), shape=(len(right), len(right))).tocsc()
    solution: FloatArray = splu(matrix).solve(right)
    return solution[0:size:2], solution[1:size:2]


def _groups(images: int, pairs: list[tuple[int, int, FloatArray, FloatArray]]) -> FloatArray:
    """Number the groups of images that overlaps connect."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    i, j = [p[0] for p in pairs], [p[1] for p in pairs]
    graph = coo_matrix((np.ones(len(pairs)), (i, j)), shape=(images, images))
    groups: FloatArray = connected_components(graph, directed=False)[1]
    return groups
