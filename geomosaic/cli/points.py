"""Options of commands that read points, and what they make of them."""

from __future__ import annotations

import math
from typing import Any

import click

from geomosaic.cli.options import stack


def longitude_latitude(
    ctx: click.Context, param: click.Parameter, value: tuple[float, float] | None
) -> tuple[float, float] | None:
    """Check a place in degrees."""
    if value is None:
        return None
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

wrong_point_options = stack(
    click.option("--robust", is_flag=True, help="Leave out tie and control points that contradict the others."),
    click.option("--insist", is_flag=True, help="Go on with points that are grossly wrong."),
)
