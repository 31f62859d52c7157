"""One radar scene over its relief, as layover masks and simulations take it."""

from __future__ import annotations

from typing import Any

from geomosaic.block import OrientedImage
from geomosaic.errors import InputError
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import Block, on_ground
from geomosaic.sensor.plugin import HasSensorPositions
from geomosaic.surface.dem import Dem
from geomosaic.surface.model import Surface
from geomosaic.types import PathLike


def radar_inputs(scene: object, dem: PathLike | Dem | float | None, dem_heights: str | None) -> Block:
    """Inputs of one scene over the ground that is given.

    Parameters
    ----------
    scene : Scene
    dem, dem_heights
        See `on_ground`.

    Raises
    ------
    InputError
        It is no scene, but an image alone.
    """
    if not isinstance(scene, Block):
        raise InputError("an image does not tell its sensor", where="`scene`", hint="give `Scene(image, sensor)`")
    return on_ground(scene, dem, dem_heights)


def radar_scene(inputs: Block, hint: str, **options: Any) -> tuple[OrientedImage, Surface]:
    """One radar scene and its relief.

    Parameters
    ----------
    inputs : Block
        As `radar_inputs` gives them.
    hint : str
        What to do about images of other sensors.
    **options
        Of `build_block`.

    Raises
    ------
    InputError
        There are several scenes, the sensor is no radar, or there is no DEM with relief.
    """
    block = build_block(inputs, **options)
    if len(block.scenes) != 1:
        raise InputError(f"one scene is taken, and {len(block.scenes)} are given", where="`scene`", hint="give one")
    one, surface = block.scenes[0], block.surface
    if not isinstance(one.model, HasSensorPositions):
        raise InputError("only scenes of side-looking radar are taken", where=str(one.path), hint=hint)
    if surface is None or surface.range[0] == surface.range[1]:
        raise InputError(
            "level ground has no slopes that a radar would show", where="`dem`", hint="give a DEM with its relief"
        )
    return one, surface
