"""Voronoi regions of image centres and halved overlaps; order of images that lie upon each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.block import Footprint, OrientedImage
from geomosaic.errors import InputError, did_you_mean
from geomosaic.raster.image_metadata import acquisition_digits
from geomosaic.types import AnyArray, FloatArray, IntArray

if TYPE_CHECKING:
    from shapely import Polygon


# A shapely Polygon or MultiPolygon.
Geometry = Any


def voronoi_regions(outlines: list[Polygon], centres: list[tuple[float, float]]) -> list[Geometry]:
    """Voronoi regions of image centres within footprints: where each image is the nearest that shows the ground.

    Parameters
    ----------
    outlines : list of Polygon
        Footprints in the output map.
    centres : list of (x, y)
        The place each image sees best. Of two images with the same centre the first has precedence.

    Returns
    -------
    list of Polygon or MultiPolygon
        They share no area, and together they cover the union of the footprints.
    """
    import shapely

    tree = shapely.STRtree(outlines)
    shares = []
    for i, outline in enumerate(outlines):
        share = outline
        for j in sorted(int(k) for k in tree.query(outline, predicate="intersects")):
            if j == i:
                continue
            nearer = _nearer(centres[j], centres[i], outline.union(outlines[j]).bounds, first=j < i)
            if nearer is not None:
                share = share.difference(outlines[j].intersection(nearer))
        shares.append(polygonal(share))
    return shares


def _nearer(
    a: tuple[float, float], b: tuple[float, float], bounds: tuple[float, float, float, float], *, first: bool
) -> Polygon | None:
    """Part of a box that is nearer to a than to b: one side of the perpendicular bisector."""
    import shapely

    left, bottom, right, top = bounds
    if a == b:
        return shapely.box(left - 1, bottom - 1, right + 1, top + 1) if first else None
    middle = (np.array(a) + np.array(b)) / 2
    along = np.array(a) - np.array(b)
    along = along / np.hypot(*along)
    across = np.array([-along[1], along[0]])
    # Long enough that the far ends of the half-plane lie beyond the box, wherever the bisector crosses it.
    reach = 4.0 * (np.hypot(right - left, top - bottom) + np.hypot(*(np.array(a) - middle)))
    corners = [middle - across * reach, middle + across * reach]
    return shapely.Polygon([*corners, corners[1] + along * reach, corners[0] + along * reach])


def polygonal(geometry: Geometry) -> Geometry:
    """Polygons of a geometry, without the points and lines that an overlay may leave.

    Parameters
    ----------
    geometry : geometry
        Of any type.

    Returns
    -------
    Polygon or MultiPolygon
        Empty where the geometry has no area.
    """
    import shapely

    if geometry.geom_type in ("Polygon", "MultiPolygon"):
        return geometry
    parts = [part for part in getattr(geometry, "geoms", []) if part.geom_type in ("Polygon", "MultiPolygon")]
    return shapely.union_all(parts) if parts else shapely.Polygon()


def inner_edges(outlines: Sequence[Any]) -> list[Any]:
    """Parts of each footprint's edge that lie within others; the edge of the whole block is left out.

    Parameters
    ----------
    outlines : sequence of Polygon
        Footprints in the output map.

    Returns
    -------
    list of geometry
        One per image; empty where no other image overlaps.
    """
    import shapely

    tree, found = shapely.STRtree(list(outlines)), []
    for i, outline in enumerate(outlines):
        near = [outlines[int(k)] for k in tree.query(outline, predicate="intersects") if int(k) != i]
        # The others shrunk by a hair: where edges coincide, the edge of the block stays outside despite rounding.
        others = shapely.union_all(near).buffer(-_hair(outline)) if near else shapely.Polygon()
        found.append(outline.boundary.intersection(others))
    return found


def shared_edges(polygons: Sequence[Any]) -> list[Any]:
    """Parts of each polygon's edge along which others lie: seams without the edge of the whole block.

    Parameters
    ----------
    polygons : sequence of Polygon or MultiPolygon
        Seam polygons in the output map; they share no area.

    Returns
    -------
    list of geometry
        One per image; empty where no other image adjoins.
    """
    import shapely

    tree, found = shapely.STRtree(list(polygons)), []
    for i, polygon in enumerate(polygons):
        near = [polygons[int(k)] for k in tree.query(polygon, predicate="intersects") if int(k) != i]
        # Widened by a hair: borders were computed from either side.
        others = shapely.union_all(near).buffer(_hair(polygon)) if near else shapely.Polygon()
        found.append(polygon.boundary.intersection(others))
    return found


def _hair(outline: Any) -> float:
    """Length in map units beside which rounding is nothing, and which is nothing beside a footprint."""
    if outline.is_empty:
        return 0.0
    left, bottom, right, top = outline.bounds
    return 1e-6 * max(float(np.hypot(right - left, top - bottom)), 1e-300)


def farthest_inside(edges: Sequence[Any], places: FloatArray, covers: AnyArray) -> IntArray:
    """Image in which each place lies deepest: farthest from the inner edges of its footprint.

    Parameters
    ----------
    edges : sequence of geometry
        From `inner_edges`, one per image.
    places : array (N, 2)
        In the output map.
    covers : bool array (K, N)
        Whether an image shows a place.

    Returns
    -------
    int array (N,)
        Number of the image; the first of equals; -1 where none shows the place.
    """
    # For two footprints the border is the line that is equally far from both inner edges: the overlap is halved. For
    # more it is the same rule, so that no place is left over and none is claimed twice.
    import shapely

    points = shapely.points(places)
    depth = np.full(covers.shape, -1.0)
    for k, edge in enumerate(edges):
        if edge.is_empty:
            depth[k, covers[k]] = np.inf
            continue
        shapely.prepare(edge)
        depth[k, covers[k]] = shapely.distance(points[covers[k]], edge)
    return np.where(covers.any(axis=0), depth.argmax(axis=0), -1)


# Candidate images of a cell: seams meet in junctions of three.
MAX_CANDIDATES = 3


def nearest_images(
    centres: FloatArray, places: FloatArray, covers: AnyArray, reach: float, most: int = MAX_CANDIDATES
) -> IntArray:
    """Candidate images of cells, the nearest first.

    Parameters
    ----------
    centres : array (K, 2)
        Of the images at hand, in map units.
    places : array (N, 2)
        Of the cells, in map units.
    covers : bool array (K, N)
        Whether an image shows a cell.
    reach : float
        Width of the zone in which a seam may run, as a part of the distance of two image centres.
    most : int
        Largest number of candidates of a cell.

    Returns
    -------
    int array (most, N)
        Numbers among the images, -1 where there are no more. A cell with one candidate is surely that one's.
    """
    found = np.full((most, len(places)), -1)
    distance = np.hypot(*(places[None] - centres[:, None]).transpose(2, 0, 1))
    # Images that do not show a cell come last, and are no candidates.
    distance = np.where(covers, distance, np.inf)
    order, each = np.argsort(distance, axis=0, kind="stable"), np.arange(len(places))
    for rank in range(min(most, len(centres))):
        spacing = np.hypot(*(centres[order[0]] - centres[order[rank]]).T)
        with np.errstate(invalid="ignore"):  # where no image is left, all distances are infinite
            excess = distance[order[rank], each] - distance[order[0], each]
            allowed = np.isfinite(distance[order[rank], each]) & (excess <= reach * spacing)
        found[rank] = np.where(allowed, order[rank], -1)
    # The second may be beyond reach where the third is not: candidates close up, so that -1 ends the list.
    closed = np.argsort(found < 0, axis=0, kind="stable")
    return np.take_along_axis(found, closed, axis=0)


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


def image_index(name: str, scenes: Sequence[OrientedImage], where: str = "`base`", hint: str = "") -> int:
    """Number of the image of a name, with or without its suffix.

    Parameters
    ----------
    name : str
    scenes : sequence of OrientedImage
    where : str
        Option that names the image, for the error.
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
    date = acquisition_digits(scene.path)
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
