"""Run whole processes and say what they cost."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
Command = tuple[str, ...]

ENVIRONMENT = {k: v for k, v in os.environ.items() if k not in ("PYTHONDONTWRITEBYTECODE", "PYTHONUNBUFFERED")}
"""Of all that is timed: without compiled modules every start would compile its imports anew, a second and more."""


@dataclass(frozen=True)
class Cost:
    """Wall and processor seconds, and the largest resident memory in MB, of one process or of several in turn."""

    wall: float
    cpu: float
    memory: float

    def __add__(self, other: Cost) -> Cost:
        return Cost(self.wall + other.wall, self.cpu + other.cpu, max(self.memory, other.memory))


@contextmanager
def held_to(cores: int | None) -> Iterator[None]:
    """Let children that are started meanwhile run on so many cores only, where the system can do that."""
    every = os.sched_getaffinity(0) if cores and hasattr(os, "sched_getaffinity") else set()
    if every:
        os.sched_setaffinity(0, sorted(every)[:cores])
    try:
        yield
    finally:
        if every:
            os.sched_setaffinity(0, every)


def run(commands: tuple[Command, ...], log: Path, cores: int | None = None) -> tuple[Cost, str]:
    """Run commands one after the other, on all cores or on so many; what they cost, and what the last one printed.

    The memory of a child counts from before its program is loaded: keep the process that calls this small.
    """
    total, text = Cost(0.0, 0.0, 0.0), ""
    for command in commands:
        with log.open("w+b") as out, log.with_suffix(".err").open("w+b") as err:
            started = time.perf_counter()
            with held_to(cores):
                child = subprocess.Popen(
                    command, stdout=out, stderr=err, stdin=subprocess.DEVNULL, cwd=log.parent, env=ENVIRONMENT
                )
            _, status, used = os.wait4(child.pid, 0)
            wall = time.perf_counter() - started
            child.returncode = os.waitstatus_to_exitcode(status)
        text = log.read_text(errors="replace")
        if child.returncode:
            said = log.with_suffix(".err").read_text(errors="replace")
            raise SystemExit(f"failed ({child.returncode}): {' '.join(command)}\n{text[-2000:]}\n{said[-4000:]}")
        kilobytes = used.ru_maxrss / 1024 if sys.platform == "darwin" else used.ru_maxrss
        total += Cost(wall, used.ru_utime + used.ru_stime, kilobytes / 1024)
    return total, text


def helper(module: str, *arguments: str) -> str:
    """Run one of our modules in a process of its own, so that this one stays small; returns what it printed."""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-m", f"benchmarks.{module}", *arguments],
        cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    return done.stdout


def find(name: str, *folders: Path | None) -> str | None:
    """Path of a program in the folders (or their bin), then on the PATH."""
    for folder in folders:
        for place in (folder, folder / "bin") if folder else ():
            if (place / name).is_file():
                return str(place / name)
    return shutil.which(name)


@dataclass(frozen=True)
class Programs:
    """What is run; None for a peer that is not there."""

    geomosaic: Command
    rio: str | None
    oty: str | None
    gdal_translate: str | None
    peers: Path | None = None

    def peer(self, name: str) -> str | None:
        """Path of any other program."""
        return find(name, self.peers)

    def python_with(self, *modules: str) -> str | None:
        """The peers' Python, if it can import these modules."""
        python = str(self.peers / "bin" / "python") if self.peers else sys.executable
        asked = [python, "-W", "ignore", "-c", f"import {', '.join(modules)}"]
        try:
            done = subprocess.run(asked, capture_output=True, check=False)
        except OSError:
            return None
        return None if done.returncode else python

    @classmethod
    def found(cls, peers: Path | None) -> Programs:
        """Look for them: ours beside this Python, the peers where the user says, beside this Python, or on the PATH."""
        own = Path(sys.executable).parent
        script = own / "geomosaic"
        ours: Command = (str(script),) if script.is_file() else (sys.executable, "-c", ENTRY)
        return cls(ours, find("rio", peers, own), find("oty", peers), find("gdal_translate"), peers)

    def versions(self) -> dict[str, str]:
        """Version of each, as it says itself."""
        asked: dict[str, Any] = {
            "geomosaic": (*self.geomosaic, "--version"),
            "rasterio": (self.rio, "--version") if self.rio else None,
            "orthority": (self.oty, "--version") if self.oty else None,
            "gdal_translate": (self.gdal_translate, "--version") if self.gdal_translate else None,
        }
        out = {"python": sys.version.split()[0]}
        for name, command in asked.items():
            if command:
                said = subprocess.run(command, capture_output=True, text=True, check=False).stdout.split()
                out[name] = next((word.strip(",") for word in said if word[:1].isdigit()), "unknown")
        return out


ENTRY = "from geomosaic.cli.main import main; main()"
