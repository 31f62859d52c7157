"""Drafts of projects whose photos are to be found in a georeferenced reference, such as an old ortho."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.projection_domain import longitude_latitude
from geomosaic.inputs.declarations import Block, file_of
from geomosaic.inputs.summary import undeclared_heights
from geomosaic.project.photo_block import EmbeddedInputs
from geomosaic.raster.info import inspect
from geomosaic.render.extent import utm_zone

# Metres of relief about one height that is assumed for want of a DEM: tie points find it then.
RELIEF = 30.0


def on_map_of(block: Block, reference: Path) -> Block:
    """Block in the CRS of a reference, in the UTM zone of its middle where that is in degrees, unless it has its own.

    Parameters
    ----------
    block : Block
    reference : Path

    Raises
    ------
    InputError
        The reference cannot be read, or is not georeferenced.
    """
    info = inspect(reference)
    if info.crs is None or info.transform is None:
        raise InputError(
            "the reference is not georeferenced",
            where=str(reference),
            hint="give an ortho, a mosaic or a map with a CRS",
        )
    if block.crs is not None:
        return block
    crs = horizontal(info.crs)
    if not crs.is_projected:
        import numpy as np

        middle = info.transform @ (info.size[0] / 2.0, info.size[1] / 2.0)
        crs = utm_zone(*longitude_latitude(np.array([middle]), crs)[0].tolist())
    code = crs.to_epsg(min_confidence=70)
    return replace(block, crs=f"EPSG:{code}" if code else crs.to_wkt())


def found_in(carried: EmbeddedInputs, reference: Path) -> EmbeddedInputs:
    """Draft of photos whose control points are to be found in a reference.

    Parameters
    ----------
    carried : EmbeddedInputs
    reference : Path

    Raises
    ------
    InputError
        The images are no photos that tie points orient together, or have control points.
    """
    inputs, notes, said = carried.inputs, list(carried.notes), dict(carried.said)
    if carried.adjust is None or inputs.control is not None:
        raise InputError(
            "a reference gives control points to photos that have none, two or more",
            where="`reference`",
            hint="one scan alone is placed by `geomosaic georeference SCAN --reference ORTHO -o MAP`; a reference for "
            "scenes stands in [match] beside an empty section [adjust]",
        )
    lines = [*carried.lines, f"control points are looked for in {reference.name}, wherever in it the photos lie"]
    if inputs.dem is None and inputs.height is None:
        flat = "ASSUMED: control points at one height, since no DEM is given; tie points give the ground of the mosaic"
        inputs, notes = replace(inputs, height=0.0, dem_from_tie_points=True), [*notes, flat]
        carried = replace(carried, height_sigma=RELIEF)
        lines.append(f"  {flat}")
    if inputs.dem_heights is None and (inputs.dem is None or undeclared_heights(file_of(inputs.dem))):
        inputs = replace(inputs, dem_heights=inputs.heights or "ellipsoidal")
    if inputs.heights is None:
        # Nothing but the ground has heights: what they count from moves nothing.
        inputs = replace(inputs, heights=inputs.dem_heights or "ellipsoidal")
        said["heights"] = "of the ground; what it counts from moves nothing in plan"
    return replace(carried, inputs=inputs, reference=reference, lines=lines, notes=notes, said=said)
