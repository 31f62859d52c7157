"""Options of `geomosaic mosaic` for images that are georeferenced already, and how they are blended."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from geomosaic.cli.options import FILE, stack


def _width(ctx: click.Context, param: click.Parameter, value: str | None) -> Any:
    """Width with its unit."""
    if value is None:
        return None
    from geomosaic.errors import InputError
    from geomosaic.product.blend.options import Width

    try:
        return Width.parse(value)
    except InputError as error:
        raise click.BadParameter(f"{error.what}; {error.mend}") from None


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


def merging(flags: Mapping[str, Any]) -> dict[str, Any]:
    """What these options say, as fields of `MosaicOptions`."""
    from geomosaic.product.blend.options import Blending
    from geomosaic.product.depth import Depth

    if "rule" not in flags:  # a command whose images are not georeferenced ones
        return {"blending": Blending(flags["blend"], flags["feather"], flags["ramp"], flags["limit"])}
    depth = Depth(flags["dtype"], flags["convert"])
    blending = Blending(flags["blend"], flags["feather"], flags["ramp"], flags["limit"])
    return {
        "rule": flags["rule"],
        "order": flags["order"],
        "base": flags["base"],
        "blending": blending,
        "depth": depth,
        "water": flags["water"],
        "water_fill": flags["water_fill"],
    }


def balanced(flags: Mapping[str, Any]) -> bool:
    """Whether colours are balanced: as asked; unless asked, where there are seams."""
    asked: bool | None = flags["balance"]
    return flags.get("rule") is None if asked is None else asked
