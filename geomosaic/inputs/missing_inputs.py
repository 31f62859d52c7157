"""Missing inputs of a block, and programs recognised by their orientation files."""

from __future__ import annotations

from pathlib import Path

from geomosaic.errors import SensorError
from geomosaic.geo.crs import has_heights
from geomosaic.inputs.declarations import Block, file_of
from geomosaic.inputs.exterior_orientation import (
    RECONSTRUCTION_SYSTEM,
    RECONSTRUCTIONS,
    SELF_PLACED,
    frame_words,
    undeclared_reconstruction,
)
from geomosaic.inputs.frames import positions_crs
from geomosaic.raster.info import inspect
from geomosaic.sensor.plugin import Capabilities
from geomosaic.sensor.registry import capabilities

HEIGHTS = "ellipsoidal, egm96, an EPSG code of a vertical CRS, or the path of a geoid grid"


def list_missing_inputs(inputs: Block) -> list[str]:
    """Missing inputs of a block, each with the key of a project file that takes it.

    Parameters
    ----------
    inputs : Block
        May be incomplete, as of a drafted project.

    Returns
    -------
    list of str
        One line for each; empty where the block can be built.
    """
    found: list[str] = []
    power = known_capabilities(inputs.sensor)
    if inputs.planar is not None:
        if inputs.planar.kind != "uncontrolled":
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
    # What says itself what it counts from: OpenSfM's reconstructions, and scenes that carry their own model.
    framed = undeclared or inputs.angles in SELF_PLACED or not _takes_positions(inputs, power)
    if undeclared:
        found.append(f"the angle system of the reconstruction: [exterior] angles: {RECONSTRUCTION_SYSTEM}")
    if inputs.angles == "colmap" and "world" not in inputs.options:
        found.append(
            "what COLMAP's world is: [sensor] world = 'map' (then also [exterior] crs and heights), 'geocentric' "
            "(then [exterior] crs), or 'local' with reference = [longitude, latitude, altitude]"
        )
    if inputs.angles == "colmap" and inputs.options.get("world") in ("map", "geocentric"):
        framed = False
    exterior = file_of(inputs.exterior)
    of_text = inputs.angles == "metashape" and exterior is not None and exterior.suffix.lower() != ".xml"
    if of_text:
        framed, reconstruction = False, False
    if power.needs_camera and inputs.camera is None and not reconstruction:
        found.append(f"the camera: [sensor] camera, a TOML file (see `geomosaic sensors {inputs.sensor}`)")
    if power.needs_exterior and inputs.exterior is None and inputs.control is None:
        found.append(
            "positions and angles of the photos: [exterior] file, a table with image, x, y, z, omega, phi, kappa"
        )
    of_map, of_heights = frame_words(exterior if inputs.angles == "ori" else None)
    if inputs.crs is None and not framed:
        found.append(f"the CRS of the positions: [exterior] crs, such as EPSG:32633{of_map}")
    declared = inputs.heights is not None or framed
    if not declared and not (inputs.crs and has_heights(positions_crs(inputs.crs, None))):
        found.append(f"the vertical datum of the positions: [exterior] heights: {HEIGHTS}{of_heights}")
    if inputs.dem is None and inputs.height is None:
        found.append("the ground: [dem] file, or [dem] height in metres")
    own = framed and (power.carries_placement or (inputs.exterior is not None and inputs.angles in SELF_PLACED))
    if own and inputs.height is not None and not (inputs.dem_heights or inputs.heights or inputs.crs):
        found.append(f"what the height of the ground counts from: [dem] heights: {HEIGHTS}")
    if inputs.dem_heights is None and undeclared_heights(file_of(inputs.dem)):
        found.append(f"the vertical datum of the DEM: [dem] heights: {HEIGHTS}")
    return found


def undeclared_heights(dem: Path | None) -> bool:
    """Whether a DEM's file does not say from where its heights count.

    Parameters
    ----------
    dem : Path or None

    Returns
    -------
    bool
        False without a DEM.
    """
    crs = None if dem is None else inspect(dem).crs
    return dem is not None and (crs is None or not has_heights(crs))


def _takes_positions(inputs: Block, power: Capabilities) -> bool:
    """Whether positions or control points are used, so that their CRS matters."""
    return inputs.exterior is not None or inputs.control is not None or "position" in power.exterior


def known_capabilities(sensor: str) -> Capabilities:
    """Capabilities of a sensor; of one that is not installed here, those that a project can be drafted with.

    Parameters
    ----------
    sensor : str

    Returns
    -------
    Capabilities
    """
    try:
        return capabilities(sensor)
    except SensorError:
        return Capabilities(exterior=("position",))
