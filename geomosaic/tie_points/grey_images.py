"""Images as matching wants them: one band of eight bits, at full size or reduced, the last used ones held."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

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
HELD = 768 << 20


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
    """Grey versions of images, the last used of them held.

    Parameters
    ----------
    scenes : sequence of OrientedImage
    held : int
        Bytes.
    """

    def __init__(self, scenes: Sequence[OrientedImage], held: int = HELD) -> None:
        self._scenes = scenes
        self._held = held
        self._images: OrderedDict[tuple[int, int], Grey] = OrderedDict()
        self._ranges: dict[int, tuple[float, float]] = {}

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
        key = image, shrink
        if key not in self._images:
            self._images[key] = self._read(image, shrink)
            while len(self._images) > 2 and sum(grey.values.nbytes for grey in self._images.values()) > self._held:
                self._images.popitem(last=False)
        self._images.move_to_end(key)
        return self._images[key]

    def _read(self, image: int, shrink: int) -> Grey:
        scene = self._scenes[image]
        with Source(scene.path, nodata=scene.nodata, bands=scene.bands, usable=scene.usable) as source:
            whole = Window(0, 0, source.info.width, source.info.height)
            if source.dtype != np.uint8 and image not in self._ranges:
                coarse = max(1, max(whole.width, whole.height) // 1000)
                values, valid = source.read(whole, coarse)
                seen = values if valid is None else values[valid != 0]
                low, high = np.percentile(_one_band(seen), (LOW, HIGH)) if seen.size else (0.0, 1.0)
                self._ranges[image] = float(low), float(high if high > low else low + 1.0)
            low, high = self._ranges.get(image, (0.0, 255.0))
            # By strips: a picture of many bands in floating point is several times as large as what is kept of it.
            rows = -(-whole.height // shrink)
            grey = np.empty((rows, -(-whole.width // shrink)), dtype=np.uint8)
            known: BoolArray | None = None
            step = shrink * max(1, (16 << 20) // (whole.width * shrink * len(source.bands)))
            for strip in whole.split(whole.width, step):
                values, valid = source.read(strip, shrink)
                part = slice(strip.row // shrink, strip.row // shrink + len(values))
                light = (_one_band(values) - low) * (255.0 / (high - low))
                if valid is not None:
                    known = np.ones(grey.shape, dtype=bool) if known is None else known
                    known[part] = valid != 0
                    light[valid == 0] = 0.0
                grey[part] = np.clip(np.rint(light), 0.0, 255.0)
        return Grey(grey, known, shrink)


def _one_band(values: AnyArray) -> AnyArray:
    """Luminance of three bands or more, else the mean of all bands, as float32."""
    bands = values.shape[-1]
    weights = np.array(LUMINANCE if bands >= 3 else (1.0 / bands,) * bands, dtype=np.float32)
    return values[..., : len(weights)].astype(np.float32) @ weights
