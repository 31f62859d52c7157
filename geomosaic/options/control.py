"""Options of control points and of what is measured with them: fits, edge matching, monoplotting, fiducials, RPCs."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError
from geomosaic.options.check import CheckedOptions, SelfContainedOptions, as_written, finite_numbers
from geomosaic.options.declaration import option
from geomosaic.options.inputs import PLANE_MODELS, Area
from geomosaic.options.render import InputSigmas, OrientationSigmas, RenderOptions

# Names of fits, those of fewer parameters first.
# Points of a spline: its matrix and the work of its inverse take five times N² numbers, 4 GB here, and some minutes.
MOST_SPLINE_POINTS = 10_000
MODELS = (*PLANE_MODELS, "poly1", "poly2", "poly3", "poly4", "poly5", "tps")


def parse_place(value: Any) -> tuple[float, float]:
    """Longitude and latitude, degrees.

    Parameters
    ----------
    value : sequence of float

    Raises
    ------
    InputError
        Not two numbers, or no place on the Earth.
    """
    place = finite_numbers(value)
    # Longitudes beyond 180 degrees are in use across the date line.
    if len(place) != 2 or abs(place[0]) > 360.0 or abs(place[1]) > 90.0:
        hint = "write longitude and latitude in degrees, such as 16.5 48.8"
        raise InputError(f"'{as_written(value)}' is no place", hint=hint)
    return place[0], place[1]


def _parse_heights(value: Any) -> tuple[float, ...]:
    """Lowest and highest height, metres."""
    heights = finite_numbers(value)
    if len(heights) != 2:
        what = f"'{as_written(value)}' is no range of heights"
        raise InputError(what, hint="give the lowest and the highest, metres")
    return heights


def _parse_residual_limits(value: Any) -> tuple[float, ...]:
    """Largest residual along columns and along rows, pixels; one number is for both."""
    parts = value.replace(",", " ").split() if isinstance(value, str) else value
    limits = finite_numbers(parts if isinstance(parts, list | tuple) else [parts])
    limits = limits * 2 if len(limits) == 1 else limits
    if len(limits) != 2 or not min(limits) > 0.0:
        hint = "give pixels above 0: 2 for both axes, or 2,3"
        raise InputError(f"'{as_written(value)}' is no limit of residuals", hint=hint)
    return limits


@dataclass(frozen=True, kw_only=True)
class PointFileOptions(CheckedOptions, group="input"):
    """What a file of control or check points does not declare."""

    crs: str | None = option(
        None, "CRS of the points' ground coordinates, where the file names none.", metavar="CRS",
        idle_with=("reference",),
    )  # fmt: skip
    rows: str | None = option(
        None, "Way rows count in a QGIS file of unusual sign.", choices=("up", "down"), idle_with=("reference",)
    )
    pixels: str | None = option(
        None, "What (0, 0) is in a table: the corner of the upper-left pixel, or its centre.",
        choices=("corner", "centre"), shown="corner; centre for gcp_list.txt", idle_with=("reference",),
    )  # fmt: skip
    without: tuple[str, ...] = option((), "Leave a point out; any number of times.", metavar="POINT")


@dataclass(frozen=True, kw_only=True)
class _ControlSource(CheckedOptions, group="input"):
    """Control points of an image: a file, values, or what is found in a reference."""

    control: Path | Any | None = option(
        None, "Control points: a table, QGIS .points, gcp_list.txt, a raster or a world file.",
        shown="those in the image, or a world file beside it", flag="--gcps",
    )  # fmt: skip
    reference: Path | None = option(
        None, "Georeferenced raster of the land, in which control points are found.", idle_with=("control",)
    )


# Fields stand in the order of help and docs: those of the last base come first.
@dataclass(frozen=True, kw_only=True)
class ControlOptions(PointFileOptions, _ControlSource, SelfContainedOptions):
    """Source of an image's control points, with what its file does not declare.

    Attributes
    ----------
    control : Path or ControlPoints, optional
        File or points; without them the control in the image itself, or the world file beside it.
    reference : Path, optional
        Raster in which they are found instead.
    near : tuple of float, optional
        Longitude and latitude near the image, degrees.
    """

    near: tuple[float, float] | None = option(
        None, "A place near the image, degrees: tells a wrong zone from the right one.",
        metavar="LON LAT", parse=parse_place, group="input",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class CheckOptions(CheckedOptions):
    """Check points of a finished map, and the limits that it is held against.

    Attributes
    ----------
    points : PointFileOptions
        How the file of points is read.
    raster_crs : str, optional
        Of the raster, where it names none.
    survey_rms : float
        RMS length of the errors of the true places, map units.
    max_rms, max_rms_map : float, optional
        Largest total RMS, pixels of the raster and map units.
    map_scale : float, optional
        Denominator: the total RMS is at most 0.3 mm on paper.
    target : Path, optional
        Plan of a product, or TOML of largest values.
    """

    points: PointFileOptions = field(default_factory=PointFileOptions)
    raster_crs: str | None = option(None, "CRS of the raster, where it names none.", metavar="CRS", group="input")
    survey_rms: float = option(
        0.0, "RMS error of the true places themselves, in map units.", least=0.0, metavar="UNITS", shown="0",
        group="input",
    )  # fmt: skip
    max_rms: float | None = option(
        None, "Exit with 3 where the total RMS is larger, in pixels of the raster.", above=0.0, metavar="PIXELS"
    )
    map_scale: float | None = option(
        None, "Exit with 3 where the total RMS is larger than 0.3 mm at this scale; see `geomosaic plan product`.",
        unit="1:", metavar="1:N",
    )  # fmt: skip
    max_rms_map: float | None = option(None, "The same in map units.", above=0.0, metavar="UNITS")
    target: Path | None = option(
        None, "Exit with 3 where the map misses a plan of `geomosaic plan product --json`: position, pixel, survey.",
        metavar="PLAN",
    )  # fmt: skip


@dataclass(frozen=True)
class FitOptions(CheckedOptions, group="input"):
    """Model of the fit and treatment of blunders.

    Attributes
    ----------
    model : str
        One of `MODELS`, or 'auto'.
    fit_crs : str, optional
        CRS in which the fit is made; that of the control where it is projected, else that of the output.
    threshold : float, optional
        Total RMS in pixels down to which the worst points are deleted.
    threshold_xy : tuple of float, optional
        Residuals along columns and rows in pixels down to which the worst points are deleted.
    robust : bool
        Leave out the blunders that the robust fit finds.
    insist : bool
        Continue in spite of errors among the diagnostics.
    """

    model: str = option(
        "auto", "Fit: auto takes the one of the smallest errors at points left out.", choices=("auto", *MODELS)
    )
    fit_crs: str | None = option(
        None, "CRS in which the fit is made.", metavar="CRS",
        shown="that of the points, where projected; else of the output",
    )  # fmt: skip
    threshold: float | None = option(
        None, "Delete the worst point and fit again, until the total RMS is below.", above=0.0, metavar="PIXELS"
    )
    threshold_xy: tuple[float, float] | None = option(
        None, "Delete the worst point and fit again, until no residual is larger along columns or rows: 2, or 2,3.",
        metavar="PIXELS", parse=_parse_residual_limits,
    )  # fmt: skip
    robust: bool = option(False, "Leave out the points that data snooping and M-estimator reject.")
    insist: bool = option(
        False, "Go on where points look wrong (diagnostics of severity error) or hardly hold the corners."
    )

    @property
    def deletes(self) -> bool:
        """Whether the worst points are deleted."""
        return self.threshold is not None or self.threshold_xy is not None


@dataclass(frozen=True, kw_only=True)
class VectorOptions(SelfContainedOptions, group="input"):
    """Vectors that a fit carries to the map."""

    vectors: Path | None = option(
        None, "Vectors drawn over the image, in its coordinates: written on the map beside the output.", metavar="FILE"
    )
    vector_rows: str | None = option(
        None,
        "How the vectors count rows: down from the top, the same with a minus sign (as QGIS shows images without "
        "georeference), or up from the bottom.", choices=("down", "negative", "up"), shown="negative where all are",
        needs=("vectors",),
    )  # fmt: skip
    line_tolerance: float = option(
        0.1, "Pixels by which a line between two vertices may miss the fit: where it bends, vertices are put in.",
        above=0.0, metavar="PIXELS", group="geometry",
    )  # fmt: skip


@dataclass(frozen=True)
class GeoreferenceOptions:
    """Options of `georeference`, composed of those of control, fit, vectors, extent and rendering."""

    source: ControlOptions = field(default_factory=ControlOptions)
    fit: FitOptions = field(default_factory=FitOptions)
    drawn: VectorOptions = field(default_factory=VectorOptions)
    area: Area = field(default_factory=Area)
    render: RenderOptions = field(default_factory=RenderOptions)


@dataclass(frozen=True)
class RegistrationOptions(CheckedOptions, group="input"):
    """Displacement between two rasters.

    Attributes
    ----------
    model : str
        'shift', 'affine' or 'local'; a simpler one is taken where it predicts as well.
    search : float, optional
        Metres that the raster may lie wrong at most; 30 pixels of the coarser raster unless given.
    """

    model: str = option(
        "shift",
        "Displacement: one shift, an affine one, or a smooth field; a simpler one where the rasters do not "
        "bear it.", choices=("shift", "affine", "local"),
    )  # fmt: skip
    search: float | None = option(
        None, "Metres that the raster may lie wrong at most.", above=0.0, shown="30 pixels of the coarser raster"
    )


@dataclass(frozen=True)
class CoregisterOptions:
    """Options of `coregister`, composed of those of the displacement, extent and rendering."""

    registration: RegistrationOptions = field(default_factory=RegistrationOptions)
    area: Area = field(default_factory=Area)
    render: RenderOptions = field(default_factory=RenderOptions)


@dataclass(frozen=True, kw_only=True)
class PixelOptions(OrientationSigmas, group="input"):
    """Pixel coordinates of points and vectors, and the standard deviations of the image's orientation."""

    layer: str | None = option(None, "Layer of the vectors.", shown="the first")
    rows: str | None = option(
        None,
        "How pixel coordinates count rows: down from the top, the same with a minus sign (as QGIS shows images "
        "without georeference), or up from the bottom.", choices=("down", "negative", "up"),
        shown="down in tables; vectors need it",
    )  # fmt: skip
    first_pixel: float = option(0.5, "What pixel coordinates call the centre of the first pixel: 0.5, 0 or 1.")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.first_pixel not in (0.0, 0.5, 1.0):
            raise InputError(f"{self.first_pixel:g} is no centre of a pixel", where="`first_pixel`", hint="0.5, 0 or 1")


@dataclass(frozen=True, kw_only=True)
class LocateOptions(PixelOptions, InputSigmas, group="input"):
    """Options of `locate`: accuracy of pixels and heights, CRS of the places.

    Attributes
    ----------
    layer, rows, first_pixel, sigmas
        See `PixelOptions`.
    step : float, optional
        Most pixels between vertices of digitized lines; vertices alone unless given.
    sigma_px, sigma_dem
        See `InputSigmas`.
    dst_crs, dst_heights : str, optional
        CRS and vertical datum of the places; those of the ground unless given.
    """

    step: float | None = option(
        None, "Most pixels between vertices of digitized lines.", above=0.0, metavar="PIXELS",
        shown="their own vertices",
    )  # fmt: skip
    dst_crs: str | None = option(None, "CRS of the places.", metavar="CRS", shown="of the ground")
    dst_heights: str | None = option(None, "Vertical datum of the places.", metavar="DATUM", shown="of the ground")


@dataclass(frozen=True, kw_only=True)
class DrawOptions(PixelOptions, group="input"):
    """Options of `draw_vectors`: the map vectors, and what the photo does not show of them.

    Attributes
    ----------
    layer, rows, first_pixel, sigmas
        See `PixelOptions`; rows and first pixel are those of the output.
    src_crs : str, optional
        CRS of the vectors, instead of what they say.
    mark_hidden : bool
        Keep hidden parts, marked; left out otherwise.
    """

    src_crs: str | None = option(None, "CRS of map vectors, instead of what they say.", metavar="CRS")
    mark_hidden: bool = option(False, "Keep hidden parts in the drawing, marked.", shown="left out")


@dataclass(frozen=True)
class SearchOptions(CheckedOptions):
    """Limits of the search for fiducial marks.

    Attributes
    ----------
    pixel_size : float
        Size of a pixel of the scans, micrometres.
    side : float
        Side of the square that is cut out of a scan as the template, mm.
    reach : float
        Millimetres by which the film may lie off the middle of the scan.
    turned : float, optional
        Degrees by which the film is turned in the scan, counter-clockwise; the right angle at which the marks fit the
        certificate unless given, and none where that does not tell.
    mirrored : bool
        Whether the scan shows the film from its back.
    least : float
        Correlation that a mark must have.
    """

    pixel_size: float = option(help="Pixels of the scans, µm.", above=0.0)
    side: float = option(2.0, "Side of the square that is cut out of a scan as the template, mm.", above=0.0)
    reach: float = option(5.0, "How far marks may be off, mm.")
    turned: float | None = option(
        None,
        "Turn of the film in the scan, degrees counter-clockwise.",
        shown="as the marks fit, else 0",
    )
    mirrored: bool = option(False, "The scan shows the film from its back.")
    least: float = option(0.6, "Least correlation of a mark.", least=0.0, most=1.0)


@dataclass(frozen=True)
class TieOptions(SelfContainedOptions, group="input"):
    """Options of tie points that refine RPCs: their table, images that stay, standard deviation."""

    ties: Path | None = option(None, "Tie points between the images: id, image, col, row.")
    fixed: tuple[str, ...] = option((), "Image that tie points leave as it is.", metavar="IMAGE", needs=("ties",))
    sigma_px: float = option(0.5, "Standard deviation of tie points.", above=0.0, metavar="PIXELS", needs=("ties",))


@dataclass(frozen=True)
class RpcOptions(SelfContainedOptions):
    """Options of RPCs that are fitted or refined: heights of the fit, files that are written.

    Attributes
    ----------
    height_range : tuple of float, optional
        Lowest and highest ellipsoidal height in metres to fit to; those of the DEM under the image unless given.
    tags, text : bool
        Write the tags of the images (GeoTIFF) in place, and IMAGE_RPC.TXT.
    grid : bool
        Write IMAGE_RPC_grid.csv, what a fitted RPC cannot follow of its sensor.
    folder : Path, optional
        For the text files and grids; beside the images unless given.
    overwrite : bool
        Replace an RPC that the image or the file has.
    """

    height_range: tuple[float, float] | None = option(
        None, "Ellipsoidal heights in metres that an RPC is fitted to.",
        metavar="LOW HIGH", parse=_parse_heights, shown="those of the DEM under the image",
    )  # fmt: skip
    tags: bool = option(False, "Write the RPC into the tags of the images (GeoTIFF), in place.")
    text: bool = option(False, "Write IMAGE_RPC.TXT.")
    grid: bool = option(
        False, "Write IMAGE_RPC_grid.csv, what the fitted RPC cannot follow of the sensor: --corrections takes it.",
        needs=("text", "tags"),
    )  # fmt: skip
    folder: Path | None = option(
        None, "Folder of text files and grids.", shown="beside the images", needs=("text", "grid")
    )
    overwrite: bool = option(False, "Replace an RPC that the image or the file has.")


@dataclass(frozen=True)
class RefineOptions:
    """Options of `refine_rpc`: tie points, and those of the files."""

    tied: TieOptions = field(default_factory=TieOptions)
    files: RpcOptions = field(default_factory=RpcOptions)
