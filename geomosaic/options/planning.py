"""Options of planning: flights, coverage of an area, control, quality of a photo map, processing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from geomosaic.options.check import CheckedOptions
from geomosaic.options.declaration import option
from geomosaic.options.render import GIGABYTE, parse_size

FILMS = ("grey", "colour")


@dataclass(frozen=True, kw_only=True)
class PhotoFormat(CheckedOptions):
    """Sides of the photo and its overlaps."""

    format_along: float = option(230.0, "Side of the photo along the strip.", unit="mm", metavar="MM", shown="230")
    format_across: float = option(230.0, "Side of the photo across it.", unit="mm", metavar="MM", shown="230")
    overlap: float = option(
        60.0, "Overlap along the strip.", unit="%", metavar="PERCENT", shown="60", idle_with=("photos_in_strip",)
    )
    sidelap: float = option(
        30.0, "Overlap of the strips.", unit="%", metavar="PERCENT", shown="30", idle_with=("strips",)
    )
    monoscopic: bool = option(
        False, "Each place on one photo is enough, instead of on two.", flag="--monoscopic --mono"
    )


@dataclass(frozen=True, kw_only=True)
class CoverageOptions(PhotoFormat):
    """Coverage of a rectangle by photos.

    Attributes
    ----------
    area : tuple of float
        Length along the strips and width across them, metres.
    photo_scale : float
        Denominator.
    strips, photos_in_strip : int, optional
        Numbers instead of `sidelap` and `overlap`, which follow.
    ortho_pixel : float, optional
        Metres; gives the size of the raster.
    """

    area: tuple[float, float] = option(
        help="Length along the strips and width across them.", unit="m", metavar="LENGTH WIDTH"
    )
    photo_scale: float = option(help="Scale of the photo.", unit="1:", metavar="1:N")
    strips: int | None = option(None, "Number of strips, from which --sidelap follows.", least=1)
    photos_in_strip: int | None = option(None, "Number of photos in a strip, from which --overlap follows.", least=1)
    ortho_pixel: float | None = option(None, "Tell the size of the raster too.", unit="m", metavar="METRES")


@dataclass(frozen=True, kw_only=True)
class MapTarget(CheckedOptions):
    """Scale of a photo map and camera of its photos."""

    ortho_scale: float = option(help="Scale of the photo map.", unit="1:", metavar="1:N")
    camera_constant: float = option(help="Camera constant (focal length) of the photos.", unit="mm", metavar="MM")
    film: str = option("colour", "Kind of the photos.", choices=FILMS)
    ratio: float | None = option(None, "K = M_photo / M_ortho.", shown="that of K-2.8", metavar="NUMBER")


@dataclass(frozen=True, kw_only=True)
class FlightOptions(PhotoFormat, MapTarget):
    """Flight for a photo map.

    Attributes
    ----------
    scan_pixel : float, optional
        Pixel of the scan or of the detector, µm; the largest that K-2.8 allows unless given.
    area : tuple of float, optional
        Length along the strips and width across them, metres.
    """

    scan_pixel: float | None = option(
        None, "Pixel of the scan, or of a digital camera.", unit="µm", metavar="MICRONS",
        shown="the largest that K-2.8 allows",
    )  # fmt: skip
    area: tuple[float, float] | None = option(
        None, "Length along the strips and width across them: counts the photos.", unit="m", metavar="LENGTH WIDTH"
    )


@dataclass(frozen=True, kw_only=True)
class ProductOptions(MapTarget):
    """Quality that a photo map shall have.

    Attributes
    ----------
    position_error : float, optional
        Target, metres; 0.3 mm on the map unless given.
    other_errors : tuple of float
        Errors of position that do not come from heights, metres.
    radius : float
        Largest distance from the principal point that is used, mm.
    """

    position_error: float | None = option(None, "Target.", unit="m", metavar="METRES", shown="0.3 mm on the map")
    other_errors: tuple[float, ...] = option(
        (), "An error of position that does not come from heights: orientation, identification.", unit="m",
        flag="--other-error", metavar="METRES",
    )  # fmt: skip
    radius: float = option(140.0, "Largest r that is used.", unit="mm", metavar="MM", shown="140")


@dataclass(frozen=True, kw_only=True)
class TableOptions(CheckedOptions):
    """Scales and camera constants of tables.

    Attributes
    ----------
    ortho_scale : tuple of float
        Denominators.
    camera_constant : tuple of float
        Millimetres.
    """

    ortho_scale: tuple[float, ...] = option(
        (2000.0, 5000.0, 10000.0), "Scale of the photo map; any number of times.", unit="1:", metavar="1:N",
        shown="1:2000, 1:5000, 1:10000",
    )  # fmt: skip
    camera_constant: tuple[float, ...] = option(
        (150.0, 300.0), "Camera constant; any number of times.", unit="mm", metavar="MM", shown="150, 300"
    )


@dataclass(frozen=True, kw_only=True)
class ControlNeedOptions(CheckedOptions):
    """Model of the images and size of the block, for the number of control points.

    Attributes
    ----------
    model : str
    points : int, optional
        Points to lay out in an image.
    photos : int, optional
        Photos adjusted together.
    ties : int
        Connections of two photos by a tie point.
    control : int
        Measurements of control points in photos.
    """

    model: str = option("affine", "Model of the image.")
    points: int | None = option(
        None, "Number of points: where they should lie, and for which models they are enough.", least=2
    )
    photos: int | None = option(None, "Photos adjusted together, for the balance of the block.", least=1)
    ties: int = option(0, "Connections of two photos by a tie point.", least=0, needs=("photos",))
    control: int = option(0, "Measurements of control points in photos.", least=0, needs=("photos",))


@dataclass(frozen=True, kw_only=True)
class ProcessingOptions(CheckedOptions):
    """Block and machines of a run."""

    photos: int = option(help="Number of photos.", least=1)
    photo_size: tuple[int, int] = option(help="Columns and rows of a photo.", least=1, metavar="COLUMNS ROWS")
    photo_bytes: int | None = option(
        None, "Size of the file of a photo, such as 8M.", least=1, metavar="SIZE", parse=parse_size,
        shown="0.4 bytes a pixel",
    )  # fmt: skip
    ground_pixel: float = option(help="Pixel of the photos on the ground.", above=0.0, unit="m", metavar="METRES")
    ortho_pixel: float | None = option(
        None, "Pixel of the mosaic.", above=0.0, unit="m", metavar="METRES", shown="that of the photos"
    )
    overlap: float = option(
        80.0, "Overlap along the strips.", least=0.0, most=95.0, unit="%", metavar="PERCENT", shown="80"
    )
    sidelap: float = option(
        60.0, "Overlap of the strips.", least=0.0, most=95.0, unit="%", metavar="PERCENT", shown="60"
    )
    oriented: bool = option(False, "Orientations are known: nothing is matched and adjusted.", flag="--oriented")
    seams: str = option("nearest", "How seams are laid, see `geomosaic mosaic`.", choices=("nearest", "graph-cut"))
    workers: int = option(1, "Machines that match photos and draw the mosaic.", least=1)
    cores: int = option(2, "Cores of each.", least=1)
    memory: int = option(
        8 * GIGABYTE, "Memory of each, such as 16G.", least=1, metavar="SIZE", parse=parse_size, shown="8G"
    )
    disk: int | None = option(
        None, "Room on the disk that the mosaic is written to, such as 2T.", least=1, metavar="SIZE",
        parse=parse_size, shown="no limit",
    )  # fmt: skip
    bandwidth: float | None = option(
        None, "From the storage to each machine and back, megabytes a second.", above=0.0, metavar="MB/S",
        shown="no limit",
    )  # fmt: skip
    core_hour: float | None = option(None, "Price of a core for an hour.", least=0.0, metavar="PRICE")
    rates: Path | None = option(
        None,
        "Rates of your own machine, by `python -m benchmarks.rates`.",
        metavar="FILE",
        shown="those of the package",
    )
