"""The group of commands: the modules of `cli/commands`, listed without importing them, and their errors.

The first line of a command's docstring is its short help. A line `Help group: NAME` below it says under which heading
`geomosaic --help` lists the command. Nothing is imported for that, since a command may import numerical libraries.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from itertools import groupby
from pathlib import Path
from typing import Any, NoReturn

import click

import geomosaic
from geomosaic.cli.process import leave, set_up

# Headings in their order; another one comes after them.
GROUPS = ("Projects", "Orthos and mosaics", "Orientation and accuracy", "Maps", "Calculations and lists")

_DOCSTRING = re.compile(r'\A"""(?P<help>[^\n"]*)(?:\n\nHelp group: (?P<group>[^\n"]+))?')


@dataclass(frozen=True)
class CommandSummary:
    """Line of `geomosaic --help` for one command."""

    name: str
    help: str
    group: str


@lru_cache
def commands() -> dict[str, CommandSummary]:
    """Summaries of all commands by name, in the order of their groups and names."""
    files = (Path(__file__).parent / "commands").glob("[!_]*.py")
    found = sorted((_summary(file) for file in files), key=lambda one: (_rank(one.group), one.group, one.name))
    return {one.name: one for one in found}


def _summary(file: Path) -> CommandSummary:
    with file.open(encoding="utf-8") as opened:
        match = _DOCSTRING.match(opened.read(400))
    found = match.groupdict("") if match else {"help": "", "group": ""}
    return CommandSummary(file.stem, found["help"], found["group"] or "Others")


def _rank(group: str) -> int:
    return GROUPS.index(group) if group in GROUPS else len(GROUPS)


class LazyGroup(click.Group):
    """A group whose commands are modules `geomosaic.cli.commands.<name>` with an attribute `command`."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of their groups."""
        return list(commands())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import one command."""
        if cmd_name not in commands():
            return None
        command: click.Command = import_module(f"geomosaic.cli.commands.{cmd_name}").command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Suggest the command that was meant."""
        name = args[0] if args else ""
        if name and not name.startswith("-") and name not in commands():
            from geomosaic.errors import did_you_mean

            hint = did_you_mean(name, commands())
            ctx.fail(f"No such command '{name}'. {hint[:1].upper()}{hint[1:]}".rstrip())
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the short help of each command under the headings of the groups."""
        width = max(map(len, commands()))
        for group, listed in groupby(commands().values(), key=lambda one: one.group):
            with formatter.section(group):
                formatter.write_dl([(one.name.ljust(width), one.help) for one in listed])


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Exit codes: 0 done, 1 failed, 2 usage, 3 done but a quality threshold failed, "
    "4 interrupted and resumable, 130 stopped by Ctrl-C.",
)
@click.version_option(geomosaic.__version__, prog_name="geomosaic", message="%(prog)s %(version)s")
def cli() -> None:
    """From raw photos and scenes to georeferenced, colour-balanced mosaics."""


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run the command line and exit.

    Parameters
    ----------
    arguments : list of str, optional
        Instead of the process's own.
    """
    if arguments is not None:
        sys.exit(run(arguments))
    set_up()
    leave(run(sys.argv[1:]))


def run(words: list[str]) -> int:
    """Run the command line and return the exit code.

    Parameters
    ----------
    words : list of str
    """
    as_json, debug = "--json" in words, "--debug" in words
    try:
        result: Any = cli.main(args=words, prog_name="geomosaic", standalone_mode=False)
        return result if isinstance(result, int) else 0
    except click.exceptions.Exit as stop:
        return int(stop.exit_code)
    except (click.Abort, KeyboardInterrupt) as stop:
        from geomosaic.cli.output import stopped

        return stopped(stop.__cause__ or stop, as_json, resumes=words[:1] == ["run"] or words[:2] == ["sheets", "make"])
    except Exception as error:
        from geomosaic.cli.output import failed

        return failed(error, as_json=as_json, debug=debug, command=next(iter(words), ""))
