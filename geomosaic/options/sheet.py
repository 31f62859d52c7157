"""Options of map sheets: page, area, contents, stretch of the raster, and the files that sheets are written to."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError, did_you_mean
from geomosaic.options.check import CheckedOptions, SelfContainedOptions
from geomosaic.options.declaration import option
from geomosaic.options.inputs import parse_bounds
from geomosaic.options.render import WorkerOptions

# Width and height in mm, portrait (ISO 216).
PAPERS = {"A0": (841.0, 1189.0), "A1": (594.0, 841.0), "A2": (420.0, 594.0), "A3": (297.0, 420.0), "A4": (210.0, 297.0)}


def paper_size(text: str, where: str | None = None) -> tuple[float, float]:
    """Width and height in mm of 'A4' (portrait) or '300x200'.

    Parameters
    ----------
    text : str
    where : str, optional
        Named in errors.

    Raises
    ------
    InputError
        No paper is called so, or it is too small or large for a sheet (80 mm to 5 m).
    """
    if text.strip().upper() in PAPERS:
        return PAPERS[text.strip().upper()]
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*[xX×*]\s*(\d+(?:\.\d+)?)\s*(?:mm)?\s*", text)
    if not found:
        hint = did_you_mean(text, PAPERS)
        raise InputError(
            f"'{text}' is no paper", where=where, hint=hint or f"one of {', '.join(PAPERS)}, or 300x200 in mm"
        )
    width, height = float(found[1]), float(found[2])
    if not (min(width, height) >= 80.0 and max(width, height) <= 5000.0):
        raise InputError(
            f"a sheet of {width:g} x {height:g} mm cannot be laid out",
            where=where,
            hint="give sides from 80 to 5000 mm",
        )
    return width, height


def parse_scale(text: str, where: str | None = None) -> float:
    """Denominator of '1:5000', '1:25 000' or '5000'.

    Parameters
    ----------
    text : str
    where : str, optional
        Named in errors.

    Raises
    ------
    InputError
        It is no scale, or 0.
    """
    found = re.fullmatch(r"\s*(?:1\s*[:/]\s*)?((?:\d+|\d{1,3}(?:[\s'’,\u202f]\d{3})+)(?:\.\d+)?)\s*", text)
    value = float(re.sub(r"[\s'’,\u202f]", "", found[1])) if found else 0.0
    if not 0.0 < value < float("inf"):
        raise InputError(f"'{text}' is no scale", where=where, hint="write 1:5000")
    return value


def scale_text(denominator: float) -> str:
    """Scale as it is typed: 1:25000.

    Parameters
    ----------
    denominator : float
    """
    return f"1:{denominator:.10g}"


def _scale(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else parse_scale(value)


def _paper(value: str) -> str:
    paper_size(value)
    return value


@dataclass(frozen=True, kw_only=True)
class StretchOptions(CheckedOptions, group="colour"):
    """Options of how a raster is shown on 8 bits; what is not given follows from its samples or the layout."""

    bands: tuple[int, ...] | None = option(
        None, "Bands of the images to use, such as 1,2,3.", shown="all but alpha", metavar="NUMBERS", flag="-b --bidx",
        group="input",
    )  # fmt: skip
    stretch: str | None = option(
        None, "Stretch of the values, from the whole raster.", choices=("none", "percentile", "linear", "equalise"),
        shown="percentile for other than 8 bits",
    )  # fmt: skip
    limits: tuple[float, float] | None = option(None, "Values that become black and white: linear.", metavar="LOW HIGH")
    percentiles: tuple[float, float] | None = option(
        None, "Percentiles that do.", least=0.0, most=100.0, shown="2 98", metavar="LOW HIGH"
    )
    gamma: float | None = option(None, "Above 1 brightens the middle.", above=0.0, most=10.0)
    clahe: float | None = option(None, "Local contrast; 2 is moderate.", least=0.0, most=100.0, metavar="LIMIT")
    sharpen: float | None = option(None, "Unsharp mask; 0.5 is moderate.", least=0.0, most=10.0, metavar="AMOUNT")
    hillshade: Path | None = option(None, "Blend with the hillshade of this DEM.", metavar="DEM")


@dataclass(frozen=True, kw_only=True)
class EnhanceOptions(StretchOptions, SelfContainedOptions):
    """Options of a picture for print: how the raster is shown, and how far its sharpening reaches."""

    radius: float | None = option(
        None, "Of sharpening, pixels.", least=0.3, most=50.0, shown="1", group="colour", needs=("sharpen",)
    )


# Models of the pan band.
PAN_METHODS = ("regression", "brovey", "weighted")


@dataclass(frozen=True)
class PanOptions(SelfContainedOptions, group="colour"):
    """Options of pan-sharpening: the panchromatic raster, and how its detail is added."""

    pan: Path | None = option(None, "Sharpen the bands with this panchromatic raster; keeps the sample type.")
    method: str | None = option(None, "Of pan-sharpening.", choices=PAN_METHODS, shown=PAN_METHODS[0], needs=("pan",))


@dataclass(frozen=True)
class FileOptions(CheckedOptions):
    """Options of the files of sheets."""

    driver: str = option(
        "GTiff", "Of .tif; PDF: make .pdf a raster GeoPDF of the map alone.", choices=("GTiff", "COG", "PDF"),
        flag="-f --driver",
    )  # fmt: skip
    collar: bool = option(
        False, "Write the whole page to .tif or a raster GeoPDF, not the map alone.",
        needs=("output=.tif", "driver=PDF"),
    )  # fmt: skip
    world_file: bool = option(False, "Write a world file beside .tif and .png.", needs=("output=.png", "output=.tif"))


@dataclass(frozen=True)
class ContourOptions(SelfContainedOptions):
    """Options of contours and spot heights; what is not given follows from the DEM.

    Attributes
    ----------
    interval : float, optional
        Metres; a round one that gives about 20 contours.
    index : int
        Contours from one main (index) contour to the next.
    tolerance : float, optional
        Metres of height that smoothing may change; 0 for none.
    min_length : float, optional
        Shorter rings are left out; units of the DEM's CRS.
    prominence : float, optional
        Metres by which spot heights stand out at least; 0 for no spot heights.
    spacing : float, optional
        Least distance of spot heights, units of the DEM's CRS.
    """

    interval: float | None = option(None, "Interval.", above=0.0, metavar="METRES", shown="about 20 lines")
    index: int = option(5, "Contours from one main (index) contour to the next.", least=1, shown="5")
    tolerance: float | None = option(
        None, "Height that smoothing may change; 0 for none.", least=0.0, metavar="METRES",
        shown="a tenth of the interval",
    )  # fmt: skip
    min_length: float | None = option(None, "Leave out shorter rings.", least=0.0, metavar="UNITS", shown="8 nodes")
    prominence: float | None = option(
        None, "Spot heights: summits and hollows with at least this prominence, metres; 0 for none.", least=0.0,
        metavar="METRES", shown="the interval",
    )  # fmt: skip
    spacing: float | None = option(
        None, "Least distance of spot heights.", least=0.0, metavar="UNITS", shown="20 nodes",
        idle_with=("prominence=0.0",),
    )  # fmt: skip


@dataclass(frozen=True)
class WaterOptions(CheckedOptions, group="geometry"):
    """Options of areas that may be water.

    Attributes
    ----------
    min_area : float, optional
        Square metres; 40 cells, and never less.
    tilt : float
        Largest slope of an area as a whole.
    """

    min_area: float | None = option(None, "Smallest water, square metres.", above=0.0, metavar="M2", shown="40 cells")
    tilt: float = option(0.003, "Largest slope of an area as a whole.", least=0.0, flag=None)


@dataclass(frozen=True, kw_only=True)
class SchemeOptions(SelfContainedOptions, group="geometry"):
    """Division of the ground into sheets.

    Attributes
    ----------
    scheme : str, optional
        Name of a scheme.
    scale : float, optional
        Denominator of the sheets.
    size : tuple of float, optional
        Width and height of sheets of 'mgrs' and 'grid', map units.
    origin : tuple of float
        x, y of 'grid'.
    crs : str, optional
        Of 'grid'.
    polygons : str, optional
        FILE or FILE#LAYER of sheets that are drawn, instead of a scheme.
    name_column : str
        Of their names.
    """

    scheme: str | None = option(
        None, "How the ground is divided; see `geomosaic sheets`.", metavar="NAME", idle_with=("polygons",)
    )
    scale: float | None = option(None, "Scale of the sheets.", parse=_scale, least=1.0, metavar="1:N")
    size: tuple[float, float] | None = option(
        None, "Width and height of sheets of 'mgrs' and 'grid', map units.", above=0.0, metavar="W H",
        needs=("scheme=mgrs", "scheme=grid"),
    )  # fmt: skip
    origin: tuple[float, float] = option((0.0, 0.0), "Of 'grid'.", metavar="X Y", shown="0 0", needs=("scheme=grid",))
    crs: str | None = option(None, "Of 'grid'.", metavar="CRS", needs=("scheme=grid",))
    polygons: str | None = option(
        None, "Sheets that are drawn, instead of a scheme.", metavar="FILE[#LAYER]", group="input"
    )
    name_column: str = option("name", "Column of their names.", needs=("polygons",), metavar="NAME", group="input")


@dataclass(frozen=True, kw_only=True)
class SeriesOptions(WorkerOptions):
    """Sheets of a series that are made.

    Attributes
    ----------
    format : str
        'pdf', 'png', 'tif', 'mbtiles' or 'kmz'.
    overlap : float
        Reach of a sheet beyond its edges, map units.
    only : tuple of str
        Names of the sheets to make; all unless given.
    workers
        See `WorkerOptions`.
    """

    format: str = option("pdf", "Format of the sheets.", choices=("pdf", "png", "tif", "mbtiles", "kmz"))
    overlap: float = option(0.0, "Reach beyond the edges.", least=0.0, metavar="UNITS", shown="0", group="geometry")
    only: tuple[str, ...] = option((), "This sheet; any number of times.", metavar="SHEET", shown="all")


@dataclass(frozen=True, kw_only=True)
class SheetOptions(CheckedOptions, group="input"):
    """Options of a map sheet; what is given here wins over the layout file."""

    layout: Path | None = option(None, "Layout of the sheet (TOML).")
    scale: float | None = option(
        None, "Scale.", parse=_scale, least=1.0, metavar="1:N", shown="the largest round one that fits",
        group="geometry",
    )  # fmt: skip
    paper: str | None = option(
        None, "A0 to A4, or millimetres.", parse=_paper, metavar="NAME|WxH", shown="A3", group="geometry"
    )
    orientation: str | None = option(
        None, "Paper on its long or short side.", choices=("landscape", "portrait"), flag=None, group="geometry"
    )
    bounds: tuple[float, float, float, float] | None = option(
        None, "Area in map units.", parse=parse_bounds, metavar="LEFT BOTTOM RIGHT TOP",
        shown="what fits of the raster", group="geometry",
    )  # fmt: skip
    title: str | None = option(
        None, "Title of the sheet.",
        needs=("collar", "driver=PDF", "output=.pdf", "output=.png", "output=.mbtiles", "output=.kmz"),
    )  # fmt: skip
    vectors: tuple[str, ...] = option(
        (), "Vector layer to draw; later ones lie above.", metavar="FILE[#LAYER][:STYLE]", flag="--vector"
    )
    contours: Path | None = option(None, "Draw contours of this DEM.", metavar="DEM")
    interval: float | None = option(
        None, "Interval of the contours.", above=0.0, metavar="METRES", needs=("contours",), group="geometry"
    )
    dem_heights: str | None = option(
        None, "Vertical datum of the DEM, where the file does not say it.", metavar="DATUM",
        needs=("contours", "hillshade"),
    )  # fmt: skip
    report: Path | None = option(
        None, "report.json of the project.", shown="that beside the raster",
        needs=("collar", "output=.pdf", "output=.png"), idle_with=("panel=none",),
    )  # fmt: skip
    dpi: int | None = option(None, "Resolution of the picture.", least=72, most=2400, shown="300", group="output")
    look: StretchOptions = field(default_factory=StretchOptions)
    files: FileOptions = field(default_factory=FileOptions)
