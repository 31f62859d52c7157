"""What the commands need at least, so that a limit that cannot be kept is not accepted in silence."""

from __future__ import annotations

import os

import click

from geomosaic.cli.talk import say

MEGABYTE = 1 << 20
LEAST = {"ortho": 220, "mosaic": 330, "run": 460, "demo": 460}
"""Megabytes that a command takes before it holds a pixel: Python, its libraries and their tables, as measured."""
PER_THREAD = 40
"""Megabytes of one thread: the block it works on, as measured with 1, 2 and 4 threads."""
TOLERATED = 1.2
"""A limit is kept when the peak is at most so many times as large."""


def note_memory(limit: int | None, threads: int | None) -> None:
    """Say so where a limit is below what the command needs; it works all the same, with as little as it can."""
    command = click.get_current_context().info_name or ""
    many = threads or os.cpu_count() or 1
    need = LEAST[command] + PER_THREAD * many
    if limit is None or need * MEGABYTE <= TOLERATED * limit:
        return
    fewer = ", less with fewer --threads" if many > 1 else ""
    say(
        f"note: --mem-limit {limit // MEGABYTE}M will be exceeded: with {many} thread{'s' if many > 1 else ''} the "
        f"program itself takes about {need}M{fewer}; it works with as little as it can"
    )
