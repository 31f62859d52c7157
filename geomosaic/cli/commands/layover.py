"""Layover, shadow and local incidence of a radar scene.

Help group: Orthos and mosaics
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import (
    FILE,
    PLANAR,
    RANKED,
    area_options,
    block_of,
    options_of,
    output_option,
    running_options,
)
from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.output import answer, notes, progress
from geomosaic.options.inputs import BlockInputs
from geomosaic.options.render import RenderOptions


@grouped_command()
@click.argument("image", type=FILE)
@options_of(BlockInputs, "inputs", without=(*PLANAR, *RANKED))
@area_options
@output_option
@click.option("--incidence/--no-incidence", default=True, help="Write the local incidence angles (NAME-incidence.tif).")
@options_of(RenderOptions, only=("driver", "creation", "overwrite", "max_output", "threads", "memory_limit", "workers"))
@running_options
def command(
    image: Path,
    output: Path,
    as_json: bool,
    incidence: bool,
    options: dict[str, Any],
    inputs: dict[str, Any],
) -> int:
    """Mask layover, shadow and foreshortening of a radar scene, pixel by pixel of its ortho.

    \b
    Example:
      geomosaic layover scene.tif --sensor sar --dem dem.tif --dem-heights egm96 --res 10 -o mask.tif

    Values are sums of 1 (layover), 2 (shadow) and 4 (foreshortening). `geomosaic ortho --true-ortho` and
    `geomosaic mosaic --true-ortho` leave out pixels of layover and shadow.
    """
    from geomosaic.products.layover import layover_mask

    with notes(), progress(as_json) as report:
        result = layover_mask(block_of((image,), inputs), output, incidence=incidence, progress=report, **options)
    facts = {
        "output": str(result.path), "incidence": None if result.incidence is None else str(result.incidence),
        "known_pixels": result.known, "shares": dict(result.shares),
        **({} if result.run is None else {"run": result.run.facts}),
    }  # fmt: skip
    shares = ", ".join(f"{100 * share:.2f} % {name}" for name, share in result.shares.items())
    lines = [f"{result.path}: {result.grid.label}", f"{shares} of {result.known} pixels"]
    lines += [] if result.incidence is None else [f"local incidence angles: {result.incidence.name}"]
    lines += [] if result.run is None else [str(result.run)]
    answer(facts, "\n".join(lines), as_json)
    return 0
