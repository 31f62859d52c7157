"""Observed times of units: how many go into a task, and how long an answer may take."""

from __future__ import annotations

# Most units of a task, and what it shall take: long enough that sending it costs little, short enough that workers
# end together, and that its results are no burden for memory.
MOST_UNITS, SECONDS, BYTES = 64, 0.25, 4 << 20
# A worker that has not answered after so many times the longest unit seen, for each unit of its task, hangs; never
# before so many seconds, in which it also has to unpack its function and open images.
PATIENCE, LEAST_PATIENCE = 20.0, 600.0
# Weight of the newest task in the means.
_NEWEST = 0.5


class UnitTimes:
    """Seconds and bytes of a unit, as the answers so far have them."""

    def __init__(self) -> None:
        self._seconds: float | None = None
        self._bytes = 0.0
        self._longest = 0.0

    def add(self, units: int, seconds: float, longest: float, size: int) -> None:
        """Take note of an answer.

        Parameters
        ----------
        units : int
            How many it has results of.
        seconds : float
            Spent in all of them.
        longest : float
            Spent in one.
        size : int
            Bytes of the answer.
        """
        if not units:
            return
        self._longest = max(self._longest, longest)
        if self._seconds is None:
            self._seconds, self._bytes = seconds / units, size / units
        else:
            self._seconds += _NEWEST * (seconds / units - self._seconds)
            self._bytes += _NEWEST * (size / units - self._bytes)

    def units_of_task(self) -> int:
        """Units of the next task; one until the first answer."""
        if self._seconds is None:
            return 1
        fit = min(SECONDS / max(self._seconds, 1e-9), BYTES / max(self._bytes, 1.0))
        return max(1, min(MOST_UNITS, int(fit)))

    def patience(self, units: int) -> float:
        """Seconds in which a task of so many units has to answer."""
        return max(LEAST_PATIENCE, PATIENCE * self._longest * units)
