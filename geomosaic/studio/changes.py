"""Changes of files by anyone, and of edits that wait, told to every page that listens within a second."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Callable, Hashable
from typing import Any

from geomosaic.jobs.run_control import LONGEST, SHARE, FileStates, file_states
from geomosaic.studio.workspace import Workspace

# Seconds between two looks, and between signs of life to a page that listens.
_PAUSE, _SIGN = 0.3, 15.0
# Pages that listen at once.
MOST = 32


class Changes:
    """Watch over the files of a workspace, with the pages that listen.

    Attributes
    ----------
    waiting : callable
        Edits that are not in their files yet; asked at every look, in the server's thread.
    """

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self.waiting: Callable[[], Hashable] = tuple
        self._listeners: set[asyncio.Queue[dict[str, Any] | None]] = set()
        self._ended = False

    @property
    def listeners(self) -> int:
        """Number of pages that listen."""
        return len(self._listeners)

    async def watch(self) -> None:
        """Look for changes until the task is cancelled."""
        before: FileStates = await asyncio.to_thread(self._states)
        waited, spent = self.waiting(), 0.0
        while True:
            await asyncio.sleep(min(max(_PAUSE, spent / SHARE), LONGEST))
            started = time.perf_counter()
            now = await asyncio.to_thread(self._states)
            spent = time.perf_counter() - started
            changed = [path for path in {**before, **now} if before.get(path) != now.get(path)]
            if changed:
                self.tell({"kind": "changed", "files": sorted({path.name for path in changed})})
            if (waiting := self.waiting()) != waited:
                self.tell({"kind": "waiting"})
            before, waited = now, waiting

    def tell(self, event: dict[str, Any]) -> None:
        """Tell an event to every page that listens; to be called in the server's thread.

        Parameters
        ----------
        event : dict
            JSON values; `kind` says what has happened.
        """
        for queue in self._listeners:
            if queue.full():  # a page that does not read loses what it would read late
                queue.get_nowait()
            queue.put_nowait(event)

    def end(self) -> None:
        """Let go of the pages that listen, for the server to end."""
        self._ended = True
        for queue in self._listeners:
            if queue.full():
                queue.get_nowait()
            queue.put_nowait(None)

    async def events(self) -> AsyncIterator[str]:
        """Events from now on as a stream of server-sent events.

        Yields
        ------
        str
        """
        queue: asyncio.Queue[dict[str, Any] | None] = asyncio.Queue(maxsize=100)
        self._listeners.add(queue)
        try:
            yield "retry: 1000\n\n"
            while not self._ended:
                try:
                    event = await asyncio.wait_for(queue.get(), _SIGN)
                except TimeoutError:
                    yield ": still here\n\n"
                    continue
                if event is None:
                    return
                yield f"data: {json.dumps(event)}\n\n"
        finally:
            self._listeners.discard(queue)

    def _states(self) -> FileStates:
        return file_states(self._workspace.watched())
