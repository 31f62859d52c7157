"""Rotation of images that a block's measurements hardly determine: above all the roll of a strip.

Points near the line of the cameras turn with them about that line: their rays still meet, and camera positions stay on
it. The direction in which the block is determined worst is followed by one standard deviation; the rotations that the
images then make are compared with the line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import listed
from geomosaic.orientation.block.poses import pose_of, rotation_vector
from geomosaic.orientation.block.problem import BlockProblem
from geomosaic.orientation.block.unknowns import BlockState
from geomosaic.types import FloatArray, IntArray

# Degrees of one standard deviation from which on a rotation is worth a word: photos at 1 km miss by 17 m.
WEAK = 1.0
# Change in pixels along the direction over which rotations are taken: small enough to be linear.
SMALL = 1e-3
# Share of the largest rotation from which on an image takes part.
PART = 0.5
# Extent of camera positions across their line, over that along it, up to which they are on one; and the cosine between
# rotation and line from which on it is a roll.
STRAIGHT, ALONG = 0.1, 0.9


@dataclass(frozen=True, eq=False)
class WeakRotation:
    """Rotation that images make along the direction in which a block is determined worst.

    Attributes
    ----------
    images : int array
        That take part.
    sigma : float
        Standard deviation of the largest angle, degrees.
    roll : bool
        Whether the axis is the line on which all projection centres lie.
    """

    images: IntArray
    sigma: float
    roll: bool

    def text(self, names: Sequence[str]) -> str:
        """What is hardly determined, by the names of all images."""
        which = listed((names[image] for image in self.images.tolist()), 4)
        # A first-order figure: beyond a quarter of a turn it says only that nothing holds the angle.
        size = f"is known to {self.sigma:.2g} degrees only" if self.sigma < 90.0 else "is free"
        if self.roll:
            return f"the roll of {which} about the flight line {size}: what holds it lies near that line"
        return f"the rotation of {which} {size}"

    @property
    def hint(self) -> str:
        """What would determine it."""
        if self.roll:
            return (
                "add tie points or control on both sides of the flight line, photos of a neighbouring or crossing "
                "strip, or the accuracy of the angles (`attitude_sigma`)"
            )
        return "add tie points, control, camera positions, or the accuracy of the angles (`attitude_sigma`)"


def weak_rotation(problem: BlockProblem, state: BlockState, least: float = WEAK) -> WeakRotation | None:
    """Rotation that the observations hardly determine.

    Parameters
    ----------
    problem : BlockProblem
    state : BlockState
        A solution, or first values.
    least : float
        Standard deviation in degrees below which a rotation is well determined.

    Returns
    -------
    WeakRotation or None
        None where no image turns by as much, or where nothing can be said.
    """
    network, unknowns = problem.linearise(state), problem.unknowns
    posed = np.array([k for k, model in enumerate(state.models) if hasattr(model, "pose")], dtype=np.int64)
    if not len(posed) or not unknowns.count or network.approximate or not network.factored.regular:
        return None
    _, change = network.weakest()
    largest = unknowns.all.movement(change[: unknowns.count])
    if not np.isfinite(largest) or largest <= SMALL:
        return None
    share = SMALL / largest
    after = problem.moved(state, share * change)
    before, moved = ([pose_of(each.models[k], problem.frame) for k in posed.tolist()] for each in (state, after))
    pairs = zip(before, moved, strict=True)
    turns = np.array([rotation_vector(b.rotation.T @ a.rotation) for a, b in pairs]) / share
    sizes = np.linalg.norm(turns, axis=1)
    sigma = float(np.degrees(sizes.max()))
    if not sigma >= least:
        return None
    part = sizes > PART * sizes.max()
    line = _line(np.array([pose.centre for pose in before]))
    roll = line is not None and bool((np.abs(turns[part] @ line) >= ALONG * sizes[part]).all())
    return WeakRotation(posed[part], sigma, roll)


def weak_roll(problem: BlockProblem, state: BlockState) -> WeakRotation | None:
    """Roll of a strip that the observations hardly determine, at no cost where the images are not on a line.

    Parameters
    ----------
    problem : BlockProblem
    state : BlockState
        A solution.
    """
    posed = [model for model in state.models if hasattr(model, "pose")]
    if len(posed) < 2 or _line(np.array([pose_of(model, problem.frame).centre for model in posed])) is None:
        return None
    found = weak_rotation(problem, state)
    return found if found is not None and found.roll else None


def _line(centres: FloatArray) -> FloatArray | None:
    """Direction (3,) of the line on which projection centres (M, 3) lie; None where they do not."""
    _, extent, axes = np.linalg.svd(centres - centres.mean(axis=0), full_matrices=False)
    if len(centres) < 2 or extent[0] == 0.0 or extent[1] > STRAIGHT * extent[0]:
        return None
    found: FloatArray = axes[0]
    return found
