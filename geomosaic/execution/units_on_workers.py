"""Units on workers: tasks of a few units of one function, in order, begun again where they are lost.

A task is one unit until it is known how long they take, then as many as `unit_times` says.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence, Sized
from dataclasses import dataclass
from itertools import islice
from textwrap import shorten
from typing import Any, TypeVar

from geomosaic.errors import GeomosaicError, RasterReadError, WorkerError, warn
from geomosaic.execution.task import answer_of
from geomosaic.execution.unit_times import UnitTimes
from geomosaic.execution.work import Pending, UnitsLostError, Work
from geomosaic.execution.workers import Run, run_of
from geomosaic.options.render import RunningOptions
from geomosaic.stores.failures import StoreError

Item = TypeVar("Item")
Result = TypeVar("Result")

# How often a unit is begun again after its worker was lost.
RETRIES = 3


def units_on_workers(
    parts: Iterable[tuple[Callable[[Item], Result], Iterable[Item]]], options: RunningOptions, ahead: int
) -> Generator[tuple[Item, Result], None, None]:
    """Results of functions over items in their order, see `units.map_units`.

    Parameters
    ----------
    parts : iterable of (callable, iterable)
        Functions, and the items of each. A part is begun while the one before it is still under way.
    options : RunningOptions
    ahead : int
        Tasks per worker that may be begun before their turn.

    Yields
    ------
    item, result
    """
    running = run_of(options)
    # The context of a generator is that of its caller: a run of its own is not entered there.
    run = running or Run(options.workers, options.memory_limit)
    try:
        yield from _in_order(_Units(run), parts, ahead)
    finally:
        if running is None:
            run.close()


@dataclass
class _Begun:
    """Items whose task is on its way, after so many trials that were lost."""

    work: Work
    items: Sequence[Any]
    pending: Pending
    trials: int = 0


class _Units:
    """Units on workers, all of which take much the same time."""

    def __init__(self, run: Run) -> None:
        self._workers, self._report = run.workers, run.report
        self._times = UnitTimes()
        self._told: set[str] = set()
        self.slots = self._workers.slots

    def next_size(self, left: int | None) -> int:
        """Units of the next task, of so many that are left."""
        size = self._times.units_of_task()
        return size if left is None else max(1, min(size, left // (2 * self.slots)))

    def begin(self, work: Work, items: Sequence[Any], trials: int = 0) -> _Begun:
        """Begin a task."""
        patience = self._times.patience(len(items))
        return _Begun(work, items, self._workers.begin(work, items, patience), trials)

    def outcome(self, begun: _Begun) -> tuple[list[tuple[Any, Any]], list[_Begun]]:
        """Items of a task with their results, as far as there are any, and what was begun of the rest."""
        work, items = begun.work, begun.items
        try:
            data = begun.pending.answer()
        except UnitsLostError as error:
            # Each by itself: only one of them may be at fault.
            self._report.lost[error.why] += len(items)
            return [], [self._again(work, item, begun.trials, error) for item in items]
        answer = answer_of(data)
        self._report.add(work.name, answer, len(data))
        for text in answer.warnings:
            if text not in self._told:
                self._told.add(text)
                warn(text)
        self._times.add(len(answer.results), answer.seconds, answer.longest, len(data))
        done, rest = list(zip(items, answer.results, strict=False)), items[len(answer.results) :]
        if answer.error is None:  # it ended early
            size = self.next_size(None)
            return done, [self.begin(work, rest[first : first + size]) for first in range(0, len(rest), size)]
        if isinstance(answer.error, GeomosaicError):  # the same anywhere, but for files that are not everywhere
            if isinstance(answer.error, RasterReadError | StoreError):
                file = isinstance(answer.error, RasterReadError)
                needs = "must see the file under this path" if file else "asks the store by its own environment"
                answer.error.hint = f"{answer.error.hint or 'check the path'}; worker {answer.worker} {needs}"
            return done, [_Begun(work, rest, _Failed(answer.error))]
        self._report.lost["failed"] += 1
        others = [self.begin(work, rest[1:])] if rest[1:] else []
        return done, [self._again(work, rest[0], begun.trials, answer.error), *others]

    def _again(self, work: Work, item: Any, trials: int, error: Exception) -> _Begun:
        """Item begun again by itself; after too many trials its error."""
        if trials < RETRIES:
            return self.begin(work, [item], trials + 1)
        why = str(error) if isinstance(error, UnitsLostError) else f"{type(error).__name__}: {error}"
        named = WorkerError(
            f"the unit was begun {RETRIES + 1} times and lost every time ({why})",
            where=shorten(str(item), 120, placeholder=" ..."),  # of some it tells arrays
            hint="look into the logs of the workers; with less memory each than a unit needs, give them more",
        )
        named.__cause__ = error
        return _Begun(work, [item], _Failed(named))


@dataclass(frozen=True)
class _Failed:
    """Answer that is an error."""

    error: Exception

    def answer(self) -> bytes:
        """Raise it."""
        raise self.error

    def cancel(self) -> None:
        """Nothing is on its way."""


def _tasks(units: _Units, parts: Iterable[tuple[Any, Iterable[Any]]]) -> Iterator[tuple[Work, Sequence[Any]]]:
    """Functions and items of tasks, as they are needed."""
    for function, items in parts:
        work, source, left = Work.of(function), iter(items), len(items) if isinstance(items, Sized) else None
        while task := list(islice(source, units.next_size(left))):
            left = None if left is None else left - len(task)
            yield work, task


def _in_order(units: _Units, parts: Iterable[tuple[Any, Iterable[Any]]], ahead: int) -> Iterator[tuple[Any, Any]]:
    tasks, begun = _tasks(units, parts), deque[_Begun]()

    def fill() -> None:
        for work, items in islice(tasks, max(0, units.slots * ahead - len(begun))):
            begun.append(units.begin(work, items))

    try:
        fill()
        while begun:
            done, rest = units.outcome(begun.popleft())
            begun.extendleft(reversed(rest))
            fill()
            yield from done
    finally:
        for one in begun:
            one.pending.cancel()
