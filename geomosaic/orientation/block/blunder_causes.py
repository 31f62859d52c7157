"""Likely causes of blunders in a block: points exchanged, wrong id, wrong image, wrong height, control moved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from geomosaic.orientation.block.observations import UNITS, GroundControl, in_units
from geomosaic.orientation.block.solution import BlockSolution
from geomosaic.types import FloatArray, IntArray

Positions = Callable[[int], FloatArray]

# Distance in standard deviations, and pixels at least, within which a measurement is taken for that of another point.
NEAR_SIGMAS, NEAR_PIXELS = 5.0, 2.0
# A measurement nearer to another point than this share of its own error can be that of the other.
NEARER = 0.2
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
        Image of an image position, a camera position or an attitude; '' of others.
    point : str
        '' of camera positions and attitudes.
    size : tuple of float
        Measured minus what the rest of the block says: (col, row) in pixels, or metres, or degrees.
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
        return "px" if self.kind == "image position" else UNITS.get(self.kind, "m")

    def __str__(self) -> str:
        where = " in ".join(each for each in (f"point '{self.point}'" if self.point else "", self.image) if each)
        length = float(np.linalg.norm(self.size))
        said = f"{self.kind}: {where} is off by {length:.3g} {self.unit}"
        return f"{said}: {self.cause}" if self.cause else said


def blunders(solution: BlockSolution) -> list[BlockBlunder]:
    """Measurements that were left out, with likely causes, the least probable first.

    Parameters
    ----------
    solution : BlockSolution
    """
    adjustment = solution.adjustment
    found = []
    for index, group in enumerate(adjustment.problem.groups):
        rows = np.flatnonzero(adjustment.rejected[index])
        if not len(rows):
            continue
        if index == 0:
            found += _of_images(solution, rows)
        elif isinstance(group, GroundControl):
            found += _of_control(solution, index, group, rows)
        else:
            sizes = in_units(group, adjustment.statistics[index].residuals)
            found += [_plain(solution, index, row, tuple(sizes[row].tolist())) for row in rows.tolist()]
    return sorted(found, key=lambda each: (each.log_probability, each.image, each.point))


def _sigma0_with(solution: BlockSolution, index: int, row: int) -> float:
    adjustment, statistic = solution.adjustment, solution.adjustment.statistics[index]
    squares = adjustment.squares + float(statistic.statistic[row])
    freedom = adjustment.redundancy + int(statistic.freedom[row])
    return float(np.sqrt(squares / freedom)) if freedom > 0 else float("nan")


def _plain(solution: BlockSolution, index: int, row: int, size: tuple[float, ...]) -> BlockBlunder:
    """Blunder without a likely cause, of a point or of an image."""
    group, statistic = solution.adjustment.problem.groups[index], solution.adjustment.statistics[index]
    point, (rows, images) = int(group.point[row]), group.row_images
    image = "" if group.of_points else solution.images[int(images[rows == row][0])]
    return BlockBlunder(
        group.name, image, solution.ids[point] if point >= 0 else "", size, float(statistic.log_probability[row]),
        _sigma0_with(solution, index, row), "",
    )  # fmt: skip


def _of_images(solution: BlockSolution, rows: IntArray) -> list[BlockBlunder]:
    adjustment, views = solution.adjustment, solution.adjustment.problem.views
    state, statistic = adjustment.state, adjustment.statistics[0]
    sigma = np.linalg.norm(np.linalg.inv(views.root), axis=(1, 2)) / np.sqrt(2.0)
    computed = _computed(solution)
    found = []
    for image in np.unique(views.image[rows]).tolist():
        mine = rows[views.image[rows] == image]
        seen = computed(image)
        places = np.flatnonzero(np.isfinite(seen).all(axis=1) & state.moving)
        tree = cKDTree(seen[places]) if len(places) else None
        other: dict[int, int] = {}
        for row in mine.tolist():
            off = float(np.linalg.norm(solution.residuals[row]))
            within = min(max(NEAR_SIGMAS * sigma[row], NEAR_PIXELS), NEARER * off if np.isfinite(off) else np.inf)
            if tree is not None:
                distance, nearest = tree.query(views.colrow[row])
                if distance < within and int(places[nearest]) != int(views.points[row]):
                    other[row] = int(places[nearest])
        by_point = {int(views.points[row]): target for row, target in other.items()}
        for row in mine.tolist():
            point, cause = int(views.points[row]), ""
            if not state.moving[point]:
                two = int((views.points == point).sum()) == 2
                cause = "its two rays do not meet: either is wrong" if two else "no two of the point's rays agree"
            elif row in other:
                name = solution.ids[other[row]]
                swapped = by_point.get(other[row]) == point
                cause = f"exchanged with point '{name}'" if swapped else f"it is where point '{name}' lies: wrong id"
            else:
                cause = _wrong_image(solution, computed, row, sigma[row])
            found.append(
                BlockBlunder(
                    "image position", solution.images[image], solution.ids[point],
                    tuple(solution.residuals[row].tolist()), float(statistic.log_probability[row]),
                    _sigma0_with(solution, 0, row), cause,
                )
            )  # fmt: skip
    return found


def _computed(solution: BlockSolution) -> Positions:
    """Function of an image: positions (S, 2) of all points in it."""
    state, frame, cache = solution.adjustment.state, solution.adjustment.problem.frame, dict[int, FloatArray]()

    def positions(image: int) -> FloatArray:
        if image not in cache:
            model = state.models[image]
            cache[image] = model.ground_to_image(frame.to_crs(model.crs, state.points)[0])
        return cache[image]

    return positions


def _wrong_image(solution: BlockSolution, computed: Positions, row: int, sigma: float) -> str:
    """Another image in which the point lies where it was measured."""
    views = solution.adjustment.problem.views
    point = int(views.points[row])
    measured = set(views.image[views.points == point].tolist())
    off = float(np.linalg.norm(solution.residuals[row]))
    for image in range(len(solution.images)):
        if image not in measured:
            distance = float(np.linalg.norm(computed(image)[point] - views.colrow[row]))
            if distance < min(max(NEAR_SIGMAS * sigma, NEAR_PIXELS), NEARER * off):
                return f"it is where {solution.images[image]} shows the point: wrong image"
    return ""


def _of_control(solution: BlockSolution, index: int, group: GroundControl, rows: IntArray) -> list[BlockBlunder]:
    statistic, ground = solution.adjustment.statistics[index], solution.ground
    found = []
    for row in rows.tolist():
        point = int(group.points[row])
        off, sigmas = solution.given[point] - ground[point], np.maximum(solution.point_sigmas[point], 1e-9)
        cause, length = "", float(np.linalg.norm(off))
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
        size = tuple(off.tolist())
        found.append(
            BlockBlunder(
                "control", "", solution.ids[point], size, float(statistic.log_probability[row]),
                _sigma0_with(solution, index, row), cause,
            )
        )  # fmt: skip
    return found
