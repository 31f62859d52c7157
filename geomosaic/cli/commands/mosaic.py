"""Make one mosaic from images.

Help group: Orthos and mosaics
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import FILE, block_of, options_of, output_option, running_options
from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.output import answer, notes, progress
from geomosaic.cli.results import (
    accuracy_failure,
    mosaic_facts,
    mosaic_text,
    placement_failure,
    quality_facts,
    verdict,
)
from geomosaic.errors import InputError
from geomosaic.options.inputs import Area, BlockInputs, QualityLimits
from geomosaic.options.mosaic import MosaicOptions


@grouped_command()
@click.argument("images", type=FILE, nargs=-1, required=True, metavar="IMAGE...")
@options_of(BlockInputs, "inputs")
@options_of(QualityLimits, "limits", made=True, only=("max_corner_sigma_px",))
@options_of(Area, without=("snap",))
@output_option
@options_of(MosaicOptions)
@running_options
def command(
    images: tuple[Path, ...],
    output: Path,
    as_json: bool,
    options: dict[str, Any],
    inputs: dict[str, Any],
    limits: QualityLimits,
) -> int:
    """Make one mosaic from raw or georeferenced images, each pixel resampled once.

    Without --sensor the images must be georeferenced, and lie as their files say; or --kind says how
    tie and control points place them. Control points of images of another sensor orient or correct them, where it can
    be; the mosaic says how well it is placed.
    """
    from geomosaic.inputs.declarations import leave_out
    from geomosaic.mosaicking.outputs import rasters_of_earlier_run
    from geomosaic.products.mosaics import mosaic
    from geomosaic.sensor.registry import plane_sensor

    with notes():
        block = block_of(images, inputs)
        others = {"`reference`": options.get("reference"), **rasters_of_earlier_run(output)}
        block = replace(block, images=leave_out(block.images, others))
    if block.control is not None and block.planar is None and block.sensor == plane_sensor():
        raise InputError("`control` is given without `kind`", hint="give `kind`, or leave out `control`")
    with notes(), progress(as_json) as report:
        made = mosaic(block, output, progress=report, **options)
    failure = placement_failure(made.placement, str(made.path), limits) or accuracy_failure(made.accuracy)
    answer(mosaic_facts(made) | quality_facts(failure), mosaic_text(made), as_json)
    return verdict(failure, as_json)
