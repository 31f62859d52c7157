"""Memory that the threads of a run share, where the work on one block may need much of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Condition


class Room:
    """So many bytes: who needs more than is left waits for others to end; who needs more than all works alone.

    What comes out does not depend on it, only when.
    """

    def __init__(self, size: int) -> None:
        self._size, self._held = size, 0
        self._changed = Condition()

    @contextmanager
    def of(self, size: int) -> Iterator[None]:
        """Hold so many bytes for the length of a block; never to be asked for by a thread that holds some."""
        with self._changed:
            self._changed.wait_for(lambda: self._held == 0 or self._held + size <= self._size)
            self._held += size
        try:
            yield
        finally:
            with self._changed:
                self._held -= size
                self._changed.notify_all()
