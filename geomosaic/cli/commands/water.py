"""Propose areas of water, from a mosaic and a DEM.

Help group: Orthos and mosaics
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import FILE, dem_heights_option, file_options, options_of
from geomosaic.cli.output import answer, notes
from geomosaic.errors import counted
from geomosaic.options.sheet import WaterOptions


@click.command()
@click.argument("image", type=FILE)
@click.option("--dem", type=FILE, required=True, help="Heights of the ground.")
@dem_heights_option
@options_of(WaterOptions)
@file_options("GeoPackage to write.")
def command(
    image: Path,
    dem: Path,
    dem_heights: str | None,
    output: Path,
    overwrite: bool,
    as_json: bool,
    options: dict[str, Any],
) -> None:
    """Propose areas of water: level and even, and lower than their shores.

    Look at them, correct them, and give the file to geomosaic mosaic --water.

    \b
    Example:
      geomosaic water mosaic.tif --dem dem.tif -o water.gpkg
    """
    from geomosaic.mosaicking.water_proposal import propose_water

    with notes():
        made = propose_water(image, dem, output, dem_heights=dem_heights, overwrite=overwrite, **options)
    facts = {
        "output": str(made.path),
        "areas_m2": [round(area, 1) for area in made.areas],
        "cell_m": made.cell,
        "smallest_m2": made.smallest,
        "heights": made.heights,
    }
    found = f"{counted(len(made.areas), 'area')} that may be water"
    words = (
        f"{made.path}: {found}, of {sum(made.areas) / 1e4:.4g} ha together (cells of {made.cell:g} m, areas from "
        f"{made.smallest:.4g} m2)\nthese are proposals: look at them and correct them, then give them to --water"
    )
    answer(facts, words, as_json)
