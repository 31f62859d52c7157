"""MBTiles written row by row: every tile is there, or an error is raised; GDAL leaves an empty file on a full disk.

Specification: MBTiles 1.3 (tables `metadata` and `tiles`, rows of tiles counted from the south, XYZ zoom levels).
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import numpy as np
from pyproj import Transformer

from geomosaic.types import ByteArray

SIDE = 256
"""Pixels of a tile."""
_APPLICATION = 0x4D504258  # 'MPBX', as the specification wants


def write_mbtiles(path: Path, pixels: ByteArray, level: int, col: int, row: int, *, title: str) -> None:
    """Write a picture and all zoom levels below it, down to the one on which it is a single tile.

    Parameters
    ----------
    path : Path
        Made new.
    pixels : uint8 array (rows, cols, 4)
        Red, green, blue, opacity, in pixels of web Mercator at the zoom level.
    level : int
        Zoom level of the pixels.
    col, row : int
        Of the first pixel, from the upper left corner of the world.
    title : str

    Raises
    ------
    sqlite3.Error, OSError
    """
    base = sqlite3.connect(path)
    try:
        base.executescript(
            f"PRAGMA application_id = {_APPLICATION}; PRAGMA journal_mode = MEMORY;"
            "CREATE TABLE metadata (name TEXT, value TEXT);"
            "CREATE TABLE tiles (zoom_level INTEGER, tile_column INTEGER, tile_row INTEGER, tile_data BLOB);"
        )
        box = _degrees(level, col, row, pixels.shape[1], pixels.shape[0])
        top = level
        while True:
            pixels, col, row = _to_tiles(pixels, col, row)
            rows = _tiles(pixels, level, col // SIDE, row // SIDE)
            base.executemany("INSERT INTO tiles VALUES (?, ?, ?, ?)", rows)
            if max(pixels.shape[:2]) == SIDE or level == 0:
                break
            pixels, col, row, level = _halved(pixels), col // 2, row // 2, level - 1
        facts = {
            "name": title, "type": "overlay", "version": "1.3", "description": title, "format": "png",
            "bounds": ",".join(f"{v:.7f}" for v in box), "minzoom": str(level), "maxzoom": str(top),
        }  # fmt: skip
        base.executemany("INSERT INTO metadata VALUES (?, ?)", list(facts.items()))
        base.execute("CREATE UNIQUE INDEX tile_index ON tiles (zoom_level, tile_column, tile_row)")
        base.commit()
    finally:
        base.close()


def _to_tiles(pixels: ByteArray, col: int, row: int) -> tuple[ByteArray, int, int]:
    """Add empty pixels around, up to whole tiles."""
    height, width = pixels.shape[:2]
    before = row % SIDE, col % SIDE
    after = -(row + height) % SIDE, -(col + width) % SIDE
    padded: ByteArray = np.pad(pixels, ((before[0], after[0]), (before[1], after[1]), (0, 0)))
    return padded, col - before[1], row - before[0]


def _tiles(pixels: ByteArray, level: int, left: int, top: int) -> Iterator[tuple[int, int, int, bytes]]:
    """Rows of the table; tiles without a picture are left out."""
    from PIL import Image

    for i in range(pixels.shape[0] // SIDE):
        for j in range(pixels.shape[1] // SIDE):
            tile = pixels[i * SIDE : (i + 1) * SIDE, j * SIDE : (j + 1) * SIDE]
            if tile[..., 3].any():
                file = BytesIO()
                Image.fromarray(np.ascontiguousarray(tile)).save(file, format="PNG")
                yield level, left + j, 2**level - 1 - (top + i), file.getvalue()


def _halved(pixels: ByteArray) -> ByteArray:
    """Means of two by two pixels, colours weighted by opacity."""
    rows, cols = pixels.shape[:2]
    blocks = pixels.reshape(rows // 2, 2, cols // 2, 2, 4)
    weight = blocks[..., 3].sum(axis=(1, 3), dtype=np.uint32)
    out = np.empty((rows // 2, cols // 2, 4), dtype=np.uint8)
    for band in range(3):
        total = (blocks[..., band].astype(np.uint32) * blocks[..., 3]).sum(axis=(1, 3), dtype=np.uint32)
        out[..., band] = (total + weight // 2) // np.maximum(weight, 1)
    out[..., 3] = (weight + 2) // 4
    return out


def _degrees(level: int, col: int, row: int, width: int, height: int) -> tuple[float, float, float, float]:
    """West, south, east, north of pixels of a level."""
    half = 20037508.342789244
    size = 2 * half / SIDE / 2**level
    xs, ys = np.array([col, col + width]) * size - half, half - np.array([row + height, row]) * size
    (west, east), (south, north) = Transformer.from_crs(3857, 4326, always_xy=True).transform(xs, ys)
    return float(west), float(south), float(east), float(north)
