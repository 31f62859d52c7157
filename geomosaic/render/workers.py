"""Worker threads: results in order, within a memory budget."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from threading import Condition
from typing import TypeVar

from geomosaic.raster.environment import enter_for_good, environment

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_order(
    function: Callable[[Item], Result], items: Iterable[Item], threads: int, ahead: int = 3
) -> Iterator[tuple[Item, Result]]:
    """Results of a function over items, computed by threads and given in the order of the items.

    At most `ahead` results per thread wait at any time, so that memory does not grow with the number of items. The
    first failure ends the run: tasks not yet started are dropped.

    Parameters
    ----------
    function : callable
        Of one item; called in any thread.
    items : iterable
        Taken as they are needed.
    threads : int
        With 1 everything runs in the thread of the caller.
    ahead : int
        Items per thread that may be begun before their turn.

    Yields
    ------
    item, result
    """
    if threads == 1:
        for item in items:
            with environment():
                result = function(item)
            yield item, result
        return
    source = iter(items)
    with ThreadPoolExecutor(threads, "geomosaic", enter_for_good) as executor:
        waiting: deque[tuple[Item, Future[Result]]] = deque()
        try:
            for item in islice(source, threads * ahead):
                waiting.append((item, executor.submit(function, item)))
            while waiting:
                item, future = waiting.popleft()
                result = future.result()
                for following in islice(source, 1):
                    waiting.append((following, executor.submit(function, following)))
                yield item, result
        finally:
            executor.shutdown(wait=True, cancel_futures=True)


class MemoryBudget:
    """Memory budget that threads share: who needs more than is left waits for others to end.

    Who needs more than all of it works alone. What comes out does not depend on the budget, only when.

    Parameters
    ----------
    size : int
        Bytes.
    """

    def __init__(self, size: int) -> None:
        self._size, self._held = size, 0
        self._changed = Condition()

    @contextmanager
    def reserve(self, size: int) -> Iterator[None]:
        """Hold so many bytes for the length of a block; never to be asked for by a thread that holds some."""
        with self._changed:
            # `_held == 0`: a request larger than the budget would wait for ever.
            self._changed.wait_for(lambda: self._held == 0 or self._held + size <= self._size)
            self._held += size
        try:
            yield
        finally:
            with self._changed:
                self._held -= size
                self._changed.notify_all()
