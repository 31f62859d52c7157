"""Datum of a block in which no control, position or distance says where, how turned or how large it is.

All shifts, turns and scales of the whole block fit its measurements alike. Of these solutions the one is taken that
moves the points least from where they began (inner constraints, Helmert; Meissl 1969). The changes of an image's
parameters that go with a change dX of the points follow from its own equations A·dp = −B·dX, whatever its sensor is.
"""

from __future__ import annotations

import numpy as np

from geomosaic.estimation.network import FreeDatum, Observations
from geomosaic.orientation.block.observations import ImagePositions
from geomosaic.orientation.block.unknowns import BlockState, BlockUnknowns
from geomosaic.types import FloatArray


def free_datum(
    views: Observations, positions: ImagePositions, state: BlockState, unknowns: BlockUnknowns, scale: bool
) -> FreeDatum:
    """Inner constraints of a block.

    Parameters
    ----------
    views : Observations
        Linearised image positions, all of them.
    positions : ImagePositions
    state : BlockState
    unknowns : BlockUnknowns
    scale : bool
        Whether the scale is free as well; no distance was measured then.
    """
    points = similarity_directions(state.points)[:, :, : 7 if scale else 6]
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
        # Columns of unlike units: degrees move an image a thousand times as far as metres.
        length = np.linalg.norm(design, axis=0)
        length = np.where(length > 0.0, length, 1.0)
        by_parameters[columns[free]] = -np.linalg.lstsq(design / length, moved, rcond=None)[0] / length[:, None]
    chosen = np.zeros(unknowns.count, dtype=np.bool_)
    for point, columns in unknowns.kept_columns.items():
        by_parameters[columns], chosen[columns] = points[point], True
    moving = state.moving.copy()
    moving[unknowns.kept] = False
    coordinates = points[moving].reshape(-1, count)
    return FreeDatum(
        np.vstack([by_parameters, coordinates]), np.concatenate([chosen, np.ones(len(coordinates), dtype=np.bool_)])
    )


def similarity_directions(points: FloatArray) -> FloatArray:
    """Changes (S, 3, 7) of points (S, 3) by three shifts, three turns and a scale of all of them.

    Parameters
    ----------
    points : array (S, 3)
        In the block's frame, metres.
    """
    x, y, z = points.T
    zero, one = np.zeros_like(x), np.ones_like(x)
    columns = [
        (one, zero, zero), (zero, one, zero), (zero, zero, one),
        (zero, -z, y), (z, zero, -x), (-y, x, zero), (x, y, z),
    ]  # fmt: skip
    return np.stack([np.stack(column, axis=1) for column in columns], axis=2)
