"""Units of work by regions: workers are sent the images that some units depend on, not all of a large block."""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Iterable, Iterator
from typing import TypeVar

from geomosaic.execution.units import map_units
from geomosaic.options.render import RunningOptions
from geomosaic.render.photos import Photos

# Images that are sent to workers at a time, with their orientation, seams and colours: up to some 60 kB of each.
MOST_IMAGES = 1000

Unit = TypeVar("Unit")
Result = TypeVar("Result")


def map_by_regions(
    function_of: Callable[[Collection[int] | None], Callable[[Unit], Result]],
    units: Iterable[Unit],
    images_of: Callable[[Unit], Collection[int]],
    images: int,
    options: RunningOptions,
    ahead: int = 3,
) -> Generator[tuple[Unit, Result], None, None]:
    """Results of units in their order, as by `map_units`, of a function that is sent to workers region by region.

    Parameters
    ----------
    function_of : callable
        Function of a unit that has some images, by their numbers; all of them for None.
    units : iterable
        Those that follow each other should depend on much the same images.
    images_of : callable
        Numbers of the images that a unit depends on.
    images : int
        Number of images of the block.
    options : RunningOptions
    ahead : int
        As in `map_units`.

    Yields
    ------
    unit, result
    """
    if options.workers is None or images <= MOST_IMAGES:
        yield from map_units(function_of(None), units, options, ahead)
        return
    # Where threads do, nothing of other processes is loaded.
    from geomosaic.execution.units_on_workers import units_on_workers

    regions = ((function_of(near), iter(own)) for near, own in _regions(units, images_of))
    yield from units_on_workers(regions, options, ahead)


def _regions(
    units: Iterable[Unit], images_of: Callable[[Unit], Collection[int]]
) -> Iterator[tuple[set[int], list[Unit]]]:
    """Units that follow each other, and the images that they depend on: at most `MOST_IMAGES`, or those of one."""
    own: list[Unit] = []
    near: set[int] = set()
    for unit in units:
        more = images_of(unit)
        if own and len(near.union(more)) > MOST_IMAGES:
            yield near, own
            own, near = [], set()
        own.append(unit)
        near.update(more)
    if own:
        yield near, own


def map_images(
    function_of: Callable[[Photos], Callable[[int], Result]],
    photos: Photos,
    options: RunningOptions,
    numbers: Iterable[int] | None = None,
) -> Generator[tuple[int, Result], None, None]:
    """Results of images one by one, in their order.

    Parameters
    ----------
    function_of : callable
        Function of the number of an image, which has some of the photos.
    photos : Photos
    options : RunningOptions
    numbers : iterable of int, optional
        Of the images; of all unless given.

    Yields
    ------
    number, result
    """
    wanted = range(len(photos)) if numbers is None else numbers
    return map_by_regions(
        lambda near: function_of(photos.only(near)), wanted, lambda number: (number,), len(photos), options, ahead=1
    )
