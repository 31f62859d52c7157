"""Make a map sheet: frame, grid, legend, vectors.

Help group: Maps
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geomosaic.cli.options import FILE, options_of, overwrite_option, running_options, stack
from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.output import answer, notes
from geomosaic.errors import counted
from geomosaic.options.sheet import SheetOptions, scale_text

if TYPE_CHECKING:
    from geomosaic.sheets.make import SheetResult


@grouped_command()
@click.argument("raster", type=FILE)
@options_of(SheetOptions, without=("orientation",))
@stack(
    click.option("--landscape", "orientation", flag_value="landscape", help="Paper on its long side."),
    click.option("--portrait", "orientation", flag_value="portrait", help="Paper on its short side."),
    group="geometry",
)
@stack(
    click.option("-o", "--output", type=FILE, required=True, help=".pdf or .png; the map alone: .tif, .mbtiles, .kmz."),
    overwrite_option,
    group="output",
)
@running_options
def command(
    raster: Path, output: Path, overwrite: bool, as_json: bool, orientation: str | None, options: dict[str, Any]
) -> None:
    """Make a map sheet at an exact scale: neatline, grids, scale bar, north, legend, vectors and contours.

    \b
    Example:
      geomosaic sheet mosaic.tif --scale 1:5000 --paper A3 --contours dem.tif \\
        --vector roads.gpkg:road -o sheet.pdf
    """
    from geomosaic.sheets.inputs import sheet

    with notes():
        made = sheet(raster, output, overwrite=overwrite, orientation=orientation, **options)
    answer(_facts(made), _text(made), as_json)


def _facts(made: SheetResult) -> dict[str, Any]:
    """Map sheet as plain values.

    Parameters
    ----------
    made : SheetResult

    Returns
    -------
    dict
        JSON values.
    """
    from geomosaic.geo.crs import authority_code

    page = made.page
    return {
        "output": str(made.path),
        "scale": page.scale,
        "paper_mm": [page.width, page.height],
        "bleed_mm": page.bleed,
        "neatline_mm": list(page.neatline),
        "elements_mm": {name: list(box) for name, box in made.elements.items()},
        "bounds": list(page.bounds),
        "crs": authority_code(page.crs) or page.crs.to_wkt(),
        "grid_interval": made.intervals[0],
        "graticule_interval": made.intervals[1],
        "convergence_degrees": made.convergence,
        "contours": made.contours,
        "contour_interval": made.contour_interval,
        "layers": dict(made.layers),
        "image_dpi": made.image_dpi,
        "records": list(made.records),
    }


def _text(made: SheetResult) -> str:
    """Map sheet in _text.

    Parameters
    ----------
    made : SheetResult
    """
    page = made.page
    left, bottom, right, top = page.neatline
    lines = [
        f"{made.path}: {scale_text(page.scale)} on {page.width:g} x {page.height:g} mm, map of {right - left:.1f} x "
        f"{top - bottom:.1f} mm",
        f"the raster has {made.image_dpi:.0f} pixels per inch on the sheet",
    ]
    if made.records:
        lines.append(f"notes of the margin from {' and '.join(made.records)}")
    if made.contours:
        lines.append(f"{counted(made.contours, 'contour')} every {made.contour_interval:g} m")
    lines += [f"{title}: {counted(count, 'object')}" for title, count in made.layers.items()]
    return "\n".join(lines)
