"""Tiles of rasters: of any size and depth, in the pyramid of the raster's own pixels, encoded for the page.

Level 0 holds the whole raster in one tile of 256 pixels, each further level has twice its scale, and the last one has
the pixels themselves. Tile (0, 0) starts at the upper-left corner.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.errors import InputError, RasterReadError
from geomosaic.geo.grid import Window
from geomosaic.raster.display import DisplayRaster, eight_bits
from geomosaic.types import ByteArray

SIZE = 256
# Rasters that are open at once, and bytes of encoded tiles that are kept.
_OPEN, _KEPT = 12, 24 << 20
_QUALITY = 85


def level_count(width: int, height: int) -> int:
    """Number of levels of a raster's pyramid.

    Parameters
    ----------
    width, height : int
        Pixels.

    Returns
    -------
    int
        At least 1.
    """
    return max(0, (-(-max(width, height) // SIZE) - 1).bit_length()) + 1


class RasterTiles:
    """Tiles of files that a function names; safe to use from any number of threads.

    Parameters
    ----------
    path_of : callable
        Path of a layer by its name; None where there is no such layer.
    """

    def __init__(self, path_of: Callable[[str], Path | None]) -> None:
        self._path_of = path_of
        self._lock, self._opening = threading.Lock(), threading.Lock()
        self._open: OrderedDict[tuple[str, int, int], DisplayRaster] = OrderedDict()
        self._kept: OrderedDict[tuple[Any, ...], bytes] = OrderedDict()
        self._bytes = 0

    def close(self) -> None:
        """Close all files."""
        with self._lock:
            rasters = list(self._open.values())
            self._open.clear()
        for raster in rasters:
            raster.close()

    def facts(self, layer: str) -> dict[str, Any]:
        """Size, levels, georeference and stretch of a layer.

        Returns
        -------
        dict
            `width`, `height`, `levels`, `tile`, `bands` (shown), `dtype`, `stretch`, `crs` (WKT), `affine` (a, b, c, d,
            e, f; pixel corners to the map), `ready` and `version`, which changes with the file.

        Raises
        ------
        InputError
            No such layer, or its file cannot be read.
        """
        key, raster = self._raster(layer)
        info = raster.info
        return {
            "width": info.width, "height": info.height, "levels": level_count(*info.size), "tile": SIZE,
            "bands": info.bands, "dtype": info.dtype, "stretch": raster.limits(),
            "crs": None if info.crs is None else info.crs.to_wkt(),
            "affine": None if info.transform is None else list(info.transform)[:6],
            "ready": raster.ready, "version": f"{key[1]:x}-{key[2]:x}",
        }  # fmt: skip

    def tile(self, layer: str, z: int, x: int, y: int) -> tuple[bytes, bool]:
        """Tile as WebP, transparent where the raster has no data.

        Parameters
        ----------
        layer : str
        z, x, y : int
            Level, column and row.

        Returns
        -------
        bytes
        bool
            Whether it is final: it is not while the coarse view of the raster is still being made.

        Raises
        ------
        InputError
            No such layer or tile, or its file cannot be read.
        """
        key, raster = self._raster(layer)
        kept = self._found((*key, z, x, y))
        if kept is not None:
            return kept, True
        width, height = raster.info.size
        top = level_count(width, height) - 1
        shrink = 1 << max(0, top - z)
        side = SIZE * shrink
        window = Window(x * side, y * side, side, side).intersection(Window(0, 0, width, height))
        if not 0 <= z <= top or x < 0 or y < 0 or window.empty:
            raise InputError(f"the raster has no tile {z}/{x}/{y}", where=layer, hint="load the page again")
        final = raster.ready >= 1.0
        limits = raster.limits()
        values, valid = raster.read(window, shrink)
        encoded = webp(eight_bits(values, limits), valid)
        if final:
            self._keep((*key, z, x, y), encoded)
        return encoded, final

    def _raster(self, layer: str) -> tuple[tuple[str, int, int], DisplayRaster]:
        """Open raster of a layer, as its file is now."""
        path = self._path_of(layer)
        if path is None:
            raise InputError("there is no such layer", where=layer, hint="load the page again")
        try:
            stat = path.stat()
        except OSError as error:
            raise RasterReadError(
                f"the file is gone ({error.strerror})", where=str(path), hint="bring it back, or make it again"
            ) from error
        key = (str(path), stat.st_mtime_ns, stat.st_size)
        with self._lock:
            raster = self._found_open(key)
        if raster is not None:
            return key, raster
        # Opening samples the raster: tiles of others do not wait for it.
        with self._opening:
            with self._lock:
                raster = self._found_open(key)
            if raster is not None:
                return key, raster
            raster = DisplayRaster(path)
            with self._lock:
                old = [other for other in self._open if other[0] == key[0]]
                self._open[key] = raster
                while len(self._open) - len(old) > _OPEN:
                    old.append(next(other for other in self._open if other not in old))
                closing = [self._open.pop(other) for other in old]
        for other in closing:
            # A thread may still read from it.
            threading.Timer(5.0, other.close).start()
        return key, raster

    def _found_open(self, key: tuple[str, int, int]) -> DisplayRaster | None:
        if key in self._open:
            self._open.move_to_end(key)
        return self._open.get(key)

    def _found(self, key: tuple[Any, ...]) -> bytes | None:
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
            return self._kept.get(key)

    def _keep(self, key: tuple[Any, ...], encoded: bytes) -> None:
        with self._lock:
            self._bytes += len(encoded) - len(self._kept.pop(key, b""))
            self._kept[key] = encoded
            while self._bytes > _KEPT:
                self._bytes -= len(self._kept.popitem(last=False)[1])


def webp(grey: ByteArray, valid: ByteArray | None) -> bytes:
    """WebP of a tile; cut tiles at the border are filled to 256 pixels with transparent ones.

    Parameters
    ----------
    grey : uint8 array (rows, cols, bands)
        One band or three.
    valid : uint8 array (rows, cols), optional
        None where all are valid.
    """
    from PIL import Image

    rows, cols = grey.shape[:2]
    rgb = np.broadcast_to(grey, (rows, cols, 3))
    if valid is None and (rows, cols) == (SIZE, SIZE):
        image = Image.fromarray(np.ascontiguousarray(rgb))
    else:
        pixels = np.zeros((SIZE, SIZE, 4), dtype=np.uint8)
        pixels[:rows, :cols, :3] = rgb
        pixels[:rows, :cols, 3] = 255 if valid is None else np.where(valid != 0, 255, 0)
        image = Image.fromarray(pixels)
    stream = BytesIO()
    image.save(stream, format="WEBP", quality=_QUALITY, method=0)
    return stream.getvalue()
