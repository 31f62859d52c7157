"""Summary of a block's inputs, in words with units and frames; missing inputs, and control discrepancies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.block import OrientedBlock
from geomosaic.errors import GeomosaicError, SensorError, counted
from geomosaic.geo.crs import crs_name, has_heights, is_local, parse_crs, with_local_heights
from geomosaic.inputs.area import plan
from geomosaic.inputs.build import build_block, is_adjusted, unadjusted
from geomosaic.inputs.control_diagnostics import likeliest_cause
from geomosaic.inputs.control_points import read_block, read_control
from geomosaic.inputs.declarations import Block, file_of
from geomosaic.inputs.exterior_orientation import (
    RECONSTRUCTION_SYSTEM,
    RECONSTRUCTIONS,
    SELF_PLACED,
    ign_reference_names,
    undeclared_reconstruction,
)
from geomosaic.inputs.images import Photo, photos_of
from geomosaic.inputs.orientation_plausibility import FAR, median_distance
from geomosaic.inputs.vertical_datums import frame_description, positions_crs
from geomosaic.options.inputs import Area
from geomosaic.raster.info import inspect
from geomosaic.sensor.plausibility import DATUMS
from geomosaic.sensor.plugin import Capabilities, ControlUse
from geomosaic.sensor.registry import capabilities


def list_missing_inputs(inputs: Block, tied: bool = False) -> list[str]:
    """Missing inputs of a block, each with the key of a project file that takes it.

    Parameters
    ----------
    inputs : Block
        May be incomplete, as of a drafted project.
    tied : bool
        Whether tie points are to orient the images and to give the ground.

    Returns
    -------
    list of str
        One line for each; empty where the block can be built.
    """
    found: list[str] = []
    power = known_capabilities(inputs.sensor)
    if inputs.planar is not None:
        if not inputs.planar.is_local(controlled=inputs.control is not None):
            if inputs.control is None:
                found.append("control points: [control] file, a table with id, x, y, image, col, row")
            if inputs.crs is None:
                found.append("the CRS of the control points: [exterior] crs, such as EPSG:32633")
        if inputs.planar.ties is None and inputs.planar.kind != "controlled":
            found.append("tie points: [planar] ties, a table with id, image, col, row")
        return found
    if power.planar:
        for path in inputs.images:
            if inspect(path).transform is None and inputs.control is None and not inputs.options:
                found.append(
                    f"{path.name} is not georeferenced: control points, [control] file, or another [sensor] name"
                )
                break
        return found
    undeclared = undeclared_reconstruction(inputs.exterior, inputs.angles)
    reconstruction = undeclared or inputs.angles in RECONSTRUCTIONS
    # OpenSfM's reconstructions and scenes with their own model carry their coordinate reference.
    framed = undeclared or inputs.angles in SELF_PLACED or not takes_positions(inputs, power)
    if undeclared:
        found.append(f"the angle system of the reconstruction: [exterior] angles: {RECONSTRUCTION_SYSTEM}")
    if inputs.angles == "colmap" and "world" not in inputs.options:
        found.append(
            "the coordinate system of COLMAP's world: [sensor] world = 'map' (then also [exterior] crs and heights), "
            "'geocentric' (then [exterior] crs), or 'local' with reference = [longitude, latitude, altitude]"
        )
    if inputs.angles == "colmap" and inputs.options.get("world") in ("map", "geocentric"):
        framed = False
    exterior = file_of(inputs.exterior)
    of_text = inputs.angles == "metashape" and exterior is not None and exterior.suffix.lower() != ".xml"
    if of_text:
        framed, reconstruction = False, False
    own_cameras = all("camera" in inputs.image_options.get(path.name, {}) for path in inputs.images)
    if power.needs_camera and inputs.camera is None and not reconstruction and not own_cameras:
        found.append(f"the camera: [sensor] camera, a TOML file (see `geomosaic sensors {inputs.sensor}`)")
    if power.needs_exterior and inputs.exterior is None and inputs.control is None and not tied:
        found.append(
            "positions and angles of the photos: [exterior] file, a table with image, x, y, z, omega, phi, kappa"
        )
    of_map, of_heights = ign_reference_names(exterior if inputs.angles == "ori" else None)
    if inputs.crs is None and not framed:
        found.append(f"the CRS of the positions: [exterior] crs, such as EPSG:32633{of_map}")
    nowhere = inputs.crs is not None and is_local(parse_crs(inputs.crs, "`crs`"))
    declared = inputs.heights is not None or framed or nowhere
    if not declared and not (inputs.crs and has_heights(positions_crs(inputs.crs, None))):
        found.append(f"the vertical datum of the positions: [exterior] heights: {DATUMS}{of_heights}")
    if inputs.dem is None and inputs.height is None and not (tied or inputs.dem_from_tie_points):
        found.append("the ground: [dem] file, [dem] height in metres, or [dem] from_tie_points of an adjusted block")
    own = framed and (power.carries_placement or (inputs.exterior is not None and inputs.angles in SELF_PLACED))
    if own and inputs.height is not None and not (inputs.dem_heights or inputs.heights or inputs.crs):
        found.append(f"the vertical datum of the ground's height: [dem] heights: {DATUMS}")
    if inputs.dem_heights is None and undeclared_heights(file_of(inputs.dem)):
        found.append(f"the vertical datum of the DEM: [dem] heights: {DATUMS}")
    return found


def undeclared_heights(dem: Path | None) -> bool:
    """Whether a DEM's file names no vertical datum.

    Parameters
    ----------
    dem : Path or None

    Returns
    -------
    bool
        False without a DEM.
    """
    crs = None if dem is None else inspect(dem).crs
    return dem is not None and (crs is None or not has_heights(with_local_heights(crs)))


def takes_positions(inputs: Block, power: Capabilities) -> bool:
    """Whether positions or control points are used, whose CRS must be known.

    Parameters
    ----------
    inputs : Block
    power : Capabilities
        Of its sensor.
    """
    given = [{*inputs.options, *inputs.image_options.get(path.name, {})} for path in inputs.images]
    placed = bool(given) and not any(names.isdisjoint(power.placements) for names in given)
    return inputs.exterior is not None or inputs.control is not None or ("position" in power.exterior and not placed)


def known_capabilities(sensor: str) -> Capabilities:
    """Capabilities of a sensor; of one that is not installed, those of a sensor with positions.

    Parameters
    ----------
    sensor : str
    """
    try:
        return capabilities(sensor)
    except SensorError:
        return Capabilities(exterior=("position",))


def summarise_inputs(inputs: Block, tied: bool = False) -> tuple[list[str], str | None]:
    """Summary of a block's inputs: images, positions, DEM, control points; of a complete block its place and sampling.

    Parameters
    ----------
    inputs : Block
    tied : bool
        Whether tie points are to orient the images: where they lie is told if positions, angles and ground are given.

    Returns
    -------
    lines : list of str
    problem : str or None
        Problem of the whole block, although nothing is missing.
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
        if inputs.planar is not None:  # points on flat ground need no height
            points = read_block(photos_of(inputs)[0], None, control)[1]
        else:
            images, plane = [path.name for path in inputs.images], known_capabilities(inputs.sensor).planar
            points = read_control(control, images, plane=plane)
        names = {role: {point.id for point in points if point.role == role} for role in ("control", "check")}
        lines.append(
            f"control: {len(names['control'])} control and {len(names['check'])} check points, "
            f"{counted(len(points), 'measurement')}"
        )
    if list_missing_inputs(inputs) or (tied and not _whole(inputs)):
        return lines, None
    try:
        together, far = _block(inputs)
        return [*lines, together], far
    except GeomosaicError as error:
        return lines, str(error)


def _whole(inputs: Block) -> bool:
    """Whether position and angles of all images are known, and the ground."""
    rows = [photo.exterior for photo in photos_of(inputs)[0]]
    return (inputs.dem is not None or inputs.height is not None) and all(
        row is not None and row.placed and row.turned for row in rows
    )


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
    rows = [photo.exterior for photo in photos if photo.exterior is not None and photo.exterior.placed]
    if not rows:
        return []
    low, high = (f(np.array([row.position for row in rows]), axis=0) for f in (np.min, np.max))
    lines = ["  " + ", ".join(f"{axis} {a:.10g} to {b:.10g}" for axis, a, b in zip("xyz", low, high, strict=True))]
    names, rows = list(rows[0].angles), [row for row in rows if row.turned]
    if rows and len(names) <= 3:
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
    if undeclared_heights(path) and inputs.dem_heights is None:
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
    """Extent and ground sampling of the block; its control discrepancy, if any."""
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


@dataclass(frozen=True)
class ControlDiscrepancy:
    """Discrepancy between the points of one role and the images.

    Attributes
    ----------
    role : str
        'control' or 'check'.
    median : float
        Median distance, pixels; inf where an image cannot see them at all.
    cause : str
        Likeliest slip; empty where none explains it.
    hint : str
    """

    role: str
    median: float
    cause: str
    hint: str

    @property
    def text(self) -> str:
        """One sentence, and a hint."""
        off = f"{self.median:.3g} px" if self.median < 1e6 else "out of sight"
        why = f"; {self.cause}" if self.cause else ""
        return f"{self.role} points lie {off} (median) from where the images put them{why}: {self.hint}"

    @property
    def facts(self) -> dict[str, Any]:
        """JSON values, with the text and the limit."""
        return {**asdict(self), "text": self.text, "limit": FAR}


def control_discrepancies(inputs: Block, block: OrientedBlock) -> list[ControlDiscrepancy]:
    """Discrepancies of control and check points whose median distance exceeds `FAR` pixels.

    Parameters
    ----------
    inputs : Block
    block : OrientedBlock
        Block built of them, adjusted on the control as far as its sensor does that.
    """
    if block.crs is None or inputs.planar is not None or capabilities(inputs.sensor).planar:
        return []
    found = []
    for role in ("control", "check"):
        points = [point for point in block.control if point.role == role]
        off = median_distance(block.scenes, points, block.crs) if points else 0.0
        if off > FAR:
            scenes = unadjusted(inputs) or block.scenes
            cause, hint = likeliest_cause(scenes, points, block.crs, median_distance(scenes, points, block.crs))
            found.append(ControlDiscrepancy(role, off, cause, hint or _how_to_adjust(inputs, role)))
    return found


def _how_to_adjust(inputs: Block, role: str) -> str:
    """Hint where no usual slip explains a discrepancy."""
    use = capabilities(inputs.sensor).control
    resected = use is ControlUse.RESECTION and is_adjusted(inputs)
    only = ""
    if role == "control" and use is ControlUse.ADJUSTMENT and inputs.options.get("refine") == "none":
        only = "they serve for assessment only, as refine is 'none': "
    elif role == "control" and use is not ControlUse.ADJUSTMENT and not resected:
        placed = use is ControlUse.RESECTION
        more = ", but photos without `exterior` are placed by three of them" if placed else ""
        only = f"they serve for assessment only, as sensor '{inputs.sensor}' is not adjusted on them{more}: "
    return (
        f"{only}check their CRS, the order of x and y, the vertical datum of z, and how col and row are counted; "
        "an orientation that is poor itself has to be adjusted; what you accept is "
        f"max_{role}_rms_px under [quality] of a project"
    )
