"""Order of images that lie upon each other, and the parts of each that remain visible."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from geomosaic.block.block import OrientedImage
from geomosaic.block.footprint import Footprint
from geomosaic.errors import InputError, did_you_mean
from geomosaic.mosaicking.seams.voronoi import polygonal
from geomosaic.raster.photo_metadata import dated

ORDERS = ("list", "name", "resolution", "date")


def image_order(
    scenes: Sequence[OrientedImage], outlines: Sequence[Footprint], order: str = "list", base: str | None = None
) -> list[int]:
    """Order of precedence of images that lie upon each other, the uppermost first.

    Parameters
    ----------
    scenes : sequence of OrientedImage
    outlines : sequence of Footprint
        Of the scenes, with their ground sampling distance.
    order : str
        'list' as given; 'name' by alphabet; 'resolution' the finest first; 'date' the newest first.
        Equals stay as given.
    base : str, optional
        Name of the image that comes last, whatever the order.

    Returns
    -------
    list of int
        Numbers of the images.

    Raises
    ------
    InputError
        An unknown order or image, or an image without acquisition date.
    """
    # Sorts are stable, so equals stay as given.
    numbers = list(range(len(scenes)))
    if order == "name":
        numbers.sort(key=lambda i: scenes[i].name)
    elif order == "resolution":
        # Six digits: the same pixel size, computed at different places, must be equal.
        numbers.sort(key=lambda i: float(f"{outlines[i].sampling:.6g}"))
    elif order == "date":
        dates = [_acquisition_date(scene) for scene in scenes]
        numbers.sort(key=lambda i: dates[i], reverse=True)  # stable in reverse, too
    elif order != "list":
        raise InputError(f"no order is named '{order}'", hint=f"one of {', '.join(ORDERS)}")
    if base is not None:
        lowest = image_index(base, scenes)
        numbers = [i for i in numbers if i != lowest] + [lowest]
    return numbers


def image_index(name: str, scenes: Sequence[OrientedImage], where: str = "base image", hint: str = "") -> int:
    """Number of the image of a name, with or without its suffix.

    Parameters
    ----------
    name : str
    scenes : sequence of OrientedImage
    where : str
        Role of the image, for the error.
    hint : str
        Added to the error's hint.

    Returns
    -------
    int

    Raises
    ------
    InputError
        No image, or several, of that name.
    """
    names = [scene.name for scene in scenes]
    found = [i for i, own in enumerate(names) if own == name] or [
        i for i, own in enumerate(names) if own.rpartition(".")[0] == name
    ]
    if len(found) != 1:
        meant = did_you_mean(name, names)
        raise InputError(
            f"{'several images are' if found else 'no image is'} called '{name}'",
            where=where,
            hint=f"{meant or f'name one of the images, such as {names[0]}'}{hint}",
        )
    return found[0]


def _acquisition_date(scene: OrientedImage) -> str:
    date = dated(scene.path)
    if date is None:
        raise InputError(
            "the image does not say when it was taken",
            where=scene.path,
            hint="leave out `order=date` and name the images in the order you want, or write the tag TIFFTAG_DATETIME",
        )
    return date


def visible_regions(outlines: Sequence[Any], order: Sequence[int]) -> list[Any]:
    """Visible part of each image where images lie upon each other.

    Parameters
    ----------
    outlines : sequence of Polygon or MultiPolygon
        What each image shows.
    order : sequence of int
        All images, the uppermost first.

    Returns
    -------
    list of Polygon or MultiPolygon
        They share no area, and together they cover the union of the outlines.
    """
    import shapely

    tree = shapely.STRtree(list(outlines))
    rank = {image: place for place, image in enumerate(order)}
    shares = []
    for i, outline in enumerate(outlines):
        above = [int(j) for j in tree.query(outline, predicate="intersects") if rank[int(j)] < rank[i]]
        covered = shapely.union_all([outlines[j] for j in sorted(above)])
        shares.append(polygonal(outline.difference(covered)) if above else outline)
    return shares


def with_base_image(shares: Sequence[Any], outlines: Sequence[Any], base: int) -> list[Any]:
    """Shares with that of a base image added: the part of its outline that no other image takes.

    Parameters
    ----------
    shares : sequence of Polygon or MultiPolygon
        Of all images but the base, in their order.
    outlines : sequence of Polygon or MultiPolygon
        Of all images.
    base : int
        Number of the base image among all.

    Returns
    -------
    list of Polygon or MultiPolygon
        Of all images.
    """
    import shapely

    rest = polygonal(outlines[base].difference(shapely.union_all(list(shares))))
    return [*shares[:base], rest, *shares[base:]]
