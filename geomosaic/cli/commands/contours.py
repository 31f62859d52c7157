"""Draw contours of a DEM.

Help group: Maps
"""

from __future__ import annotations

from pathlib import Path

import click

from geomosaic.cli.options import FILE, debug_option, dem_heights_option, json_option, overwrite_option
from geomosaic.cli.output import answer, notes


@click.command()
@click.argument("dem", type=FILE)
@click.option(
    "--interval", type=click.FloatRange(0, min_open=True), metavar="METRES", help="Interval.  [default: about 20 lines]"
)
@click.option(
    "--index", type=click.IntRange(1), default=5, show_default=True, help="Every so many contours, a main one."
)
@click.option(
    "--tolerance",
    type=click.FloatRange(0),
    metavar="METRES",
    help="Height that smoothing may change; 0 for none.  [default: a tenth of the interval]",
)
@click.option(
    "--min-length", type=click.FloatRange(0), metavar="UNITS", help="Leave out shorter rings.  [default: 8 nodes]"
)
@click.option(
    "--prominence",
    type=click.FloatRange(0),
    metavar="METRES",
    help="Spot heights: summits and hollows that stand out by so many metres; 0 for none.  [default: the interval]",
)
@click.option(
    "--spacing", type=click.FloatRange(0), metavar="UNITS", help="Least distance of spot heights.  [default: 20 nodes]"
)
@dem_heights_option
@click.option("-o", "--output", type=FILE, required=True, help="GeoPackage to write.")
@overwrite_option
@json_option
@debug_option
def command(
    dem: Path,
    interval: float | None,
    index: int,
    tolerance: float | None,
    min_length: float | None,
    prominence: float | None,
    spacing: float | None,
    dem_heights: str | None,
    output: Path,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Draw contours and spot heights of a DEM into a GeoPackage.

    Contours are smoothed within a tolerance of height that is measured and told.

    \b
    Example:
      geomosaic contours dem.tif --interval 5 --index 5 -o contours.gpkg
    """
    from dataclasses import asdict

    from geomosaic.errors import counted
    from geomosaic.relief.contours import contours

    with notes():
        made = contours(
            dem, output, interval=interval, index=index, tolerance=tolerance, min_length=min_length,
            dem_heights=dem_heights, prominence=prominence, spacing=spacing, overwrite=overwrite,
        )  # fmt: skip
    facts = {"output" if key == "path" else key: value for key, value in asdict(made).items()}
    words = (
        f"{made.path}: {made.lines} contours every {made.interval:g} m from {made.low:g} to {made.high:g} m, "
        f"{made.index_lines} of them main ones (heights: {made.heights})\n"
        f"within {made.deviation:.3f} m of the DEM's surface (smoothing: tolerance {made.tolerance:g} m)"
        + (
            f"\n{counted(made.summits, 'summit')} and {counted(made.hollows, 'hollow')} that stand out by "
            f"{made.prominence:g} m or more"
            if made.prominence
            else ""
        )
    )
    answer(facts, words, as_json)
