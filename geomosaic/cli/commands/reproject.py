"""Bring a georeferenced raster or vectors to another CRS.

Help group: Orthos and mosaics
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geomosaic.cli.memory import check_memory
from geomosaic.cli.options import FILE, options_of, output_option, running_options
from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.output import answer, notes, progress
from geomosaic.cli.results import ortho_facts, ortho_words
from geomosaic.options.inputs import Area
from geomosaic.options.render import RenderOptions

if TYPE_CHECKING:
    from pyproj import CRS

    from geomosaic.reprojection import VectorResult


@grouped_command()
@click.argument("source", type=FILE, metavar="INPUT")
@click.option("--src-crs", metavar="CRS", help="CRS of the input, instead of what the file says.")
@options_of(Area, "area")
@output_option
@options_of(RenderOptions, "render", made=False, without=("true_ortho",))
@running_options
def command(
    source: Path,
    src_crs: str | None,
    output: Path,
    as_json: bool,
    area: Area,
    render: dict[str, Any],
) -> None:
    """Bring a georeferenced raster, or a file of vectors, to another CRS.

    \b
    Examples:
      geomosaic reproject lambert.tif --dst-crs EPSG:32631 --res 0.5 -o utm.tif
      geomosaic reproject roads.gpkg --dst-crs EPSG:32631 -o roads-utm.gpkg

    Grids of datum shifts are looked for in the folders that the environment variable PROJ_DATA names, too.
    """
    from dataclasses import asdict

    from geomosaic.api.orthos import reproject
    from geomosaic.geo.crs import parse_map
    from geomosaic.inputs.rasters import check_placed
    from geomosaic.raster.info import inspect
    from geomosaic.reprojection import VectorResult

    check_memory()
    with notes(), progress(as_json) as report:
        options = {**render, "progress": report}
        result = reproject(source, output, src_crs=src_crs, **{**asdict(area), "like": area.like}, **options)
        if isinstance(result, VectorResult):
            _tell_vectors(result, as_json)
            return
        own = check_placed(inspect(source), parse_map(src_crs, "`src_crs`") if src_crs else None)
    words = _operation(own, result.grid.crs)
    answer({**ortho_facts(result), "operation": words}, f"{ortho_words(result)}\n{words}", as_json)


def _tell_vectors(result: VectorResult, as_json: bool) -> None:
    crs = result.crs
    words = "; ".join(_operation(found, crs) for found in result.sources)
    layers = ", ".join(f"{name}: {count} features" for name, count in result.layers.items())
    lost = f"; {result.lost} features have no place in {crs.name} and were left out" if result.lost else ""
    cut = f"; {result.cut} reach over the edge of that map and were cut there" if result.cut else ""
    facts = {"output": str(result.path), "layers": result.layers, "lost": result.lost, "cut": result.cut}
    answer({**facts, "operation": words}, f"{result.path}: {layers}{lost}{cut}\n{words}", as_json)


def _operation(source: CRS, target: CRS) -> str:
    """Say how the two CRS are joined, and what would be better."""
    from geomosaic.geo.crs import horizontal
    from geomosaic.geo.transform import operation_between

    return f"{source.name} to {target.name}: {operation_between(horizontal(source), horizontal(target)).words()}"
