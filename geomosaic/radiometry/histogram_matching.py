"""Histogram matching: values of one image brought to the distribution of another's by rising tone curves.

A value goes to the value of equal rank: y = F⁻¹(G(x)), with G the distribution of the image and F that of its master
(Gonzalez and Woods, *Digital Image Processing*, section 3.3). Over whole images that needs no common ground. Over the
overlap both show the same ground, so that what one has more of, a lake, does not change the other's colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from heapq import heappop, heappush

import numpy as np

from geomosaic.radiometry.corrections import ToneCurve
from geomosaic.radiometry.overlaps import MIN_CELLS, Thumbnail, partners_of_pieces
from geomosaic.types import AnyArray, FloatArray

# Ranks at which two distributions are compared.
RANKS = 256


def matching_curve(source: AnyArray, target: AnyArray) -> ToneCurve:
    """Curve that brings values to the distribution of others.

    Parameters
    ----------
    source : array (N, bands)
    target : array (M, bands)

    Returns
    -------
    ToneCurve
        With at most `RANKS` knots per band.
    """
    # Where a value stands for many ranks, as in images of 8 bits, it goes to the mean of theirs.
    # Middles of equal classes: the least and the largest value, often outliers, are no knots.
    ranks = (np.arange(RANKS) + 0.5) / RANKS
    knots = []
    for band in range(source.shape[1]):
        x = np.quantile(source[:, band].astype(np.float64), ranks)
        y = np.quantile(target[:, band].astype(np.float64), ranks)
        values, which, count = np.unique(x, return_inverse=True, return_counts=True)
        knots.append((values, np.bincount(which, weights=y) / count))
    return ToneCurve(knots)


def match_whole(pieces: Sequence[Thumbnail], master: Thumbnail) -> list[ToneCurve]:
    """Curves that match each image to the master over all that both show.

    Parameters
    ----------
    pieces : sequence of Thumbnail
    master : Thumbnail
        One of the pieces, or another image.

    Returns
    -------
    list of ToneCurve
        One per piece; the identity for the master, and where an image shows fewer than `MIN_CELLS` cells.
    """
    target = master.values[master.valid > 0]
    curves = []
    for piece in pieces:
        own = piece.values[piece.valid > 0]
        enough = piece is not master and min(len(own), len(target)) >= MIN_CELLS
        curves.append(matching_curve(own, target) if enough else ToneCurve.identity(piece.values.shape[2]))
    return curves


def match_overlaps(pieces: Sequence[Thumbnail], master: Thumbnail) -> tuple[list[ToneCurve], list[int]]:
    """Curves that match images to the master one after the other, each over its overlap with those already matched.

    The next one is always that with the largest overlap.

    Parameters
    ----------
    pieces : sequence of Thumbnail
    master : Thumbnail
        One of the pieces, or another image.

    Returns
    -------
    curves : list of ToneCurve
    alone : list of int
        Images that no chain of overlaps joins to the master; they stay as they are.
    """
    bands = master.values.shape[2]
    curves: dict[int, ToneCurve] = {i: ToneCurve.identity(bands) for i, piece in enumerate(pieces) if piece is master}
    own: list[list[AnyArray]] = [[] for _ in pieces]
    others: list[list[FloatArray]] = [[] for _ in pieces]
    shared = np.zeros(len(pieces), dtype=np.int64)
    partners = partners_of_pieces([*pieces, master])
    waiting: list[tuple[int, int]] = []  # the largest overlap first; of an image the last entry counts

    def meet(number: int, done: Thumbnail, curve: ToneCurve) -> None:
        for i in partners[number].tolist():
            if i < len(pieces) and i not in curves and (found := common_values(pieces[i], done)) is not None:
                own[i].append(found[0])
                others[i].append(curve(found[1]))
                shared[i] += len(found[0])
                if shared[i] >= MIN_CELLS:
                    # Equal overlaps in the order of the images, so that equal runs give equal curves.
                    heappush(waiting, (-int(shared[i]), i))

    meet(len(pieces), master, ToneCurve.identity(bands))
    while waiting:
        size, following = heappop(waiting)
        if following in curves or -size != shared[following]:
            continue
        curves[following] = matching_curve(np.concatenate(own[following]), np.concatenate(others[following]))
        own[following], others[following] = [], []
        meet(following, pieces[following], curves[following])
    alone = [i for i in range(len(pieces)) if i not in curves]
    return [curves.get(i, ToneCurve.identity(bands)) for i in range(len(pieces))], alone


def match_sequence(pieces: Sequence[Thumbnail], master: Thumbnail, first: int) -> list[ToneCurve]:
    """Curves that match each image to the one before it: those after `first` in order, then those before it, backwards.

    Two are matched over their overlap, or, where it is too small, over all that each shows.

    Parameters
    ----------
    pieces : sequence of Thumbnail
    master : Thumbnail
        The first of the pieces, or another image, which the first is matched to.
    first : int
        Number of the first piece.
    """
    bands = master.values.shape[2]
    curves = [ToneCurve.identity(bands) for _ in pieces]
    if master is not pieces[first]:
        curves[first] = _matched_to(pieces[first], master, ToneCurve.identity(bands))
    for order in (range(first + 1, len(pieces)), range(first - 1, -1, -1)):
        for i in order:
            before = i - 1 if i > first else i + 1
            curves[i] = _matched_to(pieces[i], pieces[before], curves[before])
    return curves


def _matched_to(piece: Thumbnail, other: Thumbnail, curve: ToneCurve) -> ToneCurve:
    found = common_values(piece, other)
    if found is None or len(found[0]) < MIN_CELLS:
        found = piece.values[piece.valid > 0], other.values[other.valid > 0]
    if min(len(found[0]), len(found[1])) < MIN_CELLS:
        return ToneCurve.identity(piece.values.shape[2])
    return matching_curve(found[0], curve(found[1]))


def common_values(one: Thumbnail, other: Thumbnail) -> tuple[AnyArray, AnyArray] | None:
    """Values of two images where both are valid.

    Parameters
    ----------
    one, other : Thumbnail
        On the same coarse grid.

    Returns
    -------
    tuple of array (N, bands), or None
        Of the first and of the second image; None where they share nothing.
    """
    window = one.window.intersection(other.window)
    if window.empty:
        return None
    views = []
    for piece in (one, other):
        here = window.slices_in(piece.window)
        views.append((piece.values[here], piece.valid[here] > 0))
    seen = views[0][1] & views[1][1]
    return (views[0][0][seen], views[1][0][seen]) if seen.any() else None
