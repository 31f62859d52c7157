"""Read areas that a person has drawn: what to leave out of the statistics of colour, or what to take them from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.transform import Transform
from geomosaic.raster.vector import layer_names, read_layer


def read_areas(path: Path, crs: CRS) -> list[Any]:
    """Polygons of the first layer of a vector file, in a map.

    Raises
    ------
    InputError
        No CRS, no polygon, a geometry that is no area.
    """
    import shapely

    layer = layer_names(path)[0]
    frame, where = read_layer(path, layer), f"{path}, layer {layer}"
    if frame.crs is None:
        raise InputError("the layer has no CRS", where=where, mend="set it, for example in QGIS")
    move, found = Transform(horizontal(CRS.from_user_input(frame.crs)), horizontal(crs)), []
    for row, geometry in enumerate(frame.geometry, start=1):
        if geometry is None or geometry.is_empty:
            continue
        if geometry.geom_type not in ("Polygon", "MultiPolygon"):
            raise InputError(f"row {row} is a {geometry.geom_type}, not an area", where=where, mend="draw polygons")
        found.append(shapely.make_valid(shapely.transform(geometry, move)))
    if not found:
        raise InputError("the layer has no areas", where=where, mend="draw polygons, or leave the option out")
    return found
