"""Samples of a surface, a plane through them, triangles between them, and the rim beyond which neither reaches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import shapely
from scipy.spatial import ConvexHull, QhullError

from geomosaic.errors import SolveError
from geomosaic.surface.triangulation import Triangulation
from geomosaic.types import BoolArray, FloatArray, IntArray

# Height of a triangle at the rim, as a share of its edge there, below which it is left out: it spans what no point saw
# from one outermost point to the next.
SLIVER = 0.2
# Places on the rim that tell how the trend goes on beyond it.
RIM = 200


@dataclass(frozen=True, eq=False)
class Samples:
    """Places (N, 2), heights (N,), and the variances of these: of the point's own errors, and of shared ones."""

    xy: FloatArray
    z: FloatArray
    own: FloatArray
    shared: FloatArray

    @classmethod
    def of(cls, xyz: FloatArray, own: FloatArray, shared: FloatArray, slope: FloatArray) -> Samples:
        """Heights of points (N, 3) with covariances (N, 3, 3) on ground of slopes (N, 2).

        Parameters
        ----------
        xyz : array (N, 3)
            Metres.
        own : array (N, 3, 3)
            Covariances that each point has alone.
        shared : array (N, 3, 3)
            Covariances that all points share.
        slope : array (N, 2)
            Of the ground.
        """
        # On sloping ground errors in plan are errors of height, too.
        across = np.column_stack([-slope, np.ones(len(slope))])
        of_own, of_shared = (np.maximum(np.einsum("ni,nij,nj->n", across, c, across), 0.0) for c in (own, shared))
        return cls(xyz[:, :2], xyz[:, 2], of_own, of_shared)

    def part(self, rows: BoolArray | IntArray) -> Samples:
        """Some of the samples."""
        return Samples(self.xy[rows], self.z[rows], self.own[rows], self.shared[rows])

    def thinned(self, cell: float) -> Samples:
        """Weighted means of what lies in one cell."""
        key = np.floor(self.xy / cell).astype(np.int64)
        _, number = np.unique(key, axis=0, return_inverse=True)
        number = number.ravel()
        weight = 1.0 / (self.own + max(1e-6 * float(np.median(self.own)), 1e-12))
        total = np.bincount(number, weight)
        x, y, z, shared = (np.bincount(number, weight * v) / total for v in (*self.xy.T, self.z, self.shared))
        return Samples(np.column_stack([x, y]), z, 1.0 / total, shared)


@dataclass(frozen=True, eq=False)
class Plane:
    """Plane through samples: level and slopes (3,), their covariance, and how it fits."""

    values: FloatArray
    covariance: FloatArray
    explains: bool
    rms: float
    apart: float
    shared: float

    @classmethod
    def through(cls, samples: Samples) -> Plane:
        """Least squares plane; where it does not explain the samples, one with what they depart from it as error."""
        design = np.column_stack([np.ones(len(samples.z)), samples.xy])
        scale = np.maximum(np.abs(design).max(axis=0, initial=0.0), 1e-300)
        if len(design) < 3 or np.linalg.matrix_rank(design / scale, tol=1e-6) < 3:
            raise SolveError(
                "the tie points determine no surface: they are fewer than three, or lie on one line",
                hint="give a DEM, or one height of the ground",
            )
        freedom, apart, explains = max(len(samples.z) - 3, 1), 0.0, True
        for _ in range(10):
            weight = 1.0 / np.maximum(samples.own + apart, 1e-12)
            # Not by matrix products, whose last bits depend on the threads that the library of these has.
            normal = np.einsum("ni,n,nj->ij", design, weight, design)
            covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
            values: FloatArray = covariance @ np.einsum("ni,n->i", design, weight * samples.z)
            off = samples.z - np.einsum("ni,i->n", design, values)
            if not apart and (weight * off**2).sum() / freedom <= 1.0 + 3.0 * np.sqrt(2.0 / freedom):
                break
            explains, before = False, apart
            apart = max(float((off**2 - samples.own).sum() / freedom), 1e-3 * float((off**2).mean()))
            if abs(apart - before) <= 1e-3 * apart:
                break
        rms = float(np.sqrt((off**2).mean()))
        return cls(values, covariance, explains, rms, apart, float(np.median(samples.shared)))

    def at(self, xy: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Heights (N,) at places (N, 2), their variances, and whether the places lie beyond the samples: not told."""
        design = np.column_stack([np.ones(len(xy)), xy])
        spread = np.einsum("ni,ij,nj->n", design, self.covariance, design)
        return (
            np.einsum("ni,i->n", design, self.values),
            spread + self.apart + self.shared,
            np.zeros(len(xy), dtype=bool),
        )


@dataclass(frozen=True, eq=False)
class Interpolation:
    """Interpolated places.

    Attributes
    ----------
    index : int array (N, 3)
        Samples that tell the height.
    weight : array (N, 3)
        Theirs; they add up to 1.
    height : array (N,)
    noise : array (N,)
        Variance by errors of the samples.
    to, between : array (N, 3)
        Distances of the place to the samples, and of the samples 0 and 1, 1 and 2, 2 and 0; from the rim of the
        triangles beyond it.
    gap : array (N,)
        Distance beyond the rim; 0 within.
    """

    index: IntArray
    weight: FloatArray
    height: FloatArray
    noise: FloatArray
    to: FloatArray
    between: FloatArray
    gap: FloatArray

    def shape(self, exponent: float) -> FloatArray:
        """Variance (N,) of the ground between samples for roughness 1, see `geomosaic.surface.ground_roughness`."""
        power, w = 2.0 * exponent, self.weight
        pairs = w * np.roll(w, -1, axis=1) * self.between**power
        found = 2.0 * ((w * self.to**power).sum(axis=1) - pairs.sum(axis=1))
        variance: FloatArray = np.maximum(found if exponent < 1.0 else -found, 0.0)
        return variance

    def part(self, rows: BoolArray | IntArray) -> Interpolation:
        """Some of the places."""
        return Interpolation(*(getattr(self, each.name)[rows] for each in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[Interpolation]) -> Interpolation:
        """Places of several, one after the other."""
        return cls(*(np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(cls)))


@dataclass(frozen=True, eq=False)
class TriangulatedSurface:
    """Triangles between samples, and the trend that goes on beyond them."""

    samples: Samples
    triangles: Triangulation
    kept: BoolArray
    rim: IntArray
    slope: FloatArray

    @classmethod
    def of(cls, samples: Samples, plane: Plane) -> TriangulatedSurface:
        """Delaunay triangles of samples."""
        try:
            triangles, rim = Triangulation.of(samples.xy), ConvexHull(samples.xy).vertices
        except QhullError as error:
            what = "the tie points lie on one line"
            raise SolveError(what, hint="give a DEM, or one height of the ground") from error
        kept, rim = _without_slivers(triangles, rim)
        return cls(samples, triangles, kept, rim, plane.values[1:])

    def weights(self, xy: FloatArray) -> Interpolation:
        """Triangles and weights of places (N, 2)."""
        samples, (found, weight) = self.samples, self.triangles.locate(xy)
        inside = (found >= 0) & self.kept[found]
        index = self.triangles.corners.take(found, axis=0)  # -1, beyond the hull, takes the last; it counts for nothing
        foot = xy.copy()
        if not inside.all():
            foot[~inside], index[~inside], weight[~inside] = self._on_rim(xy[~inside])
        corner = samples.xy.take(index, axis=0)
        to = np.linalg.norm(corner - foot[:, None], axis=2)
        between = np.linalg.norm(corner - np.roll(corner, -1, axis=1), axis=2)
        height = (weight * samples.z.take(index)).sum(axis=1)
        height[~inside] = self._beyond(xy[~inside])
        noise = (weight**2 * samples.own.take(index) + np.abs(weight) * samples.shared.take(index)).sum(axis=1)
        gap = np.where(inside, 0.0, np.linalg.norm(xy - foot, axis=1))
        return Interpolation(index, weight, height, noise, to, between, gap)

    def _beyond(self, xy: FloatArray) -> FloatArray:
        """Heights of places beyond the rim: the trend, and how far the rim departs from it, nearer parts of it more."""
        if not len(xy):
            return np.zeros(0)
        # What the nearest place of the rim alone says tears the surface where another becomes the nearest.
        ring = np.append(self.rim, self.rim[0])
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.samples.xy[ring], axis=0), axis=1))])
        at = np.arange(RIM) / RIM * along[-1]
        x, y, z = (np.interp(at, along, values[ring]) for values in (*self.samples.xy.T, self.samples.z))
        above = z - (x * self.slope[0] + y * self.slope[1])
        # Place by place: all at once they would take more memory than all the rest, and more time.
        weighted, total = np.zeros(len(xy)), np.zeros(len(xy))
        for place in range(RIM):
            near = np.maximum((xy[:, 0] - x[place]) ** 2 + (xy[:, 1] - y[place]) ** 2, 1e-12) ** -2.0
            total += near
            near *= above[place]
            weighted += near
        found: FloatArray = xy[:, 0] * self.slope[0] + xy[:, 1] * self.slope[1] + weighted / total
        return found

    def _on_rim(self, xy: FloatArray) -> tuple[FloatArray, IntArray, FloatArray]:
        """Nearest places (N, 2) on the rim, the samples (N, 3) at the ends of their edges, and weights (N, 3)."""
        ends = np.stack([self.rim, np.roll(self.rim, -1)], axis=1)
        edge = shapely.STRtree(shapely.linestrings(self.samples.xy[ends])).nearest(shapely.points(xy))
        first, second = ends[edge].T
        start, along = self.samples.xy[first], self.samples.xy[second] - self.samples.xy[first]
        share = ((xy - start) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-24)
        share = np.clip(share, 0.0, 1.0)
        foot = start + share[:, None] * along
        weight = np.column_stack([1.0 - share, share, np.zeros_like(share)])
        return foot, np.column_stack([first, second, second]), weight


def _without_slivers(triangles: Triangulation, hull: IntArray) -> tuple[BoolArray, IntArray]:
    """Triangles that stay, and the corners of their rim in order; `hull` are those of all."""
    xy, kept = triangles.points, np.ones(len(triangles.corners), dtype=bool)
    follows = dict(zip(hull.tolist(), np.roll(hull, -1).tolist(), strict=True))
    left = np.flatnonzero((triangles.across < 0).any(axis=1)).tolist()
    while left:
        number = left.pop()
        corners = triangles.corners[number].tolist()
        for place, tip in enumerate(corners):
            one, other = corners[place - 2], corners[place - 1]
            one, other = (one, other) if follows.get(one) == other else (other, one)
            along = xy[other] - xy[one]
            area = abs(along[0] * (xy[tip] - xy[one])[1] - along[1] * (xy[tip] - xy[one])[0])
            # A tip on the rim would cut the sheet in two.
            if follows.get(one) == other and tip not in follows and area < SLIVER * (along @ along):
                kept[number] = False
                follows[one], follows[tip] = tip, other
                left += [each for each in triangles.across[number].tolist() if each >= 0 and kept[each]]
                break
    ring = [int(hull[0])]
    while follows[ring[-1]] != ring[0]:
        ring.append(follows[ring[-1]])
    return kept, np.array(ring)
