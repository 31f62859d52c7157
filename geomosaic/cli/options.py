"""Options of commands: shared ones, named as rio names them, and those made from their declarations; help in groups."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from functools import partial, wraps
from pathlib import Path
from typing import Any, TypeVar

import click

from geomosaic.cli.values import FilePath, band_names, band_numbers, box, map_crs, pairs, pixel
from geomosaic.errors import InputError
from geomosaic.options.declaration import GROUPS, Declared, compose, declared, is_part

Function = TypeVar("Function", bound=Callable[..., Any])

FILE = FilePath(path_type=Path)


class GroupedCommand(click.Command):
    """Command whose help shows options under the headings of their groups."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, group by group."""
        shown: dict[str, list[tuple[str, str]]] = {group: [] for group in GROUPS}
        for param in self.get_params(ctx):
            record = param.get_help_record(ctx)
            if record is not None and isinstance(param, click.Option):
                shown[getattr(param, "group", "running")].append(record)
        for group, records in shown.items():
            if records:
                with formatter.section(group.capitalize()):
                    formatter.write_dl(records)


command = partial(click.command, cls=GroupedCommand)


def stack(*decorators: Callable[[Any], Any], group: str = "") -> Callable[[Function], Function]:
    """Decorator that applies several, so that `--help` shows their options in the order given here.

    Parameters
    ----------
    *decorators : callable
        As of `click.option`.
    group : str
        Heading in the help, one of `GROUPS`, of options that have none yet.

    Returns
    -------
    callable
    """

    def apply(function: Function) -> Function:
        before = len(getattr(function, "__click_params__", ()))
        # Decorators apply from the last to the first, as they would when written above a function.
        for decorator in reversed(decorators):
            function = decorator(function)
        for param in getattr(function, "__click_params__", ())[before:]:
            if group and not hasattr(param, "group"):
                param.group = group
        return function

    return apply


def options_of(
    kind: type[Any], *, without: tuple[str, ...] = (), only: tuple[str, ...] = ()
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorator that gives a command the options of a class; it receives their value as `options`.

    Parameters
    ----------
    kind : type
        Options class, or one composed of such.
    without : tuple of str
        Names that the command does not have.
    only : tuple of str
        Names that it has alone; all unless given.

    Returns
    -------
    callable
    """
    own = [one for one in declared(kind) if one.flag and one.name not in without and (not only or one.name in only)]

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def call(**flags: Any) -> Any:
            given = {one.name: flags.pop(one.name) for one in own}
            # Only what was given: the defaults are those of the class.
            set_ = {name: value for name, value in given.items() if value is not None and value != ()}
            return function(options=compose(kind, set_), **flags)

        decorated: Callable[..., Any] = stack(*(click_option(one) for one in own))(call)
        return decorated

    return decorate


def click_option(one: Declared) -> Callable[[Any], Any]:
    """Decorator that adds the click option of a declared one.

    Parameters
    ----------
    one : Declared

    Returns
    -------
    callable
        None stands for what is not given: the options class has the default, in one place.
    """
    option, more = one.option, _type_of(one)
    names = (option.flag or one.flag).split()
    if one.kind is bool:
        names = [f"{one.flag}/--no-{one.flag[2:]}"] if one.default is not False and "/" not in names[0] else names
        more = {"default": None, "is_flag": True}
    default = option.default or (
        str(one.default) if isinstance(one.default, str | float) and not isinstance(one.default, bool) else ""
    )
    if one.kind is bool and one.default is True:
        default = one.flag[2:]
    text = option.help + (f"  [default: {default}]" if default else "")
    return stack(click.option(*names, one.name, help=text, metavar=option.metavar or None, **more), group=option.group)


def _type_of(one: Declared) -> dict[str, Any]:
    """Type of an option as keywords of `click.option`."""
    option, kind = one.option, one.kind
    if option.parse is not None:
        return {"callback": partial(_parsed, option.parse)}
    if kind == tuple[int, ...]:
        return {"multiple": True, "callback": band_numbers}
    if kind in (tuple[Path, ...], tuple[str, ...]):
        return {"multiple": True, "type": FILE if kind == tuple[Path, ...] else str}
    if is_part(kind):
        return {"multiple": True, "callback": partial(_composed, kind)}
    if kind is Path:
        return {"type": FILE}
    if kind in (int, float):
        ends = max(option.least, option.above), option.most
        low, high = (int(end) if math.isfinite(end) and end == int(end) else end for end in ends)
        limits: dict[str, Any] = {
            "min": low if math.isfinite(low) else None,
            "max": high if math.isfinite(high) else None,
        }
        if limits == {"min": None, "max": None}:
            return {"type": kind}
        ranged = click.IntRange if kind is int else partial(click.FloatRange, min_open=option.above >= option.least)
        return {"type": ranged(**limits)}
    if kind is str:
        return {"type": click.Choice(option.choices)} if option.choices and not option.metavar else {}
    return {"multiple": True, "callback": pairs}  # a mapping of names to texts


def _parsed(parse: Callable[[Any], Any], ctx: click.Context, param: click.Parameter, value: str | None) -> Any:
    """Value of a text; what is wrong with it is an error of usage."""
    if value is None:
        return None
    try:
        return parse(value)
    except InputError as error:
        raise click.BadParameter(f"{error.what}; {error.hint}") from None


def _composed(kind: type[Any], ctx: click.Context, param: click.Parameter, values: tuple[str, ...]) -> Any:
    """Options value of NAME=VALUE, given any number of times; None where none is."""
    named: Mapping[str, str] = pairs(ctx, param, values)
    try:
        return compose(kind, {name: json_value(text) for name, text in named.items()}) if named else None
    except InputError as error:
        where = f"{error.where}: " if (error.where or "").startswith("`") else ""
        raise click.BadParameter(f"{where}{error.what}; {error.hint}") from None


def json_value(text: str) -> Any:
    """Value of a text: a JSON number, list or table where it is one, else the text.

    Parameters
    ----------
    text : str

    Returns
    -------
    object
    """
    try:
        return json.loads(text)
    except ValueError:
        return text


json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on standard output.")
debug_option = click.option("--debug", is_flag=True, expose_value=False, help="Show the traceback of an error.")

overwrite_option = click.option("--overwrite", is_flag=True, help="Replace the output if it exists.")
dem_heights_option = click.option(
    "--dem-heights", metavar="DATUM", help="Vertical datum of the DEM, where the file does not say it."
)

band_option = click.option(
    "-b",
    "--bidx",
    "bands",
    multiple=True,
    callback=band_numbers,
    metavar="NUMBERS",
    help="Bands of the images to use, such as 1,2,3.  [default: all but alpha]",
)

image_options = stack(
    click.option("--sensor", help="Sensor of the images; see `geomosaic sensors`."),
    click.option("--camera", type=FILE, help="Camera description, or calibration certificate (TOML)."),
    click.option("--exterior", type=FILE, help="Orientation table: image, x, y, z and angles."),
    click.option("--exterior-crs", "--crs", "crs", metavar="CRS", help="CRS of the positions, such as EPSG:32633."),
    click.option(
        "--heights",
        metavar="DATUM",
        help="Vertical datum of the positions: ellipsoidal, egm96, an EPSG code or a geoid grid file.",
    ),
    click.option("--dem", type=FILE, help="Digital elevation model."),
    click.option("--height", type=float, metavar="METRES", help="One height for all the ground, instead of a DEM."),
    click.option("--dem-heights", metavar="DATUM", help="Vertical datum of the DEM or of --height."),
    band_option,
    click.option(
        "--angles",
        default="opk",
        show_default=True,
        help="Angle system of the table: opk, pok, matrix, patb, rpy, dji, opensfm, odm, pix4d, metashape, colmap, "
        "ori, printed.",
    ),
    click.option(
        "--angle-unit",
        type=click.Choice(["deg", "gon", "rad"]),
        help="Unit of the angles.  [default: deg]",
    ),
    click.option(
        "--angle-frame",
        type=click.Choice(["grid", "local"]),
        help="North of the angles: the map's grid, or true.  [default: as the system has it]",
    ),
    click.option(
        "--matrix", type=click.Choice(["ground_to_image", "image_to_ground"]), help="Direction of rotation matrices."
    ),
    click.option("--fiducials", type=FILE, help="Fiducials measured in scans of film: image, id, col, row."),
    click.option(
        "--corrections",
        metavar="FILE",
        help="Correction grid of image coordinates; {image} in the name takes each image's name.",
    ),
    click.option(
        "--trust-orientation",
        "trusted",
        is_flag=True,
        help="Do not look whether the orientation can be meant.",
    ),
    click.option(
        "--option",
        "sensor_options",
        multiple=True,
        callback=pairs,
        metavar="NAME=VALUE",
        help="Any other input of the sensor.",
    ),
    group="input",
)

area_options = stack(
    click.option(
        "--dst-crs",
        callback=map_crs,
        metavar="CRS",
        help="CRS of the output, such as EPSG:32633.  [default: that of the DEM, the positions or the control]",
    ),
    click.option(
        "--res", callback=pixel, metavar="UNITS", help="Pixel size in map units.  [default: that of the images]"
    ),
    click.option(
        "--bounds",
        callback=box,
        nargs=4,
        metavar="LEFT BOTTOM RIGHT TOP",
        help="Area in map units.  [default: all images]",
    ),
    group="geometry",
)
like_option = stack(
    click.option("--like", type=FILE, metavar="RASTER", help="Take CRS, pixels and extent of this raster."),
    group="geometry",
)
output_option = stack(click.option("-o", "--output", type=FILE, required=True, help="File to write."), group="output")
running_options = stack(json_option, debug_option, group="running")

band_names_option = stack(
    click.option(
        "--bands",
        "band_names",
        callback=band_names,
        metavar="NAMES",
        help="Bands by description or colour, such as red,green,blue, wherever each file has them.",
    ),
    group="input",
)

usable_options = stack(
    click.option("--margin", type=click.FloatRange(0), metavar="PIXELS", help="Border of every image not to be used."),
    click.option("--usable", type=FILE, help="Polygons beyond which images are not to be used: image, col, row."),
    group="input",
)

NOT_BY_RULE = ("rule", "order", "base", "dtype", "convert", "water", "water_fill")
"""Options that commands which place photos themselves do not have."""
