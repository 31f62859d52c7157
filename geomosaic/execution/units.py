"""Units of work in order, on threads of this process or on workers outside of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING

from geomosaic.options.render import RunningOptions
from geomosaic.raster.environment import enter_for_good, environment
from geomosaic.types import Item, Map, Result

if TYPE_CHECKING:
    from geomosaic.execution.run_report import RunReport


def map_units(
    function: Callable[[Item], Result], items: Iterable[Item], options: RunningOptions, ahead: int = 3
) -> Generator[tuple[Item, Result], None, None]:
    """Results of a function over items in their order, computed where the options say.

    At most `ahead` items per thread, or tasks per worker, are begun before their turn: memory, here and in a scheduler,
    does not grow with the number of items. Workers are those of `workers_for` where that is entered.

    Parameters
    ----------
    function : callable
        Of one item; pure, so that an item may be begun twice. For workers see `packing.packed`.
    items : iterable
        Taken as they are needed.
    options : RunningOptions
        Its `threads` and `workers`.
    ahead : int

    Yields
    ------
    item, result

    Raises
    ------
    WorkerError
        Workers cannot be used, or an item was lost too often.
    """
    if options.workers is None:
        yield from map_in_order(function, items, options.threads, ahead)
        return
    # Where threads do, nothing of other processes is loaded.
    from geomosaic.execution.units_on_workers import units_on_workers

    yield from units_on_workers([(function, items)], options, ahead)


def unit_map(options: RunningOptions) -> Map:
    """Form of `map` that computes where the options say, for what lies below units of work.

    Parameters
    ----------
    options : RunningOptions
    """

    def each(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        return (result for _, result in map_units(function, items, options))

    return each


@contextmanager
def workers_for(options: RunningOptions) -> Iterator[RunReport | None]:
    """Workers for all units of a run: opened at first use, closed at the end.

    Within another run on the same workers it is a part of that.

    Parameters
    ----------
    options : RunningOptions
        Its `workers`, and `memory_limit` for each of them.

    Yields
    ------
    RunReport or None
        Report, which grows; None where threads of this process do everything.
    """
    if options.workers is None:
        yield None
        return
    from geomosaic.execution.workers import entered

    with entered(options) as report:
        yield report


def map_in_order(
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
