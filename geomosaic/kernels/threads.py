"""Threads that share the work of a kernel."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

# Call of a kernel for a part of its work, from one number to another.
Part = Callable[[int, int], object]


@contextmanager
def sharing(laborious: bool = True) -> Iterator[Callable[[Part, list[int]], None]]:
    """Function that calls a kernel for parts of its work, given by their bounds, with a thread for each processor.

    Parameters
    ----------
    laborious : bool
        Whether the work is worth threads; else all of it is done in one call.
    """
    count = os.cpu_count() or 1

    def alone(part: Part, bounds: list[int]) -> None:
        part(bounds[0], bounds[-1])

    if count == 1 or not laborious:
        yield alone
        return
    with ThreadPoolExecutor(count) as pool:

        def together(part: Part, bounds: list[int]) -> None:
            for _ in pool.map(part, bounds[:-1], bounds[1:]):
                pass

        yield together


def bounds(low: int, high: int, parts: int = 16) -> list[int]:
    """Bounds of parts of about the same size.

    Parameters
    ----------
    low, high : int
        Range that is cut.
    parts : int
    """
    parts = max(1, min(parts, high - low))
    return [low + (high - low) * k // parts for k in range(parts + 1)]
