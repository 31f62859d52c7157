"""Rectify one image.

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
from geomosaic.cli.results import accuracy_failure, ortho_facts, ortho_text, placement_failure, quality_facts, verdict
from geomosaic.options.inputs import BlockInputs, QualityLimits
from geomosaic.options.render import OrthoOptions


@grouped_command()
@click.argument("image", type=FILE)
@options_of(BlockInputs, "inputs", without=(*PLANAR, *RANKED))
@options_of(QualityLimits, "limits", made=True, only=("max_corner_sigma_px",))
@area_options
@output_option
@options_of(OrthoOptions)
@running_options
def command(
    image: Path,
    output: Path,
    as_json: bool,
    options: dict[str, Any],
    inputs: dict[str, Any],
    limits: QualityLimits,
) -> int:
    """Rectify one image onto a DEM or a height.

    \b
    Example:
      geomosaic ortho photo.tif --sensor frame --camera camera.toml \\
        --exterior exterior.csv --exterior-crs EPSG:32633 --heights egm96 \\
        --dem dem.tif --res 0.5 -o ortho.tif

    Control points (--gcps) orient the image in place of --exterior, or correct it, where its sensor can be; beside
    --exterior they judge it. NAME-placement.json says how well it is placed, NAME-exterior.csv its orientation.
    """
    from geomosaic.products.orthos import ortho

    with notes(), progress(as_json) as report:
        result = ortho(block_of((image,), inputs), output, progress=report, **options)
    failure = placement_failure(result.placement, str(result.path), limits) or accuracy_failure(result.accuracy)
    answer(ortho_facts(result) | quality_facts(failure), ortho_text(result), as_json)
    return verdict(failure, as_json)
