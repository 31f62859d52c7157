"""Vector layers that seams heed: lines to follow, areas to keep out of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geomosaic.geo.grid import Grid
from geomosaic.product.areas import AREAS, LINES, note_elsewhere, read_shapes
from geomosaic.raster.vector import layer_names


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


def read_seam_layers(follow: Sequence[Path], avoid: Sequence[Path], grid: Grid) -> SeamLayers:
    """Read all layers of all files, in the map of a grid.

    Raises
    ------
    InputError
        A layer without CRS, points, lines to keep out of, an area that crosses itself.
    """
    return SeamLayers(_read(follow, grid, (*LINES, *AREAS)), _read(avoid, grid, AREAS))


def _read(paths: Sequence[Path], grid: Grid, kinds: tuple[str, ...]) -> list[Any]:
    found: list[Any] = []
    for path in paths:
        own = [shape for layer in layer_names(path) for shape in read_shapes(path, layer, grid.crs, kinds)]
        note_elsewhere(path, own, grid)
        found += own
    return found
