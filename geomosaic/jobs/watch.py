"""Wait until something that a project reads has changed."""

from __future__ import annotations

import time
from collections.abc import Iterable
from pathlib import Path

from geomosaic.jobs.step import Job
from geomosaic.raster.file_dependencies import journal_of

PAUSE = 0.1
"""Seconds from one look to the next."""
SHARE = 0.05
"""Of a processor that looking may take, however many files there are."""
LONGEST = 2.0
"""Seconds between looks at most."""
Look = dict[Path, tuple[int, int] | None]
"""Size and modification time of files; None where there is none."""


def make_ready() -> None:
    """Load what the next run of a mosaic will need: seconds, better spent before it is waited for."""
    from geomosaic.raster.vector import prepare
    from geomosaic.resample.engine import numba_engine

    prepare()
    numba_engine()


def read_by(job: Job) -> list[Path]:
    """Files that the steps read and none of them writes, and the journals that databases may get.

    Those of outputs too: while one holds anything, its file is not replaced.
    """
    written = dict.fromkeys(path for step in job.steps for path in step.outputs)
    read = dict.fromkeys(path for step in job.steps for path in step.inputs if path not in written)
    return [*read, *(journal for path in (*read, *written) if (journal := journal_of(path)) is not None)]


def look(files: Iterable[Path]) -> Look:
    """See how files are."""
    return {path: _state(path) for path in files}


def wait_for_change(before: Look, pause: float = PAUSE) -> Look:
    """Wait until files are other than before and stay so for a pause: a file half written is no change yet."""
    last, spent = before, 0.0
    while True:
        time.sleep(min(max(pause, spent / SHARE), LONGEST))
        started = time.perf_counter()
        now = look(before)
        spent = time.perf_counter() - started
        if now == last and now != before:
            return now
        last = now


def _state(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    if path.name.endswith("-wal") and not found.st_size:  # comes and goes with a look at the layer
        return None
    return found.st_size, found.st_mtime_ns
