"""Displacement of one picture against another from places found in both: a shift, an affine one, or a local field.

Which of them the places bear is told by places left out of the fit: a model of more parameters counts only where it
predicts them better than chance would have it (signed-rank test).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geomosaic.estimation.statistics import MAD_TO_SIGMA, signed_rank_probability
from geomosaic.matching.two_view import expected_places
from geomosaic.sensor.corrected import CorrectionGrid
from geomosaic.types import BoolArray, FloatArray, IntArray

KINDS = ("none", "shift", "affine", "local")
# Parts into which places are cut, each predicted by the others.
FOLDS = 5
# Probability of chance below which more parameters are believed.
ALPHA = 0.01
# Places in a cell of a local field, and its nodes along the longer side at most.
PER_NODE, MOST_NODES = 3, 24
# Weights of the field's curvature, of which the places choose one.
STIFF = (0.01, 0.1, 1.0, 10.0, 100.0)
# Pixels that matching itself may be off as a whole: what changes no place by more is none.
LEAST = 0.01
# Places that are too few to judge a field by, and to judge neighbours by.
LEAST_LOCAL, LEAST_NEIGHBOURS = 40, 20


@dataclass(frozen=True, eq=False)
class Displacement:
    """Places in a picture from where its georeference puts them.

    Attributes
    ----------
    kind : str
        One of `KINDS`: what the places bear, at most what was asked for.
    matrix : array (2, 3)
        Affine part: predicted (col, row, 1) to measured (col, row), pixels.
    field : CorrectionGrid, optional
        What a local one adds, at places after the affine part.
    kept : bool array (N,)
        Places that do not contradict their neighbours.
    residuals : array (N, 2)
        Measured minus computed, pixels.
    held_out : mapping of str to float
        RMS in one axis, pixels, at places left out of the fit of each kind that was tried.
    """

    kind: str
    matrix: FloatArray
    field: CorrectionGrid | None
    kept: BoolArray
    residuals: FloatArray
    held_out: Mapping[str, float]

    @property
    def rms(self) -> float:
        """RMS of the residuals that were kept, one axis, pixels."""
        return float(np.sqrt((self.residuals[self.kept] ** 2).mean()))


def displacement(predicted: FloatArray, measured: FloatArray, size: tuple[int, int], kind: str) -> Displacement:
    """Displacement of measured places against predicted ones.

    Parameters
    ----------
    predicted, measured : array (N, 2)
        Pixels of a picture.
    size : (int, int)
        Its width and height.
    kind : str
        The one of most parameters that is wanted: 'shift', 'affine' or 'local'.
    """
    kept = consistent(predicted, measured)
    one, other = predicted[kept], measured[kept]
    tried = [name for name in KINDS[: KINDS.index(kind) + 1] if name != "local" or len(one) >= LEAST_LOCAL]
    fold = np.random.default_rng(0).permutation(len(one)) % FOLDS
    stiff = _stiffness(one, other, size, fold) if "local" in tried else STIFF[0]
    errors = {name: _left_out(one, other, size, name, stiff, fold) for name in tried}
    chosen, (matrix, field) = tried[0], _fit(one, other, size, tried[0], stiff)
    for name in tried[1:]:
        before, after = (np.linalg.norm(errors[each], axis=1) for each in (chosen, name))
        better = np.sqrt((after**2).mean()) < np.sqrt((before**2).mean())
        fitted = _fit(one, other, size, name, stiff)
        moves = np.abs(_moved(*fitted, one) - _moved(matrix, field, one)).max() > LEAST
        if better and moves and signed_rank_probability(before - after) < ALPHA:
            chosen, (matrix, field) = name, fitted
    residuals = measured - _moved(matrix, field, predicted)
    rms = {name: float(np.sqrt((left**2).mean())) for name, left in errors.items()}
    return Displacement(chosen, matrix, field, kept, residuals, rms)


def consistent(predicted: FloatArray, measured: FloatArray) -> BoolArray:
    """Places that lie where those around them would put them, within 3.5 times the scatter.

    Parameters
    ----------
    predicted, measured : array (N, 2)

    Returns
    -------
    bool array (N,)
    """
    if len(predicted) < LEAST_NEIGHBOURS:
        return np.ones(len(predicted), dtype=bool)
    away = np.linalg.norm(measured - expected_places(predicted, predicted, measured, itself=False), axis=1)
    kept: BoolArray = away <= 3.5 * max(MAD_TO_SIGMA * float(np.median(away)), 0.02)
    return kept


def _fit(
    one: FloatArray, other: FloatArray, size: tuple[int, int], kind: str, stiff: float
) -> tuple[FloatArray, CorrectionGrid | None]:
    """Affine matrix (2, 3), and the field of a local displacement."""
    matrix = np.eye(2, 3)
    if kind == "shift":
        matrix[:, 2] = (other - one).mean(axis=0)
    elif kind in ("affine", "local"):
        middle = one.mean(axis=0)
        design = np.column_stack([one - middle, np.ones(len(one))])
        linear = np.linalg.lstsq(design, other, rcond=None)[0].T
        matrix = np.column_stack([linear[:, :2], linear[:, 2] - linear[:, :2] @ middle])
    if kind != "local":
        return matrix, None
    ideal = one @ matrix[:, :2].T + matrix[:, 2]
    return matrix, _field(ideal, other - ideal, size, stiff)


def _field(places: FloatArray, off: FloatArray, size: tuple[int, int], stiff: float) -> CorrectionGrid:
    """Field through displacements (N, 2) at places (N, 2), smooth where there are none."""
    count = int(np.clip(np.sqrt(len(places) / PER_NODE), 2, MOST_NODES))
    step = max(size) / count
    cols, rows = (int(np.ceil(length / step)) + 1 for length in size)
    empty = CorrectionGrid(np.zeros(2), np.full(2, step), np.zeros((rows, cols, 2)), beyond="held")
    index, weight = empty.weights(np.clip(places, 0.0, np.array(size, dtype=np.float64)))
    design = np.zeros((len(places), rows * cols))
    np.add.at(design, (np.arange(len(places))[:, None, None], index.astype(np.int64)), weight)
    bent = np.vstack([_curvature(rows, cols), 1e-3 * np.eye(rows * cols)]) * np.sqrt(stiff)
    normal = design.T @ design + bent.T @ bent
    nodes = np.linalg.solve(normal, design.T @ off)
    return CorrectionGrid(empty.origin, empty.spacing, nodes.reshape(rows, cols, 2), beyond="held")


def _curvature(rows: int, cols: int) -> FloatArray:
    """Second differences (D, rows · cols) of a grid along both directions and across."""
    number: IntArray = np.arange(rows * cols).reshape(rows, cols)
    terms = (number[:, :-2], number[:, 1:-1], number[:, 2:]), (number[:-2], number[1:-1], number[2:])
    parts = [np.zeros((0, rows * cols))]
    for left, middle, right in terms:
        part = np.zeros((middle.size, rows * cols))
        each = np.arange(middle.size)
        part[each, left.ravel()], part[each, middle.ravel()], part[each, right.ravel()] = 1.0, -2.0, 1.0
        parts.append(part)
    across = np.zeros(((rows - 1) * (cols - 1), rows * cols))
    each = np.arange(len(across))
    for corner, sign in (
        (number[:-1, :-1], 1.0),
        (number[1:, 1:], 1.0),
        (number[1:, :-1], -1.0),
        (number[:-1, 1:], -1.0),
    ):
        across[each, corner.ravel()] = sign
    return np.vstack([*parts, across])


def _moved(matrix: FloatArray, field: CorrectionGrid | None, places: FloatArray) -> FloatArray:
    ideal: FloatArray = places @ matrix[:, :2].T + matrix[:, 2]
    return ideal if field is None else ideal + field.at(ideal)


def _left_out(
    one: FloatArray, other: FloatArray, size: tuple[int, int], kind: str, stiff: float, fold: IntArray
) -> FloatArray:
    """Errors (N, 2) at each place under the fit to those of the other folds (N,)."""
    errors = np.zeros_like(one)
    for part in range(FOLDS):
        out = fold == part
        errors[out] = other[out] - _moved(*_fit(one[~out], other[~out], size, kind, stiff), one[out])
    return errors


def _stiffness(one: FloatArray, other: FloatArray, size: tuple[int, int], fold: IntArray) -> float:
    """Weight of the curvature under which a field predicts best."""
    errors = [float((_left_out(one, other, size, "local", stiff, fold) ** 2).sum()) for stiff in STIFF]
    return STIFF[int(np.argmin(errors))]
