"""Control points of a radar scene by the match of the scene with its simulation from DEM and orbit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from affine import Affine

from geomosaic.control.points import ControlPoints, Origin, mean_sigmas
from geomosaic.errors import InputError, counted
from geomosaic.execution.units import map_units
from geomosaic.geo.crs import crs_code, horizontal, image_crs
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.transform import Transform
from geomosaic.inputs.control_table import write_control
from geomosaic.inputs.declarations import Block
from geomosaic.options.render import BLOCK_HEIGHT, RunningOptions
from geomosaic.products.radar_scene import radar_inputs, radar_scene
from geomosaic.raster.cog.codec import RasterMetadata, Samples
from geomosaic.raster.files import check_output
from geomosaic.raster.sink import RasterProduct, RasterSink
from geomosaic.raster.source import Source
from geomosaic.render.illuminated_area import WIDTH, IlluminatedArea
from geomosaic.render.radar_simulation import SimulatedControl, matched_control
from geomosaic.surface.dem import Dem
from geomosaic.types import BoolArray, FloatArray, PathLike
from geomosaic.whole_files import path_of

# Fewest windows that place a scene with some certainty.
LEAST = 4
_OTHERS = "photos and scanners: `match` with a `reference`"


@dataclass(frozen=True, eq=False, repr=False)
class SimulationMatch:
    """Match of a radar scene with its simulation.

    Attributes
    ----------
    image : str
    control : ControlPoints
        Ground of the DEM and places in the scene, with their covariances.
    matched : SimulatedControl
        In the model's frame.
    shift : array (2,)
        Weighted mean shift of the scene against its orbit, (col, row) in pixels.
    sigma : array (2,)
        Its standard deviations, by the scatter of the points where that is larger than their covariances say.
    """

    image: str
    control: ControlPoints
    matched: SimulatedControl
    shift: FloatArray
    sigma: FloatArray

    def __repr__(self) -> str:
        off = ", ".join(f"{shift:+.2f} ± {sigma:.2f} px" for shift, sigma in zip(self.shift, self.sigma, strict=True))
        return f"SimulationMatch('{self.image}', {counted(len(self.control), 'control point')}, {off})"

    @property
    def summary(self) -> str:
        """Result in words."""
        return (
            f"{self.image}: {counted(len(self.control), 'control point')}; the scene lies {self.shift[0]:+.2f} columns "
            f"and {self.shift[1]:+.2f} rows from where its orbit puts it "
            f"(± {self.sigma[0]:.2f}, {self.sigma[1]:.2f})\n"
            f"coordinates are in {crs_code(horizontal(self.control.crs))}, heights in the vertical datum of the DEM"
        )

    def write(self, path: PathLike) -> Path:
        """Table of control points, as the `control` of a block takes it.

        Parameters
        ----------
        path : path
        """
        return write_control(path, {self.image: self.control})


@dataclass(frozen=True, eq=False, repr=False)
class SimulatedScene(RasterProduct):
    """Raster of the expected brightness of a radar scene, in its columns and rows.

    Attributes
    ----------
    path : Path
    grid : Grid
        Pixels of the scene.
    """

    path: Path
    grid: Grid


def simulate_scene(
    scene: Block,
    output: PathLike,
    *,
    dem: PathLike | Dem | None = None,
    dem_heights: str | None = None,
    overwrite: bool = False,
) -> SimulatedScene:
    """Brightness of a radar scene that is expected of ground of gamma nought 1, from DEM and orbit alone.

    Parameters
    ----------
    scene : Scene
        Radar scene with its metadata; the raster itself is not read.
    output : path
        GeoTIFF of beta nought (float32), as wide and high as the scene: areas of layover add up, and shadow has next to
        nothing. NaN where the ground is not known.
    dem : path or Dem, optional
        Ground, instead of the scene's own.
    dem_heights : str, optional
        Vertical datum of `dem`, where the file does not say it.
    overwrite : bool
        Replace the output if it exists.

    Returns
    -------
    SimulatedScene

    Raises
    ------
    InputError
        The sensor is no radar, or there is no DEM with relief.
    OutputExistsError, OutputError
    """
    target = path_of(output, "output")
    inputs = radar_inputs(scene, dem, dem_heights)
    check_output(target, overwrite=overwrite, inputs=inputs.files, geotiff=True)
    one, surface = radar_scene(inputs, _OTHERS)
    grid = Grid(image_crs(), Affine.identity(), *one.model.size)
    metadata = RasterMetadata(("beta nought of ground of gamma nought 1",))
    samples = Samples(1, "float32", nodata=float("nan"))
    with RasterSink(target, grid, samples, metadata=metadata, overwrite=overwrite) as raster:
        units = grid.window.split(WIDTH, BLOCK_HEIGHT)
        for window, found in map_units(IlluminatedArea(one.model, surface).summed, units, RunningOptions()):
            raster.write(window, found.astype(np.float32)[..., None], np.isfinite(found).astype(np.uint8))
        raster.finish()
    return SimulatedScene(target, grid)


def match_simulation(
    scene: Block,
    *,
    dem: PathLike | Dem | None = None,
    dem_heights: str | None = None,
    tile: int = 128,
    reach: int = 32,
) -> SimulationMatch:
    """Control points of a radar scene without anyone pointing: the scene is matched with its simulation from the DEM.

    Parameters
    ----------
    scene : Scene
        Radar scene of amplitudes with its metadata.
    dem : path or Dem, optional
        Ground, instead of the scene's own.
    dem_heights : str, optional
        Vertical datum of `dem`, where the file does not say it.
    tile : int
        Side of the windows that are compared, pixels: at most 12 by 12 of them, spread over the scene.
    reach : int
        Largest shift that is looked for, pixels.

    Returns
    -------
    SimulationMatch

    Raises
    ------
    InputError
        The sensor is no radar, there is no DEM with relief, or too few windows look like their simulation.
    """
    one, surface = radar_scene(radar_inputs(scene, dem, dem_heights), _OTHERS)
    with Source(one.path, nodata=one.nodata, bands=one.bands, usable=one.usable, clouds=one.clouds) as source:

        def read(region: Window) -> tuple[FloatArray, BoolArray]:
            values, valid = source.read(region)
            power = values[:, :, 0].astype(np.float64) ** 2
            # Beside the swath amplitudes are 0, and within it thermal noise keeps nearly all of them above.
            return power, (power > 0.0) if valid is None else (power > 0.0) & valid.astype(np.bool_)

        matched = matched_control(one.model, surface, read, tile, reach)
    _require_windows(matched, tile, reach, str(one.path))
    weights = np.linalg.inv(matched.covariance)
    whole = np.linalg.inv(weights.sum(axis=0))
    shift = whole @ np.einsum("nij,nj->i", weights, matched.shifts)
    off = matched.shifts - shift
    factor = max(1.0, float(np.einsum("ni,nij,nj->", off, weights, off)) / (2 * len(off) - 2))
    names = tuple(f"sim{number}" for number in range(1, len(off) + 1))
    ground = Transform(one.model.crs, surface.crs)(matched.ground)
    control = ControlPoints(
        names, matched.colrow, ground, surface.crs, mean_sigmas(matched.covariance), ("control",) * len(names),
        np.ones(len(names), dtype=np.bool_), tuple(Origin("simulation", k, "window") for k in range(1, len(names) + 1)),
        covariance=matched.covariance,
    )  # fmt: skip
    return SimulationMatch(Path(one.path).name, control, matched, shift, np.sqrt(factor * np.diag(whole)))


def _require_windows(matched: SimulatedControl, tile: int, reach: int, where: str) -> None:
    """Check that enough windows were found."""
    if matched.windows < LEAST:
        raise InputError(
            f"the scene has room for {counted(matched.windows, 'window')} of {tile} pixels that may be shifted by "
            f"{reach}, and {LEAST} are needed",
            where=where, hint="take a smaller `tile`, or a smaller `reach`",
        )  # fmt: skip
    if not matched.covered:
        raise InputError(
            "the DEM has no ground where the orbit puts the scene", where=where,
            hint="give a DEM that covers the scene, or check that the metadata (orbit, times, ranges and the side it "
            "looks to) are of this image",
        )  # fmt: skip
    if len(matched.ground) < LEAST:
        raise InputError(
            f"{len(matched.ground)} of the {counted(matched.whole, 'window')} that DEM and scene fill look like their "
            f"simulation, and {LEAST} are needed",
            where=where,
            hint="look whether DEM, scene and metadata are of one place, without holes; flat land shows nothing, and a "
            "scene that lies farther off takes a larger `reach`",
        )
