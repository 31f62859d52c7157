"""The order of images: whose pixels come first, and which image is laid lowest."""

from __future__ import annotations

from collections.abc import Sequence

from geomosaic.block.footprint import Footprint
from geomosaic.block.scene import Scene
from geomosaic.errors import InputError, did_you_mean
from geomosaic.raster.acquired import dated

ORDERS = ("list", "name", "resolution", "date")


def ordered(
    scenes: Sequence[Scene], outlines: Sequence[Footprint], order: str = "list", base: str | None = None
) -> list[int]:
    """Numbers of the images, the most wanted first.

    Parameters
    ----------
    scenes : sequence of Scene
    outlines : sequence of Footprint
        Of the scenes; tell their resolution.
    order : str
        'list' as given; 'name' by alphabet; 'resolution' the finest first; 'date' the newest first.
        Equals stay as given.
    base : str, optional
        Name of the image that comes last, whatever the order.

    Raises
    ------
    InputError
        An unknown order or image, or an image that does not say when it was taken.
    """
    numbers = list(range(len(scenes)))
    if order == "name":
        numbers.sort(key=lambda i: scenes[i].name)
    elif order == "resolution":
        # A hair of tolerance: the same pixel size, computed at different places, is the same.
        numbers.sort(key=lambda i: float(f"{outlines[i].sampling:.6g}"))
    elif order == "date":
        dates = [_date(scene) for scene in scenes]
        numbers.sort(key=lambda i: dates[i], reverse=True)  # which keeps equals as they were, too
    elif order != "list":
        raise InputError(f"no order is named '{order}'", mend=f"one of {', '.join(ORDERS)}")
    if base is not None:
        lowest = index_of(base, scenes)
        numbers = [i for i in numbers if i != lowest] + [lowest]
    return numbers


def index_of(name: str, scenes: Sequence[Scene]) -> int:
    """Number of the image of that name, with or without its suffix.

    Raises
    ------
    InputError
    """
    names = [scene.name for scene in scenes]
    found = [i for i, own in enumerate(names) if own == name] or [
        i for i, own in enumerate(names) if own.rpartition(".")[0] == name
    ]
    if len(found) != 1:
        meant = did_you_mean(name, names)
        raise InputError(
            f"{'several images are' if found else 'no image is'} called '{name}'",
            where="base image",
            mend=meant or f"name one of the images, such as {names[0]}",
        )
    return found[0]


def _date(scene: Scene) -> str:
    date = dated(scene.path)
    if date is None:
        raise InputError(
            "the image does not say when it was taken",
            where=scene.path,
            mend="leave out --order date and name the images in the order you want, or write the tag TIFFTAG_DATETIME",
        )
    return date
