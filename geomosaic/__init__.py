"""geomosaic: from raw photos and scenes to georeferenced, colour-balanced mosaics and map sheets.

One function per thing that is made or measured, their inputs as values, and the options. The names load their modules
on first use, so that `import geomosaic` costs next to nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from geomosaic.accuracy.check_points import check as check
    from geomosaic.api.control import find_fiducials as find_fiducials
    from geomosaic.api.control import georeference as georeference
    from geomosaic.api.monoplots import draw_vectors as draw_vectors
    from geomosaic.api.monoplots import locate as locate
    from geomosaic.api.mosaics import develop as develop
    from geomosaic.api.mosaics import match_edges as match_edges
    from geomosaic.api.mosaics import mosaic as mosaic
    from geomosaic.api.orthos import deskew as deskew
    from geomosaic.api.orthos import ortho as ortho
    from geomosaic.api.orthos import reproject as reproject
    from geomosaic.api.projects import new_project as new_project
    from geomosaic.api.projects import plan as plan
    from geomosaic.api.projects import run_project as run_project
    from geomosaic.api.projects import sensors as sensors
    from geomosaic.api.rpcs import fit_rpc as fit_rpc
    from geomosaic.api.rpcs import refine_rpc as refine_rpc
    from geomosaic.control.points import ControlPoints as ControlPoints
    from geomosaic.enhancement.raster import enhance as enhance
    from geomosaic.enhancement.raster import pan_sharpen as pan_sharpen
    from geomosaic.errors import GeomosaicError as GeomosaicError
    from geomosaic.geo.grid import Grid as Grid
    from geomosaic.geo.grid import Window as Window
    from geomosaic.inputs.camera import Camera as Camera
    from geomosaic.inputs.declarations import Block as Block
    from geomosaic.inputs.declarations import Scene as Scene
    from geomosaic.inputs.exterior_orientation import Exterior as Exterior
    from geomosaic.mosaicking.water.proposal import propose_water as propose_water
    from geomosaic.relief.contour_layers import contours as contours
    from geomosaic.render.options import RenderOptions as RenderOptions
    from geomosaic.sheets.inputs import sheet as sheet
    from geomosaic.sheets.series.inputs import sheet_series as sheet_series
    from geomosaic.surface.dem import Dem as Dem

__version__ = "0.1.0"

_HOMES = {
    # made or measured
    "check": "geomosaic.accuracy.check_points",
    "contours": "geomosaic.relief.contour_layers",
    "deskew": "geomosaic.api.orthos",
    "develop": "geomosaic.api.mosaics",
    "draw_vectors": "geomosaic.api.monoplots",
    "enhance": "geomosaic.enhancement.raster",
    "find_fiducials": "geomosaic.api.control",
    "fit_rpc": "geomosaic.api.rpcs",
    "georeference": "geomosaic.api.control",
    "locate": "geomosaic.api.monoplots",
    "match_edges": "geomosaic.api.mosaics",
    "mosaic": "geomosaic.api.mosaics",
    "new_project": "geomosaic.api.projects",
    "ortho": "geomosaic.api.orthos",
    "pan_sharpen": "geomosaic.enhancement.raster",
    "plan": "geomosaic.api.projects",
    "propose_water": "geomosaic.mosaicking.water.proposal",
    "refine_rpc": "geomosaic.api.rpcs",
    "reproject": "geomosaic.api.orthos",
    "run_project": "geomosaic.api.projects",
    "sensors": "geomosaic.api.projects",
    "sheet": "geomosaic.sheets.inputs",
    "sheet_series": "geomosaic.sheets.series.inputs",
    # inputs
    "Block": "geomosaic.inputs.declarations",
    "Camera": "geomosaic.inputs.camera",
    "ControlPoints": "geomosaic.control.points",
    "Dem": "geomosaic.surface.dem",
    "Exterior": "geomosaic.inputs.exterior_orientation",
    "Grid": "geomosaic.geo.grid",
    "Scene": "geomosaic.inputs.declarations",
    "Window": "geomosaic.geo.grid",
    # options and errors
    "RenderOptions": "geomosaic.render.options",
    "GeomosaicError": "geomosaic.errors",
}

__all__ = ["__version__", *sorted(_HOMES)]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'geomosaic' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
