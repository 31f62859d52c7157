"""Processes of this machine as workers: one that dies, hangs or needs too much memory is replaced by itself alone."""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from geomosaic.errors import WorkerError
from geomosaic.execution.task import run_task
from geomosaic.execution.work import UnitsLostError, Work
from geomosaic.options.render import PER_THREAD, PROGRAM

# Seconds between looks at a process that works.
LOOK = 0.2
# Part of its limit by which a unit may exceed it before its process is ended in the middle of it.
EXCESS = 0.2
# Seconds in which a process has to end when it is asked to.
_END = 5.0


class Processes:
    """Processes of this machine, each with a thread here that talks to it.

    A process is started when the first task waits for it.

    Parameters
    ----------
    count : int
    memory : int
        Bytes that each may hold; never less than the program needs by itself.
    """

    def __init__(self, count: int, memory: int) -> None:
        self.slots, self.kind = count, f"{count} processes" if count > 1 else "1 process"
        self.dashboard: str | None = None
        self._memory = max(memory, PROGRAM + PER_THREAD)
        self._tasks: queue.SimpleQueue[_Task | None] = queue.SimpleQueue()
        self._threads: list[threading.Thread] = []
        self._closed = threading.Event()

    def begin(self, work: Work, items: Sequence[Any], patience: float) -> _Task:
        """Begin a task as soon as a process is free."""
        task = _Task(work, items, patience)
        self._tasks.put(task)
        if len(self._threads) < self.slots:
            self._threads.append(threading.Thread(target=self._serve, name="geomosaic-worker", daemon=True))
            self._threads[-1].start()
        return task

    def close(self) -> None:
        """End the processes; tasks that run may end within seconds, those that wait are not begun."""
        self._closed.set()
        with suppress(queue.Empty):
            while True:
                waiting = self._tasks.get_nowait()
                if waiting is not None:
                    waiting.cancel()
        for _ in self._threads:
            self._tasks.put(None)
        for thread in self._threads:
            thread.join()

    def _serve(self) -> None:
        """Tasks given to one process after another, until there are no more."""
        process: _Process | None = None
        try:
            while (task := self._tasks.get()) is not None:
                if task.future.set_running_or_notify_cancel():
                    try:
                        process = process or _Process(self._closed)
                        task.future.set_result(process.answer(task, self._memory))
                    except Exception as error:
                        if process is not None:
                            process.end(at_once=True)
                        process = None
                        task.future.set_exception(error)
                    else:
                        # What a process holds on to between units is of no use to anyone.
                        if process.memory() > self._memory:
                            process.end()
                            process = None
        finally:
            if process is not None:
                process.end()


class _Task:
    """Task with its answer, which is on its way."""

    def __init__(self, work: Work, items: Sequence[Any], patience: float) -> None:
        self.work, self.items, self.patience = work, items, patience
        self.future: Future[bytes] = Future()

    def answer(self) -> bytes:
        """Answer, waited for."""
        return self.future.result()

    def cancel(self) -> None:
        """Drop it, if it has not begun."""
        self.future.cancel()


class _Process:
    """A process and the pipe to it; once `closed` is set, nobody waits long for its answer."""

    def __init__(self, closed: threading.Event) -> None:
        self._closed = closed
        # Forked, it would inherit the locks of threads that are not there.
        context = multiprocessing.get_context("spawn")
        self._pipe, there = context.Pipe()
        self._process = context.Process(target=_work, args=(there,), name="geomosaic worker", daemon=True)
        self._answered = False
        try:
            self._process.start()
        except RuntimeError as error:
            raise _not_started("this one is itself about to start") from error
        finally:
            there.close()  # else its end would not be noticed

    def answer(self, task: _Task, most: int) -> bytes:
        """Answer of a task.

        Raises
        ------
        UnitsLostError
            The process died, hung, or held more than `most` bytes.
        WorkerError
            It failed as soon as it was started.
        """
        begun, patience = time.monotonic(), task.patience
        try:
            self._pipe.send((task.work.key, None, task.items))
            while True:
                while not self._pipe.poll(LOOK):
                    waited = time.monotonic() - begun
                    if self._closed.is_set():
                        patience = min(patience, waited + _END)
                    if waited > patience:
                        raise UnitsLostError("hung", f"no answer in {waited:.0f} s")
                    held = self.memory()
                    if held > most * (1.0 + EXCESS):
                        what = f"it held {held >> 20} MB of memory, the limit is {most >> 20} MB"
                        raise UnitsLostError("memory", what)
                found = self._pipe.recv_bytes()
                self._answered = True
                if found:
                    return found
                self._pipe.send((task.work.key, task.work.data, task.items))
        except (EOFError, OSError) as error:
            self._process.join(_END)
            if self._process.exitcode == 1 and not self._answered:  # an error of Python, on its standard error
                raise _not_started("it ended with code 1") from error
            raise UnitsLostError("died", _end_text(self._process.exitcode)) from error

    def memory(self) -> int:
        """Bytes of memory that the process has for itself; 0 where the system does not tell."""
        try:  # of Linux: size, resident, of files and shared, in pages
            _, resident, shared = Path(f"/proc/{self._process.pid}/statm").read_text().split()[:3]
        except OSError:
            return 0
        return (int(resident) - int(shared)) * os.sysconf("SC_PAGE_SIZE")

    def end(self, *, at_once: bool = False) -> None:
        """End the process."""
        with suppress(OSError):
            self._pipe.close()  # it ends when it next looks for a task
        if at_once:
            self._process.kill()
        self._process.join(_END)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _not_started(why: str) -> WorkerError:
    """Failure of a process that did not begin to work, as no other would."""
    return WorkerError(
        f"a process could not be started ({why})",
        where="`workers`",
        hint="a script must make the call under if __name__ == '__main__':, as processes start by importing it",
    )


def _end_text(code: int | None) -> str:
    """How a process ended."""
    if code is not None and code < 0:
        with suppress(ValueError):
            return f"its process was ended by {signal.Signals(-code).name}"
    return f"its process ended with code {code}"


def _work(pipe: Connection) -> None:
    """Answers of a process, until the other end of the pipe is closed."""
    # Ctrl-C reaches every process of the terminal: the one that was started ends its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(EOFError, OSError):  # the other end has gone
        while True:
            pipe.send_bytes(run_task(*pipe.recv()) or b"")
