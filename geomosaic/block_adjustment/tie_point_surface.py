"""Surface of an adjusted block: heights of the ground from its adjusted points, and their standard deviations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.block import OrientedImage
from geomosaic.errors import SolveError, counted
from geomosaic.execution.units import unit_map, workers_for
from geomosaic.geo.crs import height_name, horizontal, is_local
from geomosaic.geo.grid import Bounds, Grid
from geomosaic.options.render import RunningOptions
from geomosaic.orientation.block.solution import BlockSolution
from geomosaic.raster.cog.codec import RasterMetadata, Samples
from geomosaic.raster.sink import RasterSink
from geomosaic.sensor.solve import image_to_height
from geomosaic.surface.dem import Dem
from geomosaic.surface.from_points import PointSurface, ScatteredPoints, grid_of_points, surface_from_points
from geomosaic.types import Float32Array, FloatArray

# Points along each side of an image that say how far it reaches.
SIDE = 9
# Share of the extent of the points by which a surface goes on beyond them at most: images that look to the horizon
# reach anywhere.
FARTHEST = 0.5


@dataclass(frozen=True, eq=False)
class TiePointSurface:
    """Surface through the points of an adjusted block.

    Attributes
    ----------
    surface : PointSurface
    points : int
        Points that it was made of, those that were left out among them.
    """

    surface: PointSurface
    points: int

    @classmethod
    def of(
        cls, solution: BlockSolution, scenes: Sequence[OrientedImage], ground: CRS, running: RunningOptions
    ) -> TiePointSurface:
        """Surface over all that the images show.

        Parameters
        ----------
        solution : BlockSolution
        scenes : sequence of OrientedImage
            With adjusted models.
        ground : CRS
            3-D CRS of the points.
        running : RunningOptions

        Raises
        ------
        SolveError
            Too few points, or all on one line.
        """
        known = np.isfinite(solution.ground).all(axis=1) & (solution.rays > 1)
        xyz = solution.ground[known]
        if len(xyz) < 3:
            raise SolveError(
                f"{counted(len(xyz), 'adjusted point')} make no surface",
                where="`dem_from_tie_points`",
                hint="give a DEM (`dem`), or one height of the ground (`height`)",
            )
        # With the images held, each point has the errors of its own rays alone; the rest comes from the images, and
        # neighbours have it in common.
        own = solution.own_point_covariance[known]
        total = np.nan_to_num(solution.point_covariance[known])
        points = ScatteredPoints(xyz, own, np.where(np.isfinite(total), total - own, 0.0))
        grid = grid_of_points(xyz[:, :2], _reach(xyz, scenes, ground), ground)
        with workers_for(running):
            return cls(surface_from_points(points, grid, unit_map(running)), len(xyz))

    @property
    def dem(self) -> Dem:
        """Heights with their standard deviations."""
        grid = self.surface.grid
        sigma = Dem.from_array(self.surface.sigma, grid)
        return Dem.from_array(self.surface.heights, grid, sigma=sigma)

    @property
    def facts(self) -> dict[str, Any]:
        """JSON values."""
        found = self.surface
        within = found.sigma[~found.beyond]
        return {
            "points": self.points,
            "left_out": int((~found.kept).sum()),
            "plane": found.plane,
            "cell_m": found.grid.resolution[0],
            "residual_m": found.residual,
            "median_sigma_m": float(np.median(within)) if within.size else None,
            "largest_sigma_m": float(found.sigma.max()),
            "beyond_share": float(found.beyond.mean()),
        }

    def write(self, heights: Path, sigma: Path) -> None:
        """Heights and standard deviations as rasters of one grid."""
        crs, grid = self.surface.grid.crs, self.surface.grid
        if is_local(crs) or not crs.is_compound:
            # GeoTIFF has no map with ellipsoidal heights, and would call a local frame by the name of both its parts.
            grid = replace(grid, crs=horizontal(crs))
        above = "above the ellipsoid" if height_name(crs) == "ellipsoidal" else f"in {height_name(crs)}"
        words = f"heights from tie points, metres {above}"
        _write(heights, self.surface.heights, grid, words)
        _write(sigma, self.surface.sigma, grid, f"standard deviation of {words}")


def surface_lines(facts: dict[str, Any], unit: str) -> list[str]:
    """Surface in words.

    Parameters
    ----------
    facts : dict
        Of `TiePointSurface.facts`.
    unit : str
        Of its lengths.
    """
    used, out = facts["points"] - facts["left_out"], facts["left_out"]
    of = f"of {counted(used, 'tie point')}" + (f" ({out} left out)" if out else "")
    if facts["plane"]:
        lines = [f"surface: a plane through heights {of}, which miss it by {facts['residual_m']:.3g} {unit} RMS"]
    else:
        lines = [
            f"surface: triangles between heights {of}, every {facts['cell_m']:.3g} {unit}; points left out in turn are "
            f"met to {facts['residual_m']:.3g} {unit} RMS"
        ]
    sigma = f"largest {facts['largest_sigma_m']:.3g} {unit}"
    if facts["median_sigma_m"] is not None:
        sigma = f"median {facts['median_sigma_m']:.3g} {unit}, {sigma}"
    lines.append(f"standard deviation of its heights: {sigma}")
    if facts["beyond_share"] > 0.0:
        share = 100.0 * facts["beyond_share"]
        lines.append(f"{share:.0f} % of it lie beyond the outermost tie points, where their trend goes on")
    return lines


def _reach(xyz: FloatArray, scenes: Sequence[OrientedImage], ground: CRS) -> Bounds:
    """Area that images show of level ground, as far as points vouch for it."""
    low, high = xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0)
    most = FARTHEST * max(float((high - low).max()), 1e-6)
    share = np.linspace(0.0, 1.0, SIDE)
    border = np.array([(u, v) for u in share for v in share if u in (0.0, 1.0) or v in (0.0, 1.0)])
    level = float(np.median(xyz[:, 2]))
    for scene in scenes:
        seen = image_to_height(scene.model, border * scene.model.size, level, ground)[:, :2]
        seen = np.clip(seen[np.isfinite(seen).all(axis=1)], low - most, high + most)
        if len(seen):
            low, high = np.minimum(low, seen.min(axis=0)), np.maximum(high, seen.max(axis=0))
    # Relief at the rim reaches farther than level ground.
    margin = 0.02 * (high - low)
    (left, bottom), (right, top) = (low - margin).tolist(), (high + margin).tolist()
    return left, bottom, right, top


def _write(path: Path, values: Float32Array, grid: Grid, words: str) -> None:
    samples = Samples(1, "float32", nodata=float("nan"))
    metadata = RasterMetadata((words,), ((1.0, 0.0, "m"),))
    with RasterSink(path, grid, samples, overwrite=True, metadata=metadata) as sink:
        whole = grid.window
        sink.write(whole, values[..., None], np.ones(values.shape, dtype=np.uint8), blank=False)
        sink.finish()
