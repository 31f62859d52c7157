"""Units of a mosaic: pixels on their way to the file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.geo.grid import Window
from geomosaic.types import AnyArray, ByteArray, IntArray


def label_type(images: int) -> str:
    """Smallest sample type that numbers the images from 1."""
    return "uint8" if images < 255 else "uint16" if images < 65535 else "int32"


@dataclass(frozen=True)
class MosaicUnit:
    """Pixels of one or more blocks side by side, filled block by block.

    Attributes
    ----------
    window : Window
    values : array (rows, cols, bands)
        Zero where not valid.
    valid : uint8 array (rows, cols)
    label : array (rows, cols)
        Number of the image with the most weight, counted from 1; 0 where none; the one after the last where images
        cover a place and the surface hides it from them all.
    counts : int array (images + 2,)
        Pixels by label.
    facts : list of (error, scale)
        Of the lattices used.
    """

    window: Window
    values: AnyArray
    valid: ByteArray
    label: AnyArray
    counts: IntArray
    facts: list[tuple[float, float]]

    @classmethod
    def empty(cls, window: Window, bands: int, dtype: str, images: int) -> MosaicUnit:
        """Nothing seen yet."""
        shape = window.height, window.width
        label, counts = np.zeros(shape, dtype=label_type(images)), np.zeros(images + 2, dtype=np.int64)
        return cls(window, np.zeros((*shape, bands), dtype=dtype), np.zeros(shape, dtype=np.uint8), label, counts, [])
