"""Options of commands: shared ones, those made from declarations, help in groups, and the inputs made of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args, get_origin

import click
from click.core import ParameterSource

from geomosaic.cli.process import keep_memory, return_memory
from geomosaic.cli.values import Choice, FilePath, Measure, Number, Scale, band_numbers, json_pairs, map_crs, pairs
from geomosaic.errors import InputError
from geomosaic.options.declaration import GROUPS, Declared, compose, declared, is_part
from geomosaic.options.inputs import Area, BlockInputs, PlanarInputs
from geomosaic.options.render import RunningOptions, UncertaintyOptions

if TYPE_CHECKING:
    from geomosaic.inputs.declarations import Block


Function = TypeVar("Function", bound=Callable[..., Any])

FILE = FilePath(path_type=Path)
# Checks of values that need libraries which declarations do not load.
CHECKS = {"dst_crs": map_crs, "src_crs": map_crs}


class GroupedCommand(click.Command):
    """Command whose help shows options under the headings of their groups."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse; who types the name of the library or of a project file for a flag is told the flag."""
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            name = error.option_name.lstrip("-").replace("-", "_")
            if flags := [flag for one in self.params if one.name == name for flag in one.opts]:
                said = f"{error.message} Did you mean '{' or '.join(flags)}'?"
                raise click.NoSuchOption(error.option_name, said, ctx=ctx) from None
            raise

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
    kind: type[Any],
    into: str = "options",
    *,
    made: bool = False,
    without: Collection[str] = (),
    only: Collection[str] = (),
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorator that gives a command the options of a class.

    Parameters
    ----------
    kind : type
        Options class, or one composed of such.
    into : str
        Keyword by which the command receives what was given, by name; several classes may share it.
    made : bool
        Whether the command receives an options value instead.
    without : collection of str
        Names that the command does not have.
    only : collection of str
        Names that it has alone; all unless given.
    """
    own = [one for one in declared(kind) if one.flag and one.name not in without and (not only or one.name in only)]

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def call(**flags: Any) -> Any:
            given = {one.name: flags.pop(one.name) for one in own}
            # Only what was given: the defaults are those of the class. Flags of click have no third state but None.
            given = {name: value for name, value in given.items() if value not in (None, (), {})}
            if any(one.name == "memory_limit" for one in own):
                given |= threads_within_memory(given)
            flags[into] = compose(kind, given) if made else {**flags.get(into, {}), **given}
            return function(**flags)

        decorated: Callable[..., Any] = stack(*(_click_option(one) for one in own))(call)
        return decorated

    return decorate


class Several(click.Option):
    """Option of several values, which says so where some are left out: click takes the next flag for one of them."""

    def type_cast_value(self, ctx: click.Context, value: Any) -> Any:
        """Values in their type."""
        flag = next((part for part in value or () if isinstance(part, str) and re.match("-[^0-9.]", part)), None)
        if flag:
            raise click.BadParameter(
                f"{self.nargs} values belong here, {self.metavar}, and '{flag}' is none", ctx, self
            )
        return super().type_cast_value(ctx, value)


def _click_option(one: Declared) -> Callable[[Any], Any]:
    """Decorator that adds the click option of a declared one; None stands for what is not given."""
    option, more = one.option, _type_of(one)
    names = (option.flag or one.flag).split()
    if one.kind is bool:
        names = [f"{one.flag}/--no-{one.flag[2:]}"] if one.default is not False and "/" not in names[0] else names
        more = {"default": None, "is_flag": True}
    default = option.default or (
        str(one.default) if isinstance(one.default, str | int | float) and not isinstance(one.default, bool) else ""
    )
    if one.kind is bool and one.default is True:
        default = one.flag[2:]
    notes = [f"default: {default}"] if default else []
    if isinstance(more.get("type"), Number) and str(option.limits):
        notes.append(str(option.limits).removeprefix("of "))
    choices = f" One of {', '.join(option.choices)}." if option.choices and option.metavar else ""
    text = option.help + choices + (f"  [{'; '.join(notes)}]" if notes else "")
    kind = Several if more.get("nargs", 1) > 1 else click.Option
    made = click.option(*names, one.name, cls=kind, help=text, metavar=option.metavar or None, **more)
    return stack(made, group=option.group)


def _type_of(one: Declared) -> dict[str, Any]:
    """Type of an option as keywords of `click.option`."""
    option, kind = one.option, one.kind
    if get_origin(kind) is Mapping:
        # A mapping of names to texts, or to values of any kind.
        read = pairs if kind == Mapping[str, str] else json_pairs
        return {"multiple": True, "callback": read if option.parse is None else partial(_parsed_pairs, option.parse)}
    if option.parse is not None:
        # The help names each of several values: LEFT BOTTOM RIGHT TOP.
        return {"nargs": len(option.metavar.split()) or 1, "callback": partial(_parsed, option.parse)}
    if option.unit:
        type_ = Scale() if option.unit == "1:" else Measure(option.unit)
        several = get_origin(kind) is tuple
        if several and get_args(kind)[-1] is Ellipsis:
            return {"multiple": True, "type": type_}
        return {"type": type_, "nargs": len(get_args(kind)) if several else 1}
    if one.name in CHECKS:
        return {"callback": CHECKS[one.name]}
    if kind == tuple[int, ...]:
        return {"multiple": True, "callback": band_numbers}
    if get_origin(kind) is tuple and get_args(kind)[-1] is not Ellipsis:
        return {"nargs": len(get_args(kind)), "type": Number(get_args(kind)[0], option.limits)}
    if kind == tuple[float, ...]:
        return {"multiple": True, "type": Number(float, option.limits)}
    if kind in (tuple[Path, ...], tuple[str, ...]):
        return {"multiple": True, "type": FILE if kind == tuple[Path, ...] else str}
    if is_part(kind):
        return {"multiple": True, "callback": partial(_composed, kind)}
    if kind is Path:
        return {"type": FILE}
    if kind in (int, float):
        return {"type": Number(kind, option.limits)}
    if kind is str:
        return {"type": Choice(option.choices)} if option.choices and not option.metavar else {}
    return {}


def _parsed(parse: Callable[[Any], Any], ctx: click.Context, param: click.Parameter, value: Any) -> Any:
    """Value of a text or of several; what is wrong with it is an error of usage."""
    if value is None:
        return None
    try:
        return parse(value)
    except InputError as error:
        raise click.BadParameter(f"{error.what}; {error.hint}") from None


def _parsed_pairs(
    parse: Callable[[Any], Any], ctx: click.Context, param: click.Parameter, values: tuple[str, ...]
) -> Any:
    """Values of NAME=VALUE, given any number of times; None where none is."""
    return _parsed(parse, ctx, param, json_pairs(ctx, param, values) or None)


def _composed(kind: type[Any], ctx: click.Context, param: click.Parameter, values: tuple[str, ...]) -> Any:
    """Options value of NAME=VALUE, given any number of times; None where none is."""
    named = json_pairs(ctx, param, values)
    try:
        return compose(kind, named) if named else None
    except InputError as error:
        where = f"{error.where}: " if (error.where or "").startswith("`") else ""
        raise click.BadParameter(f"{where}{error.what}; {error.hint}") from None


json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on standard output.")
debug_option = click.option("--debug", is_flag=True, expose_value=False, help="Show the traceback of an error.")

overwrite_option = click.option("--overwrite", is_flag=True, help="Replace the output if it exists.")
dem_heights_option = click.option(
    "--dem-heights", metavar="DATUM", help="Vertical datum of the DEM, where the file does not say it."
)

# Options of photos that plane transformations place.
PLANAR = tuple(one.name for one in declared(PlanarInputs))
# Options of which image comes first where several show the ground; of what images show, beside their bands.
RANKED = ("acquired", "cloud_cover")
CHOSEN = ("band_names", "declared_bands", "margin", "usable", "src_nodata", "clouds", "cloud_values", *RANKED)

image_options = options_of(BlockInputs, "inputs", without=(*PLANAR, *CHOSEN))
area_options = options_of(Area, without=("snap", "like"))
band_option = options_of(BlockInputs, only=("bands",))
output_option = stack(click.option("-o", "--output", type=FILE, required=True, help="File to write."), group="output")
running_options = stack(json_option, debug_option, group="running")


def file_options(text: str) -> Callable[[Function], Function]:
    """Decorator of commands that write one file, and those of running.

    Parameters
    ----------
    text : str
        Help of the file.
    """
    return stack(click.option("-o", "--output", type=FILE, required=True, help=text), overwrite_option, running_options)


# Options that commands which place photos themselves do not have.
NOT_BY_RULE = ("rule", "order", "base", "dtype", "convert", "water", "water_fill")
# Options of accuracy rasters, which commands without covariances of orientations do not have.
ERRORS = tuple(one.name for one in declared(UncertaintyOptions))


def block_of(images: tuple[Path, ...], given: Mapping[str, Any]) -> Block:
    """Block of images with the inputs that a command was given.

    Parameters
    ----------
    images : tuple of Path
    given : mapping
        Inputs by name, of `Block` and its planar placement.

    Raises
    ------
    InputError
        An input would do nothing beside the others, such as an orientation without a sensor.
    """
    from geomosaic.inputs.declarations import Block
    from geomosaic.raster.info import without_side_cars

    return compose(Block, {"images": without_side_cars(images), **given})


def chosen(name: str, options: RunningOptions) -> int | None:
    """Value of an option, such as `threads`, if the user chose it.

    Parameters
    ----------
    name : str
    options : RunningOptions
    """
    given = click.get_current_context().get_parameter_source(name) is ParameterSource.COMMANDLINE
    return getattr(options, name) if given else None


def threads_within_memory(given: Mapping[str, Any]) -> dict[str, int]:
    """Threads that --mem-limit has room for, where they are fewer than would run.

    Where no limit is asked for, time is what counts, and memory is kept from one block to the next.

    Parameters
    ----------
    given : mapping
        Values by name: `memory_limit`, bytes, and `threads`, if they were given.

    Raises
    ------
    click.BadParameter
        The limit is below what the command takes with one thread, or with the threads that were asked for.
    """
    limit = given.get("memory_limit")
    if limit is None:
        keep_memory()
        return {}
    from geomosaic.options.memory import NEEDED, threads_within

    command = click.get_current_context().info_name or ""
    try:
        threads = {"threads": threads_within(command, limit, given)} if command in NEEDED else {}
    except InputError as error:
        from geomosaic.cli.output import translated

        raise click.BadParameter(translated(f"{error.what}; {error.hint}"), param_hint="--mem-limit") from error
    from geomosaic.raster.environment import limit_cache

    return_memory()
    limit_cache(limit)
    return threads
