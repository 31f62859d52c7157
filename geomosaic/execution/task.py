"""Task of a worker: a few units of one function, its answer, and what they took."""

from __future__ import annotations

import io
import os
import pickle
import platform
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geomosaic.errors import collected_warnings
from geomosaic.execution.packing import function_of, pack_into
from geomosaic.raster.environment import environment
from geomosaic.stores.traffic import NO_TRAFFIC, Traffic, traffic

# A task ends early after so many seconds or bytes of results; what is left of it goes out again.
LONGEST, LARGEST = 2.0, 16 << 20
# Bytes of the number at the end that tells where the results end.
_LENGTH = 8


@dataclass(frozen=True)
class Usage:
    """Processor time of a process, bytes of its files, and its traffic with object stores.

    Attributes
    ----------
    processor_seconds : float
    read, written : int, optional
        Of files and object stores together; None where the system does not count them.
    stores : Traffic
    """

    processor_seconds: float
    read: int | None = None
    written: int | None = None
    stores: Traffic = NO_TRAFFIC

    @classmethod
    def of_process(cls) -> Usage:
        """Usage of this process so far."""
        read = written = None
        stores = traffic()
        with suppress(OSError, ValueError, KeyError):  # Linux counts them
            lines = Path("/proc/self/io").read_text().splitlines()
            counts = {name: int(count) for name, count in (line.split(": ") for line in lines)}
            read, written = counts["rchar"] + stores.read, counts["wchar"] + stores.written
        return cls(time.process_time(), read, written, stores)

    def since(self, before: Usage) -> Usage:
        """What was used after `before`."""
        seconds, stores = self.processor_seconds - before.processor_seconds, self.stores - before.stores
        if self.read is None or self.written is None or before.read is None or before.written is None:
            return Usage(seconds, stores=stores)
        return Usage(seconds, self.read - before.read, self.written - before.written, stores)


@dataclass(frozen=True)
class Answer:
    """Results of a task.

    Attributes
    ----------
    results : list
        Of its first units; fewer than it has where it ended early or failed.
    error : Exception, optional
        Failure of the unit after them.
    worker : str
        Host and number of the process.
    seconds : float
        Spent in units.
    longest : float
        Seconds of the longest unit.
    usage : Usage
        Of the process meanwhile, each second and byte counted in one answer.
    warnings : list of str
        What its units had the user told, in their order.
    """

    results: list[Any]
    error: Exception | None
    worker: str
    seconds: float
    longest: float
    usage: Usage
    warnings: list[str]


def run_task(key: str, data: bytes | None, items: Sequence[Any]) -> bytes | None:
    """Answer of a task as bytes, for any process.

    Parameters
    ----------
    key : str
        Digest of `data`.
    data : bytes, optional
        The function, see `packing.packed`; it may be missing where this process has it.
    items : sequence
        What the function takes.

    Returns
    -------
    bytes or None
        A pickled `Answer`; None where the function is not here.
    """
    worker = f"{platform.node()}:{os.getpid()}"
    results, ends = io.BytesIO(), list[int]()
    error: Exception | None = None
    seconds = longest = 0.0
    with _shared_usage, collected_warnings() as warnings:
        try:
            function = function_of(key, data)
            if function is None:
                return None
            with environment():
                while len(ends) < len(items) and seconds < LONGEST and results.tell() < LARGEST:
                    started = time.perf_counter()
                    # Straight into one buffer: with megabytes in each, copies are what a task costs.
                    pack_into(results, function(items[len(ends)]))
                    ends.append(results.tell())
                    spent = time.perf_counter() - started
                    seconds, longest = seconds + spent, max(longest, spent)
        except Exception as failure:
            error = _sendable(failure)
        used = _shared_usage.take()
    start = ends[-1] if ends else 0  # what a unit left that failed on the way is written over
    results.seek(start)
    results.truncate()
    results.write(pickle.dumps((ends, error, worker, seconds, longest, used, warnings), protocol=5))
    results.write(start.to_bytes(_LENGTH, "little"))
    return results.getvalue()


def answer_of(data: bytes | memoryview) -> Answer:
    """Answer that `run_task` gave as bytes.

    Parameters
    ----------
    data : bytes or memoryview

    Returns
    -------
    Answer
    """
    whole = memoryview(data)
    start = int.from_bytes(whole[-_LENGTH:], "little")
    ends, *more = pickle.loads(whole[start:-_LENGTH])
    results = [pickle.loads(whole[first:end]) for first, end in zip([0, *ends[:-1]], ends, strict=True)] if ends else []
    return Answer(results, *more)


def _sendable(error: Exception) -> Exception:
    """The same error, or its text where it cannot be sent."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


class _SharedUsage:
    """Usage of a process over the tasks of all its threads, each second and byte told once."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running = 0
        self._reported = Usage(0.0)

    def __enter__(self) -> None:
        with self._lock:
            if not self._running:  # what happened between tasks is not theirs
                self._reported = Usage.of_process()
            self._running += 1

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._running -= 1

    def take(self) -> Usage:
        """What was used since it was last asked for."""
        with self._lock:
            now = Usage.of_process()
            used, self._reported = now.since(self._reported), now
        return used


_shared_usage = _SharedUsage()
