"""Contract between the loop over units and what runs them: work, workers, tasks on their way, and losses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from geomosaic.digests import digest_of
from geomosaic.execution.packing import packed


@dataclass(frozen=True)
class Work:
    """Function of units, packed for other processes.

    Attributes
    ----------
    name : str
        Its name, for reports.
    key : str
        Digest of its bytes, under which a process keeps it.
    data : bytes
        See `packing.packed`.
    """

    name: str
    key: str
    data: bytes

    @classmethod
    def of(cls, function: Callable[[Any], Any]) -> Work:
        """Work of a function.

        Raises
        ------
        WorkerError
            It holds something that cannot leave this process.
        """
        plain = function.func if isinstance(function, partial) else function
        name = str(getattr(plain, "__name__", type(plain).__name__)).strip("_")
        data = packed(function)
        return cls(name, digest_of(data), data)


class UnitsLostError(Exception):
    """Loss of a task with its worker; its units may be begun again.

    Parameters
    ----------
    why : str
        'died', 'hung' or 'memory'.
    what : str
        In words.
    """

    def __init__(self, why: str, what: str) -> None:
        super().__init__(what)
        self.why = why


class Pending(Protocol):
    """Answer that is on its way."""

    def answer(self) -> bytes | memoryview:
        """Answer of a task as bytes, waited for, see `task.run_task`.

        Raises
        ------
        UnitsLostError
            Its worker is lost.
        WorkersUnreachableError
            All of them are.
        """

    def cancel(self) -> Any:
        """Drop it, if it has not begun."""


class Workers(Protocol):
    """Workers outside of this process.

    Attributes
    ----------
    slots : int
        Tasks that run at the same time.
    kind : str
        What they are, for reports.
    dashboard : str, optional
        Address of a page that shows them.
    """

    slots: int
    kind: str
    dashboard: str | None

    def begin(self, work: Work, items: Sequence[Any], patience: float) -> Pending:
        """Begin a task as soon as there is a free worker; one that does not answer in `patience` seconds is lost."""

    def close(self) -> None:
        """End what was started."""
