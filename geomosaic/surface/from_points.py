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
    kept, slope = _without_blunders(local)
    good = local.part(kept)
    samples = Samples.of(good.xyz, good.own, good.shared, slope[kept])
    nodes = grid.xy(np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in grid.shape[::-1])), axis=-1).reshape(-1, 2))
    nodes -= middle[:2]
    plane, thinned = Plane.through(samples), samples.thinned(min(grid.resolution))
    if plane.explains or len(thinned.xy) < LEAST:
        height, variance = plane.at(nodes)
        beyond = np.zeros(len(nodes), dtype=bool)
        residual, flat = plane.rms, True
    else:
        sheet = TriangulatedSurface.of(thinned, plane)
        law = Roughness.of(sheet)
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


def _without_blunders(points: ScatteredPoints) -> tuple[BoolArray, FloatArray]:
    """Points (N,) that lie on the ground as their neighbours show it, and the slope (N, 2) of that.

    Not kept are those known much worse than their neighbours, and those that depart from the plane of these and have no
    two neighbours at their own height: roofs and trees have.
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
        scale = np.maximum(MAD_TO_SIGMA * np.median(np.abs(off), axis=1), 1e-9)
        weight = 1.0 / (1.0 + (off / (2.0 * scale[:, None])) ** 2)
        turned = (design * weight[..., None]).swapaxes(1, 2)
        # A trace of a level plane keeps neighbours on one line from having none.
        found = np.linalg.solve(turned @ design + 1e-6 * np.eye(3), turned @ away[..., 2:])[..., 0]
        off = away[..., 2] - np.einsum("nkj,nj->nk", design, found)
    # Three of the deviations went into the plane.
    scale = MAD_TO_SIGMA * np.median(np.abs(off), axis=1) * np.sqrt(away.shape[1] / (away.shape[1] - 3.0))
    return found[:, 0], found[:, 1:] / size[:, None], scale
