"""Options of `geomosaic mosaic` for images that are georeferenced already, and how they are blended."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from geomosaic.cli.options import FILE, stack

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
    click.option("--like", type=FILE, metavar="RASTER", help="Take CRS, pixels and extent of this raster."),
)


def merging(flags: Mapping[str, Any]) -> dict[str, Any]:
    """What these options say, as fields of `MosaicOptions`."""
    return {"rule": flags["rule"], "order": flags["order"], "base": flags["base"]}


def balanced(flags: Mapping[str, Any]) -> bool:
    """Whether colours are balanced: as asked; unless asked, where there are seams."""
    asked: bool | None = flags["balance"]
    return flags["rule"] is None if asked is None else asked
