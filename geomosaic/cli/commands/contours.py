"""Draw contours of a DEM.

Help group: Maps
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import FILE, dem_heights_option, file_options, options_of
from geomosaic.cli.output import answer, notes
from geomosaic.errors import counted
from geomosaic.options.sheet import ContourOptions


@click.command()
@click.argument("dem", type=FILE)
@options_of(ContourOptions)
@dem_heights_option
@file_options("GeoPackage to write.")
def command(
    dem: Path,
    dem_heights: str | None,
    output: Path,
    overwrite: bool,
    as_json: bool,
    options: dict[str, Any],
) -> None:
    """Draw contours and spot heights of a DEM into a GeoPackage.

    Contours are smoothed within a tolerance of height that is measured and told.

    \b
    Example:
      geomosaic contours dem.tif --interval 5 --index 5 -o contours.gpkg
    """
    from dataclasses import asdict

    from geomosaic.relief.contours import contours

    with notes():
        made = contours(dem, output, dem_heights=dem_heights, overwrite=overwrite, **options)
    facts = {"output" if key == "path" else key: value for key, value in asdict(made).items()}
    words = (
        f"{made.path}: {counted(made.lines, 'contour')} every {made.interval:g} m from {made.low:g} to "
        f"{made.high:g} m, {made.index_lines} of them main ones (heights: {made.heights})\n"
        f"within {made.deviation:.3f} m of the DEM's surface (smoothing: tolerance {made.tolerance:g} m)"
        + (
            f"\n{counted(made.summits, 'summit')} and {counted(made.hollows, 'hollow')} that stand out by "
            f"{made.prominence:g} m or more"
            if made.prominence
            else ""
        )
    )
    answer(facts, words, as_json)
