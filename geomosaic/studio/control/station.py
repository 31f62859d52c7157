"""Images whose control is measured, each with the table, the model and the ground that its project gives it."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pyproj import CRS

from geomosaic.errors import GeomosaicError, InputError
from geomosaic.geo.crs import parse_map
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.planar_block import plane_model
from geomosaic.inputs.vertical_datums import positions_crs
from geomosaic.options.control import MODELS
from geomosaic.raster.info import inspect
from geomosaic.sensor.plugin import SensorModel
from geomosaic.sensor.registry import capabilities
from geomosaic.studio.workspace import Workspace, file_stamp
from geomosaic.surface.model import Surface


@dataclass(frozen=True, eq=False)
class Station:
    """Image whose control is measured, with what its project says of it.

    Attributes
    ----------
    path : Path
    size : tuple of int
        Width and height, pixels.
    table : Path
        Its control points.
    crs : CRS or None
        CRS of the table as declared; None where a comment in it names one, or nothing does.
    model : str or SensorModel
        Plane transformation by name, or the model that the image comes with.
    surface : Surface or None
    """

    path: Path
    size: tuple[int, int]
    table: Path
    crs: CRS | None
    model: str | SensorModel
    surface: Surface | None


class Stations:
    """Stations of a workspace, read anew when a file they are made of changes."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._lock = threading.Lock()
        self._known: dict[tuple[Any, ...], Station] = {}

    def find(self, layer: str, model: str | None = None) -> Station:
        """Station of an image.

        Parameters
        ----------
        layer : str
            Image by its id.
        model : str, optional
            Plane transformation in place of the project's.

        Raises
        ------
        InputError
            No such image or model, or the project names no control table.
        """
        if model is not None and model not in MODELS:
            raise InputError(f"there is no model '{model}'", hint=f"choose one of {', '.join(MODELS)}")
        project = self._workspace.project()
        path = self._workspace.raster(layer)
        part = None if project is None else next((one for one in project.blocks if path in one.images), None)
        if path is None or part is None:
            raise InputError("there is no such image in the project", hint="load the page again")
        if not isinstance(part.control, Path):
            raise InputError(
                "the project names no table of control points",
                where="[control] file",
                hint="add file = 'gcps.csv' under [control]; the table is made with the first point",
            )
        read = (file for file in (self._workspace.path, *part.tables) if file != part.control)
        key = (path, *((file, file_stamp(file)) for file in read))
        with self._lock:
            if key not in self._known:
                self._known = {other: one for other, one in self._known.items() if other[0] != path}
                self._known[key] = _station(path, part, part.control)
            station = self._known[key]
        return station if model is None or not isinstance(station.model, str) else replace(station, model=model)


def _station(path: Path, part: Block, table: Path) -> Station:
    """Image with its model before any of its points is used."""
    info = inspect(path)
    declared = None if part.crs is None else positions_crs(part.crs, part.heights)
    if capabilities(part.sensor).planar:
        kind = str(part.options.get("kind", "affine")) if part.planar is None else plane_model(part.planar)
        order = int(part.options.get("order", 1))
        name = f"poly{order}" if kind == "polynomial" else kind
        flat = None if part.crs is None else parse_map(part.crs, "`crs`")
        return Station(path, info.size, table, flat, name, None)
    alone = replace(part, images=(path,), control=None)
    try:
        block = build_block(alone)
    except GeomosaicError:
        # A sensor that its control alone places.
        block = build_block(replace(alone, control=table))
    return Station(path, info.size, table, block.crs or declared, block.scenes[0].model, block.surface)
