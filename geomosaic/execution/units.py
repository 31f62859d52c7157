"""Units of work in order: one loop for threads of this process and for workers outside of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeVar

from geomosaic.errors import GeomosaicError, RasterReadError, WorkerError
from geomosaic.options.render import RenderOptions
from geomosaic.raster.environment import enter_for_good, environment

if TYPE_CHECKING:
    from geomosaic.execution.workers import Pending, Workers

Item = TypeVar("Item")
Result = TypeVar("Result")

# How often an item is begun again after its worker was lost.
RETRIES = 3


def map_units(
    function: Callable[[Item], Result], items: Iterable[Item], options: RenderOptions, ahead: int = 3
) -> Generator[tuple[Item, Result], None, None]:
    """Results of a function over items in their order, computed where the options say.

    At most `ahead` items per thread or worker are begun before their turn: memory, here and in a scheduler, does not
    grow with the number of items.

    Parameters
    ----------
    function : callable
        Of one item; pure, so that an item may be begun twice. For workers see `packing.packed`.
    items : iterable
        Taken as they are needed.
    options : RenderOptions
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
    from geomosaic.execution.packing import packed
    from geomosaic.execution.workers import workers_of

    with workers_of(options.workers, packed(function)) as workers:
        yield from _by_workers(workers, items, ahead)


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


@dataclass(frozen=True)
class _Begun:
    """Item whose result is on its way."""

    item: Any
    pending: Pending


def _by_workers(workers: Workers, items: Iterable[Item], ahead: int) -> Iterator[tuple[Item, Any]]:
    source, waiting = iter(items), deque[_Begun]()
    try:
        for item in islice(source, workers.slots * ahead):
            waiting.append(_Begun(item, workers.submit(item)))
        while waiting:
            first = waiting.popleft()
            result = _result(workers, first)
            for item in islice(source, 1):
                waiting.append(_Begun(item, workers.submit(item)))
            yield first.item, result
    finally:
        for one in waiting:
            one.pending.cancel()


def _result(workers: Workers, begun: _Begun) -> Any:
    """Result of an item, which is begun again where its worker was lost."""
    pending = begun.pending
    for left in reversed(range(RETRIES + 1)):
        try:
            return pending.result()
        except RasterReadError as error:
            error.hint = f"{error.hint or 'check the path'}; workers must see the file under the same path"
            raise
        except GeomosaicError:  # the same anywhere
            raise
        except workers.gone as error:
            raise WorkerError(
                f"the workers are out of reach ({type(error).__name__}: {error})",
                hint="start them anew, then run the same command again",
            ) from error
        except Exception as error:
            if left and not isinstance(error, workers.lost):
                pending = workers.submit(begun.item)
                continue
            raise WorkerError(
                f"the unit was begun {RETRIES + 1} times and lost every time ({type(error).__name__}: {error})",
                where=str(begun.item),
                hint="look into the logs of the workers; with less memory each than a unit needs, give them more",
            ) from error
    raise AssertionError("unreachable")
