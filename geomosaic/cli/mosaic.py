"""`geomosaic mosaic`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.memory import note_memory
from geomosaic.cli.options import FILE, image_options, machine_options, output_options, stack
from geomosaic.cli.request import area, block_inputs, mosaic_options
from geomosaic.cli.talk import answer, notes, progress
from geomosaic.cli.words import mosaic_facts, mosaic_words

mosaic_flags = stack(
    click.option(
        "--feather",
        type=click.FloatRange(0),
        metavar="UNITS",
        help="Width of seams in map units.  [default: 32 pixels]",
    ),
    click.option(
        "--seams",
        type=click.Choice(["nearest", "alike"]),
        default="nearest",
        show_default=True,
        help="Seams halfway between what images see best, or where neighbours look most alike.",
    ),
    click.option("--cutlines", type=FILE, help="Areas with an image each, drawn by hand, that win over --seams."),
    click.option("--balance/--no-balance", default=True, show_default=True, help="Balance colours over the overlaps."),
    click.option(
        "--histogram",
        type=click.Choice(["overlap", "whole"]),
        help="Match histograms instead: over what images share, one after the other, or over all that each shows.",
    ),
    click.option("--master", metavar="NAME", help="Image that the others are matched to.  [default: shares most]"),
    click.option("--reference", type=FILE, help="Georeferenced raster that all are matched to, instead of a master."),
    click.option("--labels/--no-labels", default=True, show_default=True, help="Write the raster of source images."),
)


@click.command()
@click.argument("images", type=FILE, nargs=-1, required=True, metavar="IMAGE...")
@stack(image_options, output_options, mosaic_flags, machine_options)
def command(images: tuple[Path, ...], output: Path, as_json: bool, **flags: Any) -> None:
    """Make one mosaic from raw or georeferenced images, each pixel resampled once.

    Without --sensor the images must be georeferenced, and lie as their files say.
    """
    from geomosaic.project.make import make_mosaic

    note_memory(flags["mem_limit"], flags["threads"])
    with notes(), progress(as_json) as report:
        result = make_mosaic(block_inputs(images, flags), area(flags), output, mosaic_options(flags, report))
    answer(mosaic_facts(result), mosaic_words(result), as_json)
