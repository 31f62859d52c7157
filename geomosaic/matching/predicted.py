"""Two images whose sensor models say where each place of the first lies in the second, but for errors of these models.

The model of any sensor turns a place and a height into a place of the other image, and a change of height into a
movement along the epipolar curve. Errors of orientation shift and bend all curves alike: matches that agree with one
correction across them are right, whatever the heights. Along the curve neighbours say how far a match may go.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from geomosaic.estimation.statistics import MAD_TO_SIGMA
from geomosaic.matching.descriptors import Expected, match_descriptors
from geomosaic.matching.features import Features
from geomosaic.matching.two_view import LEAST_MATCHES, NEIGHBOURS, distinct, far_from_neighbours, large_features
from geomosaic.types import BoolArray, FloatArray, IntArray

# Rounds in which the correction is fitted to the matches that it leaves within reach.
ROUNDS = 6
# Share of an image's size within which features are compared along their curve, and from which matches are left out.
REACH, FAR = 0.06, 0.1


@dataclass(frozen=True, eq=False)
class Predicted:
    """Where models expect the places of one image in another.

    Attributes
    ----------
    colrow : array (N, 2)
        Pixels; NaN where nothing is expected.
    along : array (N, 2)
        Unit vectors along the epipolar curve there; zeros where heights move nothing.
    """

    colrow: FloatArray
    along: FloatArray

    def select(self, rows: BoolArray | IntArray) -> Predicted:
        """Some of them."""
        return Predicted(self.colrow[rows], self.along[rows])

    def parts(self, seen: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels across (N,) and along (N,) the curves by which places (N, 2) are off."""
        off = seen - self.colrow
        turned = np.stack([-self.along[:, 1], self.along[:, 0]], axis=1)
        return (off * turned).sum(axis=1), (off * self.along).sum(axis=1)


def match_predicted(first: Features, second: Features, predicted: Predicted, tolerance: float) -> IntArray | None:
    """Matches of two images, the first's places being expected in the second.

    Parameters
    ----------
    first, second : Features
    predicted : Predicted
        Of all features of the first.
    tolerance : float
        Pixels from the corrected epipolar curve beyond which no match is right.

    Returns
    -------
    int array (M, 2) or None
        Indices of features; None where too few matches agree.
    """
    there = np.flatnonzero(np.isfinite(predicted.colrow).all(axis=1))
    if len(there) < LEAST_MATCHES or not len(second):
        return None
    one = first.select(there)
    expected = predicted.select(there)
    large = [large_features(features) for features in (one, second)]
    some = match_descriptors(one.select(large[0]), second.select(large[1]))
    rough = _agreeing(
        one, second, np.stack([large[0][some[:, 0]], large[1][some[:, 1]]], axis=1), expected, 2 * tolerance
    )
    if rough is None:
        return None
    matches, correction = rough
    guided = match_descriptors(one, second, _corrected(one, second, matches, expected, correction, tolerance))
    found = _agreeing(one, second, guided, expected, tolerance) or rough
    return np.stack([there[found[0][:, 0]], found[0][:, 1]], axis=1)


def _agreeing(
    first: Features, second: Features, matches: IntArray, expected: Predicted, tolerance: float
) -> tuple[IntArray, FloatArray] | None:
    """Matches (M, 2) that agree with one correction across the curves, and its coefficients (3,); else None."""
    if len(matches) < LEAST_MATCHES:
        return None
    places = first.colrow[matches[:, 0]]
    across, _ = expected.select(matches[:, 0]).parts(second.colrow[matches[:, 1]])
    correction = _fitted(_terms(places, first), across, tolerance)
    kept = np.abs(across - _terms(places, first) @ correction) <= tolerance
    if kept.sum() < LEAST_MATCHES:
        return None
    one, other = places[kept], second.colrow[matches[kept, 1]]
    kept[kept] = ~far_from_neighbours(one, other, FAR * float(np.ptp(second.colrow, axis=0).max()))
    pairs = distinct(first, second, matches[kept])
    return (pairs, correction) if len(pairs) >= LEAST_MATCHES else None


def _terms(places: FloatArray, features: Features) -> FloatArray:
    """Constant and linear terms (N, 3) of a correction, about the middle of an image's features."""
    low, high = features.colrow.min(axis=0), features.colrow.max(axis=0)
    return np.column_stack([np.ones(len(places)), (2.0 * places - low - high) / np.maximum(high - low, 1.0).max()])


def _fitted(terms: FloatArray, across: FloatArray, tolerance: float) -> FloatArray:
    """Coefficients (3,) of the correction that most matches share."""
    # Wrong matches lie anywhere: the fullest interval is that of the right ones, in whose reach lines are fitted then.
    order = np.sort(across)
    end = np.searchsorted(order, order + 4.0 * tolerance, side="right")
    fullest = int(np.argmax(end - np.arange(len(order))))
    found = np.array([np.median(order[fullest : end[fullest]]), 0.0, 0.0])
    for _ in range(ROUNDS):
        near = np.abs(across - terms @ found) <= 2.0 * tolerance
        if near.sum() < LEAST_MATCHES:
            break
        found = np.linalg.lstsq(terms[near], across[near], rcond=None)[0]
    return found


def _corrected(
    first: Features, second: Features, matches: IntArray, expected: Predicted, correction: FloatArray, tolerance: float
) -> Expected:
    """Where features are expected after what the matches found so far say of the models and of the heights."""
    one = first.colrow[matches[:, 0]]
    _, along = expected.select(matches[:, 0]).parts(second.colrow[matches[:, 1]])
    count = min(NEIGHBOURS, len(one))
    tree = cKDTree(one)
    _, near = tree.query(first.colrow, k=count)
    _, mutual = tree.query(one, k=count)
    spread = MAD_TO_SIGMA * np.median(np.abs(along - np.median(along[mutual], axis=1)))
    reach = np.clip(6.0 * spread, 6.0 * tolerance, REACH * np.ptp(second.colrow, axis=0).max() + 6.0 * tolerance)
    across = _terms(first.colrow, first) @ correction
    turned = np.stack([-expected.along[:, 1], expected.along[:, 0]], axis=1)
    # Where heights move nothing there is no curve: all that is known is the place.
    places = expected.colrow + across[:, None] * turned + np.median(along[near], axis=1)[:, None] * expected.along
    lines = np.column_stack([turned, -(turned * places).sum(axis=1)])
    return Expected(places, lines, float(reach), 3.0 * tolerance)
