"""Angles of an orientation table in another unit than declared, after the attitudes that an adjustment has found."""

from __future__ import annotations

import math
from collections.abc import Iterable

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
# Key that mends a whole table. Read as radians, degrees are nearly zero whatever they were: that shows nothing.
KEYS = {0.9: 'angle_unit = "gon"', 1.0 / 0.9: 'angle_unit = "deg"'}
TURNS = (0.0, 360.0, -360.0)
# Images without which it may be chance; share of the error that another unit may leave; degrees of an error worth it.
LEAST, BETTER, WORTH = 2, 0.2, 2.0
# Quantile of images that stands for a whole table: strips to the north, whose kappa is zero, say little of the unit,
# and some images may be wrong.
MOST = 0.75


def unit_errors(start: StartBlock, found: BlockAdjustment) -> list[str]:
    """Notes on images whose omega, phi, kappa contradict the block, and agree with it in another unit.

    Parameters
    ----------
    start : StartBlock
        Orientations as they were read.
    found : BlockAdjustment
    """
    names, angles, true = _read_and_adjusted(start, found, range(len(start.names)))
    if len(names) < LEAST:
        return []
    before, after = _off(angles, true), _off_in_other_units(angles, true)
    best = min(KEYS, key=lambda factor: float(np.quantile(after[factor], MOST)))
    # One rotation that all images share, such as a compass that is off, may look like another unit.
    alike = _off(angles - _common_turn(angles, true), true)
    off, left, turned = (float(np.quantile(each, MOST)) for each in (before, after[best], alike))
    if off > WORTH and left < BETTER * off and left <= turned:
        other = (
            "" if left < BETTER * turned else ", unless one rotation turns all of them, such as a compass that is off"
        )
        return [
            f"the adjusted angles of {len(names)} images agree with their table as {READINGS[best]}: {off:.3g} "
            f"degrees off as they were read, {left:.2g} so; set {KEYS[best]}{other}"
        ]
    return _unit_errors_of_some(start, found, len(names))


def _unit_errors_of_some(start: StartBlock, found: BlockAdjustment, count: int) -> list[str]:
    """Notes on images, of `count`, whose attitudes contradict the block and agree with it in another unit."""
    doubtful, wrong = set[int](), {each.index for each in found.wrong_groups}
    for number, (group, out) in enumerate(zip(found.problem.groups, found.rejected, strict=True)):
        if isinstance(group, Attitudes):
            doubtful |= set(group.image.tolist() if number in wrong else group.image[out].tolist())
    names, angles, true = _read_and_adjusted(start, found, sorted(doubtful))
    if len(names) < LEAST:
        return []
    before, after = _off(angles, true), _off_in_other_units(angles, true)
    right = {factor: (before > WORTH) & (left < BETTER * before) for factor, left in after.items()}
    best = max(READINGS, key=lambda factor: (int(right[factor].sum()), -float(np.median(after[factor]))))
    chosen = right[best]
    if not LEAST <= chosen.sum() < count:
        return []
    off = float(np.median(before[chosen]))
    which = listed((name for name, one in zip(names, chosen, strict=True) if one), 4)
    return [
        f"the angles of {which} agree with the block as {READINGS[best]}: {off:.3g} degrees off as "
        f"they were read, {np.median(after[best][chosen]):.2g} so; give all angles of a table in one unit"
    ]


def _read_and_adjusted(
    start: StartBlock, found: BlockAdjustment, indices: Iterable[int]
) -> tuple[list[str], FloatArray, FloatArray]:
    """Names of the images (N) that have omega, phi, kappa, these as read, and as adjusted (N, 3), degrees."""
    names, read, adjusted = list[str](), list[FloatArray](), list[FloatArray]()
    for index in indices:
        row, crs = start.rows[index], start.frames[index]
        if row is None or crs is None or not start.oriented[index] or set(row.angles) != {"omega", "phi", "kappa"}:
            continue
        pair = [exterior_of(model, None, crs) for model in (start.models[index], found.state.models[index])]
        if pair[0] is not None and pair[1] is not None:
            names.append(start.names[index])
            read.append(pair[0][0][3:])
            adjusted.append(pair[1][0][3:])
    return names, np.array(read).reshape(-1, 3), np.array(adjusted).reshape(-1, 3)


def _off_in_other_units(angles: FloatArray, adjusted: FloatArray) -> dict[float, FloatArray]:
    """Largest difference (N,) of angles (N, 3), degrees, by the factor of each reading."""
    # What was read is known but for whole turns: kappa of 200 gon is 200 degrees, or minus 160.
    return {
        factor: np.min([_off(factor * (angles + np.array([0.0, 0.0, turn])), adjusted) for turn in TURNS], axis=0)
        for factor in READINGS
    }


def _common_turn(angles: FloatArray, adjusted: FloatArray) -> FloatArray:
    """Median difference (3,) of angles (N, 3) from the adjusted ones, degrees."""
    off = angles - adjusted
    first: FloatArray = off[:1]
    turn: FloatArray = np.median(np.remainder(off - first + 180.0, 360.0) - 180.0, axis=0) + first[0]
    return turn


def _off(angles: FloatArray, adjusted: FloatArray) -> FloatArray:
    """Largest difference (N,) of angles (N, 3), degrees, whole turns apart."""
    found: FloatArray = np.abs(np.remainder(angles - adjusted + 180.0, 360.0) - 180.0).max(axis=1)
    return found
