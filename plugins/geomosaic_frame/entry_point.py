"""Entry point of the sensor 'frame': its inputs, its capabilities and an example."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from geomosaic.sensor.inputs import known_inputs
from geomosaic.sensor.plugin import RAY_CORRECTIONS, Capabilities, ControlUse, SensorExample, SensorInput, SensorRequest

if TYPE_CHECKING:
    from geomosaic_frame.model import FrameModel

INPUTS = (
    SensorInput(
        "camera",
        "table, or the name of a camera.toml, or of orthority's YAML: size [width, height] px (default the image's); "
        "focal_length mm with sensor_size [width, height] mm or pixel_size µm; principal_point [right, up] mm from the "
        "image's centre (default 0, 0); or focal_length_px and principal_point_px [col, row] from the outer corner of "
        "the upper-left pixel; distortion = {model = none | brown | opencv | fisheye, k1, ...; centre = [x, y] of the "
        "distortion from the principal point, in focal lengths; brown also takes convention = opencv | "
        "photogrammetric, and corrects = ideal | measured, what the formula starts from}; additional = {model = ebner "
        "| gruen, base, coefficients} px; rolling_shutter = {readout_time s, direction = down | up | right | left}. An "
        "image in another resolution scales the camera. For film the calibration certificate: focal_length, "
        "principal_point_autocollimation, principal_point_symmetry [x, y] mm; fiducials = {mark = [x, y]} mm, x right, "
        "y up; distortion = {model = none | radial | polynomial, ...}",
    ),
    SensorInput("fiducials", "the marks measured in the scan of a film: {mark = [col, row]}", "px"),
    SensorInput(
        "fiducial_sigma",
        "standard deviation of a measured mark: the transformation from the scan to the film is then adjusted with the "
        "photo, and the marks are observations of it",
        "px",
        "the transformation is held",
    ),
    SensorInput(
        "interior",
        "transformation from the scan to the film: conformal, affine or projective",
        default="affine; conformal with two or three marks",
    ),
    SensorInput("mirrored", "true where the scan shows the film from its back", default="false"),
    SensorInput(
        "position", "projection centre [x, y, z]; x east before y north, z in the declared vertical datum", "CRS"
    ),
    SensorInput(
        "orientation",
        "table of system and its values: opk {omega, phi, kappa} = R3(kappa) R2(phi) R1(omega); pok {phi, omega, "
        "kappa}, phi first; matrix or patb {r11 ... r33, matrix}; rpy {roll, pitch, yaw}, aircraft; dji {gimbal_yaw, "
        "gimbal_pitch, gimbal_roll}; opensfm or odm {rotation, translation, reference} or {reconstruction = file}; "
        "colmap, pix4d, metashape, ori or tsai {reconstruction = file}. "
        "frame = grid | local says whether angles refer to grid or true north",
        "angle_unit",
    ),
    SensorInput(
        "points",
        "three or more control points {x, y, z, col, row, sigma}, in place of position and orientation: the photo is "
        "resected from them, with no initial values; sigma is that of the measurement, default 1. Three points may "
        "allow several places: position, roughly, chooses the nearest",
        "CRS, px",
    ),
    SensorInput(
        "world",
        "what the coordinates in a file of COLMAP or Metashape are: map (the CRS that is named), geocentric, or local "
        "(east, north, up at reference)",
        default="COLMAP: to be given; Metashape: as its file says; Pix4D: map",
    ),
    SensorInput("reference", "origin of a local world: [longitude, latitude, altitude]", "deg, m"),
    SensorInput("offset", "[x, y, z] to be added to the positions in a file of COLMAP or Metashape", "CRS", "0, 0, 0"),
    SensorInput("angle_unit", "unit of the angles: deg, gon or rad", default="deg"),
    SensorInput(
        "angle_frame",
        "grid or local (true north), for all images; overrides the system's own",
        default="grid; local for rpy, dji",
    ),
    SensorInput("matrix", "ground_to_image or image_to_ground: direction of a rotation matrix, for all images"),
    SensorInput(
        "treatment",
        "rigorous: geocentric, with geoid, convergence and map scale; planar: collinearity in map coordinates, as in "
        "textbooks, wrong by the curvature of the Earth",
        default="rigorous",
    ),
    SensorInput(
        "scale_correction",
        "true where heights of projection centres above ground were multiplied by the map's scale factor (linear "
        "alteration): undo it, about ground_height",
        default="false",
    ),
    *RAY_CORRECTIONS,
    SensorInput(
        "upwards",
        "true where the photo may look level or above the horizon, at a facade, a tower or a dome; in a local frame "
        "that is always so",
        default="false",
    ),
    SensorInput(
        "unoriented",
        "true for a photo that a block adjustment has yet to place: the model knows its camera alone",
        default="false",
    ),
    SensorInput(
        "ground_height",
        "mean height of the ground under the photo, in the vertical datum of the positions",
        "m",
        "that of the DEM below the camera; 0 without",
    ),
    SensorInput(
        "velocity",
        "of a camera with a rolling shutter [x, y, z], along the axes of the CRS: where its motion starts",
        "m/s",
        "of the orientation table, or from its column time; else 0, 0, 0",
    ),
    SensorInput(
        "rates",
        "of a camera with a rolling shutter [right, down, forward]: its turn about these axes of the camera",
        "deg/s",
        "of the orientation table; else 0, 0, 0",
    ),
    SensorInput(
        "sigmas",
        "a-priori standard deviations: position, or east, north, up in m; angles, or omega, phi, kappa in degrees; "
        "with a rolling shutter motion, or motion_east, motion_north, motion_up in m, and turn, or turn_omega, "
        "turn_phi, turn_kappa in degrees, during the readout; 0 fixed",
        "m, deg",
        "free; motion 15 m/s, with velocity 1 m/s; turn 0",
    ),
)

EXAMPLE = SensorExample(
    (4000, 3000),
    """\
[sensor]
name = "frame"
camera = "camera.toml"
position = [500000.0, 5500000.0, 1500.0]
orientation = { system = "opk", omega = 1.5, phi = -0.8, kappa = 91.0 }

[exterior]
crs = "EPSG:32633"
heights = "egm96"

[dem]
height = 300.0
""",
    {
        "camera.toml": """\
focal_length = 24.0          # mm
sensor_size = [36.0, 27.0]   # mm
distortion = { model = "brown", k1 = -0.05 }
"""
    },
)


class FramePlugin:
    """Plugin of the sensor 'frame'; its modules are loaded when a model is asked for."""

    name = "frame"
    summary = "frame camera: collinearity with lens distortion, every usual angle system, map or geocentric positions"
    inputs = INPUTS
    capabilities = Capabilities(
        exterior=("position", "orientation", "angle_unit", "velocity"),
        needs_exterior=True,
        needs_camera=True,
        control=ControlUse.RESECTION,
        ground_height=True,
        upwards=True,
        unoriented=True,
    )
    example = EXAMPLE

    @property
    def model(self) -> type[FrameModel]:
        """Class of the models."""
        from geomosaic_frame.model import FrameModel

        return FrameModel

    def check_camera(self, camera: Mapping[str, Any], where: str) -> None:
        """Check of the keys of a camera description; see `geomosaic_frame.build.check_camera_keys`."""
        from geomosaic_frame.build import check_camera_keys

        check_camera_keys(camera, where)

    def build(self, request: SensorRequest) -> FrameModel:
        """Make the model of one photo; see `geomosaic_frame.build`."""
        from geomosaic_frame.build import build_frame

        known_inputs(request.options, INPUTS, self.name, request.image)
        return build_frame(request)
