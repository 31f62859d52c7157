"""Run control: one run at a time, stopping on request, and waiting for changes of the files that a project reads."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from geomosaic.errors import InputError, Interrupted, OutputError
from geomosaic.jobs.step import Job
from geomosaic.raster.files import journal_of
from geomosaic.types import Progress


@contextmanager
def project_lock(
    path: Path, held: str = "another run of this project is under way", hint: str = "wait until it ends, or stop it"
) -> Iterator[None]:
    """Lock that lets one run of a project, or one studio, work at a time.

    The file stays; after an error, only where it was there before, or its folder holds other files by then.

    Parameters
    ----------
    path : Path
        The lock file; the process that holds it writes its number there.
    held, hint : str
        What is told where it is held.

    Raises
    ------
    InputError
        Another process holds it.
    OutputError
        The folder cannot be written.
    """
    # The lock is on the open file, not on its being there: a run that was killed leaves a file but no lock.
    new = [each for each in (path, *path.parents) if not each.exists()]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Not "w": it would empty the number of another holder before the lock is known to be ours.
        file = path.open("a+", encoding="utf-8")
    except OSError as error:
        raise OutputError(
            f"the project's folder cannot be written: {error.strerror}", where=str(path), hint="check its permissions"
        ) from error
    with file:
        if not _try_lock(file.fileno()) or _is_removed(path, file.fileno()):
            file.seek(0)
            holder = file.read(64).strip()
            raise InputError(
                f"{held}{f' (process {holder})' if holder else ''}", where=str(path.parent.parent.parent), hint=hint
            )
        file.seek(0)
        file.truncate()
        file.write(str(os.getpid()))
        file.flush()
        try:
            yield
        except BaseException:
            # Before it is given up: a file that another run has locked since must not go.
            _remove(new)
            raise


def _remove(new: Sequence[Path]) -> None:
    """Remove a lock file and the folders above it that a run has made, unless other files have come beside it."""
    file, *folders = new or (None,)
    if file is None or {each.name for each in file.parent.iterdir()} != {file.name}:
        return
    with suppress(OSError):  # Windows removes no open file
        file.unlink()
        for folder in folders:
            folder.rmdir()


def _is_removed(path: Path, handle: int) -> bool:
    """Whether another run has removed a lock file since it was opened."""
    try:
        return not os.path.samestat(os.fstat(handle), path.stat())
    except OSError:
        return True


def _try_lock(handle: int) -> bool:
    """Take an exclusive lock without waiting."""
    if sys.platform == "win32":
        import msvcrt

        try:
            # A byte far beyond the text, so that the holder's number stays readable.
            os.lseek(handle, 1 << 20, os.SEEK_SET)
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True
    import fcntl

    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


class Stop:
    """Flag that asks a run to stop; it is looked at between tiles."""

    def __init__(self) -> None:
        self._asked = threading.Event()

    def ask(self) -> None:
        """Ask the run to stop."""
        self._asked.set()

    def check(self) -> None:
        """Stop here where it was asked for.

        Raises
        ------
        Interrupted
        """
        if self._asked.is_set():
            raise Interrupted("stopped on request", hint="the same command resumes: steps that are done stay done")

    def watching(self, progress: Progress | None) -> Progress:
        """Progress function that checks the flag at every report.

        Parameters
        ----------
        progress : callable, optional
            Called with (done, total, stage) before the flag is looked at.

        Returns
        -------
        callable
        """

        def report(done: int, total: int, stage: str) -> None:
            if progress is not None:
                progress(done, total, stage)
            self.check()

        return report


# Seconds from one look to the next.
PAUSE = 0.1
# Of a processor that looking may take, however many files there are.
SHARE = 0.05
# Seconds between looks at most.
LONGEST = 2.0
# Size and modification time of files; None where there is none.
FileStates = dict[Path, tuple[int, int] | None]


def make_ready() -> None:
    """Libraries and kernels that the next run of a mosaic needs, loaded ahead."""
    # It takes seconds, better spent before someone waits for the run.
    from geomosaic.kernels.library import library
    from geomosaic.raster.vector import prepare

    prepare()
    library()


def read_by(job: Job) -> list[Path]:
    """Files that the steps of a job read and none of them writes, with journals that databases may get.

    Parameters
    ----------
    job : Job
    """
    # Journals of outputs count too: while one holds anything, its file is not replaced.
    written = dict.fromkeys(path for step in job.steps for path in step.outputs)
    read = dict.fromkeys(path for step in job.steps for path in step.inputs if path not in written)
    return [*read, *(journal for path in (*read, *written) if (journal := journal_of(path)) is not None)]


def file_states(files: Iterable[Path]) -> FileStates:
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


def wait_for_change(before: FileStates, pause: float = PAUSE) -> FileStates:
    """State of files once they differ from before and have stayed the same for a pause.

    A file that is still being written is no change yet.

    Parameters
    ----------
    before : dict
        As `file_states` gives it.
    pause : float
        Least time between two looks, seconds.

    Returns
    -------
    dict
        As `file_states` gives it.
    """
    last, spent = before, 0.0
    while True:
        # Looking at many files on a network drive takes long: the pause grows with it, see SHARE.
        time.sleep(min(max(pause, spent / SHARE), LONGEST))
        started = time.perf_counter()
        now = file_states(before)
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
