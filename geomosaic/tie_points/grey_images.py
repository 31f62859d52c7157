"""Images as matching wants them: one band of eight bits, at full size or reduced, the last used parts held."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np

from geomosaic.block import OrientedImage
from geomosaic.geo.grid import Window
from geomosaic.raster.source import Source
from geomosaic.types import AnyArray, BoolArray

# Percentiles of values that become 0 and 255 where samples have more than eight bits: a few glints and dead pixels
# must not take the contrast from the rest.
LOW, HIGH = 0.5, 99.5
# Weights of red, green and blue in luminance (ITU-R BT.601).
LUMINANCE = (0.299, 0.587, 0.114)
# Bytes of images that are held.
HELD = 1 << 30
# Pixels up to which an image is read whole, and the side of the tiles of larger ones.
WHOLE, TILE = 48_000_000, 2048


@dataclass(frozen=True, eq=False)
class Grey:
    """One band of an image.

    Attributes
    ----------
    values : uint8 array (rows, cols)
    valid : bool array (rows, cols) or None
        None where all pixels are.
    shrink : int
        Pixels of the file along the side of one of these.
    """

    values: AnyArray
    valid: BoolArray | None
    shrink: int


class GreyImages:
    """Grey versions of images, the last used parts of them held.

    Parameters
    ----------
    scenes : sequence of OrientedImage
    held : int
        Bytes.
    """

    def __init__(self, scenes: Sequence[OrientedImage], held: int = HELD) -> None:
        self._scenes = scenes
        self._held = held
        self._lock = Lock()
        self._parts: OrderedDict[tuple[int, int, Window], Grey] = OrderedDict()
        self._ranges: dict[int, tuple[float, float]] = {}
        self._open: tuple[int, Source] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        return GreyImages, (self._scenes, self._held)

    def __enter__(self) -> GreyImages:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def _close(self) -> None:
        if self._open is not None:
            self._open[1].close()
            self._open = None

    def size(self, image: int, shrink: int = 1) -> tuple[int, int]:
        """Width and height of a reduced image.

        Parameters
        ----------
        image : int
        shrink : int
        """
        width, height = self._scenes[image].model.size
        return -(-width // shrink), -(-height // shrink)

    def read(self, image: int, shrink: int = 1) -> Grey:
        """An image, reduced by means of `shrink` x `shrink` pixels.

        Parameters
        ----------
        image : int
        shrink : int

        Returns
        -------
        Grey
        """
        return self.window(image, shrink, Window(0, 0, *self.size(image, shrink)))

    def window(self, image: int, shrink: int, window: Window) -> Grey:
        """Part of an image, reduced by means of `shrink` x `shrink` pixels.

        Parameters
        ----------
        image : int
        shrink : int
        window : Window
            Within the reduced image.

        Returns
        -------
        Grey
        """
        with self._lock:  # what it gives is not changed any more
            return self._window(image, shrink, window)

    def _window(self, image: int, shrink: int, window: Window) -> Grey:
        whole = Window(0, 0, *self.size(image, shrink))
        if whole.width * whole.height <= WHOLE:
            kept = self._held_part(image, shrink, whole)
            part = window.slices_in(whole)
            return Grey(kept.values[part], None if kept.valid is None else kept.valid[part], shrink)
        grey, known = np.empty((window.height, window.width), dtype=np.uint8), None
        for tile in whole.split(TILE, TILE):
            common = tile.intersection(window)
            if common.empty:
                continue
            kept, here, there = self._held_part(image, shrink, tile), common.slices_in(window), common.slices_in(tile)
            grey[here] = kept.values[there]
            if kept.valid is not None:
                known = np.ones(grey.shape, dtype=bool) if known is None else known
                known[here] = kept.valid[there]
        return Grey(grey, known, shrink)

    @property
    def _bytes(self) -> int:
        """Bytes of all parts that are held."""
        arrays = (array for grey in self._parts.values() for array in (grey.values, grey.valid))
        return sum(array.nbytes for array in arrays if array is not None)

    def _held_part(self, image: int, shrink: int, window: Window) -> Grey:
        """Part of a reduced image, from what is held if it is there."""
        key = image, shrink, window
        if key not in self._parts:
            self._parts[key] = self._read(image, shrink, window)
            if window == Window(0, 0, *self.size(image, shrink)):
                self._close()
            while len(self._parts) > 2 and self._bytes > self._held:
                self._parts.popitem(last=False)
        self._parts.move_to_end(key)
        return self._parts[key]

    def _source(self, image: int) -> Source:
        """File of an image, left open: one that knows no windows is decoded whole to read any of it."""
        if self._open is None or self._open[0] != image:
            self._close()
            scene = self._scenes[image]
            own = Source(scene.path, nodata=scene.nodata, bands=scene.bands, usable=scene.usable, clouds=scene.clouds)
            self._open = image, own
        return self._open[1]

    def _range(self, image: int, source: Source) -> tuple[float, float]:
        """Values of an image that become 0 and 255."""
        if source.dtype != np.uint8 and image not in self._ranges:
            whole = Window(0, 0, source.info.width, source.info.height)
            values, valid = source.read(whole, max(1, max(whole.width, whole.height) // 1000))
            seen = values if valid is None else values[valid != 0]
            low, high = np.percentile(_one_band(seen), (LOW, HIGH)) if seen.size else (0.0, 1.0)
            self._ranges[image] = float(low), float(high if high > low else low + 1.0)
        return self._ranges.get(image, (0.0, 255.0))

    def _read(self, image: int, shrink: int, window: Window) -> Grey:
        source = self._source(image)
        low, high = self._range(image, source)
        everything = Window(0, 0, source.info.width, source.info.height)
        own = Window(*(shrink * each for each in (window.col, window.row, window.width, window.height)))
        own = own.intersection(everything)
        grey = np.empty((window.height, window.width), dtype=np.uint8)
        known: BoolArray | None = None
        # By strips: a picture of many bands in floating point is several times as large as what is kept of it.
        step = shrink * max(1, (16 << 20) // (own.width * shrink * len(source.bands)))
        for strip in own.split(own.width, step):
            values, valid = _reduced(source, strip, shrink)
            first = (strip.row - own.row) // shrink
            part = slice(first, first + len(values))
            light = _one_band(values)
            if (low, high) != (0.0, 255.0):
                light = (light - low) * (255.0 / (high - low))
            if valid is not None:
                known = np.ones(grey.shape, dtype=bool) if known is None else known
                known[part] = valid != 0
                light[valid == 0] = 0
            grey[part] = light if light.dtype == np.uint8 else np.clip(np.rint(light), 0.0, 255.0)
        return Grey(grey, known, shrink)


def _reduced(source: Source, strip: Window, shrink: int) -> tuple[AnyArray, AnyArray | None]:
    """Values and validity of a strip, reduced by means."""
    # Means of bytes by OpenCV take 5 ms for 12 megapixels, in floating point 270; but a large shrink is what overviews
    # are for.
    if 1 < shrink <= 4 and source.dtype == np.uint8:
        import cv2

        values, valid = source.read(strip)
        if valid is None:
            below, right = (-size % shrink for size in values.shape[:2])
            if below or right:
                values = np.pad(values, ((0, below), (0, right), (0, 0)), mode="edge")
            rows, cols = values.shape[0] // shrink, values.shape[1] // shrink
            means = cv2.resize(values, (cols, rows), interpolation=cv2.INTER_AREA)
            return np.asarray(means).reshape(rows, cols, -1), None
    return source.read(strip, shrink)


def _one_band(values: AnyArray) -> AnyArray:
    """Luminance of three bands or more, else the mean of all bands; float32, of bytes and three bands bytes."""
    bands = values.shape[-1]
    if values.dtype == np.uint8 and bands in (1, 3):
        import cv2

        return np.asarray(cv2.cvtColor(values, cv2.COLOR_RGB2GRAY)) if bands == 3 else values[..., 0].copy()
    weights = np.array(LUMINANCE if bands >= 3 else (1.0 / bands,) * bands, dtype=np.float32)
    return values[..., : len(weights)].astype(np.float32) @ weights
