"""What a job came to: times, ratios, accuracy, and whether it is what we want."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from benchmarks.machine import ENOUGH
from benchmarks.rounds import Times


@dataclass(frozen=True)
class Target:
    """One thing that is wanted; `value` is None where it could not be measured."""

    what: str
    value: float | None
    limit: float
    sense: str

    @property
    def verdict(self) -> str:
        """Pass, FAIL or not measured."""
        if self.value is None:
            return "not measured"
        good = self.value <= self.limit if self.sense == "<=" else self.value >= self.limit
        return "pass" if good else "FAIL"


@dataclass
class Result:
    """A job done."""

    name: str
    title: str
    times: Times
    megapixels: float | None = None
    facts: dict[str, Any] = field(default_factory=dict)
    accuracy: dict[str, dict[str, Any]] = field(default_factory=dict)
    quality: dict[str, dict[str, Any]] = field(default_factory=dict)
    targets: list[Target] = field(default_factory=list)

    def at_most(self, what: str, value: float | None, limit: float) -> None:
        """Want no more than this."""
        self.targets.append(Target(what, value, limit, "<="))

    def at_least(self, what: str, value: float | None, limit: float) -> None:
        """Want no less than this."""
        self.targets.append(Target(what, value, limit, ">="))

    def plain(self) -> dict[str, Any]:
        """As JSON values."""
        names = list(self.times.costs)
        ratios = {one: {other: self.times.ratio(one, other) for other in names if other != one} for one in names}
        return {
            "title": self.title,
            "megapixels": self.megapixels,
            "facts": self.facts,
            "cores_per_round": self.times.cores,
            "trusted": all(cores >= ENOUGH for cores in (self.times.cores[i] for i in self.times.trusted)),
            "tools": self.times.table(),
            "wall_ratios": ratios,
            "accuracy": self.accuracy,
            "quality": self.quality,
            "targets": [{**asdict(target), "verdict": target.verdict} for target in self.targets],
        }
