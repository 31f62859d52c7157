"""A run that watches its files: what each of its answers cost, in a process that goes on."""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import IO

from benchmarks.process import ENVIRONMENT, Command, Cost

TICK = os.sysconf("SC_CLK_TCK")


class Watching:
    """`geomosaic run PROJECT --watch --json`, answering with a line of JSON each time."""

    def __init__(self, command: Command, folder: Path) -> None:
        self._process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, cwd=folder, env=ENVIRONMENT
        )

    def __enter__(self) -> Watching:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        with self._process:
            pass

    def answer(self, since: float, spent: float) -> Cost:
        """Wait for the next answer: seconds since then, and of the processor beyond those spent before."""
        out: IO[bytes] | None = self._process.stdout
        line = out.readline() if out is not None else b""
        wall = time.perf_counter() - since
        if not line.startswith(b'{"steps"'):
            raise SystemExit(f"a run that watches failed: {line.decode(errors='replace')[:2000]}")
        status = Path(f"/proc/{self._process.pid}/status").read_text()
        peak = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))
        return Cost(wall, self.spent() - spent, peak / 1024)

    def spent(self) -> float:
        """Processor seconds so far, of all threads."""
        fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / TICK
