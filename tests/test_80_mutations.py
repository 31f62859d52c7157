"""Mutated files of every kind, read in child processes: a value or an error with a hint, in bounded time and memory."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from reader_rig import KINDS, MORE

import geomosaic.cli
import geomosaic_frame

RIG = Path(__file__).parent / "rigs" / "mutation_rig.py"
ALL = [*KINDS, *MORE]
PARTS = 3
FOLDERS = [str(Path(module.__file__ or "").parents[up]) for module, up in ((geomosaic.cli, 2), (geomosaic_frame, 1))]


def faults(count: int, kinds: list[str], seconds: float) -> list[str]:
    """What a child process tells of `count` mutations of each kind; also how it ended, if not by itself."""
    path = os.pathsep.join([*FOLDERS, os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, str(RIG), str(count), *kinds],
        check=False, capture_output=True, text=True, timeout=seconds, env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    lines = done.stdout.splitlines()
    found = [line for line in lines if line.startswith("FAULT")]
    if done.returncode != int(bool(found)):
        found.append(f"ended with {done.returncode} after '{lines[-1:]}': {done.stderr[-2000:]}")
    return found


@pytest.mark.parametrize("part", range(PARTS))
def test_mutated_files_are_read_or_refused_with_a_hint(part: int) -> None:
    assert not faults(60, ALL[part::PARTS], 200.0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ALL)
def test_many_mutated_files_are_read_or_refused_with_a_hint(kind: str) -> None:
    assert not faults(5000, [kind], 590.0)
