"""Start of a resection without initial values: poses from three points at a time, judged by all of them."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from geomosaic.sensor.solve.three_points import Pose, three_point_poses
from geomosaic.types import FloatArray

TRIPLES = 24
"""Triples of points that are tried; the widest ones."""
KEPT = 6
"""Poses that are handed on, best first."""
APART = 1e-3
"""Poses whose centres differ by less than this share of the distance to the ground are one."""


def poses(bearings: FloatArray, points: FloatArray) -> tuple[Pose, ...]:
    """Poses from which points are seen in given directions, best first; exact with three points, else approximate.

    Each pose is one of Grunert's solutions of a triple of points that are far apart. With more than three points they
    are ordered by the median angle between where the pose sees the points and where they were measured, so that a
    wrong point, or a few, does not decide; a least squares adjustment (`resect`) then starts from the first ones.

    Parameters
    ----------
    bearings : array (N, 3)
        Directions in camera axes, of any length.
    points : array (N, 3)
        In a right-handed cartesian frame; N is three at least.

    Returns
    -------
    tuple of Pose
        At most six; empty where the points are in line.
    """
    rays = np.asarray(bearings, dtype=np.float64)
    rays = rays / np.linalg.norm(rays, axis=1)[:, None]
    known = np.asarray(points, dtype=np.float64)
    if len(known) == 3:
        return three_point_poses(rays, known)
    found: list[tuple[float, Pose]] = []
    for triple in _triples(rays):
        for pose in three_point_poses(rays[triple], known[triple]):
            off = np.linalg.norm(pose.bearings(known) - rays, axis=1)
            # The three points fit by themselves; the rest judge.
            found.append((float(np.median(np.delete(off, triple))), pose))
    found.sort(key=lambda entry: entry[0])
    kept: list[Pose] = []
    for _, pose in found:
        reach = float(np.linalg.norm(known.mean(axis=0) - pose.centre))
        if all(np.linalg.norm(pose.centre - other.centre) > APART * reach for other in kept):
            kept.append(pose)
        if len(kept) == KEPT:
            break
    return tuple(kept)


def _triples(rays: FloatArray) -> list[list[int]]:
    """Triples of directions that span the largest triangles; of many points only some are looked at."""
    count = len(rays)
    chosen = range(count) if count <= 24 else np.linspace(0, count - 1, 24).astype(int).tolist()
    all_of_them = [list(triple) for triple in combinations(chosen, 3)]
    first, second, third = (rays[[triple[i] for triple in all_of_them]] for i in range(3))
    area = np.linalg.norm(np.cross(second - first, third - first), axis=1)
    return [all_of_them[i] for i in np.argsort(-area)[:TRIPLES]]
