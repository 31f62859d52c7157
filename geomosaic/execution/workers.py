"""Workers outside of this process, opened once for a whole run: processes, an executor, or a Dask cluster."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any

from geomosaic.errors import WorkersUnreachableError
from geomosaic.execution.run_report import RunReport, current
from geomosaic.execution.work import Work, Workers
from geomosaic.options.render import RunningOptions


@dataclass
class Run:
    """Run with its workers, which are opened when they are first needed.

    Attributes
    ----------
    wanted : int, str, Executor or Client
        As in `RunningOptions`.
    memory : int
        Bytes that each may hold.
    report : RunReport
    """

    wanted: Any
    memory: int
    report: RunReport = field(default_factory=RunReport)
    _opened: Workers | None = None

    @property
    def workers(self) -> Workers:
        """Workers, opened.

        Raises
        ------
        WorkerError
            The scheduler does not answer, has no workers, or workers that differ from here.
        InputError
            `distributed` is not installed.
        """
        if self._opened is None:
            self._opened = opened = _opened(self.wanted, self.memory)
            self.report.kind, self.report.slots, self.report.dashboard = opened.kind, opened.slots, opened.dashboard
        return self._opened

    def close(self) -> None:
        """End the workers that were started; what was given open stays open."""
        self.report.end()
        if self._opened is not None:
            self._opened.close()


_run: ContextVar[Run | None] = ContextVar("run", default=None)


@contextmanager
def entered(options: RunningOptions) -> Iterator[RunReport]:
    """Run on workers in this context, see `units.workers_for`.

    Parameters
    ----------
    options : RunningOptions

    Yields
    ------
    RunReport
    """
    run = run_of(options)
    if run is not None:
        yield run.report
        return
    run = Run(options.workers, options.memory_limit)
    before, shown = _run.set(run), current.set(run.report)
    try:
        yield run.report
    finally:
        _run.reset(before)
        current.reset(shown)
        run.close()


def run_of(options: RunningOptions) -> Run | None:
    """Run of these workers that is under way.

    Parameters
    ----------
    options : RunningOptions
    """
    run = _run.get()
    return run if run is not None and run.wanted == options.workers else None


def _opened(wanted: Any, memory: int) -> Workers:
    if isinstance(wanted, int):
        from geomosaic.execution.processes import Processes

        return Processes(wanted, memory)
    if isinstance(wanted, Executor):
        return _Executor(wanted)
    from geomosaic.execution.cluster import Cluster

    return Cluster(wanted, memory)


class _Executor:
    """Any executor of `concurrent.futures`; each task goes along with the packed function."""

    dashboard: str | None = None

    def __init__(self, executor: Executor) -> None:
        self.slots = getattr(executor, "_max_workers", None) or os.cpu_count() or 1
        self.kind, self._executor = type(executor).__name__, executor

    def begin(self, work: Work, items: Sequence[Any], patience: float) -> _ExecutorTask:
        """Begin a task."""
        from geomosaic.execution.task import run_task

        with _reachable():
            return _ExecutorTask(self._executor.submit(run_task, work.key, work.data, items))

    def close(self) -> None:
        """Nothing: who made the executor ends it."""


@dataclass(frozen=True)
class _ExecutorTask:
    future: Future[bytes | None]

    def answer(self) -> bytes:
        """Answer, waited for."""
        with _reachable():
            return self.future.result() or b""

    def cancel(self) -> None:
        """Drop it, if it has not begun."""
        self.future.cancel()


@contextmanager
def _reachable() -> Iterator[None]:
    try:
        yield
    except BrokenExecutor as error:
        raise WorkersUnreachableError(
            f"the workers are out of reach ({type(error).__name__}: {error})",
            hint="start them anew, then run the same command again",
        ) from error
