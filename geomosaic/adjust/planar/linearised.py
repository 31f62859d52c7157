"""The search's network of a block at an adjustment of most of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from geomosaic.adjust.network.findings import Label
from geomosaic.adjust.network.labels import Doubt, named
from geomosaic.adjust.network.linear import Network
from geomosaic.adjust.network.shifts import Shifts
from geomosaic.adjust.planar.equations import GROUND, mean_positions, views_of
from geomosaic.adjust.planar.kinds import by_parameters, by_photo
from geomosaic.adjust.planar.problem import Problem
from geomosaic.adjust.planar.residuals import image_residuals
from geomosaic.adjust.planar.solution import PlanarSolution
from geomosaic.adjust.planar.tilt import lacking_terms
from geomosaic.adjust.planar.transform import PlanarTransform, half, photo_coordinates
from geomosaic.adjust.planar.values import PlanarBlock
from geomosaic.types import FloatArray, IntArray


def shifts_of(
    block: PlanarBlock,
    solution: PlanarSolution,
    fixed: Mapping[str, PlanarTransform],
    left: Sequence[Doubt] = (),
    tilted: frozenset[str] = frozenset(),
) -> tuple[Shifts, list[Label], list[Doubt]]:
    """The block at a solution of most of it, what may be wrong in it, and the names of that.

    Parameters
    ----------
    block : PlanarBlock
    solution : PlanarSolution
        Of the block, or of it without some measurements.
    fixed : mapping of str to PlanarTransform
        Photos that are held.
    left : sequence of Doubt
        What the solution is without.
    tilted : frozenset of str
        Photos with unknowns for what the kind of the solution lacks: the last ones, in the order of the block.
    """
    views, kind, values = views_of(block), solution.kind, solution.values
    problem = Problem(block, kind, views, solution.frame, fixed)
    names = [None if i == GROUND else block.photos[i].name for i in views.photo]
    out = set(left)
    off = np.array([(views.ids[p], name) in out for p, name in zip(views.point, names, strict=True)])
    inside = problem.in_photo
    sigma = np.where(off, np.inf, problem.sigma_ground(values, views.xy))
    points = mean_positions(views, problem.positions(values, views.xy), sigma)
    errors = image_residuals(problem, values, points)[inside]
    at, photo, point = problem.adjusted(values, points)[inside], views.photo[inside], views.point[inside]
    own = values[photo]
    turn = np.array([1.0, -1.0]) / problem.half[photo, None]
    by_point = np.linalg.inv(by_photo(kind, own, at) * turn[:, None, :])
    slopes = -by_point @ by_parameters(kind, own, at)

    given, given_sigma = np.zeros((len(views.ids), 2)), np.full(len(views.ids), np.inf)
    ground = np.flatnonzero(~inside)
    known = views.point[ground]
    given[known] = problem.ground[ground] - points[known]
    given_sigma[known] = views.sigma[ground] / problem.frame.scale
    held = given_sigma[point] == 0.0  # linearised where the photos put it, but held where it is given
    errors[held] -= np.einsum("nij,nj->ni", by_point[held], given[point[held]])

    seen = np.bincount(point, minlength=len(views.ids))
    used = (seen[point] > 1) | np.isfinite(given_sigma[point])
    numbers = np.unique(point[used], return_inverse=True)[1]
    chosen = np.unique(point[used])
    first = problem.first[photo[used]]
    columns = np.where(first[:, None] >= 0, first[:, None] + np.arange(problem.count), -1)
    columns, slopes, unknowns = _with_tilt(problem, tilted, at[used], photo[used], columns, slopes[used])
    network = Network(
        numbers, columns, slopes, by_point[used], errors[used], views.sigma[inside][used],
        np.where(given_sigma[chosen, None] > 0.0, given[chosen], 0.0), given_sigma[chosen],
        np.full(unknowns, np.inf), np.zeros(unknowns),
    )  # fmt: skip
    images = [block.photos[int(k)].name for k in photo[used]]
    ids = [views.ids[k] for k in chosen]
    lines = [block.by_photo[name][ids[k]].where for name, k in zip(images, numbers, strict=True)]
    return named(network, ids, images, lines, "tie point")


def tilt_shifts(block: PlanarBlock, kind: str, tilted: frozenset[str], unknowns: FloatArray) -> dict[str, float]:
    """Largest shift in pixels, at the points of each tilted photo, by the unknowns (U,) that the kind lacks."""
    names = [photo.name for photo in block.photos if photo.name in tilted]
    count = lacking_terms(kind, np.zeros((1, 2))).shape[-1]
    own = unknowns[len(unknowns) - count * len(names) :].reshape(len(names), count)
    found = {}
    for name, values in zip(names, own, strict=True):
        size = block.photo(name).size
        colrow = np.array([[p.col, p.row] for p in block.by_photo[name].values()])
        moved = lacking_terms(kind, photo_coordinates(size, colrow)) @ values * half(size)
        found[name] = float(np.hypot(*moved.T).max())
    return found


def _with_tilt(
    problem: Problem, tilted: frozenset[str], at: FloatArray, photo: IntArray, columns: IntArray, slopes: FloatArray
) -> tuple[IntArray, FloatArray, int]:
    """Columns and slopes of the views with those of what the kind lacks, and how many unknowns there are."""
    if not tilted:
        return columns, slopes, problem.unknowns
    terms = lacking_terms(problem.kind, at) * (np.array([1.0, -1.0]) * problem.half[photo, None])[:, :, None]
    count = terms.shape[-1]
    own = np.array([one.name in tilted for one in problem.block.photos])
    first = np.where(own, problem.unknowns + (np.cumsum(own) - 1) * count, -1)[photo]
    further = np.where(first[:, None] >= 0, first[:, None] + np.arange(count), -1)
    return (
        np.hstack([columns, further]),
        np.concatenate([slopes, terms], axis=2),
        problem.unknowns + count * len(tilted),
    )
