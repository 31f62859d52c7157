"""Options that a sheet and the sheets of a series share."""

from __future__ import annotations

from collections.abc import Callable

import click

from geomosaic.cli.looks import look_options
from geomosaic.cli.options import FILE, dem_heights_option, stack


def scale_value(ctx: click.Context, param: click.Parameter, value: str | None) -> str | None:
    """Check that a scale is one; it stays text."""
    from geomosaic.carto.layout import parse_scale

    return _checked(parse_scale, value)


def paper_value(ctx: click.Context, param: click.Parameter, value: str | None) -> str | None:
    """Check that a paper is one; it stays text."""
    from geomosaic.carto.layout import paper_size

    return _checked(paper_size, value)


def _checked(read: Callable[[str], object], value: str | None) -> str | None:
    from geomosaic.errors import InputError

    if value is not None:
        try:
            read(value)
        except InputError as error:
            raise click.BadParameter(f"{error.what}; {error.mend}") from None
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
