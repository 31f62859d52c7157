"""Make one mosaic from images.

Help group: Orthos and mosaics
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.memory import check_memory
from geomosaic.cli.options import (
    FILE,
    area_options,
    band_names_option,
    image_options,
    like_option,
    options_of,
    output_option,
    running_options,
    stack,
    usable_options,
)
from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.output import answer, notes, progress
from geomosaic.cli.request import area, block_inputs, planar_inputs
from geomosaic.cli.results import mosaic_facts, mosaic_words
from geomosaic.cli.sheet_flags import wrong_point_options
from geomosaic.options.mosaic import MosaicOptions

planar_flags = stack(
    click.option(
        "--kind",
        type=click.Choice(["uncontrolled", "semicontrolled", "controlled", "grown"]),
        help="Place photos of flat ground by tie and control points.",
    ),
    click.option(
        "--model",
        type=click.Choice(["conformal", "affine", "projective"]),
        help="Their transformation.  [default: as is usual for the kind]",
    ),
    click.option("--ties", type=FILE, help="Tie points: id, image, col, row."),
    click.option("--gcps", type=FILE, help="Control points: id, x, y, image, col, row."),
    click.option(
        "--scale",
        type=click.FloatRange(0, min_open=True),
        metavar="UNITS",
        help="Map units per pixel of an uncontrolled mosaic's start photo.  [default: 1]",
    ),
    click.option(
        "--azimuth",
        type=float,
        metavar="DEGREES",
        help="Direction of the top of an uncontrolled mosaic's start photo, from north.  [default: 0]",
    ),
    click.option(
        "--rectify",
        type=click.Choice(["singly", "together"]),
        help="Controlled photos.  [default: singly where each has 4 control points]",
    ),
    wrong_point_options,
    group="input",
)


@grouped_command()
@click.argument("images", type=FILE, nargs=-1, required=True, metavar="IMAGE...")
@stack(image_options, band_names_option, usable_options, planar_flags, area_options, like_option, output_option)
@options_of(MosaicOptions)
@running_options
def command(images: tuple[Path, ...], output: Path, as_json: bool, options: MosaicOptions, **flags: Any) -> None:
    """Make one mosaic from raw or georeferenced images, each pixel resampled once.

    Without --sensor the images must be georeferenced, and lie as their files say; or --kind says how
    tie and control points place them.
    """
    from geomosaic.products import make_mosaic, make_planar_mosaic

    planar = planar_inputs(flags)
    check_memory()
    with notes(), progress(as_json) as report:
        if planar is not None:
            inputs = block_inputs(images, flags, flags["gcps"], planar)
            made, facts, path = make_planar_mosaic(inputs, planar, area(flags), output, options.with_progress(report))
            known = [(role, facts[f"rms_{role}_px"]) for role in ("control", "check")]
            told = [f"{role} points: {value:.2f} px RMS" for role, value in known if value is not None]
            words = "\n".join([*facts["summary"], *told, mosaic_words(made), f"placement: {path}"])
            answer({**mosaic_facts(made), "placement": facts}, words, as_json)
            return
        result = make_mosaic(block_inputs(images, flags), area(flags), output, options.with_progress(report))
    answer(mosaic_facts(result), mosaic_words(result), as_json)
