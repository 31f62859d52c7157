"""Measurement to a fraction of a pixel: centre of a mark, or match of a reference."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.block import OrientedImage
from geomosaic.errors import InputError
from geomosaic.sensor.plugin import SensorModel
from geomosaic.sensor.registry import plane_sensor
from geomosaic.studio.control.station import Station


def mark_centre(station: Station, col: float, row: float, half: int) -> dict[str, Any]:
    """JSON values of the centre of the mark near a place of the image.

    Parameters
    ----------
    station : Station
        Image with its table, model and surface.
    col, row : float
        Place near the mark, pixels.
    half : int
        Half of the mark's width, pixels.

    Raises
    ------
    InputError
        The place lies outside the image, or nothing symmetric is there.
    """
    from geomosaic.geo.grid import Window
    from geomosaic.matching.marks import measure_mark
    from geomosaic.raster.source import Source

    half = min(max(half, 5), 64)
    border = 3 * half
    left, top = int(col) - border, int(row) - border
    window = Window(left, top, 2 * border + 1, 2 * border + 1).intersection(Window(0, 0, *station.size))
    if window.empty:
        raise InputError("the place lies outside the image", hint="point at a mark")
    source = Source(str(station.path))
    try:
        grey = np.asarray(source.read(window)[0], dtype=np.float64).mean(axis=2)
    finally:
        source.close()
    found = measure_mark(grey, (col - window.col, row - window.row), half)
    if not found.found:
        raise InputError(
            "nothing symmetric is there: no dot, cross, ring or square", hint="point nearer to it, or place it by hand"
        )
    return {
        "col": window.col + found.col, "row": window.row + found.row,
        "sigma": found.sigma, "correlation": found.correlation,
    }  # fmt: skip


def reference_match(station: Station, model: SensorModel, other: Path, at: tuple[float, float]) -> dict[str, Any]:
    """JSON values of the place in the image of what a reference shows at col and row of its own.

    Parameters
    ----------
    station : Station
        Image with its table, model and surface.
    model : SensorModel
        Approximate model of the image.
    other : Path
        Georeferenced raster.
    at : (float, float)
        Column and row in it.

    Raises
    ------
    InputError
        The image does not show there what the reference shows.
    """
    from geomosaic.reference_matching.drawing import Drawer, georeferenced
    from geomosaic.reference_matching.match import Reference, match_place

    scene, grid = georeferenced(other, "the reference")
    x, y = grid.xy(np.array([at]))[0].tolist()
    image = OrientedImage(station.path.stem, str(station.path), plane_sensor(), model)
    with (
        (opened := Reference.open(scene, grid)).drawer,
        Drawer.open(image, station.surface, grid.crs) as drawer,
    ):
        found = match_place(drawer, opened, (x, y))
    if found is None:
        raise InputError(
            "the image does not show there what the reference shows", hint="place it by hand, or choose another place"
        )
    sigma = float(np.sqrt(np.trace(found.covariance) / 2.0))
    return {"col": found.colrow[0], "row": found.colrow[1], "sigma": sigma, "correlation": found.correlation}
