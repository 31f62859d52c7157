"""Runs of a project's steps from the page, one at a time, in a process of their own."""

from __future__ import annotations

import asyncio
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError

# Lines of the log that are kept, and seconds that a run has to stop when the studio ends.
_LINES, _PATIENCE = 200, 10.0


@dataclass
class Run:
    """A run as the page shows it.

    Attributes
    ----------
    state : str
        'running', 'stopping', 'done', 'quality' (a threshold failed), 'stopped' or 'failed'.
    steps : list of str
        Steps that were asked for; all that are stale if empty.
    stage : str
        What it is at.
    done, total : int
        How far the stage is; a total of 0 is not known.
    log : list of str
        Stages, notes and steps with their times.
    what, where, hint : str
        How it ended.
    """

    state: str
    steps: list[str]
    stage: str = "starting"
    done: int = 0
    total: int = 0
    log: list[str] = field(default_factory=list)
    what: str | None = None
    where: str | None = None
    hint: str | None = None


class Runs:
    """Runs of one project.

    Parameters
    ----------
    path : Path
        Project file.
    tell : callable
        Takes events for the pages.

    Attributes
    ----------
    before : callable
        Called ahead of every run.
    """

    def __init__(self, path: Path, tell: Callable[[dict[str, Any]], None]) -> None:
        self._path, self._tell = path, tell
        self.before: Callable[[], None] = lambda: None
        self._run: Run | None = None
        self._process: asyncio.subprocess.Process | None = None
        self._reading: asyncio.Task[None] | None = None
        self._starting = asyncio.Lock()
        self._following: tuple[str, ...] | None = None
        self._count, self._started = 0, 0.0
        # Beyond any number of a studio before this one.
        self._serial = int(1000 * time.time())

    @property
    def running(self) -> bool:
        """Whether a run is under way."""
        return self._run is not None and self._run.state in ("running", "stopping")

    def state(self) -> dict[str, Any] | None:
        """Facts of the run that is under way or ended last, see `Run`; None where there was none.

        `serial` grows with every change: an answer and an event may reach the page in any order.
        """
        return None if self._run is None else {**asdict(self._run), "serial": self._serial}

    async def start(self, steps: Sequence[str], force: bool) -> None:
        """Start a run.

        Parameters
        ----------
        steps : sequence of str
            With what they read from; all unless given.
        force : bool
            Run the steps whether stale or not.

        Raises
        ------
        InputError
            One is under way.
        """
        process = await self._ready()
        if self.running:
            raise InputError("a run of this project is under way", hint="wait until it ends, or stop it")
        self.before()
        self._count += 1
        self._run = Run("running", list(steps))
        self._started = time.monotonic()
        self._ask(process, {"kind": "run", "run": self._count, "steps": list(steps), "force": force})
        self._report()

    async def follow(self, steps: Sequence[str]) -> None:
        """Start a run of what is stale among steps, after the one that is under way."""
        if self.running:
            self._following = tuple(steps)
        else:
            await self.start(steps, force=False)

    async def prepare(self) -> None:
        """Load what a run needs, so that the first one starts at once."""
        await self._ready()

    def stop(self) -> None:
        """Ask the run to stop; what is done stays done.

        Raises
        ------
        InputError
            None is under way.
        """
        if self._run is None or self._process is None or not self.running:
            raise InputError("no run is under way", hint="load the page again")
        self._run.state, self._following = "stopping", None
        self._ask(self._process, {"kind": "stop", "run": self._count})
        self._report()

    async def end(self) -> None:
        """Stop the run, for the studio to end."""
        if self._process is None or self._reading is None:
            return
        if self.running:
            self.stop()
        if self._process.stdin is not None:
            self._process.stdin.close()
        done, _ = await asyncio.wait({self._reading}, timeout=_PATIENCE)
        if not done:
            self._process.kill()
            await self._reading

    async def _ready(self) -> asyncio.subprocess.Process:
        """Process that waits for requests."""
        async with self._starting:
            if self._process is None or self._reading is None or self._reading.done():
                words = [sys.executable, "-m", "geomosaic.studio.run_process", str(self._path)]
                # A session of its own: Ctrl-C in the terminal is for the studio, which then stops the run.
                self._process = await asyncio.create_subprocess_exec(
                    *words, stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, start_new_session=True
                )
                self._reading = asyncio.create_task(self._read(self._process))
            return self._process

    @staticmethod
    def _ask(process: asyncio.subprocess.Process, request: dict[str, Any]) -> None:
        assert process.stdin is not None
        process.stdin.write(json.dumps(request).encode() + b"\n")

    async def _read(self, process: asyncio.subprocess.Process) -> None:
        assert process.stdout is not None
        async for line in process.stdout:
            if self._run is None:
                continue
            self._take(self._run, json.loads(line))
            self._report()
            if not self.running and self._following is not None:
                following, self._following = self._following, None
                if self._run.state in ("done", "quality"):
                    await self.start(following, force=False)
        code = await process.wait()
        if self._run is not None and self.running:
            self._run.state, self._run.what = "failed", f"the run ended without a word (code {code})"
            self._run.hint = "there may be too little memory; what is done stays done"
            self._report()

    def _take(self, run: Run, message: dict[str, Any]) -> None:
        kind = message.pop("kind")
        if kind == "progress":
            if message["stage"] != run.stage:
                self._note(run, message["stage"])
            run.stage, run.done, run.total = message["stage"], message["done"], message["total"]
        elif kind == "ended":
            run.state, run.what = message["state"], message["what"]
            run.where, run.hint = message.get("where"), message.get("hint")
        elif not any(line.endswith(f"  {message['text']}") for line in run.log):
            self._note(run, message["text"])

    def _note(self, run: Run, text: str) -> None:
        run.log.append(f"{time.monotonic() - self._started:.1f} s  {text}")
        del run.log[:-_LINES]

    def _report(self) -> None:
        self._serial += 1
        self._tell({"kind": "run", "run": self.state()})
