"""Runs of a project's steps from the page, one at a time, each in a process of its own."""

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
from geomosaic.studio.run_process import ALL, STALE, STOPPED

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
    """

    def __init__(self, path: Path, tell: Callable[[dict[str, Any]], None]) -> None:
        self._path, self._tell = path, tell
        self._run: Run | None = None
        self._process: asyncio.subprocess.Process | None = None
        self._reading: asyncio.Task[None] | None = None
        self._started = 0.0
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
        if self.running:
            raise InputError("a run of this project is under way", hint="wait until it ends, or stop it")
        self._run = Run("running", list(steps))
        self._started = time.monotonic()
        words = [sys.executable, "-m", "geomosaic.studio.run_process", ALL if force else STALE, str(self._path), *steps]
        # A session of its own: Ctrl-C in the terminal is for the studio, which then stops the run.
        self._process = await asyncio.create_subprocess_exec(
            *words, stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE,
            start_new_session=True,
        )  # fmt: skip
        self._reading = asyncio.create_task(self._read(self._run, self._process))
        self._report()

    def stop(self) -> None:
        """Ask the run to stop; what is done stays done.

        Raises
        ------
        InputError
            None is under way.
        """
        if self._run is None or self._process is None or not self.running:
            raise InputError("no run is under way", hint="load the page again")
        self._run.state = "stopping"
        if self._process.returncode is None:
            self._process.terminate()
        self._report()

    async def end(self) -> None:
        """Stop the run, for the studio to end."""
        if self._process is None or self._reading is None:
            return
        if self.running:
            self.stop()
        done, _ = await asyncio.wait({self._reading}, timeout=_PATIENCE)
        if not done:
            self._process.kill()
            await self._reading

    async def _read(self, run: Run, process: asyncio.subprocess.Process) -> None:
        assert process.stdout is not None
        async for line in process.stdout:
            self._take(run, json.loads(line))
            self._report()
        code = await process.wait()
        if run.state == "stopping":  # before it could listen to signals
            run.state, run.what = "stopped", STOPPED
            self._report()
        elif self.running:
            run.state, run.what = "failed", f"the run ended without a word (code {code})"
            run.hint = "there may be too little memory; what is done stays done"
            self._report()

    def _take(self, run: Run, told: dict[str, Any]) -> None:
        kind = told.pop("kind")
        if kind == "progress":
            if told["stage"] != run.stage:
                self._note(run, told["stage"])
            run.stage, run.done, run.total = told["stage"], told["done"], told["total"]
        elif kind == "ended":
            run.state, run.what, run.where, run.hint = told["state"], told["what"], told.get("where"), told.get("hint")
        elif not any(line.endswith(f"  {told['text']}") for line in run.log):
            self._note(run, told["text"])

    def _note(self, run: Run, text: str) -> None:
        run.log.append(f"{time.monotonic() - self._started:.1f} s  {text}")
        del run.log[:-_LINES]

    def _report(self) -> None:
        self._serial += 1
        self._tell({"kind": "run", "run": self.state()})
