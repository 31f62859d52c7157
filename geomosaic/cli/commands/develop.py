"""Draw photos of a facade, tower or dome on its developed surface.

Help group: Orthos and mosaics
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import (
    ERRORS,
    FILE,
    NOT_BY_RULE,
    PLANAR,
    RANKED,
    block_of,
    options_of,
    output_option,
    running_options,
    stack,
)
from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.output import answer, notes, progress
from geomosaic.cli.results import mosaic_facts, mosaic_text, ortho_facts, ortho_text
from geomosaic.cli.values import Number
from geomosaic.options.inputs import Area, BlockInputs
from geomosaic.options.mosaic import MosaicOptions


@grouped_command()
@click.argument("images", type=FILE, nargs=-1, required=True, metavar="IMAGE...")
@click.option("--surface", type=FILE, required=True, help="Surface: plane, cylinder, cone, sphere, ellipsoid (TOML).")
@click.option(
    "--oblique",
    type=Number(),
    default=80.0,
    show_default=True,
    metavar="DEGREES",
    help="Largest angle between line of sight and normal that is drawn.",
)
@stack(
    options_of(BlockInputs, "inputs", without=(*PLANAR, *RANKED)),
    options_of(Area, only=("resolution", "bounds")),
    output_option,
    options_of(MosaicOptions, without=(*NOT_BY_RULE, *ERRORS)),
    running_options,
)
def command(
    images: tuple[Path, ...],
    surface: Path,
    oblique: float,
    output: Path,
    as_json: bool,
    options: dict[str, Any],
    inputs: dict[str, Any],
) -> None:
    """Draw photos of a facade, a tower or a dome on its developed surface, in metres.

    Positions and control points count in the frame of the surface file: a local Cartesian one, or
    the CRS that it names. Several images make a mosaic.

    \b
    Example:
      geomosaic develop tower1.jpg tower2.jpg --sensor frame --camera camera.toml \\
        --gcps points.csv --surface tower.toml --res 0.01 -o tower.tif
    """
    from geomosaic.developed.develop import develop

    with notes(), progress(as_json) as report:
        done = develop(block_of(images, inputs), output, surface, oblique=oblique, progress=report, **options)
    if done.ortho is not None:
        facts, words = ortho_facts(done.ortho), ortho_text(done.ortho).splitlines()[-2:]
    elif done.mosaic is not None:
        facts, words = mosaic_facts(done.mosaic), mosaic_text(done.mosaic).splitlines()
    answer({**facts, "surface": done.facts, "notes": list(done.notes)}, "\n".join([*done.notes, *words]), as_json)
