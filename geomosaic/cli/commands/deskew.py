"""Remove skew and tangential distortion of a scanned strip, without control.

Help group: Orthos and mosaics
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import FILE, options_of, output_option, running_options, stack
from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.output import answer, notes, progress
from geomosaic.cli.results import ortho_facts, ortho_text
from geomosaic.options.inputs import Area, BlockInputs
from geomosaic.options.render import RenderOptions


@grouped_command()
@click.argument("image", type=FILE)
@stack(
    options_of(BlockInputs, only=("bands", "sensor", "options")),
    options_of(Area, only=("resolution", "bounds")),
    output_option,
    options_of(RenderOptions, without=("true_ortho",)),
    running_options,
)
def command(image: Path, output: Path, as_json: bool, options: dict[str, Any]) -> None:
    """Remove skew and tangential distortion of a scanned strip, without control.

    Nominal numbers of the scanner and its flight are all it takes; `geomosaic sensors panoramic` lists them.
    The result is in relative metres, x across and y ahead of the scanner: it has shape and scale, but no place and no
    north.

    \b
    Example:
      geomosaic deskew strip.tif --option kind=scanner --option field_of_view=90 \\
        --option height_above_ground=3000 --option v_over_h=0.00133 -o flat.tif
    """
    from geomosaic.products.orthos import deskew

    with notes(), progress(as_json) as report:
        result = deskew(image, output, options.pop("options", {}), progress=report, **options)
    answer(ortho_facts(result), ortho_text(result), as_json)
