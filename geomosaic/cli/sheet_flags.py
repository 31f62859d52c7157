"""Options of sheets, print enhancement and point files."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import click

from geomosaic.cli.options import FILE, dem_heights_option, stack
from geomosaic.cli.values import band_numbers

stretch_options = stack(
    click.option(
        "-b",
        "--bidx",
        "bands",
        multiple=True,
        callback=band_numbers,
        metavar="NUMBERS",
        help="Bands to use, such as 1,2,3.  [default: the first three, or the first]",
    ),
    click.option(
        "--stretch",
        type=click.Choice(["none", "percentile", "linear", "equalise"]),
        help="Stretch of the values, from the whole raster.  [default: percentile for other than 8 bits]",
    ),
    click.option(
        "--limits", nargs=2, type=float, metavar="LOW HIGH", help="Values that become black and white: linear."
    ),
    click.option(
        "--percentiles",
        nargs=2,
        type=click.FloatRange(0, 100),
        metavar="LOW HIGH",
        help="Percentiles that do.  [default: 2 98]",
    ),
    click.option("--gamma", type=click.FloatRange(0, 10, min_open=True), help="Above 1 brightens the middle."),
    click.option("--clahe", type=click.FloatRange(1, 100), metavar="LIMIT", help="Local contrast; 2 is moderate."),
    click.option("--sharpen", type=click.FloatRange(0, 10), metavar="AMOUNT", help="Unsharp mask; 0.5 is moderate."),
)
look_options = stack(
    stretch_options,
    click.option("--hillshade", type=FILE, metavar="DEM", help="Blend with the hillshade of this DEM."),
)


def scale_value(ctx: click.Context, param: click.Parameter, value: str | None) -> str | None:
    """Callback of click that checks a scale, such as 1:5000; it stays text.

    Parameters
    ----------
    ctx, param
        Of click.
    value : str or None

    Returns
    -------
    str or None

    Raises
    ------
    click.BadParameter
    """
    from geomosaic.options.sheet import parse_scale

    return _checked(parse_scale, value)


def paper_value(ctx: click.Context, param: click.Parameter, value: str | None) -> str | None:
    """Callback of click that checks a paper size, such as A3; it stays text.

    Parameters
    ----------
    ctx, param
        Of click.
    value : str or None

    Returns
    -------
    str or None

    Raises
    ------
    click.BadParameter
    """
    from geomosaic.options.sheet import paper_size

    return _checked(paper_size, value)


def _checked(read: Callable[[str], object], value: str | None) -> str | None:
    from geomosaic.errors import InputError

    if value is not None:
        try:
            read(value)
        except InputError as error:
            raise click.BadParameter(f"{error.what}; {error.hint}") from None
    return value


content_options = stack(
    click.option("--title", help="Title of the sheet."),
    click.option(
        "--vector",
        "vectors",
        multiple=True,
        metavar="FILE[#LAYER][:STYLE]",
        help="Vector layer to draw; later ones lie above.",
    ),
    click.option("--contours", type=FILE, metavar="DEM", help="Draw contours of this DEM."),
    click.option(
        "--interval", type=click.FloatRange(0, min_open=True), metavar="METRES", help="Interval of the contours."
    ),
    dem_heights_option,
    look_options,
    click.option("--report", type=FILE, help="report.json of the project.  [default: that beside the raster]"),
    click.option("--dpi", type=click.IntRange(72, 2400), help="Resolution of the picture.  [default: 300]"),
)

file_options = stack(
    click.option(
        "-f",
        "--driver",
        type=click.Choice(["GTiff", "COG", "PDF"]),
        default="GTiff",
        show_default=True,
        help="Of .tif; PDF: make .pdf a raster GeoPDF of the map alone.",
    ),
    click.option("--collar", is_flag=True, help="Write the whole page to .tif or a raster GeoPDF, not the map alone."),
    click.option("--world-file", is_flag=True, help="Write a world file beside .tif and .png."),
)


def longitude_latitude(
    ctx: click.Context, param: click.Parameter, value: tuple[float, float] | None
) -> tuple[float, float] | None:
    """Callback of click that checks a place.

    Parameters
    ----------
    ctx, param
        Of click.
    value : tuple of float or None
        Longitude and latitude, degrees.

    Returns
    -------
    tuple of float or None

    Raises
    ------
    click.BadParameter
    """
    if value is None:
        return None
    # Longitudes beyond 180 degrees are in use across the date line.
    if not (all(map(math.isfinite, value)) and abs(value[0]) <= 360.0 and abs(value[1]) <= 90.0):
        raise click.BadParameter("write longitude and latitude in degrees, such as 16.5 48.8")
    return value


control_options = stack(
    click.option("--crs", metavar="CRS", help="CRS of the points' ground coordinates, where the file names none."),
    click.option(
        "--pixels",
        type=click.Choice(["corner", "centre"]),
        help="What (0, 0) is in a table: the corner of the upper-left pixel, or its centre.  "
        "[default: corner; centre for gcp_list.txt]",
    ),
    click.option("--rows", type=click.Choice(["up", "down"]), help="Way rows count in a QGIS file of unusual sign."),
    click.option("--insist", is_flag=True, help="Go on where points look wrong (advice of severity error)."),
)

near_option: Any = click.option(
    "--near",
    type=float,
    nargs=2,
    callback=longitude_latitude,
    metavar="LON LAT",
    help="A place near the image, degrees: tells a wrong zone from the right one.",
)
