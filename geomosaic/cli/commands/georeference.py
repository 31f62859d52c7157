"""Place one image on the map by control points.

Help group: Orthos and mosaics
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import (
    FILE,
    area_options,
    band_option,
    check_memory,
    control_options,
    extent,
    near_option,
    options_of,
    output_option,
    running_options,
    stack,
)
from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.output import answer, notes, progress, say
from geomosaic.options.inputs import Area
from geomosaic.options.render import RenderOptions

MODELS = ("auto", "conformal", "affine", "projective", "poly1", "poly2", "poly3", "poly4", "poly5", "tps")

georeference_options = stack(
    click.option(
        "--gcps",
        type=FILE,
        help="Control points: a table, QGIS .points, gcp_list.txt, a raster or a world file.  "
        "[default: those in the image, or a world file beside it]",
    ),
    click.option(
        "--model",
        type=click.Choice(MODELS),
        default="auto",
        show_default=True,
        help="Fit: auto takes the one of the smallest errors at points left out.",
    ),
    control_options,
    near_option,
    click.option(
        "--fit-crs",
        metavar="CRS",
        help="CRS in which the fit is made.  [default: that of the points, where projected; else of the output]",
    ),
    click.option("--without", multiple=True, metavar="POINT", help="Leave a point out; any number of times."),
    click.option(
        "--threshold",
        type=click.FloatRange(0, min_open=True),
        metavar="PIXELS",
        help="Delete the worst point and fit again, until the total RMS is below.",
    ),
    click.option("--robust", is_flag=True, help="Leave out the points that data snooping and M-estimator reject."),
    click.option("--report/--no-report", default=True, show_default=True, help="Write the control report beside it."),
    band_option,
    group="input",
)


@grouped_command()
@click.argument("image", type=FILE)
@stack(
    georeference_options,
    area_options,
    output_option,
    options_of(RenderOptions, without=("true_ortho",)),
    running_options,
)
def command(
    image: Path, output: Path, as_json: bool, options: RenderOptions, area: Area, chosen: dict[str, Any], **flags: Any
) -> None:
    """Place an image on the map by control points, and draw it there.

    Beside the output stands the control report: NAME-control.html for people, .json for programs, .gpkg with the
    residual vectors for a GIS.

    \b
    Examples:
      geomosaic georeference scan.tif --gcps scan.points --crs EPSG:32633 -o map.tif
      geomosaic georeference photo.jpg --gcps gcps.csv --model projective --dst-crs EPSG:2180 -o map.tif
    """
    from geomosaic.api.control import georeference
    from geomosaic.cli.measured_results import georeference_words
    from geomosaic.cli.results import ortho_facts
    from geomosaic.georeferencing.fit_diagnostics import BadControlError

    check_memory()
    try:
        with notes(), progress(as_json) as bars:
            made = georeference(image, output, **flags, **chosen, **extent(area), render=options.with_progress(bars))
    except BadControlError as error:
        for found in error.diagnostics:
            if found.severity != "error":
                say(str(found))
        raise
    for found in made.solution.diagnostics:
        say(str(found))
    answer({**ortho_facts(made.product), **made.facts}, georeference_words(made), as_json)
