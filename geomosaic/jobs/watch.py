"""Waiting for a change of the files that a project reads."""

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
    """Libraries and kernels that the next run of a mosaic needs, loaded ahead.

    It takes seconds, better spent before someone waits for the run.
    """
    from geomosaic.raster.vector import prepare
    from geomosaic.resample.engine import numba_engine

    prepare()
    numba_engine()


def read_by(job: Job) -> list[Path]:
    """Files that the steps of a job read and none of them writes, with journals that databases may get.

    Journals of outputs count too: while one holds anything, its file is not replaced.

    Parameters
    ----------
    job : Job

    Returns
    -------
    list of Path
    """
    written = dict.fromkeys(path for step in job.steps for path in step.outputs)
    read = dict.fromkeys(path for step in job.steps for path in step.inputs if path not in written)
    return [*read, *(journal for path in (*read, *written) if (journal := journal_of(path)) is not None)]


def look(files: Iterable[Path]) -> Look:
    """State of files: size in bytes and modification time in nanoseconds.

    Parameters
    ----------
    files : iterable of Path

    Returns
    -------
    dict
        None for a file that does not exist.
    """
    return {path: _state(path) for path in files}


def wait_for_change(before: Look, pause: float = PAUSE) -> Look:
    """State of files once they differ from before and have stayed the same for a pause.

    A file that is still being written is no change yet.

    Parameters
    ----------
    before : dict
        As `look` gives it.
    pause : float
        Least time between two looks, seconds.

    Returns
    -------
    dict
        As `look` gives it.
    """
    last, spent = before, 0.0
    while True:
        # A look at many files on a network drive takes long: the pause grows with it, see SHARE.
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
