"""Report of a run: what each worker did, read and wrote, what was lost, and what a rerun would cost."""

from __future__ import annotations

import time
from collections import Counter
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from geomosaic.errors import counted
from geomosaic.stores.traffic import NO_TRAFFIC
from geomosaic.stores.traffic import add as add_traffic

if TYPE_CHECKING:
    from geomosaic.execution.task import Answer


@dataclass
class WorkerReport:
    """Work of one worker.

    Attributes
    ----------
    name : str
        Host and number of the process.
    units : Counter of str
        Units done, by the name of the work.
    seconds : float
        Spent in them.
    processor_seconds : float
        Of all threads of the process meanwhile.
    read, written : int, optional
        Bytes of files meanwhile; None where the system does not count them.
    returned : int
        Bytes of results sent back.
    """

    name: str
    units: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0
    processor_seconds: float = 0.0
    read: int | None = None
    written: int | None = None
    returned: int = 0

    def add(self, work: str, answer: Answer, size: int) -> None:
        """Add what a task took.

        Parameters
        ----------
        work : str
            Name of the work.
        answer : Answer
        size : int
            Bytes it was sent in.
        """
        used = answer.usage
        self.units[work] += len(answer.results)
        self.seconds += answer.seconds
        self.processor_seconds += used.processor_seconds
        self.returned += size
        if used.read is not None and used.written is not None:
            self.read, self.written = (self.read or 0) + used.read, (self.written or 0) + used.written

    @property
    def facts(self) -> dict[str, Any]:
        """Values for JSON."""
        return {
            "worker": self.name,
            "units": dict(self.units),
            "seconds": round(self.seconds, 3),
            "processor_seconds": round(self.processor_seconds, 3),
            "bytes_read": self.read,
            "bytes_written": self.written,
            "bytes_returned": self.returned,
        }


@dataclass
class RunReport:
    """Work of all workers of a run.

    Attributes
    ----------
    kind : str
        What the workers are, such as '2 processes'.
    slots : int
        Tasks that run at the same time.
    dashboard : str, optional
        Address of Dask's dashboard.
    workers : dict of str to WorkerReport
        By name, in the order of their first answer.
    lost : Counter of str
        Units that were begun again, by why.
    """

    kind: str = ""
    slots: int = 0
    dashboard: str | None = None
    workers: dict[str, WorkerReport] = field(default_factory=dict)
    lost: Counter[str] = field(default_factory=Counter)
    _started: float = field(default_factory=time.monotonic)
    _ended: float | None = None

    def add(self, work: str, answer: Answer, size: int) -> None:
        """Add what a task took, see `WorkerReport.add`; its traffic counts as that of this process, too."""
        if answer.usage.stores != NO_TRAFFIC:
            add_traffic(answer.usage.stores)
        self.workers.setdefault(answer.worker, WorkerReport(answer.worker)).add(work, answer, size)

    def end(self) -> None:
        """Note the time at which the run is over."""
        self._ended = time.monotonic()

    @property
    def units(self) -> int:
        """Units that were done."""
        return sum(one.units.total() for one in self.workers.values())

    @property
    def seconds(self) -> float:
        """Time from the first to the last use of the workers."""
        return (self._ended or time.monotonic()) - self._started

    @property
    def core_hours(self) -> float:
        """Hours that workers spent in units, each on one core."""
        return sum(one.seconds for one in self.workers.values()) / 3600.0

    @property
    def rerun(self) -> dict[str, Any]:
        """Cost of the same run on as many workers, from the rates of this one; what was lost does not count."""
        done = self.workers.values()
        known = [one for one in done if one.read is not None and one.written is not None]
        return {
            "core_hours": self.core_hours,
            "seconds": self.core_hours * 3600.0 / max(1, self.slots),
            "bytes_read": sum(one.read or 0 for one in known) if known else None,
            "bytes_written": sum(one.written or 0 for one in known) if known else None,
        }

    @property
    def facts(self) -> dict[str, Any]:
        """Values for JSON."""
        return {
            "kind": self.kind,
            "slots": self.slots,
            "seconds": round(self.seconds, 3),
            "units": self.units,
            "lost_units": dict(self.lost),
            "core_hours": self.core_hours,
            "rerun": self.rerun,
            "workers": [one.facts for one in self.workers.values()],
        }

    @property
    def status(self) -> str:
        """Workers that are at work, and lost units, in a few words."""
        lost = self.lost.total()
        words = counted(min(len(self.workers), self.slots), "worker")  # fewer than have been
        return f"{words}, {counted(lost, 'unit')} lost" if lost else words

    def __str__(self) -> str:
        lost = self.lost.total()
        again = f", {counted(lost, 'unit')} begun again" if lost else ""
        return (
            f"{self.kind}: {counted(self.units, 'unit')} by {counted(len(self.workers), 'worker')}{again}, "
            f"{self.core_hours:.3g} core-hours"
        )


# Report of the run that is under way, for what shows its progress.
current: ContextVar[RunReport | None] = ContextVar("current", default=None)
