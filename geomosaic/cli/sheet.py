"""`geomosaic sheet`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geomosaic.cli.looks import look_options
from geomosaic.cli.options import FILE, debug_option, json_option
from geomosaic.cli.talk import answer, notes
from geomosaic.cli.values import box

if TYPE_CHECKING:
    from geomosaic.product.maps.sheet import SheetResult


def scale_value(ctx: click.Context, param: click.Parameter, value: str | None) -> str | None:
    """Check that a scale is one; it stays text."""
    from geomosaic.carto.layout import parse_scale

    return _checked(parse_scale, value)


def paper_value(ctx: click.Context, param: click.Parameter, value: str | None) -> str | None:
    """Check that a paper is one; it stays text."""
    from geomosaic.carto.layout import paper_size

    return _checked(paper_size, value)


def _checked(read: Any, value: str | None) -> str | None:
    from geomosaic.errors import InputError

    if value is not None:
        try:
            read(value)
        except InputError as error:
            raise click.BadParameter(f"{error.what}; {error.mend}") from None
    return value


@click.command()
@click.argument("raster", type=FILE)
@click.option("--layout", type=FILE, help="Layout of the sheet (TOML).")
@click.option("--scale", callback=scale_value, metavar="1:N", help="Scale.  [default: the largest round one that fits]")
@click.option("--paper", callback=paper_value, metavar="NAME|WxH", help="A0 to A4, or millimetres.  [default: A3]")
@click.option("--landscape", "orientation", flag_value="landscape", help="Paper on its long side.")
@click.option("--portrait", "orientation", flag_value="portrait", help="Paper on its short side.")
@click.option(
    "--bounds",
    callback=box,
    nargs=4,
    metavar="LEFT BOTTOM RIGHT TOP",
    help="Area in map units.  [default: what fits of the raster]",
)
@click.option("--title", help="Title of the sheet.")
@click.option(
    "--vector",
    "vectors",
    multiple=True,
    metavar="FILE[#LAYER][:STYLE]",
    help="Vector layer to draw; later ones lie above.",
)
@click.option("--contours", type=FILE, metavar="DEM", help="Draw contours of this DEM.")
@click.option("--interval", type=click.FloatRange(0, min_open=True), metavar="METRES", help="Interval of the contours.")
@click.option("--dem-heights", metavar="DATUM", help="Vertical datum of the DEM, where the file does not say it.")
@look_options
@click.option("--report", type=FILE, help="report.json of the project.  [default: that beside the raster]")
@click.option("--dpi", type=click.IntRange(72, 2400), help="Resolution of the picture.  [default: 300]")
@click.option(
    "-o",
    "--output",
    type=FILE,
    required=True,
    help=".pdf or .png; the map alone: .tif, .mbtiles, .kmz.",
)
@click.option(
    "-f",
    "--driver",
    type=click.Choice(["GTiff", "COG", "PDF"]),
    default="GTiff",
    show_default=True,
    help="Of .tif; PDF: make .pdf a raster GeoPDF of the map alone.",
)
@click.option("--collar", is_flag=True, help="Write the whole page to .tif or a raster GeoPDF, not the map alone.")
@click.option("--world-file", is_flag=True, help="Write a world file beside .tif and .png.")
@click.option("--overwrite", is_flag=True, help="Replace the output if it exists.")
@json_option
@debug_option
def command(raster: Path, output: Path, as_json: bool, **flags: Any) -> None:
    """Make a map sheet at an exact scale: neatline, grids, scale bar, north, legend, vectors and contours.

    \b
    Example:
      geomosaic sheet mosaic.tif --scale 1:5000 --paper A3 --contours dem.tif \\
        --vector roads.gpkg:road -o sheet.pdf
    """
    from geomosaic.project.sheets.sheet import sheet_from_files

    with notes():
        made = sheet_from_files(raster, output, bounds=flags.pop("bounds") or None, **flags)
    answer(facts(made), words(made), as_json)


def facts(made: SheetResult) -> dict[str, Any]:
    """Plain values of a sheet."""
    page = made.page
    code = page.crs.to_authority(min_confidence=100)
    return {
        "output": str(made.path),
        "scale": page.scale,
        "paper_mm": [page.width, page.height],
        "bleed_mm": page.bleed,
        "neatline_mm": list(page.neatline),
        "bounds": list(page.bounds),
        "crs": f"{code[0]}:{code[1]}" if code else page.crs.to_wkt(),
        "grid_interval": made.intervals[0],
        "graticule_interval": made.intervals[1],
        "convergence_degrees": made.convergence,
        "contours": made.contours,
        "contour_interval": made.contour_interval,
        "layers": dict(made.layers),
        "image_dpi": made.image_dpi,
        "records": list(made.records),
    }


def words(made: SheetResult) -> str:
    """Say what was made."""
    page = made.page
    left, bottom, right, top = page.neatline
    lines = [
        f"{made.path}: 1:{page.scale:.10g} on {page.width:g} x {page.height:g} mm, map of {right - left:.1f} x "
        f"{top - bottom:.1f} mm",
        f"the raster has {made.image_dpi:.0f} pixels per inch on the sheet",
    ]
    if made.records:
        lines.append(f"notes of the margin from {' and '.join(made.records)}")
    if made.contours:
        lines.append(f"{made.contours} contours every {made.contour_interval:g} m")
    lines += [f"{title}: {count} objects" for title, count in made.layers.items()]
    return "\n".join(lines)
