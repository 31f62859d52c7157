"""Histogram matching: values of one image brought to the distribution of another's by rising curves.

A value goes to the value of equal rank: y = F⁻¹(G(x)), with G the distribution of the image and F that of its master
(Gonzalez and Woods, *Digital Image Processing*, section 3.3). Over whole images that needs no common ground. Over the
overlap both show the same ground, so that what one has more of, a lake, does not change the other's colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.radiometry.overlap_samples import LEAST_CELLS, Thumbnail
from geomosaic.types import AnyArray, FloatArray


@dataclass(frozen=True, eq=False)
class Curve:
    """A rising curve per band: straight between its knots, of one slope beyond them.

    Attributes
    ----------
    knots : sequence of (x, y)
        One pair of arrays (K,) per band, x rising.
    slope : float
        Beyond them.
    """

    knots: Sequence[tuple[FloatArray, FloatArray]]
    slope: float = 1.0

    @classmethod
    def identity(cls, bands: int) -> Curve:
        """Leave values as they are."""
        return cls([(np.zeros(1), np.zeros(1))] * bands)

    def __call__(self, values: AnyArray) -> FloatArray:
        """Apply to values (..., bands)."""
        out = np.empty(values.shape, dtype=np.float64)
        for band, (x, y) in enumerate(self.knots):
            plain = np.asarray(values[..., band], dtype=np.float64)
            beyond = np.minimum(plain - x[0], 0.0) + np.maximum(plain - x[-1], 0.0)
            out[..., band] = np.interp(plain, x, y) + self.slope * beyond
        return out

    def line(self) -> tuple[FloatArray, FloatArray]:
        """Gain and offset (bands,) between the quarters of the knots: what the curve does on the whole."""
        gain, offset = np.ones(len(self.knots)), np.zeros(len(self.knots))
        for band, (x, y) in enumerate(self.knots):
            low, high = len(x) // 4, (3 * (len(x) - 1)) // 4 if len(x) > 3 else len(x) - 1
            if x[high] > x[low]:
                gain[band] = (y[high] - y[low]) / (x[high] - x[low])
            offset[band] = np.mean(y) - gain[band] * np.mean(x)
        return gain, offset


RANKS = 256
"""Ranks at which two distributions are compared."""


def match(source: AnyArray, target: AnyArray) -> Curve:
    """Curve that brings values (N, bands) to the distribution of others (M, bands).

    Where a value stands for many ranks, as in images of 8 bits, it goes to the mean of theirs.
    """
    ranks = (np.arange(RANKS) + 0.5) / RANKS
    knots = []
    for band in range(source.shape[1]):
        x = np.quantile(source[:, band].astype(np.float64), ranks)
        y = np.quantile(target[:, band].astype(np.float64), ranks)
        values, which, count = np.unique(x, return_inverse=True, return_counts=True)
        knots.append((values, np.bincount(which, weights=y) / count))
    return Curve(knots)


def match_whole(pieces: Sequence[Thumbnail], master: Thumbnail) -> list[Curve]:
    """Bring each image to the distribution of the master, all that both show."""
    target = master.values[master.valid > 0]
    curves = []
    for piece in pieces:
        own = piece.values[piece.valid > 0]
        enough = piece is not master and min(len(own), len(target)) >= LEAST_CELLS
        curves.append(match(own, target) if enough else Curve.identity(piece.values.shape[2]))
    return curves


def match_overlaps(pieces: Sequence[Thumbnail], master: Thumbnail) -> tuple[list[Curve], list[int]]:
    """Bring images to the master one after the other, each over what it shares with those already done.

    The next one is always that which shares most. `master` is one of the pieces, or a picture of its own.

    Returns
    -------
    curves : list of Curve
    alone : list of int
        Images that no chain of overlaps joins to the master; they stay as they are.
    """
    bands = master.values.shape[2]
    curves: dict[int, Curve] = {i: Curve.identity(bands) for i, piece in enumerate(pieces) if piece is master}
    own: list[list[AnyArray]] = [[] for _ in pieces]
    others: list[list[FloatArray]] = [[] for _ in pieces]
    shared = np.zeros(len(pieces), dtype=np.int64)

    def meet(done: Thumbnail, curve: Curve) -> None:
        for i, piece in enumerate(pieces):
            if i not in curves and (found := common(piece, done)) is not None:
                own[i].append(found[0])
                others[i].append(curve(found[1]))
                shared[i] += len(found[0])

    meet(master, Curve.identity(bands))
    while True:
        waiting = [i for i in range(len(pieces)) if i not in curves and shared[i] >= LEAST_CELLS]
        if not waiting:
            break
        following = max(waiting, key=lambda i: (shared[i], -i))
        curves[following] = match(np.concatenate(own[following]), np.concatenate(others[following]))
        own[following], others[following] = [], []
        meet(pieces[following], curves[following])
    alone = [i for i in range(len(pieces)) if i not in curves]
    return [curves.get(i, Curve.identity(bands)) for i in range(len(pieces))], alone


def match_sequence(pieces: Sequence[Thumbnail], master: Thumbnail, first: int) -> list[Curve]:
    """Bring each image to the one before it: those after `first` in their order, then those before it, backwards.

    Two are matched over what both show, or, where they share too little, over all that each shows. `master` is the
    first of the pieces, or a picture of its own, which the first is brought to.
    """
    bands = master.values.shape[2]
    curves = [Curve.identity(bands) for _ in pieces]
    if master is not pieces[first]:
        curves[first] = _to(pieces[first], master, Curve.identity(bands))
    for order in (range(first + 1, len(pieces)), range(first - 1, -1, -1)):
        for i in order:
            before = i - 1 if i > first else i + 1
            curves[i] = _to(pieces[i], pieces[before], curves[before])
    return curves


def _to(piece: Thumbnail, other: Thumbnail, curve: Curve) -> Curve:
    found = common(piece, other)
    if found is None or len(found[0]) < LEAST_CELLS:
        found = piece.values[piece.valid > 0], other.values[other.valid > 0]
    if min(len(found[0]), len(found[1])) < LEAST_CELLS:
        return Curve.identity(piece.values.shape[2])
    return match(found[0], curve(found[1]))


def common(one: Thumbnail, other: Thumbnail) -> tuple[AnyArray, AnyArray] | None:
    """Values (N, bands) of two images where both are known; None where they share nothing."""
    window = one.window.intersection(other.window)
    if window.empty:
        return None
    views = []
    for piece in (one, other):
        here = window.slices_in(piece.window)
        views.append((piece.values[here], piece.valid[here] > 0))
    seen = views[0][1] & views[1][1]
    return (views[0][0][seen], views[1][0][seen]) if seen.any() else None
