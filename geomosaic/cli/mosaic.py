"""`geomosaic mosaic`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.memory import note_memory
from geomosaic.cli.merging import blend_flags, merge_flags
from geomosaic.cli.options import (
    FILE,
    image_options,
    machine_options,
    output_options,
    stack,
    true_ortho_option,
    usable_options,
)
from geomosaic.cli.points import wrong_point_options
from geomosaic.cli.request import area, block_inputs, mosaic_options, planar_inputs
from geomosaic.cli.talk import answer, notes, progress
from geomosaic.cli.values import band_numbers, pairs
from geomosaic.cli.words import mosaic_facts, mosaic_words

mosaic_flags = stack(
    blend_flags,
    click.option(
        "--seams",
        type=click.Choice(["nearest", "halve", "alike", "order"]),
        default="nearest",
        show_default=True,
        help="Seams halfway between what images see best, halving overlaps, where neighbours look most alike, or by "
        "--order.",
    ),
    click.option("--follow", type=FILE, multiple=True, help="Roads and rivers that --seams alike runs along."),
    click.option(
        "--avoid", type=FILE, multiple=True, help="Areas, such as buildings, that --seams alike keeps out of."
    ),
    click.option(
        "--seam-weight",
        "seam_weights",
        multiple=True,
        callback=pairs,
        metavar="NAME=VALUE",
        help="What counts how much for --seams alike, such as heights=5.",
    ),
    click.option("--cutlines", type=FILE, help="Areas with an image each, drawn by hand, that win over --seams."),
    click.option(
        "--seam-quality/--no-seam-quality", default=False, show_default=True, help="Judge seams piece by piece."
    ),
    click.option("--views/--no-views", default=False, help="Write the raster of view angles and resolutions."),
    click.option(
        "--displacement",
        type=float,
        metavar="HEIGHT",
        help="Write the raster of relief displacements against level ground of this height, metres.",
    ),
    click.option("--exclude", multiple=True, metavar="NAME", help="Image that is to show nothing."),
    click.option(
        "--balance/--no-balance",
        default=None,
        help="Balance colours over the overlaps.  [default: balance, but not with --rule]",
    ),
    click.option(
        "--colour",
        metavar="TERMS",
        default="auto",
        show_default=True,
        help="What the balance solves: gain (and offset), and vignetting, trend, hotspot, haze, gamma, dodging, with "
        "commas between; or auto for what is warranted.",
    ),
    click.option("--mask", type=FILE, help="Areas that say nothing of colours, as polygons: clouds, water."),
    click.option(
        "--histogram",
        type=click.Choice(["overlap", "whole", "sequence"]),
        help="Match histograms instead: over what images share, nearest first; over all that each shows; or each image "
        "to the one before it.",
    ),
    click.option("--region", type=FILE, help="Areas that histograms are matched over, as polygons."),
    click.option("--master", metavar="NAME", help="Image that the others are matched to.  [default: shares most]"),
    click.option("--reference", type=FILE, help="Georeferenced raster that all are matched to, instead of a master."),
    click.option(
        "--reference-bidx",
        multiple=True,
        callback=band_numbers,
        metavar="NUMBERS",
        help="Bands of the reference that go with those of the images.",
    ),
    click.option(
        "--stretch",
        metavar="LOW,HIGH",
        help="Stretch the mosaic to 8 bits between these percentiles (2,98), or values (v100,v3000).",
    ),
    true_ortho_option,
    click.option("--labels/--no-labels", default=True, show_default=True, help="Write the raster of source images."),
    click.option(
        "--records/--no-records",
        default=True,
        show_default=True,
        help="Write footprints, seams and gains (GeoPackage), and the STAC item with the checksum.",
    ),
)


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
)


@click.command()
@click.argument("images", type=FILE, nargs=-1, required=True, metavar="IMAGE...")
@stack(image_options, planar_flags, output_options, merge_flags, mosaic_flags, usable_options, machine_options)
def command(images: tuple[Path, ...], output: Path, as_json: bool, **flags: Any) -> None:
    """Make one mosaic from raw or georeferenced images, each pixel resampled once.

    Without --sensor the images must be georeferenced, and lie as their files say; or --kind says how
    tie and control points place them.
    """
    from geomosaic.project.make import make_mosaic, make_planar_mosaic

    planar = planar_inputs(flags)
    note_memory(flags["mem_limit"], flags["threads"])
    with notes(), progress(as_json) as report:
        if planar is not None:
            inputs = block_inputs(images, flags, flags["gcps"], planar)
            made, facts, path = make_planar_mosaic(inputs, planar, area(flags), output, mosaic_options(flags, report))
            known = [(role, facts[f"rms_{role}_px"]) for role in ("control", "check")]
            told = [f"{role} points: {value:.2f} px RMS" for role, value in known if value is not None]
            words = "\n".join([*facts["summary"], *told, mosaic_words(made), f"placement: {path}"])
            answer({**mosaic_facts(made), "placement": facts}, words, as_json)
            return
        result = make_mosaic(block_inputs(images, flags), area(flags), output, mosaic_options(flags, report))
    answer(mosaic_facts(result), mosaic_words(result), as_json)
