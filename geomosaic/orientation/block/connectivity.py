"""Images of a block joined by common points, and the parts that nothing joins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from geomosaic.errors import SolveError, counted
from geomosaic.types import FloatArray, IntArray

# Common points that join two images: the five of a relative orientation, and one that checks it.
LEAST_COMMON = 6
# Common points are on one line if they scatter across it by less than this share of their scatter along it.
THINNEST = 0.01


class UndeterminedError(SolveError):
    """Parts of a block are held by nothing; the rest could be adjusted without them.

    Parameters
    ----------
    what, hint : str
    parts : sequence of int array
        Images of each part; empty where nothing would be left.
    """

    def __init__(self, what: str, *, hint: str, parts: Sequence[IntArray]) -> None:
        super().__init__(what, hint=hint)
        self.parts = tuple(parts)

    @property
    def count(self) -> int:
        """Number of images that are not held."""
        return sum(map(len, self.parts))


@dataclass(frozen=True, eq=False)
class Connectivity:
    """Pairs of images with common points, and the parts that they form.

    Attributes
    ----------
    pairs : int array (K, 2)
        Images joined, the lower number first; most common points first.
    common : int array (K,)
        Their common points.
    part : int array (M,)
        Part of each image, the one of most images being 0; an image that nothing joins is a part of its own.
    """

    pairs: IntArray
    common: IntArray
    part: IntArray

    @property
    def parts(self) -> list[IntArray]:
        """Images of each part."""
        order = np.argsort(self.part, kind="stable")
        return np.split(order, np.cumsum(np.bincount(self.part))[:-1]) if len(order) else []

    def text(self, names: Sequence[str]) -> str:
        """Parts by the names of their images, for messages."""
        alone = [names[part[0]] for part in self.parts if len(part) == 1]
        listing = [
            f"{counted(len(part), 'image')} ({_some([names[i] for i in part])})" for part in self.parts if len(part) > 1
        ]
        listing += [f"{counted(len(alone), 'image')} alone ({_some(alone)})"] if alone else []
        return f"{counted(len(self.parts), 'part')} without enough common points: {'; '.join(listing)}"


def connectivity(image: IntArray, point: IntArray, colrow: FloatArray, images: int) -> Connectivity:
    """Connectivity of a block: its images are joined in pairs by six common points that are not on one line.

    Parameters
    ----------
    image, point : int array (N,)
        Of each image position.
    colrow : array (N, 2)
        Pixels.
    images : int
        Number of images in the block.
    """
    shape = (images, int(point.max(initial=-1)) + 1)
    # About each image's own middle: moments of far-off numbers would lose the digits that tell a line from a strip.
    count = np.maximum(np.bincount(image, minlength=images), 1)
    middle = np.column_stack([np.bincount(image, axis, images) / count for axis in colrow.T])
    col, row = (colrow - middle[image]).T

    def over_images(values: FloatArray) -> sparse.csr_array:
        return sparse.csr_array((values, (image, point)), shape=shape)

    # A product of (images x points) matrices sums over common points, so the work grows with rays, not with pairs.
    seen = over_images(np.ones(len(image)))
    seen.data[:] = 1.0
    counts = sparse.coo_array(seen @ seen.T)
    joined = (counts.data >= LEAST_COMMON) & (counts.row != counts.col)
    first, second, common = counts.row[joined], counts.col[joined], counts.data[joined]
    sums = [
        np.asarray((over_images(values) @ seen.T).tocsr()[first, second]).ravel()
        for values in (col, row, col * col, col * row, row * row)
    ]
    # Both directions are looked at: a line in one image is enough.
    wide = _widths(common, *sums) > THINNEST
    keep = sparse.csr_array((np.where(wide, common, 0.0), (first, second)), shape=(images, images))
    both = sparse.coo_array(sparse.triu(keep.minimum(keep.T)))
    both.eliminate_zeros()
    order = np.lexsort((both.col, both.row, -both.data))
    pairs = np.column_stack([both.row, both.col])[order].astype(np.int64)
    raw = connected_components(sparse.csr_array(both), directed=False)[1]
    sizes = np.bincount(raw)
    rank = np.empty(len(sizes), dtype=np.int64)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    return Connectivity(pairs, both.data[order].astype(np.int64), rank[raw] if images else np.zeros(0, dtype=np.int64))


def _widths(
    count: FloatArray, u: FloatArray, v: FloatArray, uu: FloatArray, uv: FloatArray, vv: FloatArray
) -> FloatArray:
    """Scatter of points across their best line over that along it, of moments (K,) each."""
    a, b, c = (m / count - p * q / count**2 for m, p, q in ((uu, u, u), (uv, u, v), (vv, v, v)))
    spread = np.hypot((a - c) / 2, b)
    return np.sqrt(np.maximum((a + c) / 2 - spread, 0.0) / np.maximum((a + c) / 2 + spread, 1e-300))


def _some(names: Sequence[str]) -> str:
    """First names of a list, and that there are more."""
    return ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
