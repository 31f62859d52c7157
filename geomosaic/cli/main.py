"""The group of commands and what becomes of their errors; a command's module is imported when it is called."""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Any, NoReturn

import click

import geomosaic
from geomosaic.cli.process import leave, set_up

COMMANDS: dict[str, str] = {
    "demo": "Run the sample block from photos to mosaic, with its accuracy.",
    "new": "Write a project file from images and tables.",
    "run": "Run what is stale in a project.",
    "status": "Show which steps of a project are stale, and why.",
    "georeference": "Place one image on the map by control points.",
    "ortho": "Rectify one image.",
    "deskew": "Remove skew and tangential distortion of a scanned strip, without control.",
    "mosaic": "Make one mosaic from images.",
    "develop": "Draw photos of a facade, tower or dome on its developed surface.",
    "edges": "Join photos with control at their edges, and mosaic them.",
    "reproject": "Bring a georeferenced raster or vectors to another CRS.",
    "rpc": "Fit RPCs to any sensor, refine them, and write them.",
    "locate": "Find places on the ground from pixels, or draw map vectors into a photo.",
    "check": "Measure a map at check points.",
    "fiducials": "Find the fiducial marks of scanned films.",
    "water": "Propose areas of water, from a mosaic and a DEM.",
    "contours": "Draw contours of a DEM.",
    "sheet": "Make a map sheet: frame, grid, legend, vectors.",
    "enhance": "Stretch, sharpen or pan-sharpen a raster for print.",
    "sheets": "Make, find and show the sheets of a series.",
    "plan": "Calculate scales, scanning, relief, swath, coverage, control.",
    "sensors": "List sensors, or show the inputs of one.",
}
"""Short help by command: `geomosaic --help` imports none of them."""


class LazyGroup(click.Group):
    """A group whose commands are modules `geomosaic.cli.commands.<name>` with an attribute `command`."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import one command."""
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = import_module(f"geomosaic.cli.commands.{cmd_name}").command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Suggest the command that was meant."""
        name = args[0] if args else ""
        if name and not name.startswith("-") and name not in COMMANDS:
            from geomosaic.errors import did_you_mean

            hint = did_you_mean(name, COMMANDS)
            ctx.fail(f"No such command '{name}'. {hint[:1].upper()}{hint[1:]}".rstrip())
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the table."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


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
    """Run the command line and return the exit code."""
    as_json, debug = "--json" in words, "--debug" in words
    try:
        result: Any = cli.main(args=words, prog_name="geomosaic", standalone_mode=False)
        return result if isinstance(result, int) else 0
    except click.exceptions.Exit as stop:
        return int(stop.exit_code)
    except (click.Abort, KeyboardInterrupt) as stop:
        from geomosaic.cli.failure import stopped

        return stopped(stop.__cause__ or stop, as_json, resumes=words[:1] == ["run"] or words[:2] == ["sheets", "make"])
    except Exception as error:
        from geomosaic.cli.failure import failed

        return failed(error, as_json=as_json, debug=debug, command=next(iter(words), ""))
