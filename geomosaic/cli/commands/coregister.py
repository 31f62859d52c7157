"""Move a georeferenced raster onto another of the same land.

Help group: Orthos and mosaics
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import FILE, options_of, output_option, running_options
from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.output import answer, notes, progress
from geomosaic.cli.results import ortho_facts, ortho_text
from geomosaic.options.control import CoregisterOptions


@grouped_command()
@click.argument("image", type=FILE)
@click.argument("reference", type=FILE)
@options_of(CoregisterOptions, without=("true_ortho",))
@output_option
@running_options
def command(image: Path, reference: Path, output: Path, as_json: bool, options: dict[str, Any]) -> None:
    """Find by how much a georeferenced raster lies beside another of the same land, and draw it there, once.

    Both may have any resolution, CRS and season. The output has the pixels of the image, unless --like or the other
    options of the extent say otherwise. NAME-coregistration.json tells the displacement and the residuals.

    \b
    Examples:
      geomosaic coregister scene.tif ortho.tif -o moved.tif
      geomosaic coregister old-ortho.tif ortho.tif --model local --like ortho.tif -o moved.tif
    """
    from geomosaic.products.coregistration import coregister

    with notes(), progress(as_json) as report:
        made = coregister(image, reference, output, progress=report, **options)
    facts = {name: value for name, value in made.facts.items() if name not in ("places", "field")}
    answer({**ortho_facts(made), **facts}, f"{ortho_text(made)}\n{made.summary}", as_json)
