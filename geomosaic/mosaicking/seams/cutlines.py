"""Cutlines drawn by the user: seam polygons that take precedence over computed ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, did_you_mean, warn
from geomosaic.geo.crs import horizontal
from geomosaic.geo.transform import Transform
from geomosaic.mosaicking.seams.voronoi import polygonal
from geomosaic.raster.vector import layer_names, read_layer
from geomosaic.render.areas import AREAS, check_kind


def with_cutlines(shares: Sequence[Any], drawn: Mapping[int, Any]) -> list[Any]:
    """Shares with drawn ones put in; computed shares keep the rest.

    Parameters
    ----------
    shares : sequence of Polygon or MultiPolygon
        One per image; they share no area.
    drawn : mapping of int to Polygon or MultiPolygon
        By number of the image. Where two overlap, the image of the lower number has precedence.

    Returns
    -------
    list of Polygon or MultiPolygon
        They share no area. An image without a drawn share keeps what no drawn one takes.
    """
    import shapely

    taken: Any = shapely.Polygon()
    result: list[Any] = [shapely.Polygon()] * len(shares)
    for number in sorted(drawn):
        shape = shapely.make_valid(drawn[number])
        # An overlay without need would move vertices in their last digits, and a rerun would find all tiles changed.
        result[number] = polygonal(shape.difference(taken)) if _significant(shape.intersection(taken), shape) else shape
        taken = taken.union(result[number])
    tree = shapely.STRtree(list(shares))
    for number, share in enumerate(shares):
        rest = polygonal(share.difference(taken)) if len(tree.query(taken)) else share
        if _significant(rest, share):
            result[number] = polygonal(result[number].union(rest))
    return result


def _significant(part: Any, whole: Any) -> bool:
    """Whether an area is more than rounding in an overlay leaves: a part in 10⁸ of another."""
    return bool(part.area > 1e-8 * whole.area)


def cover_everything(drawn: Mapping[int, Any], outlines: Sequence[Any]) -> bool:
    """Whether drawn shares leave less than a millionth of the footprints to others.

    Parameters
    ----------
    drawn : mapping of int to Polygon or MultiPolygon
        By number of the image.
    outlines : sequence of Polygon or MultiPolygon
        Footprints of all images.

    Returns
    -------
    bool
    """
    import shapely

    if not drawn:
        return False
    everything = shapely.union_all(list(outlines))
    return bool(everything.difference(shapely.union_all(list(drawn.values()))).area <= 1e-6 * everything.area)


LAYER, IMAGE = "seams", "image"
_HINT = "Move a border in both areas at once: in QGIS with topological editing"


def read_cutlines(path: Path, names: Sequence[str], outlines: Sequence[Any], crs: CRS) -> dict[int, Any]:
    """Drawn shares from a vector file, by number of their image, in the output map.

    The layer is that which a mosaic writes: polygons with the name of an image each. Polygons of one image are joined.

    Parameters
    ----------
    path : Path
        Vector file with a layer `seams`, or with one layer.
    names : sequence of str
        Of the images.
    outlines : sequence of Polygon
        Footprints in the output map; empty for images that are left out, whose shares do not count.
    crs : CRS
        Of the output.

    Returns
    -------
    dict of int to Polygon or MultiPolygon
        Each within its footprint: beyond it the image has nothing to show.

    Raises
    ------
    InputError
        No such layer or column, a geometry that is no area or crosses itself, a name that no image has, an area that
        its image does not show at all.
    """
    import shapely

    layers = layer_names(path)
    # The only layer of a file is taken by any name.
    layer = LAYER if LAYER in layers or len(layers) != 1 else layers[0]
    frame = read_layer(path, layer)
    where = f"{path}, layer {layer}"
    if IMAGE not in frame:
        raise InputError(f"the layer has no column '{IMAGE}'", where=where, hint="name the image of each polygon there")
    if frame.crs is None:
        raise InputError("the layer has no CRS", where=where, hint="set it, for example in QGIS")
    move = Transform(horizontal(CRS.from_user_input(frame.crs)), crs)
    found: dict[int, list[Any]] = {}
    for row, (name, geometry) in enumerate(zip(frame[IMAGE], frame.geometry, strict=True), start=1):
        if name not in names:
            hint = did_you_mean(str(name), names)
            raise InputError(
                f"row {row} names '{name}', which is no image of this mosaic",
                where=where,
                hint=f"{hint} name an image; or is this the file of another block?".strip(),
            )
        if geometry is None or geometry.is_empty:
            continue
        check_kind(geometry, AREAS, f"row {row}", where)
        number = list(names).index(name)
        outline, moved = outlines[number], shapely.make_valid(shapely.transform(shapely.force_2d(geometry), move))
        if outline.is_empty:
            continue
        if not moved.intersects(outline):
            raise InputError(
                f"row {row} lies outside of what '{name}' shows",
                where=where,
                hint="draw within its footprint; or is this the file of another block?",
            )
        # Cut only where needed: an overlay would move the vertices of a share that was not edited.
        beyond = _significant(moved.difference(outline), outline)
        found.setdefault(number, []).append(polygonal(moved.intersection(outline)) if beyond else moved)
    drawn = {
        number: parts[0] if len(parts) == 1 else shapely.union_all(np.array(parts, dtype=object))
        for number, parts in found.items()
    }
    _warn_of_overlaps(drawn, names, where)
    return drawn


def warn_of_gaps(path: Path, drawn: Mapping[int, Any], outlines: Sequence[Any]) -> None:
    """Warning of ground between drawn areas of all images: a border was moved in one area only.

    Parameters
    ----------
    path : Path
        File that they were drawn in.
    drawn : mapping of int to Polygon or MultiPolygon
        By number of the image; each image has one.
    outlines : sequence of Polygon or MultiPolygon
        Footprints of all images.

    Warns
    -----
    GeomosaicWarning
        With the area of the ground that no drawn area takes.
    """
    import shapely

    area = shapely.union_all(list(outlines)).difference(shapely.union_all(list(drawn.values()))).area
    warn(
        f"{path}: the areas of all images leave {area:.4g} square map units of what they show to no one; the program's "
        f"own seams divide that. {_HINT}"
    )


def _warn_of_overlaps(drawn: Mapping[int, Any], names: Sequence[str], where: str) -> None:
    """Warning of overlaps: a border was moved in one area and not in its neighbour."""
    import shapely

    numbers = sorted(drawn)
    shapes = np.array([drawn[number] for number in numbers], dtype=object)
    overlaps = []
    for i, j in sorted(zip(*shapely.STRtree(shapes).query(shapes, predicate="intersects").tolist(), strict=True)):
        part = shapely.intersection(shapes[i], shapes[j]) if i < j else None
        if part is not None and (_significant(part, shapes[i]) or _significant(part, shapes[j])):
            a, b = names[numbers[i]], names[numbers[j]]
            overlaps.append(f"'{a}' and '{b}' overlap by {part.area:.4g} square map units, which '{a}' shows")
    if overlaps:
        warn(f"{where}: the areas of {'; '.join(overlaps[:5])}{' ...' if len(overlaps) > 5 else ''}. {_HINT}")
