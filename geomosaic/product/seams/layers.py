"""Vector layers that seams heed: lines to follow, areas to keep out of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.transform import Transform
from geomosaic.raster.vector import layer_names, read_layer

AREAS = ("Polygon", "MultiPolygon")
LINES = ("LineString", "MultiLineString")


@dataclass(frozen=True)
class SeamLayers:
    """Geometries in the output map.

    Attributes
    ----------
    follow : sequence of geometry
        Roads and rivers, as lines or areas.
    avoid : sequence of Polygon or MultiPolygon
        Buildings, and whatever else is not to be cut.
    """

    follow: Sequence[Any] = ()
    avoid: Sequence[Any] = ()


def read_seam_layers(follow: Sequence[Path], avoid: Sequence[Path], crs: CRS) -> SeamLayers:
    """Read all layers of all files.

    Raises
    ------
    InputError
        A layer without CRS, points, lines to keep out of, an area that crosses itself.
    """
    return SeamLayers(_read(follow, crs, (*LINES, *AREAS)), _read(avoid, crs, AREAS))


def _read(paths: Sequence[Path], crs: CRS, kinds: tuple[str, ...]) -> list[Any]:
    import shapely

    found: list[Any] = []
    for path in paths:
        for layer in layer_names(path):
            frame, where = read_layer(path, layer), f"{path}, layer {layer}"
            if frame.crs is None:
                raise InputError("the layer has no CRS", where=where, mend="set it, for example in QGIS")
            move = Transform(horizontal(CRS.from_user_input(frame.crs)), crs)
            for row, geometry in enumerate(frame.geometry, start=1):
                if geometry is None or geometry.is_empty:
                    continue
                if geometry.geom_type not in kinds:
                    raise InputError(
                        f"row {row} is a {geometry.geom_type}, not {'an area' if kinds == AREAS else 'a line or area'}",
                        where=where,
                        mend="draw polygons" if kinds == AREAS else "draw lines or polygons",
                    )
                check_area(geometry, f"row {row}", where)
                moved = shapely.transform(shapely.force_2d(geometry), move)
                if np.isfinite(shapely.get_coordinates(moved)).all():  # what has no place in the map is not near it
                    found.append(moved)
    return found


def check_area(geometry: Any, which: str, where: str) -> None:
    """Refuse an area that crosses itself: nobody knows which side of it is meant."""
    import shapely

    if geometry.geom_type in AREAS and not geometry.is_valid:
        raise InputError(
            f"{which} is no valid area: {shapely.is_valid_reason(geometry)}",
            where=where,
            mend="mend it, for example with 'Fix geometries' of QGIS",
        )
