"""Least memory of the commands, so that a limit that cannot be kept is not accepted in silence."""

from __future__ import annotations

import os

import click

from geomosaic.cli.output import say
from geomosaic.cli.process import keep_memory

MEGABYTE = 1 << 20
SMALLEST = {
    "ortho": 90,
    "deskew": 90,
    "reproject": 90,
    "georeference": 180,
    "mosaic": 170,
    "edges": 220,
    "develop": 190,
    "run": 190,
    "demo": 450,
}
"""Megabytes at the peak of the smallest work, one or two pictures of 100 pixels in one thread (demo: the sample), as
measured. Nothing keeps a lower limit."""
LEAST = {
    "ortho": 220,
    "deskew": 220,
    "reproject": 220,
    "georeference": 370,
    "mosaic": 330,
    "edges": 340,
    "develop": 390,
    "run": 460,
    "demo": 460,
}
"""Megabytes that a command takes before it holds a pixel where all that it may need is loaded, as measured."""
PER_THREAD = 40
"""Megabytes of one thread: the block it works on, as measured with 1, 2 and 4 threads."""
TOLERATED = 1.2
"""A limit is kept when the peak is at most so many times as large."""


def check_memory() -> None:
    """Check of --mem-limit against the least that the running command takes, and a note where it may be exceeded.

    A command that may exceed its limit works all the same, with as little as it can. Where none is asked for, time is
    what counts, and memory is kept from one block to the next.

    Raises
    ------
    click.BadParameter
        The limit is below what the command takes however small its work.
    """
    context = click.get_current_context()
    limit, threads = context.params["memory_limit"], context.params["threads"]
    command = context.info_name or ""
    if limit is not None and limit < SMALLEST[command] * MEGABYTE:
        raise click.BadParameter(
            f"{limit // MEGABYTE}M is too little memory: {command} takes at least {SMALLEST[command]}M, however small "
            "the work; write 512M or 2G, or leave it out",
            param_hint="--mem-limit",
        )
    if limit is None:
        keep_memory()
    many = threads or os.cpu_count() or 1
    need = LEAST[command] + PER_THREAD * many
    if limit is None or need * MEGABYTE <= TOLERATED * limit:
        return
    fewer = ", less with fewer --threads" if many > 1 else ""
    say(
        f"note: --mem-limit {limit // MEGABYTE}M may be exceeded: with {many} thread{'s' if many > 1 else ''} the "
        f"program itself takes up to {need}M{fewer}; it works with as little as it can"
    )
