"""What the commands need at least, so that a limit that cannot be kept is not accepted in silence."""

from __future__ import annotations

import os

import click

from geomosaic.cli.process import keep_memory
from geomosaic.cli.talk import say
from geomosaic.cli.values import size

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


def memory_limit(ctx: click.Context, param: click.Parameter, value: str | None) -> int | None:
    """Bytes of a size such as 512M or 2G, not below what the command takes for the smallest work."""
    limit = size(ctx, param, value)
    least = SMALLEST.get(ctx.info_name or "", 0)
    if limit is not None and limit < least * MEGABYTE:
        raise click.BadParameter(
            f"'{value}' is too little memory: {ctx.info_name} takes at least {least}M, however small the work; "
            "write 512M or 2G, or leave it out"
        )
    return limit


def note_memory(limit: int | None, threads: int | None) -> None:
    """Say so where a limit is below what the command may need; it works all the same, with as little as it can.

    Where none is asked for, time is what counts, and memory is kept from one block to the next.
    """
    if limit is None:
        keep_memory()
    command = click.get_current_context().info_name or ""
    many = threads or os.cpu_count() or 1
    need = LEAST[command] + PER_THREAD * many
    if limit is None or need * MEGABYTE <= TOLERATED * limit:
        return
    fewer = ", less with fewer --threads" if many > 1 else ""
    say(
        f"note: --mem-limit {limit // MEGABYTE}M may be exceeded: with {many} thread{'s' if many > 1 else ''} the "
        f"program itself takes up to {need}M{fewer}; it works with as little as it can"
    )
