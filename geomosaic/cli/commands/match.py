"""Measure tie points in images, or find control points for them in an ortho, a mosaic or a map.

Help group: Orientation and accuracy
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import (
    FILE,
    PLANAR,
    RANKED,
    block_of,
    options_of,
    output_option,
    overwrite_option,
    running_options,
)
from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.output import answer, notes, progress
from geomosaic.options.inputs import BlockInputs
from geomosaic.options.tie_points import TiePointOptions


@grouped_command()
@click.argument("images", type=FILE, nargs=-1, required=True, metavar="IMAGE...")
@options_of(TiePointOptions, "matching")
@options_of(BlockInputs, "inputs", without=(*PLANAR, *RANKED))
@output_option
@overwrite_option
@running_options
def command(
    images: tuple[Path, ...],
    output: Path,
    overwrite: bool,
    as_json: bool,
    matching: dict[str, Any],
    inputs: dict[str, Any],
) -> None:
    """Measure tie points in images, or control points in a reference.

    Without --reference the output is a table of tie points (id, image, col, row, sigma_px ...). With it, images whose
    orientation is known roughly are found in an ortho, a mosaic or a map saved as a georeferenced raster, of any season
    and resolution: the output is a table of control points (id, x, y, z, image, col, row, sigma_xy, sigma_z ...).
    Both are what [adjust] and [control] of a project take.

    \b
    Examples:
      geomosaic match photos/*.jpg --sensor frame --camera camera.toml \\
        --exterior exterior.csv --exterior-crs EPSG:32633 --heights egm96 -o ties.csv
      geomosaic match photo.tif --sensor frame --camera camera.toml \\
        --exterior exterior.csv --exterior-crs EPSG:32633 --heights egm96 \\
        --reference ortho.tif --dem dem.tif --search 300 -o control.csv
    """
    from geomosaic.raster.files import check_output
    from geomosaic.tie_points.control import ReferenceControl
    from geomosaic.tie_points.diagnostics import nothing_in_common
    from geomosaic.tie_points.run import match

    check_output(output, overwrite=overwrite, inputs=images)
    with notes(), progress(as_json) as report:
        found = match(block_of(images, inputs), report, **matching)
    if isinstance(found, ReferenceControl):
        facts = found.facts
        found.write(output)
    else:
        if not len(found.ties):
            raise nothing_in_common(found.images, found.features)
        facts = found.facts
        found.ties.write(output)
    answer({"output": str(output), **facts}, f"{output}\n{found.summary}", as_json)
