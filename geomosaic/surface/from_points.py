"""Surface through scattered points: isolated blunders left out, the rest thinned, a plane or triangles, with sigma.

The variance of a height between points has three parts. Their own errors, which are independent, and errors that they
share follow from their covariances. What the ground does between them is that of a self-affine surface: with weights λ
of the interpolation (1 for the place, minus those of the points), which annihilate planes,

    v = ∓c·Σᵢⱼ λᵢ·λⱼ·|pᵢ − pⱼ|^2H     − for H < 1, + for 1 < H < 2

(J.-P. Chilès, P. Delfiner: Geostatistics, 2nd ed., 2012, ch. 4: generalised covariances). Exponent H and roughness c
are those under which heights of points that are left out in turn are met best; c follows the ground from place to
place. Beyond the outermost points the trend of all goes on, with an error that points left out at the rim calibrate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import shapely
from pyproj import CRS
from scipy.spatial import ConvexHull, Delaunay, QhullError, cKDTree

from geomosaic.errors import SolveError
from geomosaic.geo.grid import Bounds, Grid
from geomosaic.types import BoolArray, FloatArray, IntArray

# Neighbours whose plane a point is held against.
NEIGHBOURS = 12
# Standard deviations beyond which a point disagrees with its neighbours. The scale is that of twelve points: at 4 one
# in 300 good points of a rough ground would go.
DISAGREES = 6.0
# Times the standard deviation of neighbours above which a point tells nothing that they do not: rays that hardly meet.
VAGUE = 8.0
# Points below which nothing but a plane is determined.
LEAST = 12
# Cells between two neighbouring points; and nodes of a surface at most: 4 million nodes are 32 MB, and no tie points
# tell more.
CELLS, MOST = 2.0, 4_000_000
# Parts of the points that are left out in turn, and directions from which the rim is cut.
FOLDS, SIDES = 5, 8
# Exponents that are tried; 1 itself is excluded, as planes cost nothing there.
EXPONENTS = np.array([0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 1.1, 1.25, 1.4, 1.6, 1.8])
# Points that tell the exponent, and those around a place that tell the roughness there.
SAMPLE, AROUND = 2000, 16
# Points above which some of them stand for all where laws are found.
LARGE = 20_000
# Share of the normal distribution within one standard deviation.
WITHIN = 0.6827
CHUNK = 1 << 18


@dataclass(frozen=True, eq=False)
class ScatteredPoints:
    """Points of a surface with their errors.

    Attributes
    ----------
    xyz : array (N, 3)
        In a CRS with one unit for x and y.
    own : array (N, 3, 3)
        Covariance of what each point's own measurements leave open.
    shared : array (N, 3, 3)
        Covariance of errors that neighbouring points have in common, of the orientation of images for example.
    """

    xyz: FloatArray
    own: FloatArray
    shared: FloatArray

    def part(self, rows: BoolArray | IntArray) -> ScatteredPoints:
        """Some of the points."""
        return ScatteredPoints(self.xyz[rows], self.own[rows], self.shared[rows])


@dataclass(frozen=True, eq=False)
class PointSurface:
    """Surface through scattered points.

    Attributes
    ----------
    grid : Grid
        Its nodes are the pixel centres.
    heights, sigma : array (rows, cols)
        Heights and their standard deviations, metres.
    kept : bool array (N,)
        Points that are in it.
    beyond : bool array (rows, cols)
        Nodes beyond the outermost points.
    plane : bool
        Whether it is a plane.
    residual : float
        RMS of what the points that were left out in turn, or those of a plane, miss it by, metres.
    """

    grid: Grid
    heights: FloatArray
    sigma: FloatArray
    kept: BoolArray
    beyond: BoolArray
    plane: bool
    residual: float


def surface_from_points(points: ScatteredPoints, grid: Grid) -> PointSurface:
    """Surface through scattered points, with its standard deviation.

    Parameters
    ----------
    points : ScatteredPoints
    grid : Grid
        See `grid_of_points`.

    Returns
    -------
    PointSurface
        A plane where that explains the points within their standard deviations, or where they are few.

    Raises
    ------
    SolveError
        Fewer than three points, or all on one line.
    """
    middle = points.xyz.mean(axis=0) if len(points.xyz) else np.zeros(3)
    # Triangles of map coordinates of seven digits would be rounded.
    local = ScatteredPoints(points.xyz - middle, points.own, points.shared)
    kept, slope = without_blunders(local)
    good = local.part(kept)
    samples = _Samples.of(good, slope[kept])
    nodes = grid.xy(np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in grid.shape[::-1])), axis=-1).reshape(-1, 2))
    nodes -= middle[:2]
    plane = _Plane.through(samples)
    if plane.explains or len(samples.xy) < LEAST:
        height, variance = plane.at(nodes)
        beyond = np.zeros(len(nodes), dtype=bool)
        residual, flat = plane.rms, True
    else:
        thinned = samples.thinned(min(grid.resolution))
        sheet = _Sheet.of(thinned, plane)
        law = _Roughness.of(sheet)
        height, variance, beyond = np.empty(len(nodes)), np.empty(len(nodes)), np.zeros(len(nodes), dtype=bool)
        for start in range(0, len(nodes), CHUNK):
            part = slice(start, start + CHUNK)
            at = sheet.weights(nodes[part])
            height[part], variance[part], beyond[part] = at.height, law.variance(at), at.gap > 0.0
        residual, flat = law.residual, False
    shape = grid.shape
    sigma = np.sqrt(variance).reshape(shape)
    return PointSurface(grid, (height + middle[2]).reshape(shape), sigma, kept, beyond.reshape(shape), flat, residual)


def grid_of_points(points: FloatArray, bounds: Bounds, crs: CRS) -> Grid:
    """Grid over an area with cells that scattered points are worth: two between neighbours.

    Parameters
    ----------
    points : array (N, 2)
        x, y.
    bounds : (float, float, float, float)
        Left, bottom, right, top.
    crs : CRS
    """
    hull = shapely.convex_hull(shapely.multipoints(points))
    spacing = np.sqrt(max(hull.area, 1e-12) / max(len(points), 1))
    wide, tall = bounds[2] - bounds[0], bounds[3] - bounds[1]
    cell = max(spacing / CELLS, np.sqrt(wide * tall / MOST), max(wide, tall) / 30000.0)
    return Grid.from_bounds(crs, bounds, float(cell))


def without_blunders(points: ScatteredPoints) -> tuple[BoolArray, FloatArray]:
    """Points that lie on the ground as their neighbours show it, and the slope of that.

    Parameters
    ----------
    points : ScatteredPoints

    Returns
    -------
    kept : bool array (N,)
        Not those that are known much worse than their neighbours, nor those that depart from the plane of these and
        have no two neighbours at their own height: roofs and trees have.
    slope : array (N, 2)
        Along x and y.
    """
    xyz, count = points.xyz, len(points.xyz)
    kept, slope = np.ones(count, dtype=bool), np.zeros((count, 2))
    if count <= NEIGHBOURS:
        return kept, slope
    _, near = cKDTree(xyz[:, :2]).query(xyz[:, :2], NEIGHBOURS + 1)
    own = points.own[:, 2, 2]
    for start in range(0, count, CHUNK // NEIGHBOURS):
        rows = np.arange(start, min(count, start + CHUNK // NEIGHBOURS))
        others = near[rows, 1:]
        away = xyz[others] - xyz[rows, None]
        level, slope[rows], scale = _robust_planes(away)
        off = away[..., 2] - np.einsum("nkj,nj->nk", away[..., :2], slope[rows])
        beside = (np.abs(off) < 0.5 * np.abs(level)[:, None]).sum(axis=1)
        wrong = np.abs(level) > DISAGREES * np.sqrt(own[rows] + scale**2)
        vague = own[rows] > VAGUE**2 * np.median(own[others], axis=1)
        kept[rows] = ~vague & (~wrong | (beside > 1))
    return kept, np.clip(slope, -3.0, 3.0)


def _robust_planes(away: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Height (N,) at the origin, slope (N, 2) and scale (N,) of planes through neighbours (N, K, 3)."""
    size = np.maximum(np.linalg.norm(away[..., :2], axis=2).max(axis=1), 1e-9)
    design = np.concatenate([np.ones((*away.shape[:2], 1)), away[..., :2] / size[:, None, None]], axis=2)
    # Half of the neighbours may be wrong: the start is their median.
    off = away[..., 2] - np.median(away[..., 2], axis=1)[:, None]
    for _ in range(6):
        scale = np.maximum(1.4826 * np.median(np.abs(off), axis=1), 1e-9)
        weight = 1.0 / (1.0 + (off / (2.0 * scale[:, None])) ** 2)
        turned = (design * weight[..., None]).swapaxes(1, 2)
        # A trace of a level plane keeps neighbours on one line from having none.
        found = np.linalg.solve(turned @ design + 1e-6 * np.eye(3), turned @ away[..., 2:])[..., 0]
        off = away[..., 2] - np.einsum("nkj,nj->nk", design, found)
    # Three of the deviations went into the plane.
    scale = 1.4826 * np.median(np.abs(off), axis=1) * np.sqrt(away.shape[1] / (away.shape[1] - 3.0))
    return found[:, 0], found[:, 1:] / size[:, None], scale


@dataclass(frozen=True, eq=False)
class _Samples:
    """Places (N, 2), heights (N,), and the variances of these: of the point's own errors, and of shared ones."""

    xy: FloatArray
    z: FloatArray
    own: FloatArray
    shared: FloatArray

    @classmethod
    def of(cls, points: ScatteredPoints, slope: FloatArray) -> _Samples:
        """Heights of points on sloping ground, where errors in plan are errors of height, too."""
        across = np.column_stack([-slope, np.ones(len(slope))])
        own, shared = (
            np.maximum(np.einsum("ni,nij,nj->n", across, each, across), 0.0) for each in (points.own, points.shared)
        )
        return cls(points.xyz[:, :2], points.xyz[:, 2], own, shared)

    def part(self, rows: BoolArray | IntArray) -> _Samples:
        """Some of the samples."""
        return _Samples(self.xy[rows], self.z[rows], self.own[rows], self.shared[rows])

    def thinned(self, cell: float) -> _Samples:
        """Weighted means of what lies in one cell."""
        key = np.floor(self.xy / cell).astype(np.int64)
        _, number = np.unique(key, axis=0, return_inverse=True)
        number = number.ravel()
        weight = 1.0 / (self.own + max(1e-6 * float(np.median(self.own)), 1e-12))
        total = np.bincount(number, weight)
        x, y, z, shared = (np.bincount(number, weight * v) / total for v in (*self.xy.T, self.z, self.shared))
        return _Samples(np.column_stack([x, y]), z, 1.0 / total, shared)


@dataclass(frozen=True, eq=False)
class _Plane:
    """Plane through samples: level and slopes (3,), their covariance, and how it fits."""

    values: FloatArray
    covariance: FloatArray
    explains: bool
    rms: float
    apart: float
    shared: float

    @classmethod
    def through(cls, samples: _Samples) -> _Plane:
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
            covariance: FloatArray = np.linalg.inv((design * weight[:, None]).T @ design)
            values = covariance @ (design.T @ (weight * samples.z))
            off = samples.z - design @ values
            if not apart and (weight * off**2).sum() / freedom <= 1.0 + 3.0 * np.sqrt(2.0 / freedom):
                break
            explains, before = False, apart
            apart = max(float((off**2 - samples.own).sum() / freedom), 1e-3 * float((off**2).mean()))
            if abs(apart - before) <= 1e-3 * apart:
                break
        rms = float(np.sqrt((off**2).mean()))
        return cls(values, covariance, explains, rms, apart, float(np.median(samples.shared)))

    def at(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Heights (N,) at places (N, 2), and their variances."""
        design = np.column_stack([np.ones(len(xy)), xy])
        spread = np.einsum("ni,ij,nj->n", design, self.covariance, design)
        return design @ self.values, spread + self.apart + self.shared


@dataclass(frozen=True, eq=False)
class _At:
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
        """Variance (N,) of the ground between samples for a roughness of 1; see the head of this file."""
        power, w = 2.0 * exponent, self.weight
        pairs = w * np.roll(w, -1, axis=1) * self.between**power
        found = 2.0 * ((w * self.to**power).sum(axis=1) - pairs.sum(axis=1))
        variance: FloatArray = np.maximum(found if exponent < 1.0 else -found, 0.0)
        return variance

    def part(self, rows: BoolArray | IntArray) -> _At:
        """Some of the places."""
        return _At(*(getattr(self, each.name)[rows] for each in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[_At]) -> _At:
        """Places of several, one after the other."""
        return cls(*(np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(cls)))


@dataclass(frozen=True, eq=False)
class _Sheet:
    """Triangles between samples, and the trend that goes on beyond them."""

    samples: _Samples
    triangles: Delaunay
    rim: IntArray
    slope: FloatArray

    @classmethod
    def of(cls, samples: _Samples, plane: _Plane) -> _Sheet:
        """Delaunay triangles of samples."""
        try:
            triangles, rim = Delaunay(samples.xy), ConvexHull(samples.xy).vertices
        except QhullError as error:
            what = "the tie points lie on one line"
            raise SolveError(what, hint="give a DEM, or one height of the ground") from error
        return cls(samples, triangles, rim, plane.values[1:])

    def weights(self, xy: FloatArray) -> _At:
        """Triangles and weights of places (N, 2)."""
        samples, found = self.samples, self.triangles.find_simplex(xy)
        inside = found >= 0
        index, weight = np.zeros((len(xy), 3), dtype=np.int64), np.zeros((len(xy), 3))
        index[inside] = self.triangles.simplices[found[inside]]
        affine = self.triangles.transform[found[inside]]
        two = np.einsum("nij,nj->ni", affine[:, :2], xy[inside] - affine[:, 2])
        weight[inside] = np.column_stack([two, 1.0 - two.sum(axis=1)])
        foot = xy.copy()
        if not inside.all():
            foot[~inside], index[~inside], weight[~inside] = self._on_rim(xy[~inside])
        corner = samples.xy[index]
        to = np.linalg.norm(corner - foot[:, None], axis=2)
        between = np.linalg.norm(corner - np.roll(corner, -1, axis=1), axis=2)
        height = (weight * samples.z[index]).sum(axis=1) + (xy - foot) @ self.slope
        noise = (weight**2 * samples.own[index] + np.abs(weight) * samples.shared[index]).sum(axis=1)
        gap = np.where(inside, 0.0, np.linalg.norm(xy - foot, axis=1))
        return _At(index, weight, height, noise, to, between, gap)

    def _on_rim(self, xy: FloatArray) -> tuple[FloatArray, IntArray, FloatArray]:
        """Nearest places (N, 2) on the rim, the samples (N, 3) at the ends of their edges, and weights (N, 3)."""
        ring = np.append(self.rim, self.rim[0])
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.samples.xy[ring], axis=0), axis=1))])
        at = shapely.line_locate_point(shapely.linestrings(self.samples.xy[ring]), shapely.points(xy))
        edge = np.clip(np.searchsorted(along, at, side="right") - 1, 0, len(self.rim) - 1)
        share = np.clip((at - along[edge]) / np.maximum(along[edge + 1] - along[edge], 1e-12), 0.0, 1.0)
        first, second = ring[edge], ring[edge + 1]
        foot = (1.0 - share)[:, None] * self.samples.xy[first] + share[:, None] * self.samples.xy[second]
        weight = np.column_stack([1.0 - share, share, np.zeros_like(share)])
        return foot, np.column_stack([first, second, second]), weight


@dataclass(frozen=True, eq=False)
class _Roughness:
    """How far the ground departs from triangles between samples, and from the trend beyond them.

    Attributes
    ----------
    exponent, level : float
        H and c of the head of this file.
    local : array (N,)
        Factor of c at each sample.
    rim : (float, float)
        Exponent and factor of the variance by the distance beyond the rim.
    residual : float
        RMS of what left out samples are missed by.
    """

    exponent: float
    level: float
    local: FloatArray
    rim: tuple[float, float]
    residual: float

    @classmethod
    def of(cls, sheet: _Sheet) -> _Roughness:
        """Law under which samples that are left out in turn are met."""
        samples, random = sheet.samples, np.random.default_rng(0)
        order = random.permutation(len(samples.z))
        # All of them where that is quick; two parts of many tell as much.
        few = len(order) <= LARGE
        held = np.array_split(order, FOLDS) if few else [order[: LARGE // 4], order[LARGE // 4 : LARGE // 2]]
        found = [_left_out(samples, rows) for rows in held if len(rows)]
        rows, at = np.concatenate([each[0] for each in found]), _At.joined([each[1] for each in found])
        within = at.gap == 0.0
        rows, at = rows[within], at.part(within)
        off = samples.z[rows] - at.height
        noise = at.noise + samples.own[rows]
        some = random.permutation(len(rows))[:SAMPLE]
        tried = at.part(some)
        shapes = np.array([tried.shape(exponent) for exponent in EXPONENTS])
        best, level = _likeliest(off[some] ** 2, noise[some], shapes)
        exponent = float(EXPONENTS[best])
        shape = level * at.shape(exponent)
        # Lawns and trees of one block: the squares around a place say how rough it is there, each by at most 9.
        square = np.minimum(off**2 / np.maximum(noise + shape, 1e-300), 9.0)
        tree, count = cKDTree(samples.xy[rows]), min(AROUND, len(rows) - 1)
        near = tree.query(samples.xy[rows], count + 1)[1][:, 1:]
        around = _shrunk(square[near])
        factor = _calibrated(off, noise, around * shape)
        local = _shrunk(square[tree.query(samples.xy, count + 1)[1]])
        law = cls(exponent, factor * level, local, (1.0, 0.0), float(np.sqrt((off**2).mean())))
        return law._with_rim(samples)

    def _with_rim(self, samples: _Samples) -> _Roughness:
        """Law with that beyond the rim, from samples cut off at each side in turn."""
        found, random = [], np.random.default_rng(0)
        rows = random.permutation(len(samples.z))[:LARGE]
        law, samples = replace(self, local=self.local[rows]), samples.part(rows)
        for side in range(SIDES):
            angle = 2.0 * np.pi * side / SIDES
            ahead = samples.xy @ np.array([np.cos(angle), np.sin(angle)])
            rows, at = _left_out(samples, np.flatnonzero(ahead > np.quantile(ahead, 0.85)))
            at, rows = at.part(at.gap > 0.0), rows[at.gap > 0.0]
            found.append((at.gap, (samples.z[rows] - at.height) ** 2, law._within(at) + samples.own[rows]))
        gap, square, noise = (np.concatenate(parts) for parts in zip(*found, strict=True))
        some = random.permutation(len(gap))[:SAMPLE]
        gap, square, noise = gap[some], square[some], noise[some]
        exponents = np.array([0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0])
        best, level = _likeliest(square, noise, gap ** (2.0 * exponents[:, None]))
        level *= _calibrated(np.sqrt(square), noise, level * gap ** (2.0 * exponents[best]))
        return replace(self, rim=(float(exponents[best]), level))

    def variance(self, at: _At) -> FloatArray:
        """Variance (N,) of interpolated heights."""
        exponent, level = self.rim
        return self._within(at) + level * at.gap ** (2.0 * exponent)

    def _within(self, at: _At) -> FloatArray:
        local: FloatArray = (np.abs(at.weight) * self.local[at.index]).sum(axis=1)
        return at.noise + self.level * local * at.shape(self.exponent)


def _left_out(samples: _Samples, rows: IntArray) -> tuple[IntArray, _At]:
    """Samples that are left out, and their places as the others tell them."""
    rest = np.setdiff1d(np.arange(len(samples.z)), rows)
    others = samples.part(rest)
    at = _Sheet.of(others, _Plane.through(others)).weights(samples.xy[rows])
    return rows, replace(at, index=rest[at.index])


def _shrunk(squares: FloatArray) -> FloatArray:
    """Means of squares (N, K) of standardised values, drawn towards 1 as four values would."""
    found: FloatArray = (squares.sum(axis=1) + 4.0) / (squares.shape[1] + 4.0)
    return found


def _likeliest(square: FloatArray, noise: FloatArray, shapes: FloatArray) -> tuple[int, float]:
    """Shape (E, N) and its factor under which squared errors (N,) are likeliest, as of Student's t, 4 degrees."""
    best, found = np.inf, (0, 0.0)
    for index, shape in enumerate(shapes):
        middle = float(np.median(square)) / max(float(np.median(shape)), 1e-300)
        for factor in middle * np.geomspace(1e-4, 1e3, 71):
            variance = np.maximum(noise + factor * shape, 1e-300)
            loss = float((0.5 * np.log(variance) + 2.5 * np.log1p(square / (4.0 * variance))).sum())
            if loss < best:
                best, found = loss, (index, float(factor))
    return found


def _calibrated(off: FloatArray, noise: FloatArray, variance: FloatArray) -> float:
    """Factor of a variance with which 68 % of the errors (N,) lie within one standard deviation."""
    low, high = 1e-4, 1e4
    for _ in range(40):
        middle = np.sqrt(low * high)
        inside = (off**2 <= noise + middle * variance).mean()
        low, high = (low, middle) if inside > WITHIN else (middle, high)
    return float(np.sqrt(low * high))
