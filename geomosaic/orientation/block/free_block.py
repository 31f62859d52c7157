"""Free blocks: images and points placed relative to each other by tie points alone, image by image.

A block starts with two images that have many common points and a good parallax. Images that see most of the points
known so far follow by resection, new points by triangulation, and a bundle adjustment now and then takes out the
errors that add up. Parts that grew apart are joined by common points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.orientation.block.absolute_orientation import Correspondences, absolute_orientation
from geomosaic.orientation.block.bearing_adjustment import adjust_bearings
from geomosaic.orientation.block.bearings import Bearings, Poses
from geomosaic.orientation.block.connectivity import Connectivity
from geomosaic.orientation.block.relative_orientation import RelativeOrientation, relative_orientations
from geomosaic.orientation.block.resection import LEAST_POINTS, resect_bearings
from geomosaic.orientation.block.triangulation import midpoints, triangulate
from geomosaic.types import BoolArray, FloatArray, IntArray

# Pairs of images that are tried as a start, and the share of the most common points that they have at least.
SEED_PAIRS, SEED_SHARE = 12, 0.3
# Parallax beyond which a pair is no better: radians.
ENOUGH_PARALLAX = 0.35
# Parallax of a point in pixels from which its distance, known to 2 %, serves resections.
DEPTH = 50.0
# Images that see this share of the most known points that one sees are resected in one round.
ROUND_SHARE = 0.5
# Growth of the number of images after which all are adjusted: the work of all adjustments is four times the last.
GROWTH = 1.35
# Known points that give the scale of a pair: one, and one that checks it.
LEAST_SCALES = 2
# Growth of its known points after which an image that failed is tried again.
RETRY = 1.3


@dataclass(frozen=True, eq=False)
class FreeBlock:
    """Images and points in one free frame.

    Attributes
    ----------
    poses : Poses
    xyz : array (S, 3)
        NaN for points that are not determined.
    used : bool array (N,)
        Bearings that agree.
    """

    poses: Poses
    xyz: FloatArray
    used: BoolArray


def free_blocks(bearings: Bearings, joined: Connectivity, points: int, tolerance: float) -> list[FreeBlock]:
    """Free blocks of the images that common points join: one of each part whose points carry the scale across it.

    Parameters
    ----------
    bearings : Bearings
        Sorted by image, and by point within each.
    joined : Connectivity
        Of the images of the bearings.
    points : int
        Number of points S.
    tolerance : float
        Pixels by which a bearing may miss its point; more where most do.

    Returns
    -------
    list of FreeBlock
        Largest first. Images in none of them could not be oriented.
    """
    blocks: list[FreeBlock] = []
    shape = len(joined.part), points
    for part in range(len(joined.parts)):
        free = joined.part == part
        while np.count_nonzero(free) >= 2:
            open_ = free[joined.pairs].all(axis=1)
            grown = _best_start(bearings, joined.pairs[open_], joined.common[open_], free, shape, tolerance)
            if grown is None or not grown.poses.known.any():
                break
            blocks.append(grown)
            free &= ~grown.poses.known
    return _joined(bearings, sorted(blocks, key=lambda block: -np.count_nonzero(block.poses.known)), tolerance)


def _best_start(
    bearings: Bearings, pairs: IntArray, common: IntArray, free: BoolArray, shape: tuple[int, int], tolerance: float
) -> FreeBlock | None:
    """Block that grows from the best pair; from the next best ones if it does not grow."""
    best: FreeBlock | None = None
    seeds = _seeds(bearings, pairs, common, shape[0], tolerance)
    wanted = int(np.count_nonzero(free))
    for (first, second), relative in seeds[:4]:
        start = Poses.unknown(shape[0]).with_pose(first, np.zeros(3), np.eye(3))
        poses = start.with_pose(second, relative.centre, relative.rotation)
        grown = _grown(bearings, poses, pairs, free, shape[1], tolerance)
        if best is None or np.count_nonzero(grown.poses.known) > np.count_nonzero(best.poses.known):
            best = grown
        # Half of the images is a block; a start that was wrong ends after a few.
        if 2 * np.count_nonzero(best.poses.known) >= wanted:
            break
    return best


def _seeds(
    bearings: Bearings, pairs: IntArray, common: IntArray, images: int, tolerance: float
) -> list[tuple[tuple[int, int], RelativeOrientation]]:
    """Oriented pairs, best first: many points that agree, at a good parallax."""
    likely = np.flatnonzero(common >= SEED_SHARE * common.max(initial=0))
    tried = likely[np.unique(np.linspace(0, len(likely) - 1, SEED_PAIRS).astype(np.int64))] if len(likely) else likely
    slices = _slices(bearings.image, images)
    found = []
    for first, second in pairs[tried].tolist():
        for relative in _oriented_pair(*_common(bearings, slices[first], slices[second]), tolerance):
            # Depths of a small parallax are worth little, however many points there are.
            worth = np.count_nonzero(relative.used) * min(relative.parallax, ENOUGH_PARALLAX)
            found.append((worth, (first, second), relative))
    found.sort(key=lambda entry: -entry[0])
    return [(pair, relative) for _, pair, relative in found]


def _common(bearings: Bearings, first: IntArray, second: IntArray) -> tuple[Bearings, Bearings]:
    """Bearings of the common points of two images, of the rows of each."""
    a, b = bearings.point[first], bearings.point[second]
    _, left, right = np.intersect1d(a, b, assume_unique=True, return_indices=True)
    return bearings.select(first[left]), bearings.select(second[right])


def _oriented_pair(first: Bearings, second: Bearings, tolerance: float) -> tuple[RelativeOrientation, ...]:
    angle = np.maximum(first.angle, second.angle)
    return relative_orientations(first.direction, second.direction, angle, tolerance)


def _attached(bearings: Bearings, block: FreeBlock, pair: IntArray, slices: list[IntArray], tolerance: float) -> Poses:
    """Poses with that of an image oriented relative to another one, two known points giving the scale.

    In a strip of little overlap most points have two rays, and too few are known to a third image for its resection.
    """
    known = block.poses.known
    here, there = pair if known[pair[0]] else pair[::-1]
    near, far = _common(bearings, slices[here], slices[there])
    towards = block.xyz[near.point] - block.poses.centres[here]
    for relative in _oriented_pair(near, far, tolerance)[:1]:
        rotations = np.stack([np.eye(3), relative.rotation])
        two = Poses(np.stack([np.zeros(3), relative.centre]), rotations)
        ends = [
            two.rays(Bearings(np.full(len(b), i), b.point, b.direction, b.angle)) for i, b in enumerate((near, far))
        ]
        distance = np.linalg.norm(midpoints(*ends), axis=1)
        scales = (np.linalg.norm(towards, axis=1) / distance)[relative.used]
        scales = scales[np.isfinite(scales)]
        if len(scales) >= LEAST_SCALES:
            turn = block.poses.rotations[here]
            centre = block.poses.centres[here] + float(np.median(scales)) * turn.T @ relative.centre
            return block.poses.with_pose(int(there), centre, relative.rotation @ turn)
    return block.poses


def _grown(
    bearings: Bearings, poses: Poses, pairs: IntArray, free: BoolArray, points: int, tolerance: float
) -> FreeBlock:
    """Block grown from the images that have a pose by others that are free, as far as it goes."""
    slices = _slices(bearings.image, len(free))
    block = _adjusted(
        bearings, FreeBlock(poses, np.full((points, 3), np.nan), np.zeros(len(bearings), dtype=bool)), tolerance
    )
    adjusted = np.count_nonzero(block.poses.known)
    failed, tried = np.zeros(len(free)), np.zeros(len(pairs), dtype=bool)
    while True:
        known = np.isfinite(block.xyz[:, 0])
        waiting = free & ~block.poses.known
        seen = np.bincount(bearings.image[known[bearings.point]], minlength=len(free))
        ready = waiting & (seen >= LEAST_POINTS) & (seen >= RETRY * failed)
        now = np.count_nonzero(block.poses.known)
        if not ready.any() or now >= GROWTH * adjusted:
            if now == adjusted:
                open_ = np.flatnonzero(free[pairs].all(axis=1) & (block.poses.known[pairs].sum(axis=1) == 1) & ~tried)
                if not len(open_):
                    return block
                # Pairs come with most common points first; each is tried once.
                tried[open_[0]] = True
                poses = _attached(bearings, block, pairs[open_[0]], slices, tolerance)
                block = FreeBlock(poses, block.xyz, block.used)
                continue
            before = block.poses.known
            block = _adjusted(bearings, block, tolerance)
            adjusted = np.count_nonzero(block.poses.known)
            # What an adjustment threw out comes back with more points only; else it would come and go forever.
            failed = np.where(before & ~block.poses.known, np.maximum(failed, seen), failed)
            continue
        poses = block.poses
        for image in np.flatnonzero(ready & (seen >= ROUND_SHARE * seen[ready].max())).tolist():
            rows = slices[image][known[bearings.point[slices[image]]]]
            found = resect_bearings(bearings.select(rows), block.xyz[bearings.point[rows]], tolerance)
            if found is None:
                failed[image] = max(failed[image], seen[image])
            else:
                poses = poses.with_pose(image, found[0], found[1])
        block = _triangulated(
            bearings, FreeBlock(poses, block.xyz, block.used), poses.known & ~block.poses.known, tolerance
        )


def _triangulated(bearings: Bearings, block: FreeBlock, added: BoolArray, tolerance: float) -> FreeBlock:
    """Block with the points that added images see triangulated anew."""
    touched = np.zeros(len(block.xyz), dtype=bool)
    touched[bearings.point[added[bearings.image]]] = True
    rows = np.flatnonzero(touched[bearings.point] & block.poses.known[bearings.image])
    found = triangulate(block.poses.rays(bearings.select(rows)), len(block.xyz), tolerance, DEPTH)
    xyz, used = np.where(touched[:, None], found.xyz, block.xyz), block.used.copy()
    used[touched[bearings.point]] = False
    used[rows] = found.used
    return FreeBlock(block.poses, xyz, used)


def _adjusted(bearings: Bearings, block: FreeBlock, tolerance: float) -> FreeBlock:
    """Block after a bundle adjustment; images that hardly agree with it lose their poses."""
    block = _triangulated(bearings, block, block.poses.known, tolerance)
    if not block.used.any():
        return block
    poses, xyz = adjust_bearings(bearings.select(block.used), block.poses, block.xyz)
    count = np.bincount(bearings.image[block.used], minlength=len(poses.centres))
    return _triangulated(
        bearings,
        FreeBlock(poses.without(poses.known & (count < LEAST_POINTS)), xyz, block.used),
        poses.known,
        tolerance,
    )


def _joined(bearings: Bearings, blocks: list[FreeBlock], tolerance: float) -> list[FreeBlock]:
    """Blocks joined to larger ones with which they have points in common."""
    done: list[FreeBlock] = []
    for block in blocks:
        for index, larger in enumerate(done):
            both = np.flatnonzero(np.isfinite(block.xyz[:, 0]) & np.isfinite(larger.xyz[:, 0]))
            if len(both) < 4:
                continue
            sigma = np.full(len(both), 0.01 * float(np.linalg.norm(np.ptp(larger.xyz[both], axis=0))))
            given = Correspondences(block.xyz[both], larger.xyz[both], sigma, np.zeros((0, 3, 3)), np.zeros(0))
            found = absolute_orientation(given)
            if found is None or np.count_nonzero(found[1]) < 4:
                continue
            moved = found[0].poses(block.poses)
            own = larger.poses.known[:, None]
            poses = Poses(
                np.where(own, larger.poses.centres, moved.centres),
                np.where(own[:, :, None], larger.poses.rotations, moved.rotations),
            )
            done[index] = _adjusted(bearings, FreeBlock(poses, larger.xyz, larger.used), tolerance)
            break
        else:
            done.append(block)
    return done


def _slices(image: IntArray, images: int) -> list[IntArray]:
    """Rows of each image, of rows that are sorted by image."""
    return np.split(np.arange(len(image)), np.searchsorted(image, np.arange(1, images)))
