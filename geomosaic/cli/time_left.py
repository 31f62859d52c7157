"""Time left of stages of work, from what was done of them lately and from what is known to follow."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

# Stages that follow each other, with their times over that of the first. Measured for pairs and least squares matching:
# 0.4 and 0.3 times as long as for features with 12 photos of 1.2 Mpx, 0.06 and 0.45 times with 8 of 12 Mpx.
CHAINS: tuple[Mapping[str, float], ...] = ({"features": 1.0, "pairs": 0.25, "least squares matching": 0.4},)
# Reports of a stage from which its speed is taken: what came from a cache at its beginning must not count for ever.
WINDOW = 40


class TimeLeft:
    """Time left of each stage, and of all that follow it.

    The caller tells the clock, in seconds.
    """

    def __init__(self) -> None:
        self._reports: dict[str, deque[tuple[float, int]]] = {}
        self._begun: dict[str, float] = {}
        self._total: dict[str, int] = {}

    def tell(self, done: int, total: int, stage: str, now: float) -> None:
        """Take note of how much is done."""
        if stage not in self._reports:
            self._reports[stage] = deque([(now, done)], WINDOW)
            # What was done before the first report took time, too, and nobody knows how long, but for what comes first.
            self._begun[stage] = max(
                (seen[-1][0] for other, seen in self._reports.items() if other != stage), default=now
            )
        else:
            self._reports[stage].append((now, done))
        self._total[stage] = total

    def rate(self, stage: str) -> float | None:
        """Pieces of a stage that were done a second, lately; None where nothing tells."""
        (first, begun), (last, done) = self._reports[stage][0], self._reports[stage][-1]
        return (done - begun) / (last - first) if done > begun and last > first else None

    def of_stage(self, stage: str, now: float) -> float | None:
        """Seconds until a stage is over; None where nothing tells, or it takes longer than it seemed."""
        reports, total = self._reports[stage], self._total[stage]
        (first, begun), (last, done) = reports[0], reports[-1]
        if done >= total > 0:
            return 0.0
        if done <= begun or last <= first:
            return None
        left = (total - done) * (last - first) / (done - begun) - (now - last)
        return left if left > 0.0 else None

    def in_all(self, stage: str, now: float) -> float | None:
        """Seconds until a stage and those that follow it are over; None where none follow, or nothing tells."""
        chain = next((chain for chain in CHAINS if stage in chain), {})
        names = list(chain)
        after = [name for name in names[names.index(stage) + 1 :] if name not in self._reports] if chain else []
        own = self.of_stage(stage, now)
        if not after or own is None:
            return None
        begun = [name for name in names if name in self._begun]
        seconds = now - min(self._begun[name] for name in begun) + own
        return own + seconds * sum(chain[name] for name in after) / sum(chain[name] for name in begun)


def clock_text(seconds: float) -> str:
    """Time as h:mm:ss.

    Parameters
    ----------
    seconds : float
    """
    whole = round(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"
