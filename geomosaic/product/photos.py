"""The open images of a mosaic: opened when first needed, closed when the rows of the output have passed them."""

from __future__ import annotations

import threading
from collections.abc import Sequence

import numpy as np

from geomosaic.block.block import Block
from geomosaic.block.footprint import Footprint
from geomosaic.errors import InputError
from geomosaic.geo.grid import Grid, Window
from geomosaic.product.photo import Photo
from geomosaic.raster.source import SourceInfo, inspect


class Photos:
    """Photos by number, with their number of open ones bounded by what a row of the output needs.

    Parameters
    ----------
    block : Block
    grid : Grid
        The output.
    outlines : sequence of Footprint
        One per scene.
    memory : int
        Bytes that images which cannot be read by windows may hold, all together.
    """

    def __init__(self, block: Block, grid: Grid, outlines: Sequence[Footprint], memory: int) -> None:
        self.block, self.grid, self.outlines = block, grid, outlines
        self.windows = [grid.window_of(outline.bounds) for outline in outlines]
        self.info = _common([inspect(scene.path, scene.bands) for scene in block.scenes], block)
        self._each = memory // max(1, self._most_at_once())
        self._open: dict[int, Photo] = {}
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self.block.scenes)

    def __getitem__(self, index: int) -> Photo:
        with self._lock:
            if index not in self._open:
                scene, outline = self.block.scenes[index], self.outlines[index]
                self._open[index] = Photo.open(scene, self.block.surface, self.grid, outline, self._each)
            return self._open[index]

    def near(self, window: Window) -> list[int]:
        """Numbers of the photos whose footprint's bounds meet a window."""
        return [i for i, own in enumerate(self.windows) if not own.intersection(window).empty]

    def passed(self, row: int) -> None:
        """Close what ends above an output row that is done."""
        with self._lock:
            for index in [i for i in self._open if self.windows[i].stop_row <= row]:
                self._open.pop(index).source.close()

    def close(self) -> None:
        """Close all."""
        with self._lock:
            for photo in self._open.values():
                photo.source.close()
            self._open.clear()

    def _most_at_once(self) -> int:
        """Most photos that any row of the output needs."""
        events = sorted(
            [(w.row, 1) for w in self.windows if not w.empty] + [(w.stop_row, -1) for w in self.windows if not w.empty]
        )
        return int(max(np.cumsum([change for _, change in events]), default=1))


def _common(infos: list[SourceInfo], block: Block) -> SourceInfo:
    """Bands and sample type that all images share."""
    first = infos[0]
    for scene, info in zip(block.scenes, infos, strict=True):
        if info.bands != first.bands:
            raise InputError(
                f"the image has {info.bands} bands, '{block.scenes[0].name}' has {first.bands}",
                where=scene.path,
                mend="choose the same bands of all images: --bidx, or bands under [project]",
            )
        if info.dtype != first.dtype:
            raise InputError(
                f"the image holds {info.dtype} samples, '{block.scenes[0].name}' holds {first.dtype}",
                where=scene.path,
                mend="convert the images to one sample type first",
            )
    return first
