"""Many tasks on a few threads, results in order, never far ahead."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

from geomosaic.raster.environment import enter_for_good, environment

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_order(
    function: Callable[[Item], Result], items: Iterable[Item], threads: int, ahead: int = 3
) -> Iterator[tuple[Item, Result]]:
    """Yield (item, function(item)) in the order of the items.

    At most `ahead` results per thread wait at any time, so that memory does not grow with the number of items. The
    first failure ends the run: tasks not yet started are dropped.
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
