"""Inputs of the library from what a command was given."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geomosaic.options.declaration import compose

if TYPE_CHECKING:
    from geomosaic.inputs.declarations import Block
    from geomosaic.options.inputs import Area


def extent(area: Area) -> dict[str, Any]:
    """Keywords of the library for the extent of an output.

    Parameters
    ----------
    area : Area

    Returns
    -------
    dict
        What is given.
    """
    return {name: value for name, value in vars(area).items() if value is not None and value is not False}


def block_of(images: tuple[Path, ...], given: Mapping[str, Any]) -> Block:
    """Block of images with the inputs that a command was given.

    Parameters
    ----------
    images : tuple of Path
    given : mapping
        Inputs by name, of `Block` and its planar placement.

    Returns
    -------
    Block

    Raises
    ------
    InputError
        An input would do nothing beside the others, such as an orientation without a sensor.
    """
    from geomosaic.inputs.declarations import Block

    return compose(Block, {"images": images, **given})
