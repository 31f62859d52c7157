"""Bring a georeferenced raster or vectors to another CRS.

Help group: Orthos and mosaics
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geomosaic.cli.memory import check_memory
from geomosaic.cli.options import FILE, area_options, options_of, output_option, running_options, stack
from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.output import answer, notes, progress
from geomosaic.cli.results import ortho_facts, ortho_words
from geomosaic.options.render import RenderOptions

if TYPE_CHECKING:
    from pyproj import CRS


@grouped_command()
@click.argument("source", type=FILE, metavar="INPUT")
@click.option("--src-crs", metavar="CRS", help="CRS of the input, instead of what the file says.")
@click.option("--like", type=FILE, metavar="RASTER", help="Take CRS, pixels and extent of this raster.")
@click.option(
    "--target-aligned-pixels",
    "snap",
    is_flag=True,
    help="Widen --bounds to whole multiples of --res; without --bounds that is always done.",
)
@stack(area_options, output_option)
@options_of(RenderOptions, without=("true_ortho",))
@running_options
def command(
    source: Path,
    src_crs: str | None,
    like: Path | None,
    snap: bool,
    output: Path,
    as_json: bool,
    options: RenderOptions,
    **flags: Any,
) -> None:
    """Bring a georeferenced raster, or a file of vectors, to another CRS.

    \b
    Examples:
      geomosaic reproject lambert.tif --dst-crs EPSG:32631 --res 0.5 -o utm.tif
      geomosaic reproject roads.gpkg --dst-crs EPSG:32631 -o roads-utm.gpkg

    Grids of datum shifts are looked for in the folders that the environment variable PROJ_DATA names, too.
    """
    from geomosaic.reprojection import is_vector

    if like is None and flags["dst_crs"] is None:
        raise click.UsageError("say where to: --dst-crs, or --like RASTER")
    if like is not None and (flags["dst_crs"] or flags["res"] or flags["bounds"]):
        raise click.UsageError("--like says CRS, pixels and extent: leave out --dst-crs, --res and --bounds")
    if like is not None and snap:
        raise click.UsageError("--like says where the pixels lie: leave out --target-aligned-pixels")
    if is_vector(source):
        _refuse_for_rasters()
        _vectors(source, src_crs, like, output, as_json, options.overwrite, flags)
        return
    from geomosaic.api.orthos import reproject_raster
    from geomosaic.geo.crs import parse_map
    from geomosaic.inputs.rasters import check_placed
    from geomosaic.raster.info import inspect
    from geomosaic.render.extent import Area, grid_of

    check_memory()
    with notes(), progress(as_json) as report:
        target = grid_of(like).crs if like is not None else parse_map(flags["dst_crs"], "--dst-crs")
        own = check_placed(inspect(source), parse_map(src_crs, "--src-crs") if src_crs else None)
        area = Area(flags["dst_crs"], flags["res"], flags["bounds"], snap, like)
        result = reproject_raster(source, output, target, area, src_crs, options.with_progress(report))
    words = _operation(own, result.grid.crs)
    answer({**ortho_facts(result), "operation": words}, f"{ortho_words(result)}\n{words}", as_json)


_OF_RASTERS = {
    "res": "--res", "bounds": "--bounds", "snap": "--target-aligned-pixels", "resampling": "--resampling",
    "tolerance": "--tolerance", "nodata": "--nodata", "driver": "--driver", "creation": "--co",
}  # fmt: skip


def _refuse_for_rasters() -> None:
    """Refuse options that would do nothing."""
    given = click.get_current_context().get_parameter_source
    useless = [flag for name, flag in _OF_RASTERS.items() if given(name) == click.core.ParameterSource.COMMANDLINE]
    if useless:
        raise click.UsageError(f"vectors have no pixels and are not clipped: leave out {', '.join(useless)}")


def _vectors(
    source: Path,
    src_crs: str | None,
    like: Path | None,
    output: Path,
    as_json: bool,
    overwrite: bool,
    flags: dict[str, Any],
) -> None:
    from geomosaic.geo.crs import parse_map
    from geomosaic.render.extent import grid_of
    from geomosaic.reprojection import reproject_vectors

    with notes():
        crs = parse_map(flags["dst_crs"], "--dst-crs") if like is None else grid_of(like).crs
        own = parse_map(src_crs, "--src-crs") if src_crs else None
        result = reproject_vectors(source, crs, output, source=own, overwrite=overwrite)
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
