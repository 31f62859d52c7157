"""Resection of an image of a block on points that others have determined, some of them wrong."""

from __future__ import annotations

import numpy as np

from geomosaic.orientation.block.bearing_adjustment import adjust_pose
from geomosaic.orientation.block.bearings import Bearings
from geomosaic.orientation.block.triangulation import spread_tolerance
from geomosaic.sensor.solve import three_point_poses
from geomosaic.types import BoolArray, FloatArray

# Triples of points at once, and at most: of 60 % wrong points, 150 triples hold a right one at 99.99 %.
BATCH, MOST_TRIPLES = 4, 150
# Points that judge the poses of the triples.
JUDGES = 200
# Points that must agree, and their share of all: fewer may agree by chance.
LEAST_POINTS, LEAST_SHARE = 6, 0.3
# Factors of the tolerance, one after the other: points of a young block are known worse than measured.
LOOSENED = (1.0, 5.0, 25.0)


def resect_bearings(
    bearings: Bearings, xyz: FloatArray, tolerance: float
) -> tuple[FloatArray, FloatArray, BoolArray] | None:
    """Pose of an image on known points, without initial values.

    Parameters
    ----------
    bearings : Bearings
        Of one image.
    xyz : array (N, 3)
        The point of each; there are four at least, of which three without a fourth cannot be trusted.
    tolerance : float
        Pixels by which a bearing may miss its point; more if few points agree otherwise.

    Returns
    -------
    centre, rotation, used : array (3,), (3, 3), (N,)
        Projection centre, rotation to camera axes, and points that agree; None where no pose has enough of them.
    """
    best: tuple[FloatArray, FloatArray, BoolArray] | None = None
    for factor in LOOSENED:
        found = _consensus(bearings, xyz, factor * tolerance)
        if found is None:
            continue
        best = found
        # A looser tolerance is tried for what a stricter one explains by half only.
        if np.mean(found[2]) >= 0.5:
            break
    return best


def _consensus(
    bearings: Bearings, xyz: FloatArray, tolerance: float
) -> tuple[FloatArray, FloatArray, BoolArray] | None:
    """Best pose of random triples, adjusted on the points that agree with it."""
    count = len(xyz)
    least = max(min(LEAST_POINTS, count), LEAST_SHARE * count)
    rng = np.random.default_rng(count)
    judges = np.unique(np.linspace(0, count - 1, JUDGES).astype(np.int64))
    judging = bearings.select(judges)
    best, cost, drawn, wanted = None, np.inf, 0, MOST_TRIPLES
    while drawn < wanted:
        for chosen in np.argsort(rng.random((BATCH, count)), axis=1)[:, :3]:
            for pose in three_point_poses(bearings.direction[chosen], xyz[chosen]):
                off = _misses(judging, xyz[judges], pose.centre, pose.rotation)
                total = float(np.sum(np.minimum(off / tolerance, 1.0) ** 2))
                if total < cost:
                    best, cost, share = pose, total, float(np.mean(off <= tolerance))
        drawn += BATCH
        if best is not None:
            wanted = min(wanted, int(np.ceil(np.log(1e-4) / np.log(max(1.0 - min(share, 0.999) ** 3, 1e-9)))))
    if best is None:
        return None
    centre, rotation = best.centre, best.rotation
    used = _misses(bearings, xyz, centre, rotation) <= 2.0 * tolerance
    for _ in range(3):
        if np.count_nonzero(used) < least:
            return None
        centre, rotation = adjust_pose(bearings.select(used), xyz[used], centre, rotation)
        off = _misses(bearings, xyz, centre, rotation)
        used = off <= min(spread_tolerance(off[used]), tolerance)
    return (centre, rotation, used) if np.count_nonzero(used) >= least else None


def _misses(bearings: Bearings, xyz: FloatArray, centre: FloatArray, rotation: FloatArray) -> FloatArray:
    """Pixels (N,) by which bearings miss their points; infinite behind the camera."""
    off = np.hypot(*bearings.misclosure((xyz - centre) @ rotation.T).T)
    return np.where(np.isnan(off), np.inf, off)
