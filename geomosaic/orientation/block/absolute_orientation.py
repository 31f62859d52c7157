"""Absolute orientation: the similarity transformation from a free block to what is known of its place.

Places (control points, camera positions, points of other parts) and attitudes count together: the rotation maximises
Σ p·(X·(R·x)) + Σ q·tr(R₀ᵀ·Rᵢ·Rᵀ), which singular values solve (Umeyama 1991, IEEE PAMI 13(4), for the places alone).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.stats import chi2

from geomosaic.geo.local_frames import nearest_rotation
from geomosaic.orientation.block.bearings import Poses
from geomosaic.types import BoolArray, FloatArray

# Triples of places that are tried.
MOST_TRIPLES = 300
# A free block bends, and its places are uncertain by that share of their extent, too.
BENDING = 0.01
# Places are on one line if they scatter across it by less than this share of their scatter along it, or by less than
# twice what they are off.
THINNEST, NOISE = 0.01, 2.0
# Probability that places are worse than their scatter about a similarity is taken to say.
CHANCE = 0.01
# Sigmas at which a place is wrong.
REJECTION = 4.0


@dataclass(frozen=True, eq=False)
class Similarity:
    """Similarity transformation X = scale · rotation · x + shift."""

    scale: float
    rotation: FloatArray
    shift: FloatArray

    def places(self, xyz: FloatArray) -> FloatArray:
        """Places (N, 3) after the transformation."""
        return self.scale * xyz @ self.rotation.T + self.shift

    def poses(self, poses: Poses) -> Poses:
        """Poses after the transformation."""
        return Poses(self.places(poses.centres), poses.rotations @ self.rotation.T)


@dataclass(frozen=True, eq=False)
class Correspondences:
    """What is known in both frames.

    Attributes
    ----------
    free, known : array (K, 3)
        Places in the free block, and where they are.
    sigma : array (K,)
        Standard deviations of the latter, metres.
    turned : array (L, 3, 3)
        Rotations from the known frame to that of the free block, one of each image whose attitude is known.
    sigma_turned : array (L,)
        Their standard deviations, radians.
    """

    free: FloatArray
    known: FloatArray
    sigma: FloatArray
    turned: FloatArray
    sigma_turned: FloatArray

    def select(self, rows: BoolArray | list[int]) -> Correspondences:
        """Some of the places, and all attitudes."""
        return Correspondences(self.free[rows], self.known[rows], self.sigma[rows], self.turned, self.sigma_turned)

    @property
    def determine(self) -> bool:
        """Whether a similarity follows: two places with attitudes, or three that are not on one line."""
        if len(self.free) < (2 if len(self.turned) else 3):
            return False
        if len(self.turned):
            return bool(np.ptp(self.known, axis=0).max() > NOISE * self._noise)
        # The known places tell: a free block on one line has its own noise across.
        values = np.linalg.svd(self.known - self.known.mean(axis=0), compute_uv=False) / np.sqrt(len(self.known))
        return bool(values[1] > max(THINNEST * values[0], NOISE * self._noise))

    @property
    def _noise(self) -> float:
        """Standard deviation of the places: as declared, or less where their scatter surely is."""
        declared, freedom = float(np.median(self.sigma)), 3 * len(self.free) - 7
        if freedom < 5 or not np.ptp(self.free, axis=0).any():  # three places always fit well
            return declared
        off = _similarity(self).places(self.free) - self.known
        return min(declared, float(np.sqrt((off**2).sum() / chi2.ppf(CHANCE, freedom))))


def absolute_orientation(given: Correspondences) -> tuple[Similarity, BoolArray] | None:
    """Similarity from a free block to its place, with wrong places left out.

    Parameters
    ----------
    given : Correspondences

    Returns
    -------
    similarity : Similarity
    used : bool array (K,)
        Places that agree.
        None in place of both where the places do not determine it.
    """
    if not given.determine:
        return None
    count = len(given.free)
    extent = float(np.linalg.norm(np.ptp(given.known, axis=0)))
    tolerance = REJECTION * np.hypot(given.sigma, BENDING * extent)
    best, cost = np.ones(count, dtype=bool), np.inf
    for rows in _samples(count, 2 if len(given.turned) else 3):
        sample = given.select(rows)
        if not sample.determine:
            continue
        off = np.linalg.norm(_similarity(sample).places(given.free) - given.known, axis=1) / tolerance
        total = float(np.sum(np.minimum(off, 1.0) ** 2))
        if total < cost and np.count_nonzero(off <= 1.0) >= count / 2:
            best, cost = off <= 1.0, total
    for _ in range(3):
        part = given.select(best)
        if not part.determine:
            return None
        found = _similarity(part)
        best = np.linalg.norm(found.places(given.free) - given.known, axis=1) <= tolerance
    return found, best


def _similarity(given: Correspondences) -> Similarity:
    """Similarity of least squares, in closed form."""
    weight = 1.0 / given.sigma**2
    share = weight / weight.sum()
    middle, target = share @ given.free, share @ given.known
    free, known = given.free - middle, given.known - target
    spread = float(share @ np.sum(free**2, axis=1))
    # The scale comes first: without it the moments of places and attitudes cannot be weighed against each other.
    scale = float(np.sqrt((share @ np.sum(known**2, axis=1)) / spread))
    moment = scale * np.einsum("n,ni,nj->ij", weight, known, free)
    # Turned by a small angle δ a rotation changes by a matrix of norm √2·δ: half of the weight.
    moment += np.einsum("n,nji->ij", 0.5 / given.sigma_turned**2, given.turned)
    rotation = nearest_rotation(moment)
    scale = float(np.einsum("n,ni,ni->", share, known, free @ rotation.T)) / spread
    return Similarity(scale, rotation, target - scale * rotation @ middle)


def _samples(count: int, size: int) -> list[list[int]]:
    """Samples of places: all of a few, random ones of many."""
    if count <= 12:
        return [list(rows) for rows in combinations(range(count), size)]
    rng = np.random.default_rng(count)
    rows: list[list[int]] = np.argsort(rng.random((MOST_TRIPLES, count)), axis=1)[:, :size].tolist()
    return rows
