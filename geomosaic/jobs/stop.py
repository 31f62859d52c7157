"""Stopping on request: SIGTERM lets the running tile finish, then the run ends and can be resumed."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from geomosaic.errors import Interrupted
from geomosaic.jobs.step import Progress


class Stop:
    """A flag that is looked at between tiles."""

    def __init__(self) -> None:
        self._asked = threading.Event()

    def ask(self) -> None:
        """Ask the run to stop."""
        self._asked.set()

    def check(self) -> None:
        """Stop here if that was asked for.

        Raises
        ------
        Interrupted
        """
        if self._asked.is_set():
            raise Interrupted("stopped on request", mend="the same command resumes: steps that are done stay done")

    def watching(self, progress: Progress | None) -> Progress:
        """Make a progress function that checks the flag at every report."""

        def report(done: int, total: int, stage: str) -> None:
            if progress is not None:
                progress(done, total, stage)
            self.check()

        return report


@contextmanager
def on_sigterm(stop: Stop) -> Iterator[None]:
    """Turn SIGTERM into a request to stop; outside the main thread signals are left alone."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handler(number: int, frame: FrameType | None) -> None:
        stop.ask()

    before = signal.signal(signal.SIGTERM, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
