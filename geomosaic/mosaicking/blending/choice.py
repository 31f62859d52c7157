"""The blender that a kind of blending asks for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.blending.block import Blender, Seams
from geomosaic.options.mosaic import BlendOptions
from geomosaic.options.render import RenderOptions
from geomosaic.radiometry.histogram_matching import Curve
from geomosaic.radiometry.local_gains import Shade
from geomosaic.render.occlusion import Visibility
from geomosaic.render.photos import Photos
from geomosaic.render.workers import Room
from geomosaic.resample.engine import Engine
from geomosaic.resample.warp import Colour
from geomosaic.sensor.map_to_image import Ground


def blender_for(
    blending: BlendOptions,
    photos: Photos,
    grid: Grid,
    ground: Ground,
    seams: Seams,
    colours: Sequence[Colour | Curve | Shade],
    engine: Engine,
    render: RenderOptions,
    dtype: str,
    sight: Visibility | None,
) -> Blender:
    """Renderer of blocks; `seams.feather` is the width of the transition in output pixels, `dtype` of the output."""
    limited = blending.limits and seams.feather > 0
    seams = replace(seams, smooth=blending.ramp == "smooth")
    plain = Blender(
        photos, grid, ground, seams, colours, engine, render.resampling, render.tolerance, dtype, sight, limited
    )
    if blending.plain:
        return plain
    from geomosaic.mosaicking.blending.multiband import BandBlender
    from geomosaic.mosaicking.colour.noise import usual_difference
    from geomosaic.resample.pyramid import steps

    noise = usual_difference(plain) if blending.limits else None
    return BandBlender(
        photos, grid, ground, replace(seams, feather=0.0), colours, engine, render.resampling, render.tolerance, dtype,
        sight, limited, blending, seams.feather, steps(compiled=bool(engine.block_kernels)), noise,
        Room(render.memory_limit // 3),
    )  # fmt: skip
