"""Nodes of a DEM file in metres, unknown ones as NaN: read by windows, reduced, or once and for all."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from geomosaic.errors import InputError
from geomosaic.geo.grid import Window
from geomosaic.raster.validity import block_sum
from geomosaic.types import AnyArray, ByteArray, Float32Array

# Metres; a height beyond this either way is a mark for 'unknown' that the file forgot to declare.
HIGHEST = 20_000.0
# The commonest such mark that is not beyond it; no photo shows ground at exactly this depth.
FORGOTTEN = -9999.0
BLOCK = 256
_BLOCKS_KEPT = 64
# Nodes read at once where the whole file does not fit: 4 MB of float32, and four times that for masks and sums.
_STRIP_NODES = 1 << 20


class _Size(Protocol):
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def path(self) -> str: ...


class HeightSource(Protocol):
    """Source of a DEM's nodes: a `Source` of one band, or an array."""

    @property
    def info(self) -> _Size:
        """Size in nodes, and the name for messages."""

    def read(self, window: Window) -> tuple[AnyArray, ByteArray | None]:
        """Values (rows, cols, 1) of a window, and which of them are valid."""

    def close(self) -> None:
        """Close the file."""


@dataclass(frozen=True)
class _ArraySize:
    width: int
    height: int
    path: str = "the array of heights"


@dataclass(frozen=True, eq=False)
class ArraySource:
    """Heights held in memory, as a source of nodes.

    Attributes
    ----------
    heights : float32 array (rows, cols)
        Metres; NaN where unknown.
    """

    heights: Float32Array

    @property
    def info(self) -> _ArraySize:
        """Size of the array."""
        return _ArraySize(self.heights.shape[1], self.heights.shape[0])

    def read(self, window: Window) -> tuple[Float32Array, None]:
        """Values (rows, cols, 1) of a window; unknown ones are NaN."""
        return self.heights[window.row : window.stop_row, window.col : window.stop_col, None], None

    def close(self) -> None:
        """Nothing is open."""


class Nodes:
    """Heights at the pixel centres of a raster. Thread-safe.

    Parameters
    ----------
    source : HeightSource
        One band.
    scale, offset : float
        Stored values × scale + offset are metres.
    memory : int
        Bytes; a file of no more nodes than fit is read once and kept.
    """

    def __init__(self, source: HeightSource, scale: float, offset: float, memory: int) -> None:
        self._source, self._scale, self._offset = source, scale, offset
        self.window = Window(0, 0, source.info.width, source.info.height)
        self._keep = 4 * self.window.width * self.window.height <= memory
        self._all: Float32Array | None = None
        self._range: tuple[float, float] | None = None
        self._gaps = False
        self._blocks: OrderedDict[tuple[int, int], Float32Array] = OrderedDict()
        self._lock = threading.RLock()

    def __getstate__(self) -> dict[str, Any]:
        """All but the nodes read so far: another process reads them again."""
        return {**vars(self), "_all": None, "_blocks": None, "_lock": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._blocks, self._lock = OrderedDict(), threading.RLock()

    def close(self) -> None:
        """Close the file and free the memory."""
        self._source.close()
        with self._lock:
            self._blocks.clear()
            self._all = None

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest height in metres, from every node of the file, read once.

        Raises
        ------
        InputError
            No node has a height.
        """
        with self._lock:
            if self._range is None:
                self._range = self._find_range()
            return self._range

    @property
    def gaps(self) -> bool:
        """Whether any node has no height."""
        with self._lock:
            return self.range is not None and self._gaps

    def _find_range(self) -> tuple[float, float]:
        low, high = np.inf, -np.inf
        rows = max(1, _STRIP_NODES // self.window.width)
        for window in self.window.split(self.window.width, max(BLOCK, rows - rows % BLOCK)):
            heights = self.read(window)
            least, most = float(heights.min()), float(heights.max())
            if np.isnan(least):
                self._gaps = True
                least, most = float(np.fmin.reduce(heights, None)), float(np.fmax.reduce(heights, None))
            low, high = float(np.fmin(low, least)), float(np.fmax(high, most))
        if low > high:
            raise InputError(
                "the DEM holds no height: every node is nodata, NaN or beyond 20 km",
                where=self._source.info.path,
                hint="check the file and its nodata value",
            )
        return low, high

    def read(self, window: Window) -> Float32Array:
        """Heights (rows, cols) of a window in metres; not to be changed."""
        if not self._keep:
            return self._in_strips(window)
        with self._lock:
            if self._all is None:
                self._all = self._decode_all()
            nodes = self._all
        return nodes[window.row : window.stop_row, window.col : window.stop_col]

    @property
    def whole(self) -> Float32Array | None:
        """All nodes, where they are kept."""
        return self.read(self.window) if self._keep else None

    def _decode_all(self) -> Float32Array:
        """All nodes; what the source holds of a file that it cannot read by windows is not needed any more."""
        nodes = self._in_strips(self.window)
        self._source.close()
        return nodes

    def _in_strips(self, window: Window) -> Float32Array:
        """Nodes of a window; masks and copies that decoding makes are those of a strip."""
        nodes = np.empty((window.height, window.width), dtype=np.float32)
        for strip in window.split(window.width, max(1, _STRIP_NODES // window.width)):
            first = strip.row - window.row
            nodes[first : first + strip.height] = self._decode(strip)
        return nodes

    def _decode(self, window: Window) -> Float32Array:
        values, valid = self._source.read(window)
        heights = values[:, :, 0]
        if self._scale != 1.0 or self._offset != 0.0:
            heights = heights * self._scale + self._offset
        heights = heights.astype(np.float32, copy=False)
        unknown = None if valid is None else valid == 0
        if not (heights.min() > FORGOTTEN and heights.max() <= HIGHEST):  # nor where any is NaN
            with np.errstate(invalid="ignore"):
                marked = ~(np.abs(heights) <= HIGHEST) | (heights == FORGOTTEN)
            unknown = marked if unknown is None else unknown | marked
        if unknown is not None:
            heights = np.where(unknown, np.float32(np.nan), heights)
        return heights

    def reduced(self, window: Window, factor: int) -> Float32Array:
        """Means of blocks of factor × factor nodes, of a window in blocks; NaN where under half is known."""
        # Read in strips, so that memory does not grow with the factor.
        if factor == 1:
            return self.read(window)
        fine = Window(window.col * factor, window.row * factor, window.width * factor, window.height * factor)
        fine = fine.intersection(self.window)
        out = np.empty((window.height, window.width), dtype=np.float32)
        rows = factor * max(1, _STRIP_NODES // (fine.width * factor))
        for strip in fine.split(fine.width, rows):
            heights = self.read(strip)
            known = np.isfinite(heights)
            total = block_sum(np.where(known, heights, np.float32(0.0)), factor, np.float64)
            count, nodes = (block_sum(mask, factor, np.int64) for mask in (known, np.ones_like(known)))
            at = (strip.row - fine.row) // factor
            out[at : at + len(total)] = np.where(2 * count >= nodes, total / np.maximum(count, 1), np.nan)
        return out

    def block(self, col: int, row: int) -> Float32Array:
        """One block of nodes and the first nodes of its right and lower neighbours; the last used are kept."""
        window = Window(col * BLOCK, row * BLOCK, BLOCK + 1, BLOCK + 1).intersection(self.window)
        if self._keep:
            return self.read(window)
        key = (col, row)
        with self._lock:
            if key in self._blocks:
                self._blocks.move_to_end(key)
                return self._blocks[key]
        nodes = self._decode(window)
        with self._lock:
            self._blocks[key] = nodes
            while len(self._blocks) > _BLOCKS_KEPT:
                self._blocks.popitem(last=False)
        return nodes
