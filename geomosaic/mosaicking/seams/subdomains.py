"""Subdomains of a large seam grid: each laid out by itself, beside what its neighbours have decided, in four turns.

This is the overlapping domain decomposition of Schwarz with four colours: subdomains of one turn do not touch, so that
they are units of work. Each looks beyond its core as far as nothing is decided there, and decides the cells of its core
alone. Along decided neighbours it takes their cells as they are: seams go on where those of the neighbours end. The
turn of a subdomain depends on its place only, and so does the layout.

B. Smith, P. Bjørstad, W. Gropp, *Domain Decomposition*, Cambridge University Press 1996, section 1.2.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.window_index import WindowIndex
from geomosaic.options.render import RenderOptions
from geomosaic.render.regions import map_by_regions
from geomosaic.types import IntArray

# Side in cells of a core, and of what is looked at beyond it where nothing is decided: about half a footprint.
SIDE, MARGIN = 1024, 192
# Cells that are looked at beyond a core whose neighbour is decided: smoothing reaches no farther.
CONTEXT = 64
# Cells along a core that its neighbours are told: seams cost what they part, a cell to both sides, and spurs are short.
RIM = 4
# Cells of a grid that is one subdomain.
LARGEST = (SIDE + 2 * MARGIN) ** 2
# Values of `Subdomain.decided` besides numbers of images and -1: to be decided; decided, and too far away to matter.
FREE, OUTSIDE = -3, -2

Rim = tuple[Window, IntArray]


@dataclass(frozen=True)
class Subdomain:
    """Part of a seam grid that is laid out at once.

    Attributes
    ----------
    core : Window
        Cells that it decides.
    window : Window
        Cells that it looks at.
    images : tuple of int
        Those whose footprints' bounds meet the window.
    neighbours : tuple of Window
        Cores that are decided.
    rims : tuple of (Window, int array (rows, cols))
        Labels of decided cells along the core: the number of the image, -1 where there is none.
    """

    core: Window
    window: Window
    images: tuple[int, ...]
    neighbours: tuple[Window, ...] = ()
    rims: tuple[Rim, ...] = ()

    @property
    def decided(self) -> IntArray:
        """Labels (rows, cols) of the cells of the window that are decided; `FREE` or `OUTSIDE` elsewhere."""
        labels: IntArray = np.full((self.window.height, self.window.width), FREE, dtype=np.int32)
        for core in self.neighbours:
            labels[self.window.intersection(core).slices_in(self.window)] = OUTSIDE
        for rim, known in self.rims:
            labels[rim.slices_in(self.window)] = known
        return labels


@dataclass(frozen=True)
class SubdomainSeams:
    """Seams of a subdomain.

    Attributes
    ----------
    polygons : list of (Polygon, int)
        Polygons in cells of the grid, and the number of the image of each.
    rims : list of (Window, int array (rows, cols))
        Labels of the cells along the edges of its core.
    """

    polygons: list[tuple[Any, int]]
    rims: list[Rim]


class KeptSeams(Protocol):
    """Seams of subdomains that are kept from run to run."""

    def get(self, part: Subdomain) -> SubdomainSeams | None:
        """Seams of a subdomain; None where they have to be laid."""

    def keep(self, part: Subdomain, seams: SubdomainSeams) -> None:
        """Seams of a subdomain kept for the next run."""

    def reused(self, number: int, total: int) -> None:
        """Number of subdomains whose seams are those of an earlier run."""


def rims_of(core: Window, labels: IntArray) -> list[Rim]:
    """Labels along the edges of a core.

    Parameters
    ----------
    core : Window
    labels : int array (rows, cols)
        Of its cells.
    """
    tall, wide = min(RIM, core.height), min(RIM, core.width)
    rims = [
        Window(core.col, core.row, core.width, tall),
        Window(core.col, core.stop_row - tall, core.width, tall),
        Window(core.col, core.row, wide, core.height),
        Window(core.stop_col - wide, core.row, wide, core.height),
    ]
    return [(rim, labels[rim.slices_in(core)].astype(np.int32)) for rim in rims]


def seams_in_turns(
    grid: Grid,
    windows: Sequence[Window],
    function_of: Callable[[Collection[int] | None], Callable[[Subdomain], SubdomainSeams]],
    options: RenderOptions,
    kept: KeptSeams | None = None,
) -> Iterator[tuple[Any, int]]:
    """Seams of all subdomains of a grid, as units of work.

    Parameters
    ----------
    grid : Grid
        Of the seams' cells.
    windows : sequence of Window
        Cells of what each image shows; empty for images that are left out.
    function_of : callable
        Function that lays the seams of subdomains at which these images are at hand; any for None.
    options : RenderOptions
        Threads, workers and progress.
    kept : KeptSeams, optional
        Seams of subdomains of an earlier run, which perhaps did not end.

    Yields
    ------
    polygon, number
        In cells of the grid, and its image. Ground of a core that at most one image shows is left out.
    """
    index, cores = WindowIndex(windows), _cores(grid)
    shared = {place: core for place, core in cores.items() if len(index.meeting(core)) > 1}
    rims: dict[tuple[int, int], list[Rim]] = {}

    def subdomain(place: tuple[int, int]) -> Subdomain:
        core, (row, col) = shared[place], place
        near = [(row + down, col + right) for down in (-1, 0, 1) for right in (-1, 0, 1)]
        decided = [each for each in near if each in rims]
        sides = (row - 1, col), (row + 1, col), (row, col - 1), (row, col + 1)
        window = _widened(core, [CONTEXT if each in rims else MARGIN for each in sides], grid)
        seen = _widened(core, [RIM] * 4, grid)
        known = [
            (part, labels[part.slices_in(rim)])
            for each in decided for rim, labels in rims[each] if not (part := rim.intersection(seen)).empty
        ]  # fmt: skip
        return Subdomain(
            core, window, tuple(index.meeting(window)), tuple(cores[each] for each in decided), tuple(known)
        )

    done = reused = 0
    for turn in range(4):
        places = [place for place in shared if 2 * (place[0] % 2) + place[1] % 2 == turn]
        found: dict[tuple[int, int], SubdomainSeams] = {}
        parts = {place: subdomain(place) for place in places}
        for place, part in parts.items():
            if kept is not None and (known := kept.get(part)) is not None:
                found[place] = known
        reused, done = reused + len(found), done + len(found)
        left = [place for place in places if place not in found]
        wanted = (parts[place] for place in left)
        units = map_by_regions(function_of, wanted, lambda part: part.images, len(windows), options, ahead=1)
        for place, (part, seams) in zip(left, units, strict=True):
            found[place] = seams
            if kept is not None:
                kept.keep(part, seams)
            done += 1
            options.report(done, len(shared), "seams")
        for place in places:
            rims[place] = found[place].rims
            yield from found[place].polygons
    if kept is not None:
        kept.reused(reused, len(shared))


def _cores(grid: Grid) -> dict[tuple[int, int], Window]:
    """Cores of about `SIDE` cells a side, by row and column; they cover the grid."""
    rows, cols = (np.linspace(0, size, -(-size // SIDE) + 1).round().astype(int).tolist() for size in grid.shape)
    return {
        (r, c): Window(left, top, right - left, bottom - top)
        for r, (top, bottom) in enumerate(pairwise(rows))
        for c, (left, right) in enumerate(pairwise(cols))
    }


def _widened(core: Window, by: Sequence[int], grid: Grid) -> Window:
    """Window with so many cells more above, below, to the left and to the right, within the grid."""
    above, below, left, right = by
    wide = Window(core.col - left, core.row - above, core.width + left + right, core.height + above + below)
    return wide.intersection(grid.window)
