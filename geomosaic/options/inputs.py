"""Options of inputs: images, orientation, ground, control, planar placement; extent of the output; quality limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError
from geomosaic.options.check import CheckedOptions, SelfContainedOptions, as_written, finite_numbers
from geomosaic.options.declaration import named_only, option

# Plane transformations of a photo, those of fewer parameters first.
PLANE_MODELS = ("conformal", "affine", "projective")
# Endings of geoid grids: a vertical datum that ends so is the path of one.
GEOID_FILES = (".tif", ".gtx")

# Ending of files that hold a CRS.
CRS_FILES = (".prj",)

# Angle systems of orientations: those of tables, and the files of other programs.
ANGLE_SYSTEMS: Mapping[str, str] = {
    "opk": "omega, phi, kappa: R3(kappa) R2(phi) R1(omega)",
    "pok": "phi first: R3(kappa) R1(omega) R2(phi)",
    "matrix": "rotation matrix r11 to r33, row by row, of a declared direction",
    "patb": "the matrix a PATB file prints, of a declared direction",
    "rpy": "roll (right wing down), pitch (nose up), yaw (clockwise from north)",
    "dji": "DJI gimbal yaw, pitch (-90 looks down), roll",
    "none": "positions alone: tie points give the angles",
    "opensfm": "rotation and translation of an OpenSfM reconstruction.json, in east, north, up at its reference",
    "odm": "the same in map axes: the reconstruction.json that OpenDroneMap has brought to its UTM zone",
    "pix4d": "Pix4D's list of calibrated camera parameters, with its offset: camera, rotation and position in the map",
    "metashape": "cameras exported from Metashape: XML with the camera, geocentric unless it says otherwise; or text",
    "colmap": "COLMAP's images.txt, with cameras.txt beside it; its world is declared by `world` of the sensor",
    "ori": "IGN's XML of one photo: NAME.ori.xml for each image, in the map that <systeme> and <grid_alti> name",
    "tsai": "pinhole cameras of the Ames Stereo Pipeline, geocentric: NAME.tsai for each image, with the lens",
    "printed": "a printed list, with columns, unit, sequence and axes as declared under [exterior.printed]",
}


def _parse_names(text: Any) -> tuple[str, ...]:
    """Names of bands, separated by commas in a text."""
    names = tuple(str(word).strip() for word in (text.split(",") if isinstance(text, str) else text))
    if not names or not all(names):
        raise InputError(f"'{text}' has an empty name", hint="write red,green,blue")
    return names


def _parse_day(value: Any) -> str:
    """Day of acquisition, such as '1985-07-12'."""
    try:
        return date.fromisoformat(str(value).strip()).isoformat()
    except ValueError:
        raise InputError(f"'{value}' is no day", hint="write year, month and day, such as 1985-07-12") from None


def _parse_margin(value: Any) -> tuple[float, ...]:
    """Border of an image at its left, top, right and bottom, pixels; one width is for all sides."""
    parts = finite_numbers([value] * 4 if isinstance(value, str | int | float) else value)
    if len(parts) != 4 or min(parts) < 0.0:
        raise InputError(f"'{value}' is no border", hint="give pixels, 0 or more, for all sides or for each of four")
    return parts


def parse_bounds(value: Any) -> tuple[float, ...]:
    """Area on the map: left, bottom, right, top.

    Parameters
    ----------
    value : sequence of float or str
        Map units.

    Returns
    -------
    tuple of float
        Of four.

    Raises
    ------
    InputError
        Not four finite numbers, or an area without extent.
    """
    parts = finite_numbers(value)
    if len(parts) != 4 or not (parts[0] < parts[2] and parts[1] < parts[3]):
        hint = "write left bottom right top, such as 399850 5499850 400250 5500150"
        raise InputError(f"'{as_written(value)}' is no area", hint=hint)
    return parts


@dataclass(frozen=True)
class ListingLayout(CheckedOptions, group="input"):
    """Declaration of how a printed list of orientations is to be read.

    Attributes
    ----------
    columns : tuple of str
        What stands in each place of a record: image, x, y, z, omega, phi, kappa, r11 to r33, or '-' to pass over.
    axes : str
        Directions of the image's x and y in the picture, such as 'right up' or 'right down'.
    sequence : tuple of str
        Order in which omega (about x), phi (about y) and kappa (about z) turn the axes, from the ground to the image.
        Empty where there is only a matrix.
    lines : int
        Lines of a record.
    skip : int
        Lines at the beginning of the file that are none.
    """

    columns: tuple[str, ...] = option(help="What stands in each place of a record.")
    axes: str = option(help="Directions of the image's x and y in the picture, such as 'right up'.")
    sequence: tuple[str, ...] = option(
        (), "Order of the rotations, from the ground to the image.", choices=("omega", "phi", "kappa")
    )
    lines: int = option(1, "Lines of a record.", least=1, most=20)
    skip: int = option(0, "Lines at the top that are left out.", least=0)


@dataclass(frozen=True)
class PlanarInputs(SelfContainedOptions, group="input", section="planar"):
    """Inputs of a planar block: photos of flat ground placed together, without a rigorous model.

    Attributes
    ----------
    kind : str
        'uncontrolled', 'semicontrolled', 'controlled' or 'grown'.
    model : str, optional
        'conformal', 'affine' or 'projective'; what the kind usually has unless given.
    ties : Path, optional
        Tie points.
    scale : float
        Map units per pixel of the photo that a mosaic without control starts with.
    azimuth : float
        Direction of its top in degrees, clockwise from the map's north.
    rectify : str, optional
        'singly' or 'together', for controlled mosaics; unless given singly where each photo has enough control.
    robust : bool
        Leave out points that contradict the others.
    insist : bool
        Go on with points that are grossly wrong, with a warning; `robust` comes first where both are given.
    """

    kind: str = option(
        help="Place photos of flat ground by tie and control points.",
        choices=("uncontrolled", "semicontrolled", "controlled", "grown"),
    )  # fmt: skip
    model: str | None = option(
        None, "Plane transformation of the photos.", choices=PLANE_MODELS, shown="as is usual for the kind"
    )
    ties: Path | None = option(None, "Tie points: id, image, col, row.")
    scale: float = option(
        1.0, "Map units per pixel of the start photo of a mosaic without control.", above=0.0, metavar="UNITS",
        shown="1", needs=("kind=uncontrolled", "kind=semicontrolled"),
    )  # fmt: skip
    azimuth: float = option(
        0.0, "Direction of the top of the start photo of a mosaic without control, from north.", metavar="DEGREES",
        shown="0", needs=("kind=uncontrolled", "kind=semicontrolled"),
    )  # fmt: skip
    rectify: str | None = option(
        None, "Rectify controlled photos singly or together.", choices=("singly", "together"),
        shown="singly where each has 4 control points", needs=("kind=controlled",),
    )  # fmt: skip
    robust: bool = option(False, "Leave out tie and control points that contradict the others.")
    insist: bool = option(False, "Go on with points that are grossly wrong.")

    @property
    def blunder_policy(self) -> str:
        """Policy for wrong points: 'leave' them out, 'keep' them, or 'stop'."""
        return _blunder_policy(self.robust, self.insist)

    def is_local(self, *, controlled: bool) -> bool:
        """Whether the mosaic lies in a frame of its own, without a place on the Earth.

        Parameters
        ----------
        controlled : bool
            Whether there is ground control.
        """
        return self.kind == "uncontrolled" or (self.kind == "semicontrolled" and not controlled)


def _blunder_policy(robust: bool, insist: bool) -> str:
    """Policy for wrong points."""
    return "leave" if robust else "keep" if insist else "stop"


@dataclass(frozen=True)
class EdgeOptions(CheckedOptions, group="input"):
    """Fit of photos that are matched at their edges.

    Attributes
    ----------
    model : str
        'conformal', 'affine' or 'projective', of each photo.
    reach : float, optional
        Pixels where a correction has faded away; 3 gaps between common points unless given.
    robust, insist : bool
        Leave out points that are found wrong; go on with them, with a warning.
    """

    model: str = option("affine", "Model of each photo.", choices=PLANE_MODELS)
    reach: float | None = option(
        None, "Where a correction has faded away.", above=0.0, metavar="PIXELS", shown="3 gaps between common points"
    )
    robust: bool = option(False, "Leave out tie and control points that contradict the others.")
    insist: bool = option(False, "Go on with points that are grossly wrong.")

    @property
    def blunder_policy(self) -> str:
        """Policy for wrong points: 'leave' them out, 'keep' them, or 'stop'."""
        return _blunder_policy(self.robust, self.insist)


@named_only
@dataclass(frozen=True)
class BlockInputs(SelfContainedOptions, group="input", section="project"):
    """Declaration of the inputs of a block; `geomosaic.inputs.declarations.Block` says what they mean to the library.

    Any stands for values of the library that may be given in place of a file.
    """

    images: tuple[Path, ...]
    # Empty until `Block` finds the sensor for images that lie as their files say: options do not ask the registry.
    sensor: str = option("", "Sensor of the images; see `geomosaic sensors`.", section="sensor", key="name")
    camera: Path | Any | None = option(
        None, "Camera description, or calibration certificate (TOML).", section="sensor", needs=("sensor",)
    )
    exterior: Path | Any | None = option(
        None, "Orientation table: image, x, y, z and angles.", section="exterior", key="file", needs=("sensor",)
    )
    crs: str | None = option(
        None,
        "CRS of the positions and the control points, such as EPSG:32633; local for a frame without a place on Earth.",
        metavar="CRS", files=CRS_FILES, flag="--exterior-crs --crs", section="exterior",
    )  # fmt: skip
    heights: str | None = option(
        None, "Vertical datum of the positions: ellipsoidal, egm96, an EPSG code or a geoid grid file.",
        metavar="DATUM", files=GEOID_FILES, section="exterior",
    )  # fmt: skip
    dem: Path | Any | None = option(None, "Digital elevation model.", section="dem", key="file")
    height: float | None = option(
        None, "One height for all the ground, instead of a DEM.", metavar="METRES", section="dem", idle_with=("dem",)
    )
    dem_from_tie_points: bool = option(
        False, "Ground from the adjusted tie points, instead of a DEM.", flag=None, section="dem",
        key="from_tie_points", idle_with=("dem",),
    )  # fmt: skip
    dem_heights: str | None = option(
        None, "Vertical datum of the DEM, where the file does not say it, or of --height.", metavar="DATUM",
        files=GEOID_FILES, section="dem", key="heights",
    )  # fmt: skip
    control: Path | Any | None = option(
        None, "Control and check points: id, x, y, z, image, col, row.", flag="--gcps", section="control", key="file"
    )
    bands: tuple[int, ...] | None = option(
        None, "Bands of the images to use, such as 1,2,3.", least=1, metavar="NUMBERS", flag="-b --bidx",
        shown="all but alpha",
    )  # fmt: skip
    band_names: tuple[str, ...] | None = option(
        None, "Bands by name, colour or wavelength, such as red,green,blue or 842nm, wherever each file has them.",
        metavar="NAMES", flag="--bands", parse=_parse_names, idle_with=("bands",),
    )  # fmt: skip
    declared_bands: tuple[str, ...] | None = option(
        None, "Names or wavelengths of the bands of the files in their order, in place of what the files say.",
        metavar="NAMES", parse=_parse_names, needs=("band_names",),
    )  # fmt: skip
    acquired: str | None = option(
        None, "Day on which the images were taken, such as 1985-07-12, in place of what the files say.", metavar="DATE",
        parse=_parse_day,
    )  # fmt: skip
    cloud_cover: float | None = option(
        None, "Percentage of the images that is cloud, in place of what the files say.", least=0.0, most=100.0,
        metavar="PERCENT",
    )  # fmt: skip
    clouds: str | None = option(
        None, "Raster of the pixels that are cloud and show nothing; {image} in the name takes each image's name.",
        metavar="FILE", files=("",),
    )  # fmt: skip
    cloud_values: tuple[int, ...] | None = option(
        None, "Values of that raster that stand for clouds.", metavar="NUMBERS", shown="all but 0", needs=("clouds",)
    )
    # Not `nodata`, which is the value of unseen pixels of the output.
    src_nodata: float | None = option(
        None, "Value of missing pixels of the images, in place of what the files say.", key="nodata"
    )
    margin: tuple[float, float, float, float] | None = option(
        None, "Border of every image not to be used.", metavar="PIXELS", parse=_parse_margin
    )
    usable: Path | None = option(None, "Polygons beyond which images are not to be used: image, col, row.")
    angles: str = option(
        "opk", "Angle system of the table, or the program whose files they are.", choices=tuple(ANGLE_SYSTEMS),
        metavar="SYSTEM", section="exterior",
    )  # fmt: skip
    angle_unit: str | None = option(
        None, "Unit of the angles.", choices=("deg", "gon", "rad"), shown="deg", section="exterior"
    )
    angle_frame: str | None = option(
        None, "North of the angles: the map's grid, or true.", choices=("grid", "local"), shown="as the system has it",
        section="exterior",
    )  # fmt: skip
    matrix: str | None = option(
        None, "Direction of rotation matrices.", choices=("ground_to_image", "image_to_ground"), section="exterior"
    )
    printed: ListingLayout | None = option(
        None, "Layout of a printed list of orientations.", flag=None, section="exterior"
    )
    trusted: bool = option(
        False, "Skip the plausibility check of the orientation.", flag="--trust-orientation", section="exterior"
    )
    fiducials: Path | None = option(
        None, "Fiducials measured in scans of film: image, id, col, row.", section="sensor", needs=("sensor",)
    )
    corrections: str | None = option(
        None, "Correction grid of image coordinates; {image} in the name takes each image's name.", metavar="FILE",
        files=("",), section="sensor",
    )  # fmt: skip
    options: Mapping[str, Any] = option(
        default_factory=dict, help="Any other input of the sensor; numbers of a list with commas: offset=5150,5000.",
        metavar="NAME=VALUE", flag="--option", section=None,
    )  # fmt: skip
    image_options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    base: Path = Path()
    planar: PlanarInputs | None = None


@dataclass(frozen=True)
class Area(SelfContainedOptions, group="geometry", section="output"):
    """Area and pixel size of the output; what is not given follows from the images."""

    dst_crs: str | None = option(
        None, "CRS of the output, such as EPSG:32633.", metavar="CRS", files=CRS_FILES,
        shown="that of the DEM, the positions or the control", key="crs", idle_with=("like",),
    )  # fmt: skip
    resolution: float | None = option(
        None, "Pixel size in map units.", above=0.0, metavar="UNITS", flag="--res", shown="that of the images",
        idle_with=("like",),
    )  # fmt: skip
    bounds: tuple[float, float, float, float] | None = option(
        None, "Area in map units.", metavar="LEFT BOTTOM RIGHT TOP", shown="all images", parse=parse_bounds,
        idle_with=("like",),
    )  # fmt: skip
    snap: bool = option(
        False, "Widen --bounds to whole multiples of --res; without --bounds that is always done.",
        flag="--target-aligned-pixels", needs=("bounds",), idle_with=("like",), section=None,
    )  # fmt: skip
    like: Path | Any | None = option(
        None, "Take CRS, pixels and extent of this raster.", metavar="RASTER", section=None
    )


# Largest expected error of a solution that is taken for sound, image pixels: the distance at which control already
# makes an orientation doubtful. Well controlled blocks have 0.5 to 3, those that little holds 8 to 100.
CORNER_SIGMA_PX = 5.0


@dataclass(frozen=True, kw_only=True)
class QualityLimits(SelfContainedOptions, section="quality", flag=None):
    """Limits of the accuracy of a project's mosaic, and a reference image to compare it with."""

    max_control_rms_px: float | None = option(
        None, "RMS length of residuals at control points, image pixels.", above=0.0
    )
    max_check_rms_px: float | None = option(None, "RMS length of residuals at check points, image pixels.", above=0.0)
    max_corner_sigma_px: float = option(
        CORNER_SIGMA_PX, "Expected error (one standard deviation) at the corners of what was adjusted, image pixels.",
        above=0.0, metavar="PIXELS", group="input", flag="--max-corner-sigma",
    )  # fmt: skip
    max_lattice_error_px: float | None = option(None, "Interpolation of the geometry, image pixels.", above=0.0)
    max_seam_mismatch_px: float | None = option(None, "Mismatch across seams, pixels of the mosaic.", above=0.0)
    max_registration_px: float | None = option(
        None, "RMS of shifts against the reference, pixels of the reference.", above=0.0, needs=("quality_reference",)
    )
    max_clipped_percent: float | None = option(None, "Pixels that colours clip, percent.", above=0.0)
    max_gain_spread_percent: float | None = option(
        None, "Standard deviation of the gains of images, percent.", above=0.0
    )
    max_colour_trend_percent: float | None = option(
        None, "Trend of colour corrections over the block, percent.", above=0.0
    )
    max_colour_difference: float | None = option(
        None, "RMS of corrected minus uncorrected colours, grey values.", above=0.0
    )
    quality_reference: Path | None = option(None, "Georeferenced raster to compare with.", key="reference")
