"""Datum of a block before it is solved: its parts, the directions in which each is free, and images on one line.

A part of a block that nothing holds can be moved, turned and scaled without a residual. So each of these seven changes
is tried: its points go along, each image follows as well as its parameters can, and what is left of all residuals is
what the observations have against it. Their smallest eigenvalue tells the free direction, in metres.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from geomosaic.errors import SolveError, counted, listed
from geomosaic.estimation.observations import Observations
from geomosaic.orientation.block.connectivity import UndeterminedError, connectivity
from geomosaic.orientation.block.observations import Group, slices_of
from geomosaic.orientation.block.problem import BlockProblem, weighted
from geomosaic.orientation.block.unknowns import BlockState
from geomosaic.types import FloatArray, IntArray

# Standard deviation of a direction, over the size of the part, from which on it is free: what nothing holds has one of
# thousands, by rounding alone.
FREE = 5.0
# Least eigenvalue of an image's normalised equations on known points: its points are on one line, or too few.
DEGENERATE = 1e-10
# Mean square movement of points, in metres, below which a change of about a metre does not move them.
UNMOVED = 1e-6
CHANGES = ("shift in east", "shift in north", "shift in height", "tilt about east", "tilt about north", "turn", "scale")


@dataclass(frozen=True, eq=False)
class Part:
    """Part of a block that its points join.

    Attributes
    ----------
    images : int array
    points : int array
    free : tuple of str
        What nothing holds; empty where the part has a datum.
    """

    images: IntArray
    points: IntArray
    free: tuple[str, ...]


def _parts_of(problem: BlockProblem, state: BlockState) -> list[Part]:
    """Parts of a block, at its first values, with their datum, the largest first."""
    groups = [
        weighted(group.linearised(state, problem.unknowns, problem.frame), weight)
        for group, weight in zip(problem.groups, state.weights, strict=True)
    ]
    found = []
    for images, points in _joined(problem, state):
        found.append(Part(images, points, _free(problem, state, groups, images, points)))
    return found


def _joined(problem: BlockProblem, state: BlockState) -> list[tuple[IntArray, IntArray]]:
    """Images and points of each part: joined by any point or rig, and, where that is less, by six not on a line."""
    views = problem.views
    part = state.weights[0] > 0.0
    image, point = views.image[part], views.points[part]
    count = len(state.models)
    ends = [_pairs(group) for group in problem.groups]
    one, other = np.concatenate([image, *(a for a, _ in ends)]), np.concatenate([count + point, *(b for _, b in ends)])
    graph = sparse.csr_array((np.ones(len(one)), (one, other)), shape=(count + len(state.points),) * 2)
    labels = connected_components(graph, directed=False)[1]
    loose = [np.flatnonzero(labels[:count] == label) for label in dict.fromkeys(labels[:count].tolist())]
    firm = connectivity(image, point, views.colrow[part], count).parts
    sets = {tuple(images.tolist()): images for images in (*loose, *(each for each in firm if len(each) > 1))}
    found = [(images, np.unique(point[np.isin(image, images)])) for images in sets.values()]
    # Images without points are held by their poses alone.
    return sorted((each for each in found if len(each[1])), key=lambda each: -len(each[0]))


def _pairs(group: Group) -> tuple[IntArray, IntArray]:
    """Images that one observation joins, as those of a rig."""
    row, image = group.row_images
    row, image = row[order := np.argsort(row, kind="stable")], image[order]
    both = np.flatnonzero(np.diff(row) == 0)
    return image[both], image[both + 1]


def _free(
    problem: BlockProblem, state: BlockState, groups: Sequence[Observations], images: IntArray, points: IntArray
) -> tuple[str, ...]:
    """Changes that nothing holds."""
    unknowns = problem.unknowns
    places = state.points[points]
    off = places - places.mean(axis=0)
    spread = float(np.sqrt((off**2).sum(axis=1).mean()))
    size = spread or _widest(problem, state, groups[0], images)
    generators = np.zeros((len(state.points), 3, 7))
    # All move points by about a metre.
    generators[points, :, :3] = np.eye(3)
    for axis in range(3):
        generators[points, :, 3 + axis] = np.cross(np.eye(3)[axis], off) / size
    generators[points, :, 6] = off / size
    columns = np.unique(np.concatenate([unknowns.of_group(each) for each in _unknowns_of(problem, images)]))
    columns = columns[columns >= 0]
    # One place more, for the column -1 of what is held.
    local = np.full(unknowns.count + 1, -1)
    local[columns] = np.arange(len(columns))
    kept = {point: unknowns.kept_columns[point] for point in np.intersect1d(unknowns.kept, points).tolist()}
    design, moved = [], []
    for found in groups:
        rows, cols, values, change = _rows(found, local, generators, kept, unknowns.count)
        design.append(sparse.csr_array((values, (rows, cols)), shape=(len(change), len(columns))))
        moved.append(change)
    a, b = sparse.csr_array(sparse.vstack(design)), np.vstack(moved)
    # A turn about a line through all points moves none of them: `_undetermined_images` tells what images say of it.
    motion = generators[points].reshape(-1, 7)
    lengths, axes = np.linalg.eigh(motion.T @ motion / len(points))
    axes = axes[:, lengths > UNMOVED]
    left = _left(a, b) @ axes
    values, vectors = np.linalg.eigh(left.T @ left)
    reach = size * np.sqrt(3.0)
    sigma = 1.0 / np.sqrt(np.maximum(values, 1e-300))
    loose = axes @ vectors[:, sigma > FREE * reach]
    if not loose.shape[1]:
        return ()
    # How much of each plain change lies in the free space.
    share = (loose**2).sum(axis=1)
    return tuple(name for name, part in zip(CHANGES, share.tolist(), strict=True) if part > 0.3)


def _widest(problem: BlockProblem, state: BlockState, views: Observations, images: IntArray) -> float:
    """Metres on the ground of the widest of some images: the extent of a part whose points are all at one place."""
    part = state.weights[0] > 0.0
    by_pixel = np.linalg.solve(problem.views.root[part], views.by_point)
    image, scale = problem.views.image[part], np.linalg.norm(by_pixel, axis=(1, 2))
    return max(float(max(state.models[k].size) / scale[image == k].max()) for k in images.tolist() if k in image)


def _unknowns_of(problem: BlockProblem, images: IntArray) -> Iterator[int]:
    """Groups of unknowns that can follow: of the images, their cameras, and all further ones."""
    unknowns = problem.unknowns
    count = len(unknowns.images)
    yield from images.tolist()
    yield from (count + camera for camera in np.unique(unknowns.camera[images]).tolist() if camera >= 0)
    yield from range(count + len(unknowns.interiors), count + len(unknowns.interiors) + len(unknowns.further))


def _rows(
    found: Observations, local: IntArray, generators: FloatArray, kept: dict[int, IntArray], count: int
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Entries of the design of unknowns that can follow, and the change (R, 7) of all rows by the generators."""
    size = found.misclosure.shape[1]
    moved = np.zeros((*found.misclosure.shape, 7))
    there = found.point >= 0
    moved[there] = found.by_point[there] @ generators[found.point[there]]
    by_column = np.zeros((count + 1, 7))
    for point, columns in kept.items():
        by_column[columns] = generators[point]
    if kept:
        moved += np.einsum("nkp,npg->nkg", found.by_parameters, by_column[found.columns])
    place = local[found.columns]
    observation, parameter = np.nonzero(place >= 0)
    rows = (observation[:, None] * size + np.arange(size)).ravel()
    cols = np.repeat(place[observation, parameter], size)
    return rows, cols, found.by_parameters[observation, :, parameter].ravel(), moved.reshape(-1, 7)


def _left(a: sparse.csr_array, b: FloatArray) -> FloatArray:
    """What the best parameters leave of the columns of b."""
    touched = np.flatnonzero(np.diff(a.tocsc().indptr) > 0)
    if not len(touched):
        return b
    own = a[:, touched]
    length = np.sqrt(np.asarray(own.multiply(own).sum(axis=0)).ravel())
    scaled = own @ sparse.diags_array(1.0 / np.maximum(length, 1e-300))
    # A millionth of a millionth holds parameters of an image that its points do not determine.
    factor = splu(sparse.csc_array(scaled.T @ scaled + 1e-12 * sparse.eye_array(len(touched))))
    left = b.copy()
    for _ in range(3):
        left -= scaled @ factor.solve(np.asarray(scaled.T @ left))
    return left


def _undetermined_images(problem: BlockProblem, state: BlockState) -> IntArray:
    """Images whose own parameters their points, at first values, do not determine, wherever these lie."""
    unknowns, count = problem.unknowns, len(state.models)
    widths = [int((unknowns.of_group(image) >= 0).sum()) for image in range(count)]
    normals = [np.zeros((width, width)) for width in widths]
    first = unknowns.blocks[:count]
    for group, weight in zip(problem.groups, state.weights, strict=True):
        found = weighted(group.linearised(state, unknowns, problem.frame), weight)
        own, image = group.row_images
        there = weight[own] > 0.0
        own, image = (np.cumsum(weight > 0.0) - 1)[own[there]], image[there]
        own, image = own[order := np.argsort(image, kind="stable")], image[order]
        for each, part in slices_of(image):
            if not widths[each]:
                continue
            rows = own[part]
            columns = found.columns[rows] - first[each]
            mine = (found.columns[rows] >= 0) & (columns >= 0) & (columns < widths[each])
            dense = np.zeros((len(rows), found.misclosure.shape[1], widths[each]))
            row, place = np.nonzero(mine)
            dense[row, :, columns[row, place]] = found.by_parameters[rows][row, :, place]
            flat = dense.reshape(-1, widths[each])
            normals[each] += flat.T @ flat
    return np.array([image for image, normal in enumerate(normals) if _singular(normal)], dtype=np.int64)


def _singular(normal: FloatArray) -> bool:
    if not len(normal):
        return False
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    return bool(np.linalg.eigvalsh(normal / np.outer(scale, scale))[0] < DEGENERATE or (np.diag(normal) <= 0.0).any())


def require_determined(problem: BlockProblem, state: BlockState) -> list[str]:
    """Check that a block has a datum and determines its images.

    Parameters
    ----------
    problem : BlockProblem
    state : BlockState
        First values.

    Returns
    -------
    list of str
        Remarks on parts that nothing joins.

    Raises
    ------
    SolveError
        Names the parts without a datum and the directions in which they are free; or the images.
    """
    names = problem.unknowns.images
    parts = _parts_of(problem, state)
    loose = [] if problem.free and len(parts) == 1 else [part for part in parts if part.free]
    if loose:
        described = "; ".join(f"{_named(names, part.images)}: {_freedom(part)}" for part in loose[:4])
        whole = len(parts) == 1
        what = (
            "the block has no datum"
            if whole and len(loose[0].free) == 7
            else (
                "too little holds the block" if whole else f"{counted(len(loose), 'part')} of the block without a datum"
            )
        )
        raise UndeterminedError(
            f"{what}: {described}",
            hint="give three control points or more that are not on one line, or the accuracy of camera positions "
            "(`position_sigma`)" + ("" if whole else ", in each part; or join the parts by tie points"),
            parts=() if problem.free else [part.images for part in loose],
        )
    poor = _undetermined_images(problem, state)
    if len(poor):
        raise SolveError(
            f"the points of {listed((names[image] for image in poor.tolist()), 6)} lie on one line, or are too few: "
            "they do not determine the orientation",
            hint="measure points that are spread over the image, or give the accuracy of its position and angles "
            "(`position_sigma`, `attitude_sigma`), or fix it (`fixed`)",
        )
    apart = [part for part in parts if not any(_within(part, other) for other in parts)]
    if len(apart) < 2:
        return []
    listing = "; ".join(_named(names, part.images) for part in apart)
    return [f"{counted(len(apart), 'part')} that no points join, each adjusted by itself: {listing}"]


def _within(part: Part, other: Part) -> bool:
    return len(part.images) < len(other.images) and bool(np.isin(part.images, other.images).all())


def _freedom(part: Part) -> str:
    return "nothing holds it" if len(part.free) == 7 else f"free in {listed(part.free, 7)}"


def _named(names: Sequence[str], images: IntArray) -> str:
    chosen = [names[image] for image in images.tolist()]
    return f"{counted(len(chosen), 'image')} ({listed(chosen, 3)})"
