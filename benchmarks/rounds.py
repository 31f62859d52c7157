"""Tools of one job, run in turn round after round, and what follows from the times."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.machine import ENOUGH, effective_cores
from benchmarks.process import Command, Cost, run

ONE_CORE = ", 1 core"
"""Ending of the name of a tool's twin on one core."""


@dataclass(frozen=True)
class Tool:
    """One competitor.

    Attributes
    ----------
    name : str
    commands : tuple of commands
        Run one after the other; together they are the tool.
    outputs : tuple of Path
        Files and folders removed before and after each run.
    keep : bool
        Leave the outputs of the last run.
    cores : int, optional
        Run on so many of the machine's cores.
    prepare : callable, optional
        What is done before each run, untimed.
    """

    name: str
    commands: tuple[Command, ...]
    outputs: tuple[Path, ...]
    keep: bool = False
    cores: int | None = None
    prepare: Callable[[], object] | None = None

    def clear(self) -> None:
        """Remove the outputs."""
        for path in self.outputs:
            if path.is_dir():
                shutil.rmtree(path)
                path.mkdir()
            else:
                path.unlink(missing_ok=True)

    @property
    def on_one_core(self) -> Tool:
        """One of ours with one thread on one core of the machine."""
        commands = tuple((*command, "--threads", "1") for command in self.commands)
        return replace(self, name=self.name + ONE_CORE, commands=commands, cores=1)


@dataclass
class Times:
    """Costs of all tools over all rounds, and the effective cores of each round."""

    costs: dict[str, list[Cost]] = field(default_factory=dict)
    cores: list[float] = field(default_factory=list)

    @property
    def trusted(self) -> list[int]:
        """Rounds in which the machine was worth its cores; all of them where none was."""
        good = [i for i, cores in enumerate(self.cores) if cores >= ENOUGH]
        return good or list(range(len(self.cores)))

    def of(self, tool: str, what: str = "wall") -> list[float]:
        """Values of a tool over the trusted rounds."""
        return [getattr(self.costs[tool][i], what) for i in self.trusted]

    def ratio(self, one: str, other: str, what: str = "wall") -> float | None:
        """Median over the rounds of one's cost over the other's, paired within a round."""
        if one not in self.costs or other not in self.costs:
            return None
        return median(a / b for a, b in zip(self.of(one, what), self.of(other, what), strict=True))

    def beyond(self, one: str, other: str) -> float | None:
        """Median over the rounds of one's seconds beyond the other's."""
        if one not in self.costs or other not in self.costs:
            return None
        return median(a - b for a, b in zip(self.of(one), self.of(other), strict=True))

    def efficiency(self, tool: str, start: str | None = None) -> float | None:
        """Median over the rounds of T1 / (2 T2), less what another tool takes to start; None without T1."""
        if tool + ONE_CORE not in self.costs:
            return None
        one, two = self.of(tool + ONE_CORE), self.of(tool)
        begin = self.of(start) if start else [0.0] * len(two)
        return median((a - c) / (2 * (b - c)) for a, b, c in zip(one, two, begin, strict=True))

    def table(self) -> dict[str, dict[str, Any]]:
        """Medians and ranges."""
        out = {}
        for name in self.costs:
            wall = self.of(name)
            out[name] = {
                "runs": len(wall),
                "wall_s": median(wall),
                "wall_range_s": [min(wall), max(wall)],
                "cpu_s": median(self.of(name, "cpu")),
                "peak_mb": max(self.of(name, "memory")),
                "efficiency": self.efficiency(name),
            }
        return out


def take(tools: list[Tool], rounds: int, folder: Path, say: Callable[[str], None]) -> Times:
    """Run all tools `rounds` times: A B C, A B C."""
    times = Times({tool.name: [] for tool in tools})
    for number in range(rounds):
        before = effective_cores()
        for tool in tools:
            tool.clear()
            if tool.prepare:
                tool.prepare()
            cost, _ = run(tool.commands, folder / "run.log", tool.cores)
            times.costs[tool.name].append(cost)
            if not (tool.keep and number == rounds - 1):
                tool.clear()
        times.cores.append(min(before, effective_cores()))
        walls = ", ".join(f"{name} {costs[-1].wall:.2f}" for name, costs in times.costs.items())
        say(f"  round {number + 1}: {times.cores[-1]:.2f} cores; {walls}")
    return times


def tell(text: str) -> None:
    """Say something to whoever waits."""
    print(text, file=sys.stderr, flush=True)
