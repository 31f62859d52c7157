"""Bring a georeferenced raster or vectors to another CRS.

Help group: Orthos and mosaics
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geomosaic.cli.options import FILE, options_of, output_option, running_options
from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.output import answer, notes, progress
from geomosaic.cli.results import ortho_facts, ortho_text
from geomosaic.errors import counted
from geomosaic.options.inputs import Area
from geomosaic.options.render import RenderOptions

if TYPE_CHECKING:
    from geomosaic.reprojection import VectorResult


@grouped_command()
@click.argument("source", type=FILE, nargs=-1, required=True, metavar="INPUT...")
@click.option("--src-crs", metavar="CRS", help="CRS of the input, instead of what the file says.")
@options_of(Area)
@output_option
@options_of(RenderOptions, without=("true_ortho",))
@running_options
def command(
    source: tuple[Path, ...], src_crs: str | None, output: Path, as_json: bool, options: dict[str, Any]
) -> None:
    """Bring a georeferenced raster, or a file of vectors, to another CRS; several rasters as one of all their bands.

    \b
    Examples:
      geomosaic reproject lambert.tif --dst-crs EPSG:32631 --res 0.5 -o utm.tif
      geomosaic reproject B02.jp2 B03.jp2 B11.jp2 --dst-crs EPSG:3035 --res 10 -o stack.tif
      geomosaic reproject roads.gpkg --dst-crs EPSG:32631 -o roads-utm.gpkg

    Grids of datum shifts are looked for in the folders that the environment variable PROJ_DATA names, too.
    """
    from geomosaic.products.orthos import reproject
    from geomosaic.reprojection import VectorResult

    with notes(), progress(as_json) as report:
        made = reproject(source, output, src_crs=src_crs, progress=report, **options)
    if isinstance(made, VectorResult):
        facts = {"output": str(made.path), "layers": made.layers, "lost": made.lost, "cut": made.cut}
        words = _vector_text(made)
    else:
        facts, words = ortho_facts(made), ortho_text(made)
    answer({**facts, "operation": made.operation}, f"{words}\n{made.operation}", as_json)


def _vector_text(made: VectorResult) -> str:
    layers = ", ".join(f"{name}: {counted(count, 'feature')}" for name, count in made.layers.items())
    lost = f"; left out, without a place in {made.crs.name}: {counted(made.lost, 'feature')}" if made.lost else ""
    cut = f"; {made.cut} reach over the edge of that map and were cut there" if made.cut else ""
    return f"{made.path}: {layers}{lost}{cut}"
