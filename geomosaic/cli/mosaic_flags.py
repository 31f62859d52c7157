"""Options of mosaics: seams, colours, records, blending and rules."""

from __future__ import annotations

from typing import Any

import click

from geomosaic.cli.options import FILE, stack, true_ortho_option
from geomosaic.cli.values import band_numbers, pairs


def _width(ctx: click.Context, param: click.Parameter, value: str | None) -> Any:
    """Width with its unit."""
    if value is None:
        return None
    from geomosaic.errors import InputError
    from geomosaic.options.mosaic import Width

    try:
        return Width.parse(value)
    except InputError as error:
        raise click.BadParameter(f"{error.what}; {error.hint}") from None


def _names(ctx: click.Context, param: click.Parameter, value: str | None) -> tuple[str, ...] | None:
    """Names separated by commas."""
    if value is None:
        return None
    names = tuple(word.strip() for word in value.split(","))
    if not all(names):
        raise click.BadParameter(f"'{value}' has an empty name; write red,green,blue")
    if ctx.params.get("bands") is not None:
        raise click.BadParameter("bands are given by number too; leave out --bidx")
    return names


blend_flags = stack(
    click.option(
        "--blend",
        type=click.Choice(["feather", "overlap", "multiband", "none"]),
        default="feather",
        show_default=True,
        help="Blend across the seam, over all that images share, each band of frequency by itself, or not at all.",
    ),
    click.option(
        "--feather",
        callback=_width,
        metavar="WIDTH",
        help="Width of the blending: 20px, 5m, or a number of map units.  [default: 32px]",
    ),
    click.option(
        "--ramp",
        type=click.Choice(["linear", "smooth"]),
        default="linear",
        show_default=True,
        help="Shape of the transition.",
    ),
    click.option(
        "--limit/--no-limit",
        default=None,
        help="Do not blend what images show differently, such as cars.  [default: limit]",
    ),
)

merge_flags = stack(
    click.option(
        "--rule",
        "--method",
        type=click.Choice(["first", "last", "min", "max", "mean", "median", "sum", "count"]),
        help="Lay images together by rule, as rio merge does, instead of seams; nothing is balanced unless asked for.",
    ),
    click.option(
        "--order",
        type=click.Choice(["list", "name", "resolution", "date"]),
        default="list",
        show_default=True,
        help="Whose pixels come first: as given, by name, the finest, the newest.",
    ),
    click.option("--base", metavar="NAME", help="Image that is laid lowest, under all others."),
    click.option(
        "--bands",
        "band_names",
        callback=_names,
        metavar="NAMES",
        help="Bands by description or colour, such as red,green,blue, wherever each file has them.",
    ),
    click.option(
        "--dtype", metavar="TYPE", help="Sample type of the output, such as uint16.  [default: the images' own]"
    ),
    click.option(
        "--convert",
        type=click.Choice(["keep", "range"]),
        default="keep",
        show_default=True,
        help="Keep the numbers, or bring the whole range of each type to that of --dtype.",
    ),
    click.option("--water", type=FILE, help="Areas of water: each is shown by the image with the least glint."),
    click.option(
        "--water-fill",
        type=click.Choice(["calmest", "tone"]),
        default="calmest",
        show_default=True,
        help="Show water by that image, or fill it with a continuous tone that fits its shores.",
    ),
    click.option("--like", type=FILE, metavar="RASTER", help="Take CRS, pixels and extent of this raster."),
)


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
    click.option("--seam-quality/--no-seam-quality", default=None, help="Judge seams piece by piece."),
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
        "reference_bands",
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
        "vectors",
        default=True,
        show_default=True,
        help="Write footprints, seams and gains (GeoPackage), and the STAC item with the checksum.",
    ),
)
