"""Photos open for reading, and the memory budget that threads share."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from threading import Condition, Lock, Thread, current_thread
from typing import Any

import numpy as np

from geomosaic.block import Footprint, OrientedBlock, OrientedImage
from geomosaic.errors import InputError, counted
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.window_index import WindowIndex
from geomosaic.options.render import BLOCK_HEIGHT, SampleOptions
from geomosaic.raster.source import SourceInfo
from geomosaic.render.calibrated import check_quantities, check_squares, image_info
from geomosaic.render.photo import Photo, refuse_palette, sample_scales
from geomosaic.render.sparse import SparseSequence


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

    def __reduce__(self) -> tuple[Any, ...]:
        return MemoryBudget, (self._size,)

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


# Open files beyond which images that nobody reads are closed; opening one again takes about 2 ms.
MOST_HANDLES = 64


class Photos:
    """Photos by number, of which few are open at any time.

    Parameters
    ----------
    block : OrientedBlock
    grid : Grid
        The output.
    outlines : sequence of Footprint
        One per scene.
    memory : int
        Bytes that images which cannot be read by windows may hold, all together.
    samples : SampleOptions, optional
        Sample type of the output; that of the images unless given.
    resampling : str
        How they will be read.
    """

    def __init__(
        self,
        block: OrientedBlock,
        grid: Grid,
        outlines: Sequence[Footprint],
        memory: int,
        samples: SampleOptions | None = None,
        resampling: str = "nearest",
    ) -> None:
        self.surface, self.grid, self.outlines = block.surface, grid, outlines
        self.scenes: Sequence[OrientedImage] = block.scenes
        step = 1e-3 * grid.resolution[0]
        # Places that the photos see best, to a thousandth of a pixel: last digits may differ from run to run.
        self.centres = [(round(x / step) * step, round(y / step) * step) for x, y in (o.centre for o in outlines)]
        self.windows = [grid.window_of(outline.bounds) for outline in outlines]
        self._index = WindowIndex(self.windows)
        check_quantities(block.scenes)
        check_squares(block.scenes, resampling)
        infos = [image_info(scene) for scene in block.scenes]
        for info in infos:
            refuse_palette(info, resampling)
        dtype, self._scales = sample_scales(samples or SampleOptions(), infos)
        self.info = replace(_common(infos, block), dtype=dtype)
        self._most_whole = _most_at_once(self.windows)
        self._each = memory // self._most_whole
        self._open: dict[int, _Open] = {}  # least recently used first
        self._done_row = 0
        self._lock = Lock()

    def __getstate__(self) -> dict[str, Any]:
        """All but what is open: another process opens it again."""
        closed = {"_open": None, "_lock": None, "_done_row": 0}
        return {**vars(self), **closed}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._open, self._lock = {}, Lock()

    def __len__(self) -> int:
        return len(self.scenes)

    def only(self, near: Collection[int] | None) -> Photos:
        """The same photos, of which only some can be used: those of a region, for who draws that.

        Parameters
        ----------
        near : collection of int, optional
            Their numbers; all unless given.
        """
        if near is None:
            return self
        part = Photos.__new__(Photos)
        scenes, outlines = SparseSequence(self.scenes, near), SparseSequence(self.outlines, near)
        part.__setstate__({**vars(self), "scenes": scenes, "outlines": outlines, "_done_row": 0})
        return part

    @contextmanager
    def using(self, index: int) -> Iterator[Photo]:
        """Loan of a photo, which stays open at least until it is given back."""
        with self._lock:
            entry = self._open.pop(index, None) or self._opened(index)
            self._open[index] = entry
            entry.users += 1
            entry.readers.add(current_thread())
            self._close_spare()
        try:
            yield entry.photo
        finally:
            with self._lock:
                entry.users -= 1
                self._close_spare()

    def near(self, window: Window) -> list[int]:
        """Numbers of the photos whose footprint's bounds meet a window."""
        return self._index.meeting(window)

    def leave_out(self, numbers: Iterable[int]) -> None:
        """Show nothing of some photos from now on."""
        for index in numbers:
            self.windows[index] = Window(0, 0, 0, 0)

    def passed(self, row: int) -> None:
        """Close what ends above an output row that is done."""
        with self._lock:
            self._done_row = max(self._done_row, row)
            self._close_spare()

    def again(self) -> None:
        """Keep photos open as at the beginning: rows that were done are looked at once more."""
        with self._lock:
            self._done_row = 0

    def close(self) -> None:
        """Close all."""
        with self._lock:
            for entry in self._open.values():
                entry.photo.source.close()
            self._open.clear()

    def _opened(self, index: int) -> _Open:
        scene, outline = self.scenes[index], self.outlines[index]
        return _Open(Photo.open(scene, self.surface, self.grid, outline, self._each, self._scales[index]))

    def _close_spare(self) -> None:
        """Close photos that nobody reads: those done with, and the least recently used beyond bounds."""
        # What can be read by windows counts by its file handles, one per thread that has read it. What is decoded whole
        # costs memory and time, not handles: as many are kept as the output needs at once.
        handles = sum(len(entry.readers) for entry in self._open.values() if entry.windowed)
        whole = sum(not entry.windowed for entry in self._open.values())
        for index, entry in list(self._open.items()):
            excess = handles > MOST_HANDLES if entry.windowed else whole > self._most_whole
            if entry.users or not (excess or self.windows[index].stop_row <= self._done_row):
                continue
            handles -= len(entry.readers) if entry.windowed else 0
            whole -= not entry.windowed
            self._open.pop(index).photo.source.close()


@dataclass
class _Open:
    """An open photo, how many read it now, and the threads that ever did: each has a handle of its own."""

    photo: Photo
    users: int = 0
    readers: set[Thread] = field(default_factory=set)

    @property
    def windowed(self) -> bool:
        return self.photo.source.info.windowed


def _most_at_once(windows: Sequence[Window]) -> int:
    """Most photos that two successive rows of output blocks need: threads that end one row begin the next."""
    events = []
    for window in windows:
        if not window.empty:
            events += [(window.row // BLOCK_HEIGHT - 1, 1), (-(-window.stop_row // BLOCK_HEIGHT), -1)]
    return max(1, int(max(np.cumsum([change for _, change in sorted(events)]), default=1)))


def _common(infos: list[SourceInfo], block: OrientedBlock) -> SourceInfo:
    """Bands that all images share."""
    first = infos[0]
    for scene, info in zip(block.scenes, infos, strict=True):
        if info.bands != first.bands:
            raise InputError(
                f"the image has {counted(info.bands, 'band')}, '{block.scenes[0].name}' has {first.bands}",
                where=scene.path,
                hint="choose the same bands of all images: `bands`",
            )
    return first
