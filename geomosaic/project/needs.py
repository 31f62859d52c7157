"""What a block still lacks before it can be built."""

from __future__ import annotations

from geomosaic.geo.crs import has_heights
from geomosaic.project.exterior import RECONSTRUCTION_SYSTEM, RECONSTRUCTIONS, undeclared_reconstruction
from geomosaic.project.frames import named
from geomosaic.project.inputs import BlockInputs
from geomosaic.raster.info import inspect

HEIGHTS = "ellipsoidal, egm96, an EPSG code of a vertical CRS, or the path of a geoid grid"


def needs(inputs: BlockInputs) -> list[str]:
    """Say what a block still lacks, each with the key that takes it."""
    found = []
    if inputs.sensor == "planar":
        for path in inputs.images:
            if inspect(path).transform is None and inputs.control is None and not inputs.options:
                found.append(
                    f"{path.name} is not georeferenced: control points, [control] file, or another [sensor] name"
                )
                break
        return found
    undeclared = undeclared_reconstruction(inputs.exterior, inputs.angles)
    reconstruction = undeclared or inputs.angles in RECONSTRUCTIONS
    framed = undeclared or inputs.angles == "opensfm"  # it says itself what it counts from
    if undeclared:
        found.append(f"the angle system of the reconstruction: [exterior] angles: {RECONSTRUCTION_SYSTEM}")
    if inputs.sensor == "frame" and inputs.camera is None and not reconstruction:
        found.append("the camera: [sensor] camera, a TOML file (see `geomosaic sensors frame`)")
    if inputs.sensor == "frame" and inputs.exterior is None and inputs.control is None:
        found.append(
            "positions and angles of the photos: [exterior] file, a table with image, x, y, z, omega, phi, kappa"
        )
    if inputs.crs is None and not framed:
        found.append("the CRS of the positions: [exterior] crs, such as EPSG:32633")
    declared = inputs.heights is not None or framed
    if not declared and not (inputs.crs and has_heights(named(inputs.crs, None))):
        found.append(f"the vertical datum of the positions: [exterior] heights: {HEIGHTS}")
    if inputs.dem is None and inputs.height is None:
        found.append("the ground: [dem] file, or [dem] height in metres")
    if inputs.dem is not None and inputs.dem_heights is None:
        crs = inspect(inputs.dem).crs
        if crs is None or not has_heights(crs):
            found.append(f"the vertical datum of the DEM: [dem] heights: {HEIGHTS}")
    return found
