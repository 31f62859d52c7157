"""Likely causes of blunders in a block: points exchanged, wrong id, wrong image, wrong height, control moved."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from geomosaic.errors import listed
from geomosaic.estimation.blunders.exchanged_points import NEARER, confusion_radius, confusion_text
from geomosaic.geo.crs import is_local
from geomosaic.orientation.block.group_blunders import GroupBlunder
from geomosaic.orientation.block.observations import (
    UNITS,
    GroundControl,
    ImagePositions,
    SurfaceHeights,
    in_units,
    slices_of,
    unit_matrices,
)
from geomosaic.orientation.block.poses import Attitudes, CameraPositions
from geomosaic.orientation.block.ray_pairs import exchanged_points, other_suspects
from geomosaic.orientation.block.solution import BlockSolution, group_name
from geomosaic.types import FloatArray, IntArray

# Error in one axis, over that in the others, from which on only this axis is wrong.
ALONE = 5.0


@dataclass(frozen=True)
class BlockBlunder:
    """Measurement that was left out of a block.

    Attributes
    ----------
    kind : str
        Group of observations.
    image : str
        Image of an image position, a camera position or an attitude, or the only one that shows a control point; both
        of a relative one; '' of others.
    point : str
        '' of camera positions and attitudes; both ends of a distance.
    size : tuple of float
        Measured minus what the rest of the block says: (col, row) in pixels, or metres, or degrees. Of a control point
        that one image alone shows: its position there minus where its coordinates lie, pixels.
    log_probability : float
        Natural logarithm of the probability of so large an error, by chance.
    sigma0_with : float
        Standard deviation of unit weight that the block would have with it.
    cause : str
        What may have happened; '' where nothing speaks for one cause.
    """

    kind: str
    image: str
    point: str
    size: tuple[float, ...]
    log_probability: float
    sigma0_with: float
    cause: str

    @property
    def unit(self) -> str:
        """Unit of its size."""
        kind = ImagePositions.name if self.image and self.kind == GroundControl.name else self.kind
        return UNITS.get(kind, "m")

    def __str__(self) -> str:
        point = "that of points" if "' and '" in self.point else "point"
        where = " in ".join(each for each in (f"{point} '{self.point}'" if self.point else "", self.image) if each)
        length = float(np.linalg.norm(self.size))
        # Where the rays of a point do not meet, there is no point that one could be off.
        said = f"{self.kind}: {where}" + (f" is off by {length:.3g} {self.unit}" if np.isfinite(length) else "")
        return f"{said}: {self.cause}" if self.cause else said


def blunders(solution: BlockSolution) -> list[BlockBlunder]:
    """Measurements that were left out, with likely causes, the least probable first.

    Parameters
    ----------
    solution : BlockSolution
    """
    adjustment = solution.adjustment
    found = []
    whole = {each.index for each in adjustment.wrong_groups if each.offset is not None}
    for index, group in enumerate(adjustment.problem.groups):
        rows = np.flatnonzero(adjustment.rejected[index])
        if not len(rows) or index in whole:
            continue
        if index == 0:
            found += _of_images(solution, rows)
        elif isinstance(group, GroundControl):
            found += _of_control(solution, index, group, rows)
        else:
            sizes = in_units(group, adjustment.statistics[index].residuals)
            found += [_plain(solution, index, row, tuple(sizes[row].tolist())) for row in rows.tolist()]
    return sorted(found, key=lambda each: (each.log_probability, each.image, each.point))


def group_blunder_text(solution: BlockSolution, wrong: GroupBlunder) -> str:
    """Group that contradicts the rest as a whole, in words: by how much, what became of it, and a likely cause.

    Parameters
    ----------
    solution : BlockSolution
    wrong : GroupBlunder
    """
    groups = solution.adjustment.problem.groups
    name = groups[wrong.index].name
    kind = groups[wrong.index]
    if wrong.offset is None:
        said = f"scatter {wrong.scatter:.3g} times as much as their standard deviations say, and took part with"
        if not isinstance(kind, GroundControl):
            return f"{name} {said} standard deviations that are so much larger"
        x, y, z = np.median(np.linalg.norm(unit_matrices(kind, 3), axis=2), axis=0).tolist()
        return (
            f"control points {said} what that makes, {x:.2g}, {y:.2g}, {z:.2g} m (x, y, z): they are worse than "
            "declared, or more than a third of them are wrong, which nobody can tell apart then; see their residuals"
        )
    others = [groups[other].name for other in wrong.others]
    unless = f" (unless {listed(others)} is wrong instead)" if others else ""
    size = np.round(wrong.offset, 2) + 0.0
    amount = ", ".join(f"{each:+.2f}" for each in size)
    if isinstance(kind, SurfaceHeights):
        off, cause = f"{abs(size[0]):.2f} m too {'high' if size[0] > 0.0 else 'low'}", "another height datum"
    elif isinstance(kind, Attitudes):
        off, cause = f"turned by {amount} degrees about the camera's right, down and forward axes", "a boresight"
    else:
        axes = "x, y, z" if is_local(solution.adjustment.problem.frame.ground) else "east, north, up"
        off = f"shifted by {amount} m ({axes})"
        cause = "another datum or CRS" + (", or an antenna beside the camera" if name == CameraPositions.name else "")
    what = "control points" if name == GroundControl.name else name
    return (
        f"all {wrong.count} {what} are left out: in the median they are {off} against the rest of the block{unless}: "
        f"{cause}?"
    )


def _sigma0_with(solution: BlockSolution, index: int, row: int) -> float:
    adjustment, statistic = solution.adjustment, solution.adjustment.statistics[index]
    squares = adjustment.squares + float(statistic.statistic[row])
    freedom = adjustment.redundancy + int(statistic.freedom[row])
    return float(np.sqrt(squares / freedom)) if freedom > 0 else float("nan")


def _plain(solution: BlockSolution, index: int, row: int, size: tuple[float, ...]) -> BlockBlunder:
    """Blunder of a point or an image, of two points or two images, and what it was said to belong to."""
    group, statistic = solution.adjustment.problem.groups[index], solution.adjustment.statistics[index]

    def named(pairs: tuple[IntArray, IntArray], names: Sequence[str]) -> list[str]:
        return [names[each] for each in pairs[1][pairs[0] == row].tolist()]

    further = [group_name(each) for each in solution.adjustment.problem.unknowns.further]
    cause = f"it does not lie on {', '.join(named(group.row_further, further))}" if group.of_points else ""
    return BlockBlunder(
        group.name, " and ".join(named(group.row_images, solution.images)),
        "' and '".join(named(group.row_points, solution.ids)), size, float(statistic.log_probability[row]),
        _sigma0_with(solution, index, row), cause if len(group.row_further[0]) else "",
    )  # fmt: skip


def _of_images(solution: BlockSolution, rows: IntArray) -> list[BlockBlunder]:
    adjustment, views = solution.adjustment, solution.adjustment.problem.views
    state, statistic = adjustment.state, adjustment.statistics[0]
    sigma = np.linalg.norm(np.linalg.inv(views.root), axis=(1, 2)) / np.sqrt(2.0)
    elsewhere = _other_images(solution, rows, sigma)
    near, swaps, suspects = _near_points(solution), exchanged_points(solution), other_suspects(solution, rows)
    rays = np.bincount(views.points)
    found = []
    for image, part in slices_of(views.image[rows]):
        mine = rows[part]
        places = near(image)
        seen = _computed(solution, image, places)
        places, seen = places[np.isfinite(seen).all(axis=1)], seen[np.isfinite(seen).all(axis=1)]
        tree = cKDTree(seen) if len(places) else None
        other: dict[int, int] = {}
        for row in mine.tolist():
            if tree is not None:
                distance, nearest = tree.query(views.colrow[row])
                if distance < _within(solution, row, sigma[row]) and int(places[nearest]) != int(views.points[row]):
                    other[row] = int(places[nearest])
        by_point = {int(views.points[row]): target for row, target in other.items()}
        for row in mine.tolist():
            point, cause = int(views.points[row]), ""
            if not state.moving[point]:
                two = rays[point] == 2
                cause = "its two rays do not meet: either is wrong" if two else "no two of the point's rays agree"
                cause = swaps.get(point, cause)
            elif row in other:
                cause = confusion_text(solution.ids[other[row]], swapped=by_point.get(other[row]) == point)
            else:
                other_image = elsewhere.get(row)
                cause = f"it is where {other_image} shows the point: wrong image" if other_image else ""
                if not cause and row in suspects:
                    cause = f"or the one in {' or '.join(suspects[row])} is: three rays cannot tell which"
            found.append(
                BlockBlunder(
                    "image positions", solution.images[image], solution.ids[point],
                    tuple(solution.residuals[row].tolist()), float(statistic.log_probability[row]),
                    _sigma0_with(solution, 0, row), cause,
                )
            )  # fmt: skip
    return found


def _within(solution: BlockSolution, row: int, sigma: float) -> float:
    """Pixels within which an image position is taken for that of another point, or of another image."""
    return confusion_radius(float(np.linalg.norm(solution.residuals[row])), sigma)


def _computed(solution: BlockSolution, image: int, points: IntArray) -> FloatArray:
    """Positions (N, 2) of points in an image."""
    state, model = solution.adjustment.state, solution.models[image]
    return model.ground_to_image(solution.adjustment.problem.frame.places(model.crs, state.points[points]))


def _incidence(solution: BlockSolution) -> sparse.csr_array:
    """Which image (M) measured which point (S)."""
    views = solution.adjustment.problem.views
    shape = (len(solution.images), len(solution.ids))
    return sparse.csr_array((np.ones(len(views)), (views.image, views.points)), shape=shape)


def _near_points(solution: BlockSolution) -> Callable[[int], IntArray]:
    """Function of an image: points with a place that it, or an image with a common point, shows."""
    # Not all points of the block: images times points would be quadratic in the number of photos.
    shown = _incidence(solution)
    # By rows, once: a product with a transposed view would bring it into this form for every image.
    back = shown.T.tocsr()
    moving = solution.adjustment.state.moving

    def near(image: int) -> IntArray:
        images = (shown[[image]] @ back).indices
        points = np.unique(shown[images].indices)
        moving_points: IntArray = points[moving[points]]
        return moving_points

    return near


def _other_images(solution: BlockSolution, rows: IntArray, sigma: FloatArray) -> dict[int, str]:
    """Of image positions (N,) that were left out, another image that shows the point just there, by their rows."""
    views, shown = solution.adjustment.problem.views, _incidence(solution)
    rows = rows[solution.adjustment.state.moving[views.points[rows]]]
    # Images near those that show the point; pair by pair with the rows that they may explain.
    common = (shown @ shown.T).tocsr()
    wanted: dict[int, list[int]] = {}
    for row in rows.tolist():
        for image in common[[int(views.image[row])]].indices.tolist():
            wanted.setdefault(image, []).append(row)
    found: dict[int, str] = {}
    for image in sorted(wanted):
        own = set(views.points[views.slice_of(image)].tolist())
        these = np.array([row for row in wanted[image] if row not in found and int(views.points[row]) not in own])
        if len(these):
            off = np.linalg.norm(_computed(solution, image, views.points[these]) - views.colrow[these], axis=1)
            for row, distance in zip(these.tolist(), off.tolist(), strict=True):
                if distance < _within(solution, row, sigma[row]):
                    found[row] = solution.images[image]
    return found


def _of_control(solution: BlockSolution, index: int, group: GroundControl, rows: IntArray) -> list[BlockBlunder]:
    statistic, ground = solution.adjustment.statistics[index], solution.ground
    found = []
    for row in rows.tolist():
        point = int(group.points[row])
        off, sigmas = solution.given[point] - ground[point], np.maximum(solution.point_sigmas[point], 1e-9)
        cause, image, length = "", "", float(np.linalg.norm(off))
        for other in rows.tolist():
            twin = int(group.points[other])
            if twin != point and np.linalg.norm(solution.given[point] - ground[twin]) < NEARER * length:
                cause = f"exchanged with point '{solution.ids[twin]}'"
        if not cause and np.isfinite(off).all():
            plan, height = float(np.hypot(*off[:2])), abs(float(off[2]))
            swapped = solution.given[point][[1, 0]] - ground[point][:2]
            if np.hypot(*swapped) < NEARER * plan:
                cause = "x and y are exchanged"
            elif height > ALONE * plan and height > 3.0 * sigmas[2]:
                cause = f"its height is wrong by {off[2]:+.2f} m"
            elif plan > ALONE * height:
                cause = f"it has moved by {off[0]:+.2f}, {off[1]:+.2f} m, or was measured on something else"
            if wrong_ray := _wrong_ray(solution, point):
                cause = f"{cause}; or {wrong_ray}" if cause else wrong_ray
        size = tuple(off.tolist())
        rays = _rays_from_given(solution, point)
        if len(rays) == 1:
            ((image, size),) = rays.items()
            cause = cause or "either its coordinates or its position in this image is wrong: no other shows it"
        found.append(
            BlockBlunder(
                "control", image, solution.ids[point], size, float(statistic.log_probability[row]),
                _sigma0_with(solution, index, row), cause,
            )
        )  # fmt: skip
    return found


def _rays_from_given(solution: BlockSolution, point: int) -> dict[str, tuple[float, float]]:
    """Positions of a control point in its images, (col, row) minus where its coordinates lie, pixels."""
    views, frame = solution.adjustment.problem.views, solution.adjustment.problem.frame
    place, found = frame.from_ground(solution.given[[point]]), {}
    for row in np.flatnonzero((views.points == point) & ~solution.adjustment.rejected[0]).tolist():
        model = solution.models[int(views.image[row])]
        col, line = (views.colrow[row] - model.ground_to_image(frame.places(model.crs, place))[0]).tolist()
        found[solution.images[int(views.image[row])]] = (col, line)
    return found


def _wrong_ray(solution: BlockSolution, point: int) -> str:
    """The one position of a control point with which its given coordinates do not agree, in words; '' of none."""
    rays = {image: float(np.hypot(*off)) for image, off in _rays_from_given(solution, point).items()}
    worst = max(rays, key=lambda image: rays[image], default="")
    sigma = np.linalg.norm(np.linalg.inv(solution.adjustment.problem.views.root), axis=(1, 2)).max() / np.sqrt(2.0)
    others = [off for image, off in rays.items() if image != worst]
    if not others or not max(others) < confusion_radius(rays[worst], float(sigma)):
        return ""
    agree = "the other ray agrees" if len(others) == 1 else "the other rays agree"
    return f"its position in {worst} is wrong by {rays[worst]:.3g} px: {agree} with its coordinates"
