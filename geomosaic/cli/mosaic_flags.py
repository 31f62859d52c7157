"""Options on the seams, the colours and the records of a mosaic."""

from __future__ import annotations

import click

from geomosaic.cli.merging import blend_flags
from geomosaic.cli.options import FILE, stack, true_ortho_option
from geomosaic.cli.values import band_numbers, pairs

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
