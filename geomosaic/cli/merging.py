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
    from geomosaic.product.blending import Width

    try:
        return Width.parse(value)
    except InputError as error:
        raise click.BadParameter(f"{error.what}; {error.mend}") from None


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
        help="Do not blend what images show differently, such as cars.  [default: limit, with multiband]",
    ),
    click.option("--like", type=FILE, metavar="RASTER", help="Take CRS, pixels and extent of this raster."),
)


def merging(flags: Mapping[str, Any]) -> dict[str, Any]:
    """What these options say, as fields of `MosaicOptions`."""
    from geomosaic.product.blending import Blending

    blending = Blending(flags["blend"], flags["feather"], flags["ramp"], flags["limit"])
    return {"rule": flags["rule"], "order": flags["order"], "base": flags["base"], "blending": blending}


def balanced(flags: Mapping[str, Any]) -> bool:
    """Whether colours are balanced: as asked; unless asked, where there are seams."""
    asked: bool | None = flags["balance"]
    return flags["rule"] is None if asked is None else asked
