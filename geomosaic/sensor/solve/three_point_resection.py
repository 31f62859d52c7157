"""Three-point space resection (P3P): every solution, and starts of a resection without initial values.

With s₁, s₂, s₃ the distances from the projection centre, a, b, c the sides of the triangle opposite to its points and
α, β, γ the angles between the rays that see these sides, the law of cosines says (Grunert 1841)

    s₂² + s₃² − 2·s₂·s₃·cos α = a²,   s₁² + s₃² − 2·s₁·s₃·cos β = b²,   s₁² + s₂² − 2·s₁·s₂·cos γ = c²

Eliminating all but v = s₃/s₁ leaves a polynomial of degree four (coefficients: Haralick et al. 1994, International
Journal of Computer Vision 13(3), section 3.1). Its roots are polished on the three equations themselves, so that
rounding in the coefficients does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from geomosaic.types import FloatArray

# Newton steps at most; a double root, on the dangerous cylinder, takes many.
POLISH = 50
# Relative difference of distances below which two solutions are one.
SAME = 1e-7


@dataclass(frozen=True)
class Pose:
    """Place and attitude of a camera.

    Attributes
    ----------
    centre : array (3,)
        Projection centre, in the axes and unit of the points.
    rotation : array (3, 3)
        Axes of the points → axes of the camera in which its bearings are.
    """

    centre: FloatArray
    rotation: FloatArray

    def bearings(self, points: FloatArray) -> FloatArray:
        """Unit directions (N, 3) in camera axes in which points (N, 3) are seen."""
        rays = (np.asarray(points, dtype=np.float64) - self.centre) @ self.rotation.T
        out: FloatArray = rays / np.linalg.norm(rays, axis=1)[:, None]
        return out


def three_point_poses(bearings: FloatArray, points: FloatArray) -> tuple[Pose, ...]:
    """Every pose from which three points are seen in three directions.

    Parameters
    ----------
    bearings : array (3, 3)
        Directions to the points in camera axes, one per row, of any length.
    points : array (3, 3)
        The points, one per row, in a right-handed cartesian frame.

    Returns
    -------
    tuple of Pose
        None to four. None where the points are in line or two directions are one.
    """
    rays = np.asarray(bearings, dtype=np.float64)
    rays = rays / np.linalg.norm(rays, axis=1)[:, None]
    known = np.asarray(points, dtype=np.float64)
    origin = known.mean(axis=0)
    scale = float(np.abs(known - origin).max())
    if not np.isfinite(rays).all() or not scale > 0.0:
        return ()
    # Reduced to numbers near 1: squares of geocentric metres would lose half of the digits.
    local = (known - origin) / scale
    # Points in line leave the turn about that line open.
    if np.linalg.norm(np.cross(local[1] - local[0], local[2] - local[0])) < 1e-9:
        return ()
    poses = []
    for distances in _distances(rays, local):
        pose = _pose(rays * distances[:, None], local)
        poses.append(Pose(origin + scale * pose.centre, pose.rotation))
    return tuple(poses)


def _distances(rays: FloatArray, points: FloatArray) -> list[FloatArray]:
    """Triples of distances that fit, each once."""
    sides = np.array([np.sum((points[i] - points[j]) ** 2) for i, j in ((1, 2), (0, 2), (0, 1))])
    cosines = np.array([rays[i] @ rays[j] for i, j in ((1, 2), (0, 2), (0, 1))])
    if (cosines > 1.0 - 1e-14).any():
        return []
    found: list[FloatArray] = []
    for start in _starts(sides, cosines):
        distances = _polished(start, sides, cosines)
        if distances is None:
            continue
        if all(np.abs(distances - other).max() > SAME * np.abs(other).max() for other in found):
            found.append(distances)
    return found


def _starts(sides: FloatArray, cosines: FloatArray) -> list[FloatArray]:
    """Candidates from the roots of Grunert's polynomial, near double roots with both branches."""
    starts = []
    for root in np.roots(_grunert(sides, cosines)):
        # Rounding splits a double root into a complex pair: a small imaginary part is let pass, and polishing judges.
        if abs(root.imag) > 1e-2 * (1.0 + abs(root)) or not root.real > 0.0:
            continue
        v = float(root.real)
        first = np.sqrt(sides[1] / (1.0 + v * v - 2.0 * v * cosines[1]))
        # u = s₂/s₁ from the third law of cosines, which never divides by what may vanish.
        inner = max(cosines[2] ** 2 - 1.0 + sides[2] / first**2, 0.0)
        for u in (cosines[2] + np.sqrt(inner), cosines[2] - np.sqrt(inner)):
            if u > 0.0:
                starts.append(first * np.array([1.0, u, v]))
    return starts


def _grunert(sides: FloatArray, cosines: FloatArray) -> FloatArray:
    """Coefficients of v⁴ to v⁰."""
    a2, b2, c2 = sides
    ca, cb, cg = cosines
    minus, plus = (a2 - c2) / b2, (a2 + c2) / b2
    return np.array(
        [
            (minus - 1.0) ** 2 - 4.0 * c2 / b2 * ca**2,
            4.0 * (minus * (1.0 - minus) * cb - (1.0 - plus) * ca * cg + 2.0 * c2 / b2 * ca**2 * cb),
            2.0
            * (
                minus**2
                - 1.0
                + 2.0 * minus**2 * cb**2
                + 2.0 * (b2 - c2) / b2 * ca**2
                - 4.0 * plus * ca * cb * cg
                + 2.0 * (b2 - a2) / b2 * cg**2
            ),
            4.0 * (-minus * (1.0 + minus) * cb + 2.0 * a2 / b2 * cg**2 * cb - (1.0 - plus) * ca * cg),
            (1.0 + minus) ** 2 - 4.0 * a2 / b2 * cg**2,
        ]
    )


def _polished(start: FloatArray, sides: FloatArray, cosines: FloatArray) -> FloatArray | None:
    """Newton's method on the three laws of cosines; None where it leads to nothing positive."""
    s = start.copy()
    pairs = ((1, 2), (0, 2), (0, 1))
    goal = 1e-14 * (float(np.max(sides)) + float(np.max(start)) ** 2)
    for _ in range(POLISH):
        left = np.array(
            [s[i] ** 2 + s[j] ** 2 - 2.0 * s[i] * s[j] * c for (i, j), c in zip(pairs, cosines, strict=True)]
        )
        left -= sides
        if np.abs(left).max() <= goal:
            break
        slopes = np.zeros((3, 3))
        for row, ((i, j), c) in enumerate(zip(pairs, cosines, strict=True)):
            slopes[row, i], slopes[row, j] = 2.0 * (s[i] - s[j] * c), 2.0 * (s[j] - s[i] * c)
        s = s - np.linalg.lstsq(slopes, left, rcond=1e-13)[0]
        if not np.isfinite(s).all():
            return None
    else:
        # On the dangerous cylinder the root is double, and Newton's method comes near it slowly.
        if np.abs(left).max() > 1e3 * goal:
            return None
    return s if (s > 0.0).all() else None


def _pose(seen: FloatArray, known: FloatArray) -> Pose:
    """Rotation and centre that take known points (3, 3) to their place in camera axes (3, 3)."""
    rotation = _triad(seen).T @ _triad(known)
    return Pose(known.mean(axis=0) - rotation.T @ seen.mean(axis=0), rotation)


def _triad(points: FloatArray) -> FloatArray:
    """Orthonormal axes of a triangle, one per row."""
    first = points[1] - points[0]
    first = first / np.linalg.norm(first)
    normal = np.cross(first, points[2] - points[0])
    normal = normal / np.linalg.norm(normal)
    return np.vstack([first, normal, np.cross(first, normal)])


# Triples of points that are tried; the widest ones.
TRIPLES = 24
# Poses that are returned, best first.
KEPT = 6
# Poses whose centres differ by less than this share of the distance to the ground are one.
APART = 1e-3


def poses(bearings: FloatArray, points: FloatArray) -> tuple[Pose, ...]:
    """Poses from which points are seen in given directions, best first; exact with three points, else approximate.

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
    # Each pose is one of Grunert's solutions of a triple of points that are far apart. With more than three points they
    # are ordered by the median angle between where the pose sees the points and where they were measured, so that a
    # wrong point, or a few, does not decide; a least squares adjustment (`resect`) then starts from the first ones.
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
    # 24 points have 2024 triples; the number grows with the cube.
    chosen = range(count) if count <= 24 else np.linspace(0, count - 1, 24).astype(int).tolist()
    all_of_them = [list(triple) for triple in combinations(chosen, 3)]
    first, second, third = (rays[[triple[i] for triple in all_of_them]] for i in range(3))
    area = np.linalg.norm(np.cross(second - first, third - first), axis=1)
    return [all_of_them[i] for i in np.argsort(-area)[:TRIPLES]]


def dangerous_cylinder(centre: FloatArray, points: FloatArray) -> float:
    """Distance of a projection centre from the dangerous cylinder of three points, as a share of its radius.

    The cylinder stands on the circle through the points, across their plane. From a centre on it three points do not
    determine a pose: two of Grunert's solutions are one there, and sigmas are infinite (Finsterwalder 1903). Four
    points in one plane, no three of them in line, have no such place, on one circle or not: they determine the
    projective map between plane and image, and with it the pose.

    Parameters
    ----------
    centre : array (3,)
    points : array (3, 3)
        Three points, one per row.

    Returns
    -------
    float
        0 on the cylinder, 1 on its axis; infinite for points in line.
    """
    known = np.asarray(points, dtype=np.float64)
    first, second = known[1] - known[0], known[2] - known[0]
    normal = np.cross(first, second)
    twice = float(normal @ normal)
    # Sides that are parallel within 1e-12: no circle goes through points in line.
    if not twice > 1e-24 * float(first @ first) * float(second @ second):
        return float("inf")
    # Middle of the circle from the corner (first, second): the classical formula of the circumcentre.
    middle = np.cross((first @ first) * second - (second @ second) * first, normal) / (2.0 * twice)
    axis = normal / np.sqrt(twice)
    here = np.asarray(centre, dtype=np.float64) - known[0] - middle
    radius = float(np.linalg.norm(middle))
    return abs(float(np.linalg.norm(here - (here @ axis) * axis)) - radius) / radius
