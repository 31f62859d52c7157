"""Memory that commands and functions need, and the threads that a limit leaves room for."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from geomosaic.errors import InputError, counted
from geomosaic.options.render import MEGABYTE, PER_THREAD, PROGRAM

# Megabytes at the peak of a command besides those of its threads, as measured: the program, what it loads, decoded
# tiles, and a DEM that is read as it is needed.
NEEDED = {
    "ortho": 140,
    "deskew": 140,
    "reproject": 140,
    "georeference": 210,
    "coregister": 300,
    "mosaic": PROGRAM // MEGABYTE,
    "edges": PROGRAM // MEGABYTE,
    "develop": PROGRAM // MEGABYTE,
    "run": PROGRAM // MEGABYTE + 50,
    "demo": PROGRAM // MEGABYTE + 50,
}
# More with an option, where one image is drawn and where several are: heights around a block that may hide it, bands of
# the images that meet in a block. With both, those heights are needed twice: around the block, and around its seams.
MORE = {("true_ortho", True): (40, 180)} | {
    ("blend", kind): (0, 100) for kind in ("multiband", "overlap", "edge", "cutline")
}
BOTH = 230


def threads_within(command: str, limit: int, given: Mapping[str, Any]) -> int:
    """Threads that a limit has room for, at most as many as would run.

    Parameters
    ----------
    command : str
        One of `NEEDED`.
    limit : int
        Bytes.
    given : mapping
        Values of options by name: `threads` if they were asked for, and what needs memory.

    Raises
    ------
    InputError
        The limit is below what the command takes with one thread, or with the threads that were asked for.
    """
    threads = given.get("threads")
    several = NEEDED[command] * MEGABYTE >= PROGRAM
    found = [more[several] for (name, value), more in MORE.items() if given.get(name) == value]
    alone = NEEDED[command] + sum(found) + (BOTH if several and len(found) > 1 else 0)
    room = (limit - alone * MEGABYTE) // PER_THREAD
    if room < (threads or 1):
        least = alone + (threads or 1) * PER_THREAD // MEGABYTE
        fewer = f", or `threads={room}`" if room > 0 else ""
        raise InputError(
            f"{limit // MEGABYTE}M is too little memory: {command} takes up to {least}M with "
            f"{counted(threads or 1, 'thread')}",
            where="`memory_limit`",
            hint=f"write {least}M{fewer}, or leave it out",
        )
    return int(min(room, threads or os.cpu_count() or 1))
