"""Refusal of heights, CRS and DEM for images that lie as their files say, which use none of them."""

from __future__ import annotations

from collections.abc import Sequence

from geomosaic.errors import InputError
from geomosaic.inputs.declarations import Block
from geomosaic.raster.info import inspect
from geomosaic.sensor.registry import capabilities


def refuse_unused_ground(parts: Sequence[Block], *, uses_surface: bool) -> None:
    """Check that images which are georeferenced already are given no input that would do nothing.

    Parameters
    ----------
    parts : sequence of Block
        Of one product. Where one is placed otherwise, its ground is that of all, and nothing is refused.
    uses_surface : bool
        Whether the product needs a surface whatever its images are, as seams beside raised objects do.

    Raises
    ------
    InputError
        Names the input.
    """
    if not all(map(_lies_as_its_files_say, parts)):
        return
    for part in parts:
        own = all(inspect(image, part.bands).crs is not None for image in part.images)
        idle = ["heights", *(["crs"] if own else []), *([] if uses_surface else ["dem", "height", "dem_heights"])]
        for name in idle:
            if getattr(part, name) is not None:
                what = f"`{name}` would do nothing: the images are georeferenced and lie as their files say"
                raise InputError(what, hint=f"leave out `{name}`, or name the `sensor` that took the images")


def _lies_as_its_files_say(part: Block) -> bool:
    power = capabilities(part.sensor)
    placed = {name for given in (part.options, *part.image_options.values()) for name in given} & {*power.placements}
    otherwise = (part.planar, part.control, part.exterior)
    return power.planar and not placed and all(each is None for each in otherwise)
