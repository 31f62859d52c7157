"""Datum of a block in which no control, position or distance says where, how turned or how large it is.

All shifts, turns and scales of the whole block fit its measurements alike. Of these solutions the one is taken that
moves the points least from where they began (inner constraints, Helmert; Meissl 1969). The changes of other unknowns
that go with a change dX of the points follow from the equations A·dp = −B·dX: of an image's parameters from its own
image positions, whatever its sensor is, of a plane or a line from the points on it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomosaic.estimation.network import FreeDatum, Observations
from geomosaic.orientation.block.observations import ImagePositions
from geomosaic.orientation.block.unknowns import BlockState, BlockUnknowns
from geomosaic.types import FloatArray, IntArray

# Residual in standard deviations (RMS), for a change as large as the block, from which on a direction is observed, and
# not free: lakes hold tilts by thousands, and noise of points on a line turns with it by about one.
OBSERVED = 30.0

# Share of the largest eigenvalue of an image's normal equations from which on they are as good as its singular values.
WEAKEST = 1e-8


def free_datum(
    views: Observations,
    others: Sequence[Observations],
    positions: ImagePositions,
    state: BlockState,
    unknowns: BlockUnknowns,
    scale: bool,
) -> FreeDatum:
    """Inner constraints of a block.

    Parameters
    ----------
    views : Observations
        Linearised image positions, all of them.
    others : sequence of Observations
        What else was observed and takes part. Directions that they see are left out: a lake's shore holds two tilts.
    positions : ImagePositions
    state : BlockState
    unknowns : BlockUnknowns
    scale : bool
        Whether the scale is free as well; no distance was measured then.
    """
    points = _similarity_directions(state.points)[:, :, : 7 if scale else 6]
    count = points.shape[2]
    by_parameters = np.zeros((unknowns.count, count))
    by_point = positions.by_coordinates(views, unknowns)
    for image, rows in positions.slices:
        columns = unknowns.of_image(image)[: len(unknowns.image_parameters[image].names)]
        free = columns >= 0
        used = state.weights[0][rows] > 0.0
        if not free.any() or not used.any():
            continue
        design = views.by_parameters[rows][used][:, :, : len(columns)][:, :, free].reshape(-1, int(free.sum()))
        moved = (by_point[rows][used] @ points[positions.points[rows][used]]).reshape(-1, count)
        by_parameters[columns[free]] = _following(design, moved)
    chosen = np.zeros(unknowns.count, dtype=np.bool_)
    for point, columns in unknowns.kept_columns.items():
        by_parameters[columns], chosen[columns] = points[point], True
    for group in range(len(unknowns.further)):
        columns = unknowns.of_further(group)
        columns = columns[columns >= 0]
        designs, moves = [np.zeros((0, len(columns)))], [np.zeros((0, count))]
        for found in others:
            mine = np.isin(found.columns, columns).any(axis=1)
            if mine.any():
                moves.append(_seen(found, by_parameters, points)[mine].reshape(-1, count))
                designs.append(_design(found, columns)[mine].reshape(-1, len(columns)))
        by_parameters[columns] = _following(np.vstack(designs), np.vstack(moves))
    moving = state.moving.copy()
    moving[unknowns.kept] = False
    unseen = _unobserved(others, by_parameters, points, state)
    by_parameters, coordinates = by_parameters @ unseen, points[moving].reshape(-1, count) @ unseen
    return FreeDatum(
        np.vstack([by_parameters, coordinates]), np.concatenate([chosen, np.ones(len(coordinates), dtype=np.bool_)])
    )


def _following(design: FloatArray, moved: FloatArray) -> FloatArray:
    """Changes (U, F) of unknowns that take back what changes of the points move (R, F)."""
    # Columns of unlike units: degrees move an image a thousand times as far as metres.
    length = np.linalg.norm(design, axis=0)
    length = np.where(length > 0.0, length, 1.0)
    scaled = design / length
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    if values.min(initial=np.inf) > WEAKEST * values.max(initial=0.0):
        # Of thousands of rows singular values would take most of a round; a second solution gives the lost digits back.
        inverse = (vectors / values) @ vectors.T
        found = inverse @ (scaled.T @ moved)
        found += inverse @ (scaled.T @ (moved - scaled @ found))
    else:
        found = np.linalg.lstsq(scaled, moved, rcond=None)[0]
    follows: FloatArray = -found / length[:, None]
    return follows


def _design(found: Observations, columns: IntArray) -> FloatArray:
    """Derivatives (N, K, U) by some of the parameters."""
    design: FloatArray = np.einsum("nkp,npu->nku", found.by_parameters, found.columns[:, :, None] == columns)
    return design


def _seen(found: Observations, by_parameters: FloatArray, points: FloatArray) -> FloatArray:
    """Changes (N, K, F) of observations by directions of all parameters (U, F) and points (S, 3, F)."""
    known = found.columns >= 0
    own = np.where(known[:, :, None], by_parameters[np.where(known, found.columns, 0)], 0.0)
    seen: FloatArray = np.einsum("nkp,npf->nkf", found.by_parameters, own)
    there = found.point >= 0
    seen[there] += found.by_point[there] @ points[found.point[there]]
    return seen


def _unobserved(
    others: Sequence[Observations], by_parameters: FloatArray, points: FloatArray, state: BlockState
) -> FloatArray:
    """Combinations (F, G) of the directions that no observation sees."""
    count = points.shape[2]
    rows = [np.zeros((0, count)), *(_seen(found, by_parameters, points).reshape(-1, count) for found in others)]
    seen = np.vstack(rows)
    moving = points[state.moving]
    length = np.sqrt((moving**2).sum(axis=(0, 1)) / max(1, len(moving)))
    off = state.points[state.moving] - state.points[state.moving].mean(axis=0)
    size = float(np.sqrt((off**2).sum(axis=1).mean()))
    information = (seen / length).T @ (seen / length) * size**2
    values, vectors = np.linalg.eigh(information)
    free = values < OBSERVED**2 * max(1, len(seen))
    if free.all():
        return np.eye(count)
    combined: FloatArray = vectors[:, free] / length[:, None]
    return combined


def _similarity_directions(points: FloatArray) -> FloatArray:
    """Changes (S, 3, 7) of points (S, 3), metres, by three shifts, three turns and a scale of all of them."""
    x, y, z = points.T
    zero, one = np.zeros_like(x), np.ones_like(x)
    columns = [
        (one, zero, zero), (zero, one, zero), (zero, zero, one),
        (zero, -z, y), (z, zero, -x), (-y, x, zero), (x, y, z),
    ]  # fmt: skip
    return np.stack([np.stack(column, axis=1) for column in columns], axis=2)
