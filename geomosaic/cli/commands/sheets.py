"""Make, find and show the sheets of a series.

Help group: Maps
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geomosaic.cli.options import FILE, debug_option, json_option, options_of, stack
from geomosaic.cli.output import answer, notes, progress
from geomosaic.cli.values import Scale
from geomosaic.options.sheet import SheetOptions

if TYPE_CHECKING:
    from geomosaic.sheets.series.regular import Scheme

scheme_options = stack(
    click.option("--scheme", metavar="NAME", help="How the ground is divided; see the list above."),
    click.option("--scale", type=Scale(), help="Scale of the sheets."),
    click.option("--size", type=float, nargs=2, metavar="W H", help="Sheets of 'mgrs' or 'grid', map units."),
    click.option("--origin", type=float, nargs=2, default=(0.0, 0.0), metavar="X Y", help="Of 'grid'."),
    click.option("--crs", metavar="CRS", help="Of 'grid'."),
    click.option("--polygons", metavar="FILE[#LAYER]", help="Sheets that are drawn, instead of a scheme."),
    click.option("--name-column", default="name", show_default=True, help="Column of their names."),
)


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


def _scheme(flags: dict[str, Any]) -> Scheme:
    from geomosaic.errors import InputError
    from geomosaic.sheets.series.inputs import sheet_scheme

    found = {key: flags.pop(key) for key in ("scheme", "scale", "size", "origin", "crs", "polygons", "name_column")}
    if (found["scheme"] is None) == (found["polygons"] is None):
        raise InputError(
            "sheets need a scheme or polygons", where="--scheme", hint="give --scheme NAME or --polygons FILE"
        )
    return sheet_scheme(**found)


@command.command("make")
@click.argument("raster", type=FILE)
@scheme_options
@click.option("--overlap", type=click.FloatRange(0), default=0.0, metavar="UNITS", help="Reach beyond the edges.")
@click.option("--only", multiple=True, metavar="SHEET", help="This sheet; any number of times.  [default: all]")
@options_of(SheetOptions, made=False, without=("scale", "bounds", "orientation"))
@click.option("--format", type=click.Choice(["pdf", "png", "tif", "mbtiles", "kmz"]), default="pdf", show_default=True)
@click.option("--workers", type=click.IntRange(1), default=1, show_default=True, help="Processes that draw.")
@click.option("-o", "--output", type=FILE, required=True, help="Folder for the sheets and their index.")
@json_option
@debug_option
def make_command(raster: Path, output: Path, as_json: bool, options: dict[str, Any], **flags: Any) -> None:
    """Make all sheets of a series that show something of a raster, and their index.

    Sheets that are finished and were made of the same are kept, so that the same command goes on where it was stopped.

    \b
    Example:
      geomosaic sheets make mosaic.tif --scheme puwg1992 --scale 1:10000 -o sheets/
    """
    from geomosaic.errors import counted
    from geomosaic.sheets.series.inputs import sheet_series

    scheme = _scheme(flags)
    with notes(), progress(as_json) as bars:
        made = sheet_series(raster, output, scheme, progress=bars, **flags, **options)
    facts = {
        "sheets": list(made.names),
        "made": [str(path) for path in made.made],
        "kept": [str(path) for path in made.kept],
        "index": [str(path) for path in made.index],
    }  # fmt: skip
    words = f"{counted(len(made.names), 'sheet')} in {output}: {len(made.made)} made, {len(made.kept)} there already"
    answer(facts, f"{words}\nindex: {', '.join(path.name for path in made.index)}", as_json)


@command.command("find", context_settings={"ignore_unknown_options": True})
@click.argument("longitude", type=float)
@click.argument("latitude", type=float)
@scheme_options
@json_option
@debug_option
def find_command(longitude: float, latitude: float, as_json: bool, **flags: Any) -> None:
    """Find the sheet at a longitude and latitude (WGS 84, degrees)."""
    from geomosaic.sheets.series.inputs import find_sheet

    scheme = _scheme(flags)
    name = find_sheet(scheme, longitude, latitude)
    answer(_facts(scheme, name), name, as_json)


@command.command("show")
@click.argument("name")
@scheme_options
@click.option("--map-crs", metavar="CRS", help="Show the corners in this CRS too.  [default: that of the scheme]")
@json_option
@debug_option
def show_command(name: str, map_crs: str | None, as_json: bool, **flags: Any) -> None:
    """Show the corners and neighbours of a sheet."""
    from geomosaic.sheets.series.inputs import sheet_corners

    scheme = _scheme(flags)
    facts = _facts(scheme, name)
    target = map_crs or scheme.map_crs(name)
    lines = [f"{facts['name']}, {scheme.title}", f"corners in {facts['crs']}:"]
    lines += [f"  {x:.9g}  {y:.9g}" for x, y in facts["corners"]]
    if target is not None:
        facts["map_crs"], facts["map_corners"] = target, sheet_corners(scheme, name, target)
        lines += [f"corners in {target}:", *(f"  {x:.3f}  {y:.3f}" for x, y in facts["map_corners"])]
    lines += [f"{way}: {other}" for way, other in facts["neighbours"].items()]
    answer(facts, "\n".join(lines), as_json)


def _facts(scheme: Scheme, name: str) -> dict[str, Any]:
    name = scheme.proper(name)
    crs, ring = scheme.edges(name)
    return {"name": name, "crs": crs, "corners": ring.tolist(), "neighbours": scheme.neighbours(name)}
