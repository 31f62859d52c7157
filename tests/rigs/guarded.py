"""Arrays between pages that no one may touch, and the kernels of resampling on them: who reads beside an array ends."""

from __future__ import annotations

import ctypes
import itertools
import mmap

import numpy as np

from geomosaic.kernels.warp import METHODS, Geometry, OutputScaling, Pixels, coordinates, sample

PAGE = mmap.PAGESIZE


def guarded(array: np.ndarray, at_end: bool) -> np.ndarray:
    """Copy of an array, interleaved as it is, that touches the page behind it or the one before."""
    pages = -(-array.nbytes // PAGE)
    memory = mmap.mmap(-1, (pages + 2) * PAGE)
    start = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    system = ctypes.CDLL(None, use_errno=True)
    for page in (0, pages + 1):
        assert system.mprotect(ctypes.c_void_p(start + page * PAGE), ctypes.c_size_t(PAGE), 0) == 0
    offset = (1 + pages) * PAGE - array.nbytes if at_end else PAGE
    found: np.ndarray = np.ndarray(array.shape, array.dtype, memory, offset, array.strides)
    found[...] = array
    return found


def small_images() -> None:
    """Take values of images of a few pixels, inside, at the edges and beyond."""
    rng = np.random.default_rng(1)
    sizes, types = ((1, 1), (1, 9), (7, 1), (2, 2), (5, 4), (6, 7)), ("uint8", "uint16", "int32", "float32")
    for (height, width), dtype, bands, planar, masked, at_end in itertools.product(
        sizes, types, (1, 3), (False, True), (False, True), (False, True)
    ):
        image = rng.integers(0, 200, (bands, height, width)).astype(dtype).transpose(1, 2, 0)
        image = guarded(image if planar else np.ascontiguousarray(image), at_end)
        valid = guarded((rng.random((height, width)) < 0.7).astype(np.uint8), at_end) if masked else None
        cols, rows = rng.uniform(-1, width + 1, (2, 31)), rng.uniform(-1, height + 1, (2, 31))
        cols[0], rows[0] = np.linspace(-0.5, width + 0.5, 31), 0.5
        cols[1, :3], rows[1, :3] = (0.0, np.nextafter(width, 0), np.nan), (0.0, np.nextafter(height, 0), np.inf)
        out, seen = guarded(np.zeros((2, 31, bands), dtype), at_end), guarded(np.zeros((2, 31), np.uint8), at_end)
        ending = OutputScaling(np.ones(bands), np.zeros(bands), 0.0, 250.0, dtype != "float32")
        for method in METHODS:
            sample(cols, rows, Pixels(image, valid, 0, 0, 1, (width, height)), method, ending, out, seen)


def torn_places() -> None:
    """Place pixels between a node over known heights and one that is nowhere."""
    nodes, places = np.zeros((2, 3, 8)), np.zeros((2, 3, 2))
    nodes[..., 0], places[..., 0] = 64.0 * np.arange(3), 9.0 * np.arange(3)
    for nowhere in (np.nan, np.inf, 1e300):
        places[:, 1, 0] = nowhere
        for at_end in (False, True):
            heights = guarded(np.ones((5, 30), np.float32), at_end)
            found = np.empty((2, 64, 128))
            geometry = Geometry(nodes, places, heights, 0.0, 1.0, False, 64)
            coordinates(geometry, 0, 1, (200, 200), np.ones((1, 2), np.uint8), *found)
            assert not np.isfinite(found[0, :, 40]).any()


if __name__ == "__main__":
    small_images()
    torn_places()
    print("untouched")
