"""Make, find and show the sheets of a series.

Help group: Maps
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geomosaic.cli.options import FILE, options_of, running_options
from geomosaic.cli.output import answer, notes, progress
from geomosaic.cli.values import Number
from geomosaic.errors import counted
from geomosaic.options.sheet import SchemeOptions, SeriesOptions, SheetOptions

if TYPE_CHECKING:
    from geomosaic.sheets.series.inputs import FoundSheet

scheme_options = options_of(SchemeOptions, "division")


@click.group()
def command() -> None:
    """Make, find and show the sheets of a series.

    \b
    Schemes:
      international  division of the international map 1:1 000 000, WGS 84; sheets in UTM
      puwg1992       the same on ETRS89, as in Poland; sheets in PUWG 1992 (EPSG:2180)
      soviet         the same on Pulkovo 1942, Russian letters; sheets in Gauss-Krüger
      tk             German TK 25, TK 50, TK 100, TÜK 200, on DHDN; sheets in UTM
      ign            French 1:50 000 and 1:25 000, on NTF; sheets in Lambert-93
      mgrs           UTM squares: --size 100000 100000, or 10000, 1000, 100
      grid           any size in any CRS: --size W H --crs CRS
    """


@command.command("make")
@click.argument("raster", type=FILE)
@scheme_options
@options_of(SeriesOptions, "series")
@options_of(SheetOptions, without=("scale", "bounds", "orientation"))
@click.option("-o", "--output", type=FILE, required=True, help="Folder for the sheets and their index.")
@running_options
def make_command(
    raster: Path,
    output: Path,
    as_json: bool,
    division: dict[str, Any],
    series: dict[str, Any],
    options: dict[str, Any],
) -> None:
    """Make all sheets of a series that show something of a raster, and their index.

    Sheets that are finished and were made of the same are kept, so that the same command goes on where it was stopped.

    \b
    Example:
      geomosaic sheets make mosaic.tif --scheme puwg1992 --scale 1:10000 -o sheets/
    """
    from geomosaic.sheets.series.inputs import sheet_scheme, sheet_series

    with notes(), progress(as_json) as bars:
        made = sheet_series(raster, output, sheet_scheme(**division), progress=bars, **series, **options)
    facts = {
        "sheets": list(made.names),
        "made": [str(path) for path in made.made],
        "kept": [str(path) for path in made.kept],
        "index": [str(path) for path in made.index],
    }  # fmt: skip
    words = f"{counted(len(made.names), 'sheet')} in {output}: {len(made.made)} made, {len(made.kept)} there already"
    answer(facts, f"{words}\nindex: {', '.join(path.name for path in made.index)}", as_json)


@command.command("find", context_settings={"ignore_unknown_options": True})
@click.argument("longitude", type=Number())
@click.argument("latitude", type=Number())
@scheme_options
@running_options
def find_command(longitude: float, latitude: float, as_json: bool, division: dict[str, Any]) -> None:
    """Find the sheet at a longitude and latitude (WGS 84, degrees)."""
    from geomosaic.sheets.series.inputs import find_sheet, sheet_scheme

    found = find_sheet(sheet_scheme(**division), (longitude, latitude))
    answer(_facts(found), found.name, as_json)


@command.command("show")
@click.argument("name")
@scheme_options
@click.option("--map-crs", metavar="CRS", help="Show the corners in this CRS too.  [default: that of the scheme]")
@running_options
def show_command(name: str, map_crs: str | None, as_json: bool, division: dict[str, Any]) -> None:
    """Show the corners and neighbours of a sheet."""
    from geomosaic.sheets.series.inputs import find_sheet, sheet_scheme

    found = find_sheet(sheet_scheme(**division), name, map_crs=map_crs)
    lines = [f"{found.name}, {found.title}", f"corners in {found.crs}:"]
    lines += [f"  {x:.10g}  {y:.10g}" for x, y in found.corners]
    if found.map_corners is not None:
        lines += [f"corners in {found.map_crs}:", *(f"  {x:.10g}  {y:.10g}" for x, y in found.map_corners)]
    lines += [f"{way}: {other}" for way, other in found.neighbours.items()]
    answer(_facts(found), "\n".join(lines), as_json)


def _facts(found: FoundSheet) -> dict[str, Any]:
    return {name: value for name, value in vars(found).items() if value is not None and name != "title"}
