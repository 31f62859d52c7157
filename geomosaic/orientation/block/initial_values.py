"""Start of a block: first orientations of its images and first coordinates of its points, from nothing but ties.

Images with an orientation (scenes, photos with positions and angles) give rays; those that know their camera alone form
free blocks, which control points, camera positions, attitudes and points that oriented images see put in their place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.errors import InputError, counted
from geomosaic.geo.crs import geographic, in_space
from geomosaic.geo.local_frames import LocalFrame, nearest_rotation
from geomosaic.geo.transform import Transform
from geomosaic.orientation.block.absolute_orientation import Correspondences, Similarity, absolute_orientation
from geomosaic.orientation.block.bearings import Bearings, Poses
from geomosaic.orientation.block.connectivity import UndeterminedError, connectivity
from geomosaic.orientation.block.free_block import FreeBlock, free_blocks
from geomosaic.orientation.block.resection import resect_bearings
from geomosaic.orientation.block.triangulation import Rays, finite, triangulate
from geomosaic.sensor.plugin import HasPose, HasRays, SensorModel
from geomosaic.sensor.solve import image_to_height
from geomosaic.types import BoolArray, FloatArray, IntArray

# Standard deviations by which measurements that agree may miss each other.
TOLERANCE = 4.0
# Points on which an image is resected by itself: three, and one that checks them.
LEAST_RESECTION = 4
# Metres of height between the two places that make a ray of a sensor without rays: curved rays are straight over it.
RISE = 200.0
# Metres above the ground at which rays of such a sensor start: a miss is told as an angle at the start of a ray, and
# nearer that of a pixel would change with the height of the point.
FAR = 5e5
# The next pixel.
BESIDE = np.array([1.0, 0.0])
# Standard deviation in radians of the guess that photos of a block look down.
DOWNWARDS = 0.3


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of the places of a block, in its frame; NaN where something is not.

    Attributes
    ----------
    points : array (S, 3)
        Control points.
    sigma_points : array (S,)
        Metres.
    centres : array (M, 3)
        Projection centres, by GNSS for example.
    sigma_centres : array (M,)
        Metres.
    rotations : array (M, 3, 3)
        Attitudes, from the axes of the frame to those of the camera (x right, y down, z forward).
    sigma_rotations : array (M,)
        Radians.
    """

    points: FloatArray
    sigma_points: FloatArray
    centres: FloatArray
    sigma_centres: FloatArray
    rotations: FloatArray
    sigma_rotations: FloatArray

    @classmethod
    def nothing(cls, images: int, points: int) -> Known:
        """Nothing known of a block."""
        return cls(
            np.full((points, 3), np.nan),
            np.ones(points),
            np.full((images, 3), np.nan),
            np.ones(images),
            np.full((images, 3, 3), np.nan),
            np.ones(images),
        )


@dataclass(frozen=True, eq=False)
class UnorientedBlock:
    """Images of a block and image positions of its points.

    Attributes
    ----------
    images : tuple of str (M,)
        Names.
    models : tuple of SensorModel (M,)
    oriented : bool array (M,)
        Models whose orientation is kept; the others must know their camera (`HasPose`). Photos whose angles are good to
        degrees start better as not oriented, with these in `known`: their ties then place them to each other.
    image, point : int array (N,)
        Of each image position.
    colrow : array (N, 2)
        Pixels.
    frame : LocalFrame
        Of the block.
    known : Known
    """

    images: tuple[str, ...]
    models: tuple[SensorModel, ...]
    oriented: BoolArray
    image: IntArray
    point: IntArray
    colrow: FloatArray
    frame: LocalFrame
    known: Known


@dataclass(frozen=True, eq=False)
class InitialValues:
    """First orientations and points.

    Attributes
    ----------
    models : tuple of SensorModel (M,)
    points : array (S, 3)
        In the block's frame; NaN where fewer than two rays meet.
    used : bool array (N,)
        Image positions that agree with them.
    notes : tuple of str
        What had to be assumed.
    """

    models: tuple[SensorModel, ...]
    points: FloatArray
    used: BoolArray
    notes: tuple[str, ...]


def initial_values(block: UnorientedBlock, sigma_px: float = 1.0, datum: bool = True) -> InitialValues:
    """First orientations of all images of a block and first coordinates of its points.

    Parameters
    ----------
    block : UnorientedBlock
    sigma_px : float
        Standard deviation of the image positions.
    datum : bool
        Whether the block must have a place. Without one a single free block stays in its own frame and scale.

    Raises
    ------
    InputError
        An image has no orientation and a sensor that can be given none.
    SolveError
        Images have too few points in common with others, or a part has no datum; names them.
    """
    helpless = [
        name
        for name, model, oriented in zip(block.images, block.models, block.oriented, strict=True)
        if not oriented and not isinstance(model, HasPose)
    ]
    if helpless:
        raise InputError(
            f"{counted(len(helpless), 'image')} ({', '.join(helpless[:3])}) without an orientation, of a sensor that "
            "has no position and attitude",
            hint="give these images an orientation: only photos of a camera are oriented by tie points alone",
        )
    order = _sorted_once(block.image, block.point, block.colrow)
    work = replace(block, image=block.image[order], point=block.point[order], colrow=block.colrow[order])
    start = _Start.of(work, TOLERANCE * sigma_px)
    models, points, rows, notes = start.run(datum)
    used = np.zeros(len(block.image), dtype=bool)
    used[order] = rows
    return InitialValues(models, points, used, notes)


def _sorted_once(image: IntArray, point: IntArray, colrow: FloatArray) -> IntArray:
    """Rows sorted by image and point, without those that are NaN and points that one image has twice."""
    order = np.lexsort((point, image))
    same = (np.diff(image[order]) == 0) & (np.diff(point[order]) == 0)
    # Nobody knows which of two is right: both stay out of the start.
    twice = np.concatenate([[False], same]) | np.concatenate([same, [False]])
    rows: IntArray = order[~twice & finite(colrow)[order]]
    return rows


@dataclass(frozen=True, eq=False)
class _Start:
    """A block on its way to initial values; image positions are sorted."""

    block: UnorientedBlock
    bearings: Bearings
    rays: Rays
    tolerance: float

    @classmethod
    def of(cls, block: UnorientedBlock, tolerance: float) -> _Start:
        count = len(block.image)
        directions, angle = np.full((count, 3), np.nan), np.full(count, np.nan)
        rays = Rays(np.full((count, 3), np.nan), np.full((count, 3), np.nan), block.point, angle)
        for index, (model, oriented) in enumerate(zip(block.models, block.oriented, strict=True)):
            rows = _rows(block.image, index)
            colrow = block.colrow[rows]
            if not len(colrow):
                continue
            if oriented:
                rays.origins[rows], rays.directions[rows], angle[rows] = image_rays(model, colrow, block.frame)
            elif isinstance(model, HasPose):
                directions[rows] = model.directions(colrow)
                angle[rows] = _pixel_angles(directions[rows], model.directions(colrow + BESIDE))
        return cls(block, Bearings(block.image, block.point, directions, angle), rays, tolerance)

    def run(self, datum: bool) -> tuple[tuple[SensorModel, ...], FloatArray, BoolArray, tuple[str, ...]]:
        """Models, points, used rows and notes."""
        images, points = len(self.block.models), len(self.block.known.points)
        free = finite(self.bearings.direction)
        own = self.bearings.select(free)
        joined = connectivity(own.image, own.point, self.block.colrow[free], images)
        blocks = free_blocks(own, joined, points, self.tolerance)
        notes: list[str] = []
        poses = Poses.unknown(images)
        seen, spread = self._points(poses)
        apart: list[FreeBlock] = []
        for part in blocks:
            placed = self._placed(part, seen, spread, notes)
            if placed is None:
                apart.append(part)
            else:
                poses = _both(poses, placed.poses(part.poses))
        if not datum and apart and not poses.known.any() and not self.block.oriented.any():
            # The largest one is the frame.
            first = max(apart, key=lambda part: np.count_nonzero(part.poses.known))
            poses = first.poses
            apart.remove(first)
        poses = self._resected(poses)
        apart = [part for part in apart if not (part.poses.known & poses.known).any()]
        self._report_failures(poses, apart, joined.text(self.block.images), datum)
        return self._result(poses, notes)

    def _points(self, poses: Poses) -> tuple[FloatArray, FloatArray]:
        """Points that images with a pose see, control points where they are given, and standard deviations (S,)."""
        known = self.block.known
        rays = self._all_rays(poses)
        found = triangulate(rays, len(known.points), self.tolerance)
        missed = np.linalg.norm(found.xyz[rays.point] - rays.origins, axis=1) * np.sin(
            np.minimum(rays.angle * np.maximum(rays.misses(found.xyz), 1.0), np.pi / 2)
        )
        count = np.maximum(np.bincount(rays.point[found.used], minlength=len(known.points)), 1)
        square = np.bincount(rays.point[found.used], missed[found.used] ** 2, len(known.points)) / count
        # Errors across the rays are larger along them by the parallax.
        sigma = np.sqrt(square) / np.maximum(np.sin(np.minimum(found.parallax, 1.5)), 1e-3)
        given = finite(known.points)
        return np.where(given[:, None], known.points, found.xyz), np.where(given, known.sigma_points, sigma)

    def _all_rays(self, poses: Poses) -> Rays:
        """Rays of oriented images, and of those with a pose."""
        own = poses.rays(self.bearings)
        mine = poses.known[self.bearings.image]
        return Rays(
            np.where(mine[:, None], own.origins, self.rays.origins),
            np.where(mine[:, None], own.directions, self.rays.directions),
            self.bearings.point,
            np.where(mine, self.bearings.angle, self.rays.angle),
        )

    def _placed(self, part: FreeBlock, seen: FloatArray, spread: FloatArray, notes: list[str]) -> Similarity | None:
        """Similarity of a free block to what is known of its place."""
        known, inside = self.block.known, part.poses.known
        points = finite(part.xyz) & finite(seen)
        centres = inside & finite(known.centres)
        turned = inside & finite(known.rotations)
        given = Correspondences(
            np.vstack([part.poses.centres[centres], part.xyz[points]]),
            np.vstack([known.centres[centres], seen[points]]),
            np.concatenate([known.sigma_centres[centres], spread[points]]),
            np.swapaxes(part.poses.rotations[turned], 1, 2) @ known.rotations[turned],
            known.sigma_rotations[turned],
        )
        found = absolute_orientation(given)
        if found is None and len(given.free) >= 2 and not turned.any():
            guess = replace(given, turned=_downwards(part.poses, given)[None], sigma_turned=np.array([DOWNWARDS]))
            found = absolute_orientation(guess)
            if found is not None:
                notes.append(
                    f"what is known of the places of {_named(self.block.images, inside)} is on one line: the turn "
                    "about it is not determined, and the photos are taken to look down"
                )
        return None if found is None else found[0]

    def _resected(self, poses: Poses) -> Poses:
        """Poses with those of images that see enough known points, of control or of other images."""
        waiting = ~self.block.oriented & ~poses.known
        while True:
            points = self._points(poses)[0]
            known = finite(points)[self.bearings.point] & np.isfinite(self.bearings.angle)
            before = np.count_nonzero(waiting)
            for image in np.flatnonzero(waiting).tolist():
                rows = _known_rows(self.bearings.image, image, known)
                if len(rows) < LEAST_RESECTION:
                    continue
                found = resect_bearings(self.bearings.select(rows), points[self.bearings.point[rows]], self.tolerance)
                if found is not None:
                    poses = poses.with_pose(image, found[0], found[1])
                    waiting[image] = False
            if np.count_nonzero(waiting) in (0, before):
                return self._by_what_is_known(poses, waiting, points)

    def _by_what_is_known(self, poses: Poses, waiting: BoolArray, points: FloatArray) -> Poses:
        """Poses with those of images of known position, whose attitude is known or follows from two points."""
        known, turned = self.block.known, finite(self.block.known.rotations)
        placed = finite(points)[self.bearings.point]
        for image in np.flatnonzero(waiting & finite(known.centres)).tolist():
            rows = _known_rows(self.bearings.image, image, placed)
            towards = points[self.bearings.point[rows]] - known.centres[image]
            if turned[image]:
                poses = poses.with_pose(image, known.centres[image], known.rotations[image])
            elif len(rows) >= 2:
                towards /= np.linalg.norm(towards, axis=1)[:, None]
                rotation = nearest_rotation(self.bearings.direction[rows].T @ towards)
                poses = poses.with_pose(image, known.centres[image], rotation)
        return poses

    def _report_failures(self, poses: Poses, apart: Sequence[FreeBlock], parts: str, datum: bool) -> None:
        """Error where images have no pose."""
        missing = ~self.block.oriented & ~poses.known
        if not missing.any():
            return
        unheld = [np.flatnonzero(part.poses.known) for part in apart]
        single = missing.copy()
        single[np.concatenate([*unheld, np.zeros(0, dtype=np.int64)])] = False
        unheld += list(np.flatnonzero(single)[:, None])
        if apart:
            names = "; ".join(_named(self.block.images, part.poses.known) for part in apart)
            if not datum:
                raise UndeterminedError(
                    f"the images form {len(apart) + 1} groups without enough tie points in common: "
                    f"{_named(self.block.images, poses.known)}; {names}",
                    hint="make a block of each group, or add photos between them, or tie points",
                    parts=unheld,
                )
            raise UndeterminedError(
                f"{counted(len(apart), 'part')} of the block without a datum: {names}",
                hint="give three control points that are not on one line, or camera positions, in each part; or join "
                "the parts by tie points",
                parts=unheld,
            )
        raise UndeterminedError(
            f"{_named(self.block.images, missing)} cannot be oriented; the block has {parts}",
            hint="measure six tie points or more, spread over the image, in common with two other images; or give an "
            "orientation, or leave these images out",
            parts=unheld,
        )

    def _result(
        self, poses: Poses, notes: list[str]
    ) -> tuple[tuple[SensorModel, ...], FloatArray, BoolArray, tuple[str, ...]]:
        rays = self._all_rays(poses)
        found = triangulate(rays, len(self.block.known.points), self.tolerance)
        known = self.block.known.points
        xyz = np.where(finite(known)[:, None], known, found.xyz)
        used = np.where(finite(known)[rays.point], np.isfinite(rays.misses(xyz)), found.used)
        frame, models = self.block.frame, list(self.block.models)
        for index in np.flatnonzero(poses.known).tolist():
            model = models[index]
            mine = self.bearings.point[_known_rows(self.bearings.image, index, used)]
            centre, rotation = poses.centres[index], poses.rotations[index]
            ahead = np.median(xyz[mine], axis=0) if len(mine) else centre + rotation[2]
            assert isinstance(model, HasPose)  # checked before all else
            models[index] = model.posed(
                frame.to_geocentric(centre), rotation @ frame.axes, frame.to_geocentric(ahead), frame.crs
            )
        return tuple(models), xyz, used, tuple(notes)


def _rows(image: IntArray, index: int) -> slice:
    """Rows of one image, of rows that are sorted by image."""
    first, end = np.searchsorted(image, [index, index + 1])
    return slice(int(first), int(end))


def _known_rows(image: IntArray, index: int, known: BoolArray) -> IntArray:
    """Those rows of one image that are known, of rows that are sorted by image."""
    rows = _rows(image, index)
    found: IntArray = rows.start + np.flatnonzero(known[rows])
    return found


def _both(one: Poses, other: Poses) -> Poses:
    """Poses of the first, and of the second where the first has none."""
    mine = one.known[:, None]
    return Poses(np.where(mine, one.centres, other.centres), np.where(mine[:, :, None], one.rotations, other.rotations))


def image_rays(model: SensorModel, colrow: FloatArray, frame: LocalFrame) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Origins (N, 3) and unit directions (N, 3) of an oriented image, in the block's frame, and angles of pixels (N,).

    Parameters
    ----------
    model : SensorModel
    colrow : array (N, 2)
        Pixels.
    frame : LocalFrame
    """
    origins, directions = _lines(model, colrow, frame)
    next_origins, next_directions = _lines(model, colrow + BESIDE, frame)
    # Lines of a sensor without rays do not start at one place: what counts is how far apart they are on the ground.
    angle = _pixel_angles(directions + origins / FAR, next_directions + next_origins / FAR)
    return origins, directions, angle


def _lines(model: SensorModel, colrow: FloatArray, frame: LocalFrame) -> tuple[FloatArray, FloatArray]:
    """Origins (N, 3) and unit directions (N, 3) of lines of sight."""
    if isinstance(model, HasRays):
        origins, directions = model.rays(colrow)
        ends, crs = (origins, origins + RISE * directions), model.crs
    else:
        # Any sensor shows a place at two heights; from the upper to the lower one it looks down.
        crs = geographic(model.crs) if model.crs.is_geocentric else in_space(model.crs)
        height = float(Transform(in_space(model.crs), crs)(np.asarray(model.seed)[None])[0, 2])
        upper, lower = (image_to_height(model, colrow, height + rise, crs) for rise in (RISE, 0.0))
        ends = (upper, lower)
    to_frame = Transform(crs, frame.crs)
    first, second = (frame.to_enu(to_frame(places)) for places in ends)
    along = second - first
    directions = along / np.linalg.norm(along, axis=1)[:, None]
    return first if isinstance(model, HasRays) else second - FAR * directions, directions


def at_level(model: SensorModel, colrow: FloatArray, frame: LocalFrame, level: float) -> FloatArray:
    """Places (N, 3) in the block's frame where an image shows a level plane; NaN where it looks away from it.

    Parameters
    ----------
    model : SensorModel
    colrow : array (N, 2)
        Pixels.
    frame : LocalFrame
    level : float
        z of the plane.
    """
    origins, directions = _lines(model, colrow, frame)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (level - origins[:, 2]) / directions[:, 2]
    return origins + np.where(along > 0.0, along, np.nan)[:, None] * directions


def _pixel_angles(directions: FloatArray, beside: FloatArray) -> FloatArray:
    """Median angle in radians between unit directions (N, 3) a pixel apart: one for an image, as lenses bend edges."""
    return np.full(len(directions), np.nanmedian(np.linalg.norm(directions - beside, axis=1)))


def _downwards(poses: Poses, given: Correspondences) -> FloatArray:
    """Rotation from a level frame to the free one, in which the photos look down and known places lie along."""
    down = np.nanmean(poses.rotations[:, 2, :], axis=0)
    ends = np.argmin(given.known @ (1.0, 1.0, 0.0)), np.argmax(given.known @ (1.0, 1.0, 0.0))
    free, known = (places[ends[1]] - places[ends[0]] for places in (given.free, given.known))
    return _axes(-down, free).T @ _axes(np.array([0.0, 0.0, 1.0]), known)


def _axes(up: FloatArray, along: FloatArray) -> FloatArray:
    """Axes (3, 3), one per row: the last one up, the first along a direction."""
    z = up / np.linalg.norm(up)
    x = along - (along @ z) * z
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _named(names: Sequence[str], which: BoolArray) -> str:
    """Number and first names of images."""
    chosen = [name for name, wanted in zip(names, which, strict=True) if wanted]
    return f"{counted(len(chosen), 'image')} ({', '.join(chosen[:3])}{', ...' if len(chosen) > 3 else ''})"
