"""Summary of a block's inputs, in words with units and frames: a mistake is seen before it costs a run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomosaic.errors import GeomosaicError
from geomosaic.geo.crs import has_heights
from geomosaic.inputs.area import plan
from geomosaic.inputs.build import build_block
from geomosaic.inputs.control_diagnostics import control_discrepancies
from geomosaic.inputs.control_points import read_control
from geomosaic.inputs.declarations import Block, file_of
from geomosaic.inputs.exterior_orientation import undeclared_reconstruction
from geomosaic.inputs.frames import crs_name, frame_description
from geomosaic.inputs.missing_inputs import list_missing_inputs
from geomosaic.inputs.photos import Photo, photos_of
from geomosaic.options.inputs import Area
from geomosaic.raster.info import inspect


def summarise_inputs(inputs: Block) -> tuple[list[str], str | None]:
    """Summary of a block's inputs: images, positions, DEM, control points; of a complete block its place and sampling.

    Parameters
    ----------
    inputs : Block

    Returns
    -------
    lines : list of str
    complaint : str or None
        What speaks against the whole, although nothing is missing.
    """
    lines = [*_images(inputs), f"sensor: {inputs.sensor}"]
    known = not undeclared_reconstruction(inputs.exterior, inputs.angles)
    if inputs.exterior is not None and inputs.crs is not None and known:
        photos, crs = photos_of(inputs)
        lines.append(f"positions: {frame_description(crs)}")
        lines += _positions(photos, inputs.angle_unit or "deg")
    if inputs.dem is not None:
        lines.append(_dem(inputs))
    if inputs.height is not None:
        lines.append(f"ground: one height, {inputs.height:g} m")
    control = file_of(inputs.control)
    if control is not None:
        points = read_control(control, [path.name for path in inputs.images])
        names = {role: {point.id for point in points if point.role == role} for role in ("control", "check")}
        lines.append(
            f"control: {len(names['control'])} control and {len(names['check'])} check points, "
            f"{len(points)} measurements"
        )
    if list_missing_inputs(inputs):
        return lines, None
    try:
        together, far = _block(inputs)
        return [*lines, together], far
    except GeomosaicError as error:
        return lines, str(error)


def _images(inputs: Block) -> list[str]:
    infos = [inspect(path, inputs.bands) for path in inputs.images]
    sizes = sorted({info.size for info in infos})
    shown = ", ".join(f"{width} x {height}" for width, height in sizes[:3]) + (" ..." if len(sizes) > 3 else "")
    kinds = sorted({f"{info.bands} x {info.dtype}" for info in infos})
    placed = sum(info.crs is not None and info.transform is not None for info in infos)
    return [
        f"images: {len(infos)}, {shown} pixels, {', '.join(kinds)}"
        + (f", {placed} with a georeference" if placed else ", none georeferenced")
    ]


def _positions(photos: Sequence[Photo], unit: str) -> list[str]:
    rows = [photo.exterior for photo in photos if photo.exterior is not None]
    if not rows:
        return []
    low, high = (f(np.array([row.position for row in rows]), axis=0) for f in (np.min, np.max))
    lines = ["  " + ", ".join(f"{axis} {a:.10g} to {b:.10g}" for axis, a, b in zip("xyz", low, high, strict=True))]
    names = list(rows[0].angles)
    if len(names) <= 3:
        table = np.array([list(row.angles.values()) for row in rows])
        spans = zip(names, table.min(axis=0), table.max(axis=0), strict=True)
        lines.append(f"  angles in {unit}: " + ", ".join(f"{name} {a:g} to {b:g}" for name, a, b in spans))
    return lines


def _dem(inputs: Block) -> str:
    path = file_of(inputs.dem)
    if path is None:
        return ""
    info = inspect(path)
    if info.crs is None or info.transform is None:
        return f"DEM: {info.width} x {info.height} nodes, not georeferenced"
    if inputs.dem_heights is None and not has_heights(info.crs):
        return f"DEM: {info.width} x {info.height} nodes, {frame_description(info.crs)}"
    from geomosaic.surface.dem import Dem

    dem = Dem.open(path, heights=inputs.dem_heights)
    try:
        low, high = dem.range
        unit = dem.crs.axis_info[0].unit_name
        return (
            f"DEM: {info.width} x {info.height} nodes every {dem.spacing:g} {unit}, {low:.1f} to {high:.1f} m; "
            f"{frame_description(dem.crs)}"
        )
    finally:
        dem.close()


def _block(inputs: Block) -> tuple[str, str | None]:
    """Place and sampling of the whole; what its control says against it."""
    block = build_block(inputs)
    grid, outlines = plan(block.scenes, block.surface, Area())
    left, bottom, right, top = grid.bounds
    unit = grid.crs.axis_info[0].unit_name
    sampling = np.median([outline.sampling for outline in outlines])
    far = [points.text for points in control_discrepancies(inputs, block)]
    return (
        f"together: {right - left:.6g} x {top - bottom:.6g} {unit} in {crs_name(grid.crs)}, "
        f"ground sampling {sampling:.3g} {unit}"
    ), (far[0] if far else None)
