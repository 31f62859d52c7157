"""Place one image, or a drawing, on the map by control points.

Help group: Orthos and mosaics
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import FILE, band_option, options_of, output_option, running_options, stack
from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.output import answer, notes, progress, say
from geomosaic.options.control import GeoreferenceOptions
from geomosaic.options.inputs import QualityLimits


@grouped_command()
@click.argument("image", type=FILE)
@stack(
    options_of(GeoreferenceOptions, without=("snap", "true_ortho")),
    band_option,
    click.option("--report/--no-report", default=True, show_default=True, help="Write the control report beside it."),
    output_option,
    running_options,
)
def command(image: Path, output: Path, report: bool, as_json: bool, options: dict[str, Any]) -> int:
    """Place an image on the map by control points, and draw it there; or a drawing (DXF, GeoPackage, GeoJSON ...).

    Beside the output stands the control report: NAME-control.html for people, .json for programs, .gpkg with the
    residual vectors for a GIS.

    --like RASTER registers the image to another: the output has its CRS, pixels and extent. A table of control
    may then have positions in that raster, ref_col and ref_row, in place of x and y, and the raster needs no CRS.

    --vectors FILE carries vectors drawn over the image to the map: NAME-vectors.gpkg. Where IMAGE is a file of
    vectors itself, in any coordinates of its own, its control has drawing_x and drawing_y, and -o names vectors.

    \b
    Examples:
      geomosaic georeference scan.tif --gcps scan.points --crs EPSG:32633 -o map.tif
      geomosaic georeference scan.tif --reference ortho.tif -o map.tif
      geomosaic georeference may.tif --gcps pairs.csv --like june.tif -o registered.tif
      geomosaic georeference photo.jpg --gcps gcps.csv --model projective --dst-crs EPSG:2180 -o map.tif
      geomosaic georeference scan.tif --gcps scan.points --vectors traced.gpkg -o map.tif
      geomosaic georeference plan.dxf --gcps plan.csv --crs EPSG:32633 -o plan.gpkg
    """
    import geomosaic
    from geomosaic.cli.measured_results import georeference_text
    from geomosaic.cli.results import ortho_facts, placement_failure, quality_facts, verdict
    from geomosaic.georeferencing.fit_diagnostics import BadControlError
    from geomosaic.raster.vector_copy import is_vector

    drawn = is_vector(image)
    try:
        with notes(), progress(as_json) as bars:
            place: Any = geomosaic.georeference_vectors if drawn else geomosaic.georeference
            made = place(image, output, report=report, progress=bars, **options)
    except BadControlError as error:
        for found in error.diagnostics:
            if found.severity != "error":
                say(str(found))
        raise
    for found in made.solution.diagnostics:
        say(str(found))
    expected: dict[str, Any] = {} if options.get("insist") else {"accuracy": made.facts["accuracy"]["expected"]}
    failure = placement_failure(expected, str(made.path), QualityLimits(), "`insist` accepts it")
    product = made.facts["product"] if drawn else ortho_facts(made.product)
    answer({**product, **made.facts, **quality_facts(failure)}, georeference_text(made), as_json)
    return verdict(failure, as_json)
