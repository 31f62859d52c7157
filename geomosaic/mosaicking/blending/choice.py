"""Choice of the blender, and the width of the transition across seams in pixels of the output."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from geomosaic.geo.grid import Grid
from geomosaic.geo.units import linear_unit
from geomosaic.mosaicking.blending.block import Blender
from geomosaic.options.mosaic import BlendOptions, Width
from geomosaic.render.workers import Room


def with_blending(blender: Blender, memory: int) -> Blender:
    """Blender of the kind that its blending options ask for.

    Parameters
    ----------
    blender : Blender
        Plain; `seams.feather` is the width of the transition in output pixels.
    memory : int
        Bytes that a multiband blender may hold for what images show of a block.

    Returns
    -------
    Blender
        The same one for feathers and hard seams, else a `MultibandBlender`.
    """
    if blender.blending.plain:
        return blender
    # Imported where needed: few mosaics are blended in bands, and the kernels take time to load.
    from geomosaic.mosaicking.blending.multiband import MultibandBlender
    from geomosaic.mosaicking.colour.noise import image_noise
    from geomosaic.resample.pyramid import steps

    return MultibandBlender(
        **{**vars(blender), "seams": replace(blender.seams, feather=0.0)},
        width=blender.seams.feather,
        steps=steps(compiled=bool(blender.engine.block_kernels)),
        noise=image_noise(blender) if blender.blending.limits else None,
        room=Room(memory),
    )


PIXELS = 32.0
"""Width unless one is given."""


def width_px(width: Width, grid: Grid) -> float:
    """Width of a transition in pixels of a grid.

    Parameters
    ----------
    width : Width
        Value with its unit: pixels, metres, or map units.
    grid : Grid
        Of the output. In a geographic CRS a metre is converted at the grid's middle latitude.

    Returns
    -------
    float
        Pixels, by the geometric mean of both sides of a pixel.
    """
    if width.unit == "px":
        return width.value
    x, y = grid.resolution
    size = x if x == y else math.sqrt(x * y)
    return width.value * (_units_per_metre(grid) if width.unit == "m" else 1.0) / size


def transition_px(options: BlendOptions, grid: Grid) -> float:
    """Width of the transition across seams in output pixels.

    Parameters
    ----------
    options : BlendOptions
    grid : Grid
        Of the output.

    Returns
    -------
    float
        0 for hard seams; infinite where images are blended over all that they share; `PIXELS` unless a width is given.
    """
    if options.blend == "none":
        return 0.0
    if options.feather is None:
        return math.inf if options.blend == "overlap" else PIXELS
    return width_px(options.feather, grid)


def _units_per_metre(grid: Grid) -> float:
    metres = linear_unit(grid.crs)
    if grid.crs.is_geographic:  # the mean of both axes
        bottom, top = grid.bounds[1::2]
        metres *= math.sqrt(max(0.01, float(np.cos(np.radians((bottom + top) / 2)))))
    return 1.0 / (metres or 1.0)
