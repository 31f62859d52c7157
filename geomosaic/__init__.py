"""geomosaic: from raw photos and scenes to georeferenced, colour-balanced mosaics and map sheets.

One function per thing that is made or measured, their inputs as values, and the options. The names load their modules
on first use, so that `import geomosaic` costs next to nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    # made or measured
    "check": "geomosaic.api.control",
    "contours": "geomosaic.relief.contours",
    "deskew": "geomosaic.api.orthos",
    "develop": "geomosaic.api.mosaics",
    "draw_vectors": "geomosaic.api.monoplots",
    "enhance": "geomosaic.enhancement.raster",
    "find_fiducials": "geomosaic.api.control",
    "find_sheet": "geomosaic.sheets.series.inputs",
    "fit_rpc": "geomosaic.api.rpcs",
    "georeference": "geomosaic.api.control",
    "locate": "geomosaic.api.monoplots",
    "match_edges": "geomosaic.api.mosaics",
    "mosaic": "geomosaic.api.mosaics",
    "new_project": "geomosaic.api.projects",
    "ortho": "geomosaic.api.orthos",
    "pan_sharpen": "geomosaic.enhancement.raster",
    "plan": "geomosaic.planning.solve",
    "propose_water": "geomosaic.mosaicking.water_proposal",
    "read_control": "geomosaic.api.control",
    "refine_rpc": "geomosaic.api.rpcs",
    "reproject": "geomosaic.api.orthos",
    "run_project": "geomosaic.api.projects",
    "sensors": "geomosaic.api.projects",
    "sheet": "geomosaic.sheets.inputs",
    "sheet_scheme": "geomosaic.sheets.series.inputs",
    "sheet_series": "geomosaic.sheets.series.inputs",
    # inputs
    "Block": "geomosaic.inputs.declarations",
    "Camera": "geomosaic.inputs.declarations",
    "ControlPoints": "geomosaic.control.points",
    "Dem": "geomosaic.surface.dem",
    "Exterior": "geomosaic.inputs.exterior_orientation",
    "Grid": "geomosaic.geo.grid",
    "Scene": "geomosaic.inputs.declarations",
    "Window": "geomosaic.geo.grid",
    # options and errors
    "BlendOptions": "geomosaic.options.mosaic",
    "ColourOptions": "geomosaic.options.mosaic",
    "MosaicOptions": "geomosaic.options.mosaic",
    "RenderOptions": "geomosaic.options.render",
    "SeamOptions": "geomosaic.options.mosaic",
    "GeomosaicError": "geomosaic.errors",
}

__all__ = ["__version__", *sorted(_HOMES)]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'geomosaic' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
