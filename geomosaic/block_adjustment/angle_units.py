"""Angles of an orientation table in another unit than declared, after the attitudes that an adjustment has found."""

from __future__ import annotations

import math

import numpy as np

from geomosaic.block_adjustment.start import StartBlock
from geomosaic.errors import listed
from geomosaic.inputs.adjusted import exterior_of
from geomosaic.orientation.block.adjustment import BlockAdjustment
from geomosaic.orientation.block.poses import Attitudes
from geomosaic.types import FloatArray

# Factors from angles as they were read to what they are, in words.
READINGS = {
    0.9: "gon (read as degrees)",
    1.0 / 0.9: "degrees (read as gon)",
    180.0 / math.pi: "radians (read as degrees)",
    math.pi / 180.0: "degrees (read as radians)",
}
TURNS = (0.0, 360.0, -360.0)
# Images without which it may be chance; share of the error that another unit may leave; degrees of an error worth it.
LEAST, BETTER, WORTH = 2, 0.2, 2.0


def unit_errors(start: StartBlock, found: BlockAdjustment) -> list[str]:
    """Notes on images whose omega, phi, kappa contradict the block, and agree with it in another unit.

    Parameters
    ----------
    start : StartBlock
        Orientations as they were read.
    found : BlockAdjustment
    """
    doubtful, wrong = set[int](), {each.index for each in found.wrong_groups}
    for number, (group, out) in enumerate(zip(found.problem.groups, found.rejected, strict=True)):
        if isinstance(group, Attitudes):
            doubtful |= set(group.image.tolist() if number in wrong else group.image[out].tolist())
    names, read, adjusted = list[str](), list[FloatArray](), list[FloatArray]()
    for index in sorted(doubtful):
        row, crs = start.rows[index], start.frames[index]
        if row is None or crs is None or not start.oriented[index] or set(row.angles) != {"omega", "phi", "kappa"}:
            continue
        pair = [exterior_of(model, None, crs) for model in (start.models[index], found.state.models[index])]
        if pair[0] is not None and pair[1] is not None:
            names.append(start.names[index])
            read.append(pair[0][0][3:])
            adjusted.append(pair[1][0][3:])
    if len(names) < LEAST:
        return []
    angles, true = np.array(read), np.array(adjusted)
    before = _off(angles, true)
    # What was read is known but for whole turns: kappa of 200 gon is 200 degrees, or minus 160.
    after = {
        factor: np.min([_off(factor * (angles + np.array([0.0, 0.0, turn])), true) for turn in TURNS], axis=0)
        for factor in READINGS
    }
    right = {factor: (before > WORTH) & (left < BETTER * before) for factor, left in after.items()}
    best = max(READINGS, key=lambda factor: (int(right[factor].sum()), -float(np.median(after[factor]))))
    chosen = right[best]
    if chosen.sum() < LEAST:
        return []
    off = float(np.median(before[chosen]))
    which = listed((name for name, one in zip(names, chosen, strict=True) if one), 4)
    return [
        f"the angles of {which} agree with the block as {READINGS[best]}: {off:.3g} degrees off as "
        f"they were read, {np.median(after[best][chosen]):.2g} so; give all angles of a table in one unit"
    ]


def _off(angles: FloatArray, adjusted: FloatArray) -> FloatArray:
    """Largest difference (N,) of angles (N, 3), degrees, whole turns apart."""
    found: FloatArray = np.abs(np.remainder(angles - adjusted + 180.0, 360.0) - 180.0).max(axis=1)
    return found
