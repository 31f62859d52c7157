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
    "adjust": "geomosaic.block_adjustment.run",
    "check": "geomosaic.accuracy.product_check",
    "contours": "geomosaic.relief.contours",
    "coregister": "geomosaic.products.coregistration",
    "deskew": "geomosaic.products.orthos",
    "develop": "geomosaic.developed.develop",
    "draw_vectors": "geomosaic.monoplotting.run",
    "dtm": "geomosaic.relief.dtm",
    "enhance": "geomosaic.enhancement.raster",
    "find_fiducials": "geomosaic.fiducials",
    "find_sheet": "geomosaic.sheets.series.inputs",
    "fit_rpc": "geomosaic.rpc.write",
    "georeference": "geomosaic.georeferencing.run",
    "georeference_vectors": "geomosaic.georeferencing.drawing",
    "layover_mask": "geomosaic.products.layover",
    "locate": "geomosaic.monoplotting.run",
    "match": "geomosaic.tie_points.run",
    "match_edges": "geomosaic.products.edges",
    "match_simulation": "geomosaic.products.simulation",
    "match_vector_edges": "geomosaic.products.vector_edges",
    "mosaic": "geomosaic.products.mosaics",
    "new_project": "geomosaic.project.drafts",
    "next_points": "geomosaic.georeferencing.live_control",
    "ortho": "geomosaic.products.orthos",
    "pan_sharpen": "geomosaic.enhancement.raster",
    "plan": "geomosaic.planning.solve",
    "propose_water": "geomosaic.mosaicking.water_proposal",
    "read_control": "geomosaic.control.read",
    "read_reconstruction": "geomosaic.interchange.formats",
    "refine_rpc": "geomosaic.rpc.write",
    "reproject": "geomosaic.products.orthos",
    "run_project": "geomosaic.jobs.project",
    "sensors": "geomosaic.sensor.registry",
    "sheet": "geomosaic.sheets.inputs",
    "sheet_scheme": "geomosaic.sheets.series.inputs",
    "sheet_series": "geomosaic.sheets.series.inputs",
    "simulate_scene": "geomosaic.products.simulation",
    "write_reconstruction": "geomosaic.interchange.formats",
    # inputs
    "Block": "geomosaic.inputs.declarations",
    "Camera": "geomosaic.inputs.declarations",
    "ControlPoints": "geomosaic.control.points",
    "Dem": "geomosaic.surface.dem",
    "Exterior": "geomosaic.inputs.exterior_orientation",
    "Grid": "geomosaic.geo.grid",
    "Reconstruction": "geomosaic.interchange.reconstruction",
    "Scene": "geomosaic.inputs.declarations",
    "TiePoints": "geomosaic.inputs.tie_points",
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
