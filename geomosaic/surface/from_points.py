"""Surface through scattered points: isolated blunders left out, the rest thinned, a plane or triangles, with sigma."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from pyproj import CRS
from scipy.spatial import cKDTree

from geomosaic.estimation.statistics import MAD_TO_SIGMA
from geomosaic.geo.grid import Bounds, Grid
from geomosaic.surface.ground_roughness import Roughness
from geomosaic.surface.triangles import Plane, Samples, TriangulatedSurface
from geomosaic.types import BoolArray, Float32Array, FloatArray, IntArray, Map

# Neighbours whose plane a point is held against.
NEIGHBOURS = 12
# Standard deviations beyond which a point disagrees with its neighbours. The scale is that of twelve points: at 4 one
# in 300 good points of a rough ground would go.
DISAGREES = 6.0
# Times the standard deviation of neighbours above which a point tells nothing that they do not: rays that hardly meet.
VAGUE = 8.0
# Points below which nothing but a plane is determined.
LEAST = 12
# Cells between two neighbouring points; and nodes of a surface at most, 150 MB with their standard deviations.
CELLS, MOST = 2.0, 16_000_000
# Samples that are triangulated at most, which takes 640 bytes for each of them: with more points there is a mean in
# every cell of CELLS x CELLS nodes.
SAMPLES = int(MOST / CELLS**2)
# Nodes, or neighbours of points, of one unit of work.
CHUNK = 1 << 16


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
    heights, sigma : float32 array (rows, cols)
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
    heights: Float32Array
    sigma: Float32Array
    kept: BoolArray
    beyond: BoolArray
    plane: bool
    residual: float


def surface_from_points(points: ScatteredPoints, grid: Grid, each: Map = map) -> PointSurface:
    """Surface through scattered points, with its standard deviation.

    Parameters
    ----------
    points : ScatteredPoints
    grid : Grid
        See `grid_of_points`.
    each : callable
        Calls a function of units of work, such as rows of nodes.

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
    kept, slope = _without_blunders(local, each)
    good = local.part(kept)
    samples = Samples.of(good.xyz, good.own, good.shared, slope[kept])
    plane, thinned = Plane.through(samples), samples.thinned(_thinned_to(grid))
    flat = plane.explains or len(thinned.xy) < LEAST
    law = None if flat else Roughness.of(TriangulatedSurface.of(thinned, plane), each)
    nodes = _Nodes(grid, middle, plane if law is None else law)
    heights, sigma = np.empty(grid.shape, dtype=np.float32), np.empty(grid.shape, dtype=np.float32)
    beyond = np.zeros(grid.shape, dtype=bool)
    step = max(1, CHUNK // grid.width)
    units = [(first, min(first + step, grid.height)) for first in range(0, grid.height, step)]
    for (first, last), found in zip(units, each(nodes, units), strict=True):
        heights[first:last], sigma[first:last], beyond[first:last] = found
    return PointSurface(grid, heights, sigma, kept, beyond, flat, plane.rms if law is None else law.residual)


def _thinned_to(grid: Grid) -> float:
    """Side of cells, map units, in each of which one sample is left."""
    wide, tall = grid.resolution
    return float(max(wide, tall, np.sqrt(grid.width * wide * grid.height * tall / SAMPLES)))


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Heights of nodes, their standard deviations, and whether they lie beyond the outermost points, by rows."""

    grid: Grid
    middle: FloatArray
    surface: Plane | Roughness

    def __call__(self, rows: tuple[int, int]) -> tuple[Float32Array, Float32Array, BoolArray]:
        first, last = rows
        col, row = np.meshgrid(np.arange(self.grid.width) + 0.5, np.arange(first, last) + 0.5)
        height, variance, beyond = self.surface.at(
            self.grid.xy(np.column_stack([col.ravel(), row.ravel()])) - self.middle[:2]
        )
        shape = col.shape
        high, sigma = (height + self.middle[2]).astype(np.float32), np.sqrt(variance).astype(np.float32)
        return high.reshape(shape), sigma.reshape(shape), beyond.reshape(shape)


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


def _without_blunders(points: ScatteredPoints, each: Map) -> tuple[BoolArray, FloatArray]:
    """Points (N,) that lie on the ground as their neighbours show it, and the slope (N, 2) of that.

    Not kept are those known much worse than their neighbours, and those that depart from the plane of these and have no
    two neighbours at their own height: roofs and trees have.
    """
    xyz, count = points.xyz, len(points.xyz)
    kept, slope = np.ones(count, dtype=bool), np.zeros((count, 2))
    if count <= NEIGHBOURS:
        return kept, slope
    step = CHUNK // NEIGHBOURS
    units = [(first, min(first + step, count)) for first in range(0, count, step)]
    judged = _Judged(xyz, points.own[:, 2, 2].copy(), cKDTree(xyz[:, :2]))
    for (first, last), found in zip(units, each(judged, units), strict=True):
        kept[first:last], slope[first:last] = found
    return kept, np.clip(slope, -3.0, 3.0)


@dataclass(frozen=True, eq=False)
class _Judged:
    """Whether points lie on the ground as their neighbours show it, and the slope of that, by rows."""

    xyz: FloatArray
    own: FloatArray
    tree: cKDTree

    def __call__(self, rows: tuple[int, int]) -> tuple[BoolArray, FloatArray]:
        mine = slice(*rows)
        others = self.tree.query(self.xyz[mine, :2], NEIGHBOURS + 1)[1][:, 1:]
        away = self.xyz[others] - self.xyz[mine, None]
        level, slope, scale = _robust_planes(away)
        off = away[..., 2] - np.einsum("nkj,nj->nk", away[..., :2], slope)
        beside = (np.abs(off) < 0.5 * np.abs(level)[:, None]).sum(axis=1)
        wrong = np.abs(level) > DISAGREES * np.sqrt(self.own[mine] + scale**2)
        vague = self.own[mine] > VAGUE**2 * np.median(self.own[others], axis=1)
        return ~vague & (~wrong | (beside > 1)), slope


def _robust_planes(away: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Height (N,) at the origin, slope (N, 2) and scale (N,) of planes through neighbours (N, K, 3)."""
    size = np.maximum(np.linalg.norm(away[..., :2], axis=2).max(axis=1), 1e-9)
    design = np.concatenate([np.ones((*away.shape[:2], 1)), away[..., :2] / size[:, None, None]], axis=2)
    # Half of the neighbours may be wrong: the start is their median.
    off = away[..., 2] - np.median(away[..., 2], axis=1)[:, None]
    for _ in range(6):
        scale = np.maximum(MAD_TO_SIGMA * np.median(np.abs(off), axis=1), 1e-9)
        weight = 1.0 / (1.0 + (off / (2.0 * scale[:, None])) ** 2)
        turned = (design * weight[..., None]).swapaxes(1, 2)
        # A trace of a level plane keeps neighbours on one line from having none.
        found = np.linalg.solve(turned @ design + 1e-6 * np.eye(3), turned @ away[..., 2:])[..., 0]
        off = away[..., 2] - np.einsum("nkj,nj->nk", design, found)
    # Three of the deviations went into the plane.
    scale = MAD_TO_SIGMA * np.median(np.abs(off), axis=1) * np.sqrt(away.shape[1] / (away.shape[1] - 3.0))
    return found[:, 0], found[:, 1:] / size[:, None], scale
