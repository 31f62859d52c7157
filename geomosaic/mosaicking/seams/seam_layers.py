"""Lines and areas that seams follow or avoid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.geo.grid import Bounds, Grid
from geomosaic.raster.vector import layer_names
from geomosaic.render.areas import AREAS, LINES, note_elsewhere, read_shapes


@dataclass(frozen=True, eq=False)
class SeamLayers:
    """Lines and areas that seams follow or avoid, in the output map.

    Attributes
    ----------
    follow : sequence of geometry
        Roads and rivers, as lines or areas.
    avoid : sequence of Polygon or MultiPolygon
        Buildings, and whatever else is not to be cut.
    """

    follow: Sequence[Any] = ()
    avoid: Sequence[Any] = ()

    def near(self, bounds: Bounds, distance: float) -> SeamLayers:
        """Lines and areas within a distance of bounds.

        Parameters
        ----------
        bounds : Bounds
            Left, bottom, right, top in the output map.
        distance : float
            Map units.
        """
        import shapely

        box = shapely.box(*bounds).buffer(distance, join_style="mitre")
        return SeamLayers(
            *(
                [shapes[k] for k in np.sort(tree.query(box)).tolist()]
                for shapes, tree in zip((self.follow, self.avoid), self._trees, strict=True)
            )
        )

    @cached_property
    def _trees(self) -> tuple[Any, Any]:
        import shapely

        return shapely.STRtree(list(self.follow)), shapely.STRtree(list(self.avoid))


def read_seam_layers(follow: Sequence[Path], avoid: Sequence[Path], grid: Grid) -> SeamLayers:
    """Lines and areas that seams follow or avoid, from all layers of vector files.

    Parameters
    ----------
    follow, avoid : sequence of Path
        Files of lines or areas to follow, and of areas to avoid.
    grid : Grid
        Of the output, to whose map they are transformed.

    Returns
    -------
    SeamLayers

    Raises
    ------
    InputError
        A layer without CRS, points, lines among the areas to avoid, an area that crosses itself.
    """
    return SeamLayers(_read(follow, grid, (*LINES, *AREAS)), _read(avoid, grid, AREAS))


def _read(paths: Sequence[Path], grid: Grid, kinds: tuple[str, ...]) -> list[Any]:
    found: list[Any] = []
    for path in paths:
        shapes = [shape for layer in layer_names(path) for shape in read_shapes(path, layer, grid.crs, kinds)]
        note_elsewhere(path, shapes, grid)
        found += shapes
    return found
