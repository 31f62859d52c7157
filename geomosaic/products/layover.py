"""Layover, shadow and foreshortening of a radar scene as a raster, and its local incidence angles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.execution.units import map_units, workers_for
from geomosaic.geo.grid import Bounds, Grid
from geomosaic.inputs.area import plan
from geomosaic.inputs.declarations import Block
from geomosaic.options.declaration import compose
from geomosaic.options.inputs import Area
from geomosaic.options.render import BLOCK_HEIGHT, RenderOptions
from geomosaic.products.radar_scene import radar_inputs, radar_scene
from geomosaic.raster.cog.codec import RasterMetadata, Samples
from geomosaic.raster.files import check_output, companion
from geomosaic.raster.sink import RasterProduct, RasterSink
from geomosaic.render.radar_terrain import RadarTerrain
from geomosaic.resample.layover_shadow import FORESHORTENING, LAYOVER, SHADOW, UNKNOWN
from geomosaic.surface.dem import Dem
from geomosaic.types import PathLike
from geomosaic.whole_files import path_of

if TYPE_CHECKING:
    from geomosaic.execution.run_report import RunReport

# Options of rendering that would do nothing: no pixel is resampled.
_IDLE = ("resampling", "tolerance", "true_ortho", "nodata")


@dataclass(frozen=True, kw_only=True)
class LayoverOptions:
    """Options of a layover mask.

    Attributes
    ----------
    render : RenderOptions
    """

    render: RenderOptions = field(default_factory=RenderOptions)


# Value of a mask's cell where nothing is known.
NODATA = 255


@dataclass(frozen=True, eq=False, repr=False)
class LayoverMask(RasterProduct):
    """Raster of classes of a radar scene.

    Attributes
    ----------
    path : Path
        One band of bits: 1 layover, 2 shadow, 4 foreshortening; 255 where the ground or the orbit is not known.
    grid : Grid
    incidence : Path, optional
        Raster of local incidence angles, degrees.
    shares : mapping of str to float
        Share of the known pixels that is 'layover', 'shadow' and 'foreshortening'.
    known : int
        Pixels.
    run : RunReport, optional
        What each worker did; None where threads of the process did everything.
    """

    path: Path
    grid: Grid
    incidence: Path | None
    shares: Mapping[str, float]
    known: int
    run: RunReport | None = None


def layover_mask(
    scene: Block,
    output: PathLike,
    *,
    dem: PathLike | Dem | float | None = None,
    dem_heights: str | None = None,
    dst_crs: str | None = None,
    resolution: float | None = None,
    bounds: Bounds | None = None,
    like: PathLike | Grid | None = None,
    incidence: bool = True,
    **options: Any,
) -> LayoverMask:
    """Layover, shadow and foreshortening of each pixel of a radar scene, and local incidence angles.

    Parameters
    ----------
    scene : Scene
        Radar scene with its metadata; the raster itself is not read.
    output : path
        GeoTIFF of classes; the angles stand beside it (NAME-incidence.tif).
    dem : path or Dem, optional
        Ground, instead of the scene's own.
    dem_heights : str, optional
        Vertical datum of `dem`, where the file does not say it.
    dst_crs, resolution, bounds, like
        Of the output, as for `ortho`.
    incidence : bool
        Write the angles.
    **options
        Of `RenderOptions`, flat: `overwrite`, `threads`, `workers`, `creation`, ...; or whole as `render`.

    Returns
    -------
    LayoverMask

    Raises
    ------
    InputError
        The sensor is no radar, or there is no DEM with relief.
    OutputExistsError, OutputError
    """
    inputs = radar_inputs(scene, dem, dem_heights)
    idle = next((name for name in _IDLE if name in options), None)
    if idle is not None:
        raise InputError(f"`{idle}` would do nothing: no image is resampled", hint=f"leave out `{idle}`")
    render, target = compose(LayoverOptions, options).render, path_of(output, "output")
    angles = companion(target, "-incidence", ".tif") if incidence else None
    for file in (target, angles):
        if file is not None:
            check_output(file, overwrite=render.overwrite, inputs=inputs.files, geotiff=True)
    others = "`ortho` with `true_ortho` masks what a photo or a scanner does not see"
    one, surface = radar_scene(inputs, others, dem_memory=render.dem_memory)
    grid, _ = plan((one,), surface, Area(dst_crs, resolution, bounds, like=like))
    terrain = RadarTerrain(grid, surface, one.model)
    counts, known = np.zeros(3, dtype=np.int64), 0
    bits = {"layover": LAYOVER, "shadow": SHADOW, "foreshortening": FORESHORTENING}
    sink: dict[str, Any] = {
        "driver": render.driver,
        "creation": render.creation,
        "overwrite": render.overwrite,
        "threads": render.threads,
    }
    metadata = RasterMetadata(
        ("1 layover, 2 shadow, 4 foreshortening; sums of them",), categorical=True, tags={"GEOMOSAIC_IMAGES": "1"}
    )
    units = grid.window.split(render.tile, BLOCK_HEIGHT)
    with workers_for(render) as run:
        with RasterSink(target, grid, Samples(1, "uint8", nodata=NODATA), metadata=metadata, **sink) as masks:
            for done, (window, classes) in enumerate(map_units(terrain.classes, units, render), start=1):
                hidden = (classes & UNKNOWN) > 0
                valid = (~hidden).astype(np.uint8)
                masks.write(window, np.where(hidden, NODATA, classes)[..., None], valid)
                counts += [np.count_nonzero(classes & bit) for bit in bits.values()]
                known += int(valid.sum())
                render.report(done, len(units), "layover")
            masks.finish()
        if angles is not None:
            named = RasterMetadata(("local incidence angle, degrees",))
            nodata = float("nan")
            with RasterSink(angles, grid, Samples(1, "float32", nodata=nodata), metadata=named, **sink) as raster:
                for window, found in map_units(terrain.incidence, units, render):
                    seen = np.isfinite(found)
                    raster.write(window, found.astype(np.float32)[..., None], seen.astype(np.uint8))
                raster.finish()
    shares = {name: count / max(1, known) for name, count in zip(bits, counts.tolist(), strict=True)}
    return LayoverMask(target, grid, angles, shares, known, run)
