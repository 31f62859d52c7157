"""Areas and lines drawn by a person: water, clouds and buildings, roads to follow."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, warn
from geomosaic.geo.crs import horizontal
from geomosaic.geo.grid import Grid
from geomosaic.geo.transform import Transform
from geomosaic.raster.vector import layer_names, read_layer

AREAS = ("Polygon", "MultiPolygon")
LINES = ("LineString", "MultiLineString")


def read_areas(path: Path, grid: Grid, layer: str | None = None, *, must_meet: bool = False) -> list[Any]:
    """Polygons of a layer of a vector file, in the map of a grid.

    Parameters
    ----------
    path : Path
    grid : Grid
        Of the output. A warning says so if nothing of the layer reaches it.
    layer : str, optional
        Name of the layer; a file with a single layer may call it otherwise. Without a name the first one.
    must_meet : bool
        Raise where nothing reaches the grid.

    Returns
    -------
    list of shapely geometry
        Valid polygons.

    Raises
    ------
    InputError
        No such layer, no CRS, a geometry that is no area, an area that crosses itself.
    """
    layers = layer_names(path)
    named = layer is not None and (layer in layers or len(layers) != 1)
    found = read_shapes(path, str(layer) if named else layers[0], grid.crs, AREAS)
    note_elsewhere(path, found, grid, must_meet=must_meet)
    return found


def read_shapes(path: Path, layer: str, crs: CRS, kinds: Sequence[str]) -> list[Any]:
    """Geometries of one layer in a map, without those that have no place in it.

    Parameters
    ----------
    path : Path
    layer : str
    crs : CRS
        Of the map; a vertical part is ignored.
    kinds : sequence of str
        Geometry types that may occur: `AREAS`, `LINES` or both.

    Returns
    -------
    list of shapely geometry
        Two-dimensional, valid.

    Raises
    ------
    InputError
        No CRS, another kind of geometry, an area that crosses itself.
    """
    import shapely

    frame, where = read_layer(path, layer), f"{path}, layer {layer}"
    if frame.crs is None:
        raise InputError("the layer has no CRS", where=where, hint="set it, for example in QGIS")
    move, found = Transform(horizontal(CRS.from_user_input(frame.crs)), horizontal(crs)), []
    for row, geometry in enumerate(frame.geometry, start=1):
        if geometry is None or geometry.is_empty:
            continue
        check_kind(geometry, kinds, f"row {row}", where)
        moved = shapely.transform(shapely.force_2d(geometry), move)
        if np.isfinite(shapely.get_coordinates(moved)).all():  # what has no place in the map is not near it
            # A valid area may cross itself after the change of CRS, when its vertices are all that is moved.
            found.append(moved if moved.is_valid else shapely.make_valid(moved))
    return found


def check_kind(geometry: Any, kinds: Sequence[str], which: str, where: str) -> None:
    """Check of a geometry's type, and that an area does not cross itself: nobody knows which side of it is meant.

    Parameters
    ----------
    geometry : shapely geometry
    kinds : sequence of str
        Geometry types that are allowed.
    which, where : str
        Row and layer, named in errors.

    Raises
    ------
    InputError
        Another type, or an area that is not valid.
    """
    import shapely

    if geometry.geom_type not in kinds:
        lines = set(LINES) <= set(kinds)
        raise InputError(
            f"{which} is a {geometry.geom_type}, not {'a line or area' if lines else 'an area'}",
            where=where,
            hint="draw lines or polygons" if lines else "draw polygons",
        )
    if geometry.geom_type in AREAS and not geometry.is_valid:
        raise InputError(
            f"{which} is no valid area: {shapely.is_valid_reason(geometry)}",
            where=where,
            hint="repair it, for example with 'Fix geometries' of QGIS",
        )


def note_elsewhere(path: Path, shapes: Sequence[Any], grid: Grid, *, must_meet: bool = False) -> None:
    """Warning where none of some shapes reaches a grid: a file of another block, as a rule, or a wrong CRS.

    Parameters
    ----------
    path : Path
        File of the shapes, named in the message.
    shapes : sequence of shapely geometry
        In the map of `grid`.
    grid : Grid
    must_meet : bool
        Raise instead of warning.

    Raises
    ------
    InputError
        None reaches the grid and `must_meet` is set.
    """
    import shapely

    if shapes and shapely.intersects(np.array(shapes, dtype=object), shapely.box(*grid.bounds)).any():
        return
    what, hint = "nothing in this file reaches the mosaic", "check its CRS; is it the file of another block?"
    if must_meet:
        raise InputError(what, where=str(path), hint=hint)
    warn(f"{path}: {what}; {hint}")
