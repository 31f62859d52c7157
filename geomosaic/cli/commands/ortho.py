"""`geomosaic ortho`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.memory import note_memory
from geomosaic.cli.options import (
    FILE,
    image_options,
    machine_options,
    output_options,
    stack,
    true_ortho_option,
    usable_options,
)
from geomosaic.cli.request import area, block_inputs, render_options
from geomosaic.cli.results import ortho_facts, ortho_words
from geomosaic.cli.talk import answer, notes, progress


@click.command()
@click.argument("image", type=FILE)
@stack(image_options, true_ortho_option, usable_options, output_options, machine_options)
def command(image: Path, output: Path, as_json: bool, **flags: Any) -> None:
    """Rectify one image onto a DEM or a height.

    \b
    Example:
      geomosaic ortho photo.tif --sensor frame --camera camera.toml \\
        --exterior exterior.csv --exterior-crs EPSG:32633 --heights egm96 \\
        --dem dem.tif --res 0.5 -o ortho.tif
    """
    from geomosaic.products.from_inputs import make_ortho

    note_memory(flags["mem_limit"], flags["threads"])
    with notes(), progress(as_json) as report:
        result = make_ortho(block_inputs((image,), flags), area(flags), output, render_options(flags, report))
    answer(ortho_facts(result), ortho_words(result), as_json)
