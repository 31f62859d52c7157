"""Parameters that a message names in backticks, as the running command calls them: --flags, or [section] key.

Below the command line a message says `dem_heights` or `resampling=nearest`: the parameter of the library. A command
that has such a parameter says its flag; one that reads a project file says its section and key; anything else stays.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from collections.abc import Mapping

ALIASES = {"resolution": "res", "control": "gcps"}
"""Parameters of the library that commands hold under another name."""
PROJECT_COMMANDS = ("demo", "run", "status")

_SECTIONS = {
    "project": ("bands", "margin", "nodata", "usable"),
    "sensor": ("camera", "corrections", "fiducials"),
    "exterior": ("angle_frame", "angle_unit", "angles", "crs", "heights", "matrix", "trusted"),
    "dem": ("height",),
    "planar": ("azimuth", "insist", "kind", "model", "rectify", "robust", "scale", "ties"),
    "output": ("bounds", "resolution"),
}
_KEYS = {name: f"[{section}] {name}" for section, names in _SECTIONS.items() for name in names} | {
    "control": "[control] file",
    "dem": "[dem] file",
    "dem_heights": "[dem] heights",
    "dst_crs": "[output] crs",
    "exterior": "[exterior] file",
    "gcps": "[control] file",
    "sensor": "[sensor] name",
}
"""Where the inputs of a block stand in a project file; options declare it themselves."""


def translated(text: str, command: str | None = None) -> str:
    """Text with its parameters named as the command names them.

    Parameters
    ----------
    text : str
        Parameters stand in backticks.
    command : str, optional
        Name of a command; the one that is running unless given.

    Returns
    -------
    str
    """
    if "`" not in text:
        return text
    context = click.get_current_context(silent=True)
    if command is None and context is not None:
        command = context.command_path.split()[1] if " " in context.command_path else None
    options = _options(command or "")
    keys = _project_keys() if command in PROJECT_COMMANDS else {}

    def named(found: re.Match[str]) -> str:
        name, value = found["name"], found["value"]
        option = options.get(name) or options.get(ALIASES.get(name, ""))
        if option is not None:
            return _flag(option, value)
        if name in keys:
            return keys[name] if value is None else f"{keys[name]} = {_toml(value)}"
        return found[0]

    return re.sub(r"`(?P<name>[a-z_]+)(=(?P<value>[^`]*))?`", named, text)


def _flag(option: click.Option, value: str | None) -> str:
    long = next((flag for flag in option.opts if flag.startswith("--")), option.opts[0])
    if option.is_flag:
        return option.secondary_opts[0] if value == "False" and option.secondary_opts else long
    return f"{long} {value}" if value else long


def _toml(value: str) -> str:
    """Value as a project file writes it."""
    return value.lower() if re.fullmatch(r"True|False|[-+\d.]+", value) else f"'{value}'"


@lru_cache
def _options(command: str) -> Mapping[str, click.Option]:
    """Options of a command, and of the commands of a group, by parameter."""
    from geomosaic.cli.command_list import commands
    from geomosaic.cli.main import cli

    loaded = cli.get_command(click.Context(cli), command) if command in commands() else None
    if loaded is None:
        return {}
    inner = loaded.commands.values() if isinstance(loaded, click.Group) else ()
    return {str(one.name): one for each in (loaded, *inner) for one in each.params if isinstance(one, click.Option)}


@lru_cache
def _project_keys() -> Mapping[str, str]:
    """Section and key of every parameter that a project file has."""
    from geomosaic.options.declaration import declared
    from geomosaic.options.mosaic import MosaicOptions

    own = {one.name: f"[{one.option.section}] {one.key}" for one in declared(MosaicOptions) if one.option.section}
    return own | _KEYS
