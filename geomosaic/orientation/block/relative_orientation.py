"""Relative orientation of two images from common points alone, of any field of view.

Five points determine the essential matrix E = [t]×·R of b₂ᵀ·E·b₁ = 0 (Nistér 2004, IEEE PAMI 26(6)): it is a
combination of the four matrices that the five equations leave open, and det E = 0, 2·E·Eᵀ·E = tr(E·Eᵀ)·E are ten cubics
in its coefficients, whose solutions are eigenvectors of a matrix 10 × 10 (Stewénius, Engels and Nistér 2006, ISPRS
Journal 60(4)). It works on directions rather than on image coordinates, for fisheyes as well, and on flat ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.estimation.equations import Equations
from geomosaic.estimation.solver import Problem, Stopping, solve
from geomosaic.geo.local_frames import angle_axis, cross_matrices
from geomosaic.types import BoolArray, FloatArray

# Samples of five points that are drawn at once, and at most: of 50 % wrong ties, 450 hold a right one at 99.9999 %.
BATCH, MOST_SAMPLES = 64, 512
# Points that judge the solutions of the samples.
JUDGES = 300
# Solutions that are adjusted, and how far apart the entries of two are: a few degrees.
CANDIDATES, DISTINCT = 4, 0.05
# Share of the best solution's points on which another one may rest: 16 % lie behind a camera of a wrong one, or none.
NEARLY = 0.95


@dataclass(frozen=True, eq=False)
class RelativeOrientation:
    """Pose of a second image relative to a first.

    Attributes
    ----------
    centre : array (3,)
        Of the second projection centre in the axes of the first camera, of length one.
    rotation : array (3, 3)
        From the first camera's axes to the second's.
    used : bool array (N,)
        Common points that agree.
    parallax : float
        Median angle in radians between the rays of these.
    """

    centre: FloatArray
    rotation: FloatArray
    used: BoolArray
    parallax: float

    @property
    def matrix(self) -> FloatArray:
        """Essential matrix of norm one."""
        matrix: FloatArray = cross_matrices(-(self.rotation @ self.centre)[None])[0] @ self.rotation / np.sqrt(2.0)
        return matrix


def relative_orientations(
    first: FloatArray, second: FloatArray, angle: FloatArray, tolerance: float
) -> tuple[RelativeOrientation, ...]:
    """Relative orientations of two images, best first: mostly one.

    Points of a plane allow two, which a few points behind a camera or a third image tell apart.

    Parameters
    ----------
    first, second : array (N, 3)
        Unit directions to common points, in the axes of each camera.
    angle : array (N,)
        Angle of a pixel in radians.
    tolerance : float
        Pixels by which rays may miss each other.

    Returns
    -------
    tuple of RelativeOrientation
        Those on which nearly as many points agree, in front of both cameras, as on the best; none with fewer than six.
    """
    if len(first) < 6:
        return ()
    refined = [
        _refined(matrix, first, second, angle, tolerance) for matrix in _candidates(first, second, angle, tolerance)
    ]
    found = sorted((one for one in refined if one is not None), key=lambda one: -np.count_nonzero(one.used))
    kept: list[RelativeOrientation] = []
    for one in found:
        nearly = np.count_nonzero(one.used) >= NEARLY * np.count_nonzero(found[0].used)
        if nearly and all(_apart(one.matrix, other.matrix) > DISTINCT for other in kept):
            kept.append(one)
    return tuple(kept)


def _candidates(first: FloatArray, second: FloatArray, angle: FloatArray, tolerance: float) -> list[FloatArray]:
    """Best and distinct ones of the essential matrices of random samples."""
    judges = np.unique(np.linspace(0, len(first) - 1, JUDGES).astype(np.int64))
    rng = np.random.default_rng(len(first))
    kept: list[tuple[float, FloatArray]] = []
    drawn, wanted = 0, MOST_SAMPLES
    while drawn < wanted:
        chosen = np.argsort(rng.random((BATCH, len(first))), axis=1)[:, :5]
        drawn += BATCH
        matrices = essential_matrices(first[chosen], second[chosen])
        off = _misses(matrices, first[judges], second[judges]) / angle[judges]
        # Truncated sums of squares: many agreeing points win, and among equals the closest.
        totals = np.sum(np.minimum(off / tolerance, 1.0) ** 2, axis=1)
        best = np.argsort(totals, kind="stable")[: 4 * CANDIDATES]
        pool = sorted([*kept, *((float(totals[i]), matrices[i]) for i in best)], key=lambda entry: entry[0])
        kept = []
        for total, matrix in pool:
            if len(kept) < CANDIDATES and all(_apart(matrix, other) > DISTINCT for _, other in kept):
                kept.append((total, matrix))
        share = float(np.mean(off[best[0]] <= tolerance)) if len(best) else 0.0
        wanted = min(wanted, _samples(share, 5))
    return [matrix for _, matrix in kept]


def _apart(one: FloatArray, other: FloatArray) -> float:
    """Difference of two essential matrices of norm one, whose sign says nothing."""
    return float(min(np.abs(one - other).max(), np.abs(one + other).max()))


def _samples(share: float, size: int) -> int:
    """Samples of which one holds right points alone with great probability, of a share of right points."""
    return int(np.ceil(np.log(1e-6) / np.log(max(1.0 - min(share, 0.999) ** size, 1e-9))))


def _refined(
    matrix: FloatArray, first: FloatArray, second: FloatArray, angle: FloatArray, tolerance: float
) -> RelativeOrientation | None:
    """Least squares over all agreeing points, whose number grows as the solution becomes better."""
    used = _misses(matrix[None], first, second)[0] / angle <= 2.0 * tolerance
    for _ in range(3):
        if np.count_nonzero(used) < 6:
            return None
        pose = _in_front(matrix, first[used], second[used])
        if pose is None:
            return None
        problem = _Coplanarity(first[used], second[used], angle[used])
        rotation, base = solve(problem, pose, Stopping(rounds=20, step=1e-8)).state
        matrix = cross_matrices(base[None])[0] @ rotation
        used = _misses(matrix[None], first, second)[0] / angle <= tolerance
    near, far = _depths(rotation, base, first, second)
    used &= (near > 0.0) & (far > 0.0)
    if np.count_nonzero(used) < 6:
        return None
    cosine = np.einsum("ni,ni->n", first[used] @ rotation.T, second[used])
    parallax = float(np.median(np.arccos(np.clip(cosine, -1.0, 1.0))))
    return RelativeOrientation(-rotation.T @ base, rotation, used, parallax)


# Monomials of x, y, z by their exponents: linear ones with 1, quadratic, cubic; those of highest degree first.
_LINEAR: list[tuple[int, ...]] = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0)]
_CUBIC: list[tuple[int, ...]] = [
    (a, b, c) for degree in (3, 2, 1, 0) for a in range(4) for b in range(4) for c in range(4) if a + b + c == degree
]
_QUADRATIC = [m for m in _CUBIC if sum(m) <= 2]


def _products(left: list[tuple[int, ...]], into: list[tuple[int, ...]]) -> FloatArray:
    """Tensor (L, 4, K) of products of monomials with linear ones."""
    table = np.zeros((len(left), len(_LINEAR), len(into)))
    for i, a in enumerate(left):
        for j, b in enumerate(_LINEAR):
            table[i, j, into.index(tuple(p + q for p, q in zip(a, b, strict=True)))] = 1.0
    return table


_TO_QUADRATIC, _TO_CUBIC = _products(_LINEAR, _QUADRATIC), _products(_QUADRATIC, _CUBIC)
# Products of the ten lower monomials with x: cubics, by their row, or lower ones again.
_TIMES_X = [_CUBIC.index((a + 1, b, c)) for a, b, c in _CUBIC[10:]]


def essential_matrices(first: FloatArray, second: FloatArray) -> FloatArray:
    """Essential matrices of samples of five points.

    Parameters
    ----------
    first, second : array (S, 5, 3)
        Unit directions in the axes of each camera.

    Returns
    -------
    array (H, 3, 3)
        All real solutions of all samples, of norm one.
    """
    equations = np.einsum("sni,snj->snij", second, first).reshape(len(first), 5, 9)
    open_ = np.linalg.svd(equations)[2][:, 5:, :].reshape(-1, 4, 3, 3)
    e = np.moveaxis(open_, 1, 3)  # (S, 3, 3, 4): entries linear in x, y, z

    def quadratic(path: str, a: FloatArray, b: FloatArray) -> FloatArray:
        return np.tensordot(np.einsum(path, a, b), _TO_QUADRATIC, axes=2)

    squared = quadratic("sija,skjb->sikab", e, e)
    cubic = np.einsum("sikq,skja->sijqa", squared, e) - 0.5 * np.einsum("skkq,sija->sijqa", squared, e)
    minors = quadratic("sia,sjb->sijab", e[:, 1], e[:, 2])
    cofactors = np.stack([minors[:, i, j] - minors[:, j, i] for i, j in ((1, 2), (2, 0), (0, 1))], axis=1)
    determinant = np.einsum("siq,sia->sqa", cofactors, e[:, 0])
    stacked = np.concatenate([cubic.reshape(len(e), 9, 10, 4), determinant[:, None]], axis=1)
    system = np.tensordot(stacked, _TO_CUBIC, axes=2)
    # Samples of points on one line or twice the same leave more than four matrices open; a solution fits them anyway.
    right = np.linalg.pinv(system[:, :, :10]) @ system[:, :, 10:]
    action = np.zeros((len(e), 10, 10))
    for row, column in enumerate(_TIMES_X):
        if column < 10:
            action[:, row] = -right[:, column]
        else:
            action[:, row, column - 10] = 1.0
    values, vectors = np.linalg.eig(action)
    scale = vectors[:, 9]
    with np.errstate(divide="ignore", invalid="ignore"):
        solved = np.stack([vectors[:, _CUBIC.index(m) - 10] / scale for m in _LINEAR], axis=2)
    real = np.isfinite(solved).all(axis=2) & (np.abs(values.imag) < 1e-6 * (1.0 + np.abs(values)))
    found = np.einsum("sijk,slk->slij", e, np.where(real[:, :, None], solved.real, 0.0))[real]
    norm = np.linalg.norm(found, axis=(1, 2))
    matrices: FloatArray = found[norm > 0.0] / norm[norm > 0.0, None, None]
    return matrices


def _misses(matrices: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Angles (H, N) by which directions miss the coplanarity, to first order (Sampson's distance on the sphere)."""
    right, left = first @ np.swapaxes(matrices, 1, 2), second @ matrices
    value = np.einsum("hni,ni->hn", right, second)
    # Steps across the directions alone: the parts along them are taken off.
    slope = np.einsum("hni,hni->hn", right, right) + np.einsum("hni,hni->hn", left, left) - 2.0 * value**2
    off: FloatArray = np.abs(value) / np.sqrt(np.maximum(slope, 1e-300))
    return off


def _in_front(matrix: FloatArray, first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Rotation and base of an essential matrix that have most points in front of both cameras; None if few are."""
    u, _, v = np.linalg.svd(matrix)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    best: tuple[FloatArray, FloatArray] | None = None
    most = len(first) // 2
    for half in (turn, turn.T):
        rotation = u @ half @ v
        rotation = rotation * np.sign(np.linalg.det(rotation))
        for base in (u[:, 2], -u[:, 2]):
            near, far = _depths(rotation, base, first, second)
            count = int(np.count_nonzero((near > 0.0) & (far > 0.0)))
            if count > most:
                best, most = (rotation, base), count
    return best


def _depths(
    rotation: FloatArray, base: FloatArray, first: FloatArray, second: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Distances (N,) along both rays to where they come nearest to each other, but for a positive factor."""
    # d₁·R·b₁ + t = d₂·b₂, solved by products with R·b₁ and b₂.
    turned = first @ rotation.T
    cosine = np.einsum("ni,ni->n", turned, second)
    along_first, along_second = turned @ base, second @ base
    return cosine * along_second - along_first, along_second - cosine * along_first


_Pose = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class _Coplanarity(Problem[_Pose]):
    """Coplanarity of base and rays: a rotation vector and two components across the base are unknown."""

    first: FloatArray
    second: FloatArray
    angle: FloatArray

    def _weighted(self, state: _Pose) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Triple products t·(R·b₁ × b₂) and 1 / their standard deviations, and the two directions."""
        rotation, base = state
        turned = self.first @ rotation.T
        value = np.cross(turned, self.second) @ base
        right, left = np.cross(self.second, base), np.cross(base, turned)
        slope = np.einsum("ni,ni->n", right, right) + np.einsum("ni,ni->n", left, left) - 2.0 * value**2
        return value, 1.0 / (np.sqrt(np.maximum(slope, 1e-300)) * self.angle), turned, right

    def squares(self, state: _Pose) -> float:
        value, weight, _, _ = self._weighted(state)
        return float(np.sum((value * weight) ** 2))

    def linearise(self, state: _Pose) -> Equations:
        _, base = state
        value, weight, turned, right = self._weighted(state)
        # e = (b₂ × t)·r; a turn w changes r by w × r, so e by w·(r × (b₂ × t)).
        by_turn = np.cross(turned, right)
        by_base = np.cross(turned, self.second) @ _beside(base).T
        design = np.hstack([by_turn, by_base]) * weight[:, None]
        return Equations(design, -value * weight)

    def moved(self, state: _Pose, step: FloatArray) -> _Pose:
        rotation, base = state
        moved = base + step[3:] @ _beside(base)
        return angle_axis(step[:3]) @ rotation, moved / np.linalg.norm(moved)


def _beside(vector: FloatArray) -> FloatArray:
    """Two unit vectors (2, 3) across a unit vector."""
    return np.linalg.svd(vector[None])[2][1:]
