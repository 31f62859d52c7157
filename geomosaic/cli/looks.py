"""Options on how a picture looks in print."""

from __future__ import annotations

import click

from geomosaic.cli.options import FILE, band_option, stack

stretch_options = stack(
    band_option,
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
