"""Triangulation: points of a block as intersections of their rays, whatever sensors these come from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.types import BoolArray, FloatArray, IntArray

# Pairs of rays that are tried for a point on which its rays do not agree: all of seven rays.
MOST_PAIRS = 21
# Largest over smallest pixel on the ground up to which rays count alike.
ALIKE = 2.0
# Factors of the tolerance, one after the other, and points by which the right one is judged: positions and angles that
# are given may be off by hundreds of pixels.
LOOSENED, JUDGES = (1.0, 5.0, 25.0, 125.0), 500
# Rejection at this many standard deviations, where the scatter is estimated: one in 3000 normal errors of two
# components. Their median length is 1.18 standard deviations of a component.
REJECTION, MEDIAN_LENGTH = 4.0, 1.1774


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays to points.

    Attributes
    ----------
    origins, directions : array (N, 3)
        Directions are unit vectors.
    point : int array (N,)
        Point of each.
    angle : array (N,)
        Angle of a pixel in radians.
    """

    origins: FloatArray
    directions: FloatArray
    point: IntArray
    angle: FloatArray

    def select(self, rows: BoolArray | IntArray) -> Rays:
        """Some of the rays."""
        return Rays(self.origins[rows], self.directions[rows], self.point[rows], self.angle[rows])

    def misses(self, xyz: FloatArray) -> FloatArray:
        """Angles (N,) by which the rays miss their points (S, 3), in pixels; infinite behind the origin."""
        off = _angles(self.directions, xyz[self.point] - self.origins) / self.angle
        return np.where(np.isnan(off), np.inf, off)


@dataclass(frozen=True, eq=False)
class Triangulation:
    """Intersected points.

    Attributes
    ----------
    xyz : array (S, 3)
        NaN where fewer than two rays meet at a sufficient angle.
    parallax : array (S,)
        Angle in radians of two rays with the same spread as those of the point.
    used : bool array (N,)
        Rays that agree on their point.
    """

    xyz: FloatArray
    parallax: FloatArray
    used: BoolArray


def triangulate(rays: Rays, points: int, tolerance: float, depth: float = 10.0) -> Triangulation:
    """Intersection of the rays of many points, with rays left out that do not agree with the others.

    Parameters
    ----------
    rays : Rays
        Origins and directions may be NaN.
    points : int
        Number of points S.
    tolerance : float
        Pixels by which a ray may miss its point; more where most rays miss theirs by more.
    depth : float
        Least parallax in pixels: the distance of a point is known to about 1 / `depth` of itself.
    """
    known = np.flatnonzero(finite(rays.directions) & finite(rays.origins))
    mine = rays.select(known)
    agree, (xyz, parallax) = _agreement(mine, points, _loosened(mine, points, tolerance))
    used = np.zeros(len(rays.point), dtype=bool)
    used[known] = agree
    count = np.bincount(rays.point[used], minlength=points)
    least = np.zeros(points)
    np.maximum.at(least, rays.point[used], rays.angle[used])
    found = (count >= 2) & (parallax > depth * least) & finite(xyz)
    return Triangulation(
        np.where(found[:, None], xyz, np.nan), np.where(found, parallax, 0.0), used & found[rays.point]
    )


def _loosened(rays: Rays, points: int, tolerance: float) -> float:
    """Tolerance at which most rays of a sample of points agree; no scatter tells it, which gross errors inflate."""
    count = np.bincount(rays.point, minlength=points)
    judging = np.flatnonzero(count >= min(3, int(count.max(initial=0))))
    sample = np.zeros(points, dtype=bool)
    sample[judging[:: max(1, len(judging) // JUDGES)]] = True
    rows = np.flatnonzero(sample[rays.point])
    if not len(rows):
        return tolerance
    part = rays.select(rows)
    part = Rays(part.origins, part.directions, np.unique(part.point, return_inverse=True)[1], part.angle)
    for factor in LOOSENED:
        if np.mean(_agreement(part, int(part.point.max()) + 1, factor * tolerance)[0]) >= 0.5:
            return factor * tolerance
    return float("inf")


def _agreement(rays: Rays, points: int, tolerance: float) -> tuple[BoolArray, tuple[FloatArray, FloatArray]]:
    """Rays (N,) that agree on their points within a tolerance, and the intersections of these."""
    found = _intersections(rays, points)
    used = rays.misses(found[0]) <= tolerance
    doubtful = np.zeros(points, dtype=bool)
    doubtful[rays.point[~used]] = True
    again = np.flatnonzero(doubtful[rays.point])
    if len(again):
        used[again] = _agreeing(rays.select(again), tolerance)
        used &= rays.misses(_intersections(rays.select(used), points)[0]) <= tolerance
        found = _intersections(rays.select(used), points)
    return used, found


def finite(places: FloatArray) -> BoolArray:
    """Rows (N,) of places (N, 3), or of matrices (N, 3, 3), without a NaN.

    Parameters
    ----------
    places : array (N, 3) or (N, 3, 3)
    """
    return np.asarray(np.isfinite(places).all(axis=tuple(range(1, places.ndim))))


def spread_tolerance(off: FloatArray) -> float:
    """Tolerance in pixels of misses (N,): 4 times their robust scatter.

    Parameters
    ----------
    off : array (N,)
        Pixels.
    """
    finite = off[np.isfinite(off)]
    scatter = float(np.median(finite)) / MEDIAN_LENGTH if len(finite) else 0.0
    return REJECTION * scatter


def _intersections(rays: Rays, points: int) -> tuple[FloatArray, FloatArray]:
    """Points (S, 3) with the least sum of squared misses of their rays, in pixels, and parallaxes (S,)."""
    xyz, parallax = _nearest(rays, points, np.ones(len(rays.point)))
    size = rays.angle * np.linalg.norm(xyz[rays.point] - rays.origins, axis=1)
    known = np.isfinite(size)
    # Metres are misses in pixels only where pixels are alike: a scene's of 20 m must not pull a drone's of 0.1 m.
    if known.any() and size[known].max() > ALIKE * size[known].min():
        xyz = _nearest(rays, points, np.where(known, size, 1.0) ** -2.0)[0]
    return xyz, parallax


def _nearest(rays: Rays, points: int, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (S, 3) with the least weighted sum of squared distances from their rays, and parallaxes (S,)."""
    d, count = rays.directions, np.maximum(np.bincount(rays.point, weight, points), 1e-300)
    outer = np.empty((points, 3, 3))
    right = np.empty((points, 3))
    # Near the middle of a point's origins, where differences of large coordinates keep their digits.
    middle = np.column_stack([np.bincount(rays.point, weight * rays.origins[:, i], points) / count for i in range(3)])
    local = rays.origins - middle[rays.point]
    along = np.einsum("ni,ni->n", d, local)
    for i in range(3):
        right[:, i] = np.bincount(rays.point, weight * (local[:, i] - d[:, i] * along), points)
        for j in range(i, 3):
            outer[:, i, j] = outer[:, j, i] = np.bincount(rays.point, weight * d[:, i] * d[:, j], points)
    normal = count[:, None, None] * np.eye(3) - outer
    # Two rays at an angle θ leave 1 − cos θ = 2·sin²(θ/2) as the least eigenvalue.
    parallax = 2.0 * np.arcsin(np.sqrt(np.clip(_least_eigenvalues(normal / count[:, None, None]), 0.0, 1.0)))
    # Rays that are parallel to the last digits meet nowhere.
    meets = (np.bincount(rays.point, minlength=points) >= 2) & (parallax > 1e-7)
    xyz = np.full((points, 3), np.nan)
    xyz[meets] = middle[meets] + np.linalg.solve(normal[meets], right[meets][:, :, None])[:, :, 0]
    return xyz, parallax


def _least_eigenvalues(matrices: FloatArray) -> FloatArray:
    """Least eigenvalues (S,) of symmetric matrices (S, 3, 3) that are not negative definite."""
    # Newton's method on the characteristic polynomial rises from zero to its least root: a fifth of the time of LAPACK.
    a, b, c = (matrices[:, i, i] for i in range(3))
    d, e, f = matrices[:, 1, 2], matrices[:, 0, 2], matrices[:, 0, 1]
    trace, minors = a + b + c, b * c - d * d + a * c - e * e + a * b - f * f
    determinant = a * (b * c - d * d) - f * (f * c - d * e) + e * (f * d - b * e)
    root = np.zeros(len(matrices))
    for _ in range(12):
        slope = (3.0 * root - 2.0 * trace) * root + minors
        value = ((root - trace) * root + minors) * root - determinant
        root -= np.where(slope > 0.0, value / np.where(slope > 0.0, slope, 1.0), 0.0)
    return np.maximum(root, 0.0)


def _agreeing(rays: Rays, tolerance: float) -> BoolArray:
    """Rays (N,) that agree on a point with the best of the pairs of rays of that point."""
    order = np.argsort(rays.point, kind="stable")
    _, first, own, count = np.unique(rays.point[order], return_index=True, return_inverse=True, return_counts=True)
    mine = rays.select(order)
    mine = Rays(mine.origins, mine.directions, own, mine.angle)
    best, cost = np.full((len(first), 3), np.nan), np.full(len(first), np.inf)
    # Pairs by rising distance within a point's rays, so that few tries see all rays.
    most = int(count.max())
    tried, wanted = np.zeros(len(first), dtype=np.int64), np.minimum(MOST_PAIRS, count * (count - 1) // 2)
    for a, b in ((a, a + gap) for gap in range(1, most) for a in range(most - gap)):
        concerned = (count > b) & (tried < wanted)
        if not concerned.any():
            # One point of hundreds of rays has ten thousands of pairs.
            if (tried == wanted).all():
                break
            continue
        tried += concerned
        xyz = np.full((len(first), 3), np.nan)
        xyz[concerned] = midpoints(mine.select(first[concerned] + a), mine.select(first[concerned] + b))
        part = mine.select(np.flatnonzero(concerned[own]))
        # Truncated sum of squares: many agreeing rays win, and among equals the closest.
        missed = np.minimum(part.misses(xyz) / tolerance, 1.0) ** 2
        total = np.where(concerned, np.bincount(part.point, missed, len(first)), np.inf)
        better = total < cost
        cost[better], best[better] = total[better], xyz[better]
    used = mine.misses(best) <= tolerance
    agree = np.zeros(len(order), dtype=bool)
    agree[order] = used & (np.bincount(own[used], minlength=len(first)) >= 2)[own]
    return agree


def midpoints(one: Rays, other: Rays) -> FloatArray:
    """Places (N, 3) between two rays each, where they come nearest to each other, as many pixels from one as the other.

    Parameters
    ----------
    one, other : Rays
        Of equal number.
    """
    across = other.origins - one.origins
    cosine = np.einsum("ni,ni->n", one.directions, other.directions)
    first, second = (np.einsum("ni,ni->n", across, rays.directions) for rays in (one, other))
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.stack([first - cosine * second, cosine * first - second]) / (1.0 - cosine**2)
        size = along * [one.angle, other.angle]
        share = size[0] ** 2 / (size**2).sum(axis=0)
    ends = one.origins + along[0, :, None] * one.directions, other.origins + along[1, :, None] * other.directions
    place: FloatArray = ends[0] + share[:, None] * (ends[1] - ends[0])
    return place


def _angles(directions: FloatArray, towards: FloatArray) -> FloatArray:
    """Angles (N,) between unit directions and vectors (N, 3)."""
    across = np.linalg.norm(np.cross(directions, towards), axis=1)
    angle: FloatArray = np.arctan2(across, np.einsum("ni,ni->n", directions, towards))
    return angle
