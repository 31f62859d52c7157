"""Run control: one run at a time, and stopping on request."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from geomosaic.errors import InputError, Interrupted, OutputError
from geomosaic.types import Progress


@contextmanager
def project_lock(path: Path) -> Iterator[None]:
    """Lock that lets one run of a project work at a time.

    The lock is on the open file, not on its being there: a run that was killed leaves a file but no lock.

    Parameters
    ----------
    path : Path
        The lock file; the process that holds it writes its number there.

    Raises
    ------
    InputError
        Another run is under way.
    OutputError
        The folder cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Not "w": it would empty the number of another holder before the lock is known to be ours.
        file = path.open("a+", encoding="utf-8")
    except OSError as error:
        raise OutputError(
            f"the project's folder cannot be written: {error.strerror}", where=str(path), hint="check its permissions"
        ) from error
    with file:
        if not _try_lock(file.fileno()):
            file.seek(0)
            holder = file.read(64).strip()
            raise InputError(
                f"another run of this project is under way{f' (process {holder})' if holder else ''}",
                where=str(path.parent.parent.parent),
                hint="wait until it ends, or stop it",
            )
        file.seek(0)
        file.truncate()
        file.write(str(os.getpid()))
        file.flush()
        yield


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
