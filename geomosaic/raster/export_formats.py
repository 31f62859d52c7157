"""Formats for viewers: MBTiles, KML super-overlays, georeferenced PDF.

Specification: MBTiles 1.3 (tables `metadata` and `tiles`, rows of tiles counted from the south, XYZ zoom levels).
"""

from __future__ import annotations

import re
import sqlite3
import warnings
import zipfile
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import rasterio
import rasterio.crs
import rasterio.shutil
from affine import Affine
from pyproj import Transformer
from rasterio.enums import Resampling
from rasterio.errors import RasterioError
from rasterio.io import MemoryFile
from rasterio.warp import calculate_default_transform, reproject

from geomosaic.errors import InputError
from geomosaic.geo.grid import Grid
from geomosaic.raster.environment import environment
from geomosaic.raster.files import check_output
from geomosaic.stores.path import to_path
from geomosaic.types import ByteArray, PathLike
from geomosaic.whole_files import under_construction


def write_raster_pdf(
    path: PathLike, grid: Grid, pixels: ByteArray, *, dpi: int, title: str, overwrite: bool = False
) -> Path:
    """Write a picture as a raster GeoPDF: viewport and measure dictionary of ISO 32000, no dates.

    Parameters
    ----------
    path : path
    grid : Grid, of the pixels, in a CRS that is tied to the Earth
    pixels : uint8 array (rows, cols, 3 or 4), red, green, blue; 255 where there is a picture, 0 where the paper shows
    dpi : int, pixels of the page per inch
    title : str
    overwrite : bool

    Raises
    ------
    InputError
        GDAL was built without the driver.
    OutputExistsError, OutputError
    """
    path = to_path(path)
    check_output(path, overwrite=overwrite)
    with environment(), rasterio.Env() as gdal, warnings.catch_warnings():
        if "PDF" not in gdal.drivers():
            raise InputError(
                "this GDAL cannot write PDF",
                where=str(path),
                hint="leave out `driver=PDF`: the page is written then",
            )
        # rasterio multiplies affines in a way that the affine library wants to end.
        warnings.simplefilter("ignore", PendingDeprecationWarning)
        # Tags, since as options of the driver title and creator would become capitals.
        with under_construction(path, failures=(RasterioError,)) as unfinished:
            _translate(
                unfinished, np.moveaxis(pixels, 2, 0),
                {"crs": rasterio.crs.CRS.from_wkt(grid.crs.to_wkt()), "transform": grid.transform},
                {"driver": "PDF", "DPI": dpi, "COMPRESS": "DEFLATE", "PREDICTOR": 2, "GEO_ENCODING": "ISO32000"},
                {"TITLE": title, "CREATOR": "geomosaic", "PRODUCER": "GDAL"},
            )  # fmt: skip
    return path


# Pixels of a tile.
SIDE = 256
_APPLICATION = 0x4D504258  # 'MPBX', as the specification wants


def write_mbtiles(path: Path, pixels: ByteArray, level: int, col: int, row: int, *, title: str) -> None:
    """Write a picture and all zoom levels below it, down to the one on which it is a single tile.

    Parameters
    ----------
    path : Path, made new
    pixels : uint8 array (rows, cols, 4), red, green, blue, opacity, in pixels of web Mercator at the zoom level
    level : int, zoom level of the pixels
    col, row : int, of the first pixel, from the upper left corner of the world
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
    size = 2 * MERCATOR / SIDE / 2**level
    xs, ys = np.array([col, col + width]) * size - MERCATOR, MERCATOR - np.array([row + height, row]) * size
    (west, east), (south, north) = Transformer.from_crs(3857, 4326, always_xy=True).transform(xs, ys)
    return float(west), float(south), float(east), float(north)


# Half the side of the world in web Mercator, metres.
MERCATOR = 20037508.342789244
# The earliest time that ZIP has: the archive does not depend on when it was made.
_DATE = (1980, 1, 1, 0, 0, 0)


def write_web(path: PathLike, grid: Grid, pixels: ByteArray, *, title: str, overwrite: bool = False) -> Path:
    """Write a picture as MBTiles (web Mercator, PNG, all levels) or as a KMZ of tiles (longitude, latitude).

    Parameters
    ----------
    path : path, ends in .mbtiles or .kmz
    grid : Grid, of the pixels
    pixels : uint8 array (rows, cols, 4), red, green, blue, and 255 where there is a picture
    title : str
    overwrite : bool

    Raises
    ------
    OutputExistsError, OutputError
    """
    path = to_path(path)
    check_output(path, overwrite=overwrite)
    target = rasterio.crs.CRS.from_epsg(3857 if path.suffix.lower() == ".mbtiles" else 4326)
    failures = RasterioError, sqlite3.Error, zipfile.BadZipFile
    with under_construction(path, path.suffix.lower(), failures) as unfinished, warnings.catch_warnings():
        # rasterio multiplies affines in a way that the affine library wants to end.
        warnings.simplefilter("ignore", PendingDeprecationWarning)
        warped, affine = _warped(grid, pixels, target)
        if path.suffix.lower() == ".mbtiles":
            level = round(np.log2(2 * MERCATOR / SIDE / affine.a))
            col, row = round((affine.c + MERCATOR) / affine.a), round((MERCATOR - affine.f) / affine.a)
            write_mbtiles(unfinished, np.moveaxis(warped, 0, 2), level, col, row, title=title)
        else:
            profile = {"crs": target, "transform": affine, "alpha": "YES"}
            _translate(unfinished, warped, profile, {"driver": "KMLSUPEROVERLAY", "FORMAT": "PNG"})
            _finish_kmz(unfinished, title)
    return path


def _warped(grid: Grid, pixels: ByteArray, target: rasterio.crs.CRS) -> tuple[ByteArray, Affine]:
    """Bring the pixels to the CRS of the web: cubic, on pixels of about the same size; those of tiles in Mercator."""
    source = rasterio.crs.CRS.from_wkt(grid.crs.to_wkt())
    affine, width, height = calculate_default_transform(source, target, grid.width, grid.height, *grid.bounds)
    if target.to_epsg() == 3857:
        # Pixels of the zoom level above: nothing is lost.
        level = int(np.ceil(np.log2(2 * MERCATOR / SIDE / affine.a) - 1e-9))
        size = 2 * MERCATOR / SIDE / 2**level
        left, top = (np.floor((affine.c + MERCATOR) / size), np.floor((MERCATOR - affine.f) / size))
        stop = affine.c + affine.a * width, affine.f + affine.e * height
        width = int(np.ceil((stop[0] + MERCATOR) / size) - left)
        height = int(np.ceil((MERCATOR - stop[1]) / size) - top)
        affine = Affine(size, 0.0, left * size - MERCATOR, 0.0, -size, MERCATOR - top * size)
    out = np.zeros((4, height, width), dtype=np.uint8)
    reproject(
        np.ascontiguousarray(np.moveaxis(pixels, 2, 0)), out, src_transform=grid.transform, src_crs=source,
        dst_transform=affine, dst_crs=target, resampling=Resampling.cubic, src_alpha=4, dst_alpha=4, tolerance=0.01,
    )  # fmt: skip
    return out, affine


def _translate(
    path: Path, bands: ByteArray, profile: dict[str, Any], options: dict[str, Any], tags: dict[str, str] | None = None
) -> None:
    """Bands (3 or 4, rows, cols) to a file of another driver, by way of a GeoTIFF in memory."""
    count, height, width = bands.shape
    with MemoryFile() as memory:
        with memory.open(
            driver="GTiff", width=width, height=height, count=count, dtype="uint8", photometric="RGB", **profile
        ) as made:
            made.write(bands)
            made.update_tags(**(tags or {}))
        with memory.open() as source:
            try:
                rasterio.shutil.copy(source, path, **options)
            except Exception as error:  # of GDAL, in a class that rasterio keeps to itself
                raise OSError(str(error)) from error


def _finish_kmz(path: Path, title: str) -> None:
    """Write the members of a KMZ again with its title, without the time, in the order of their names, doc.kml first."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    # As an option of the driver it would become capitals.
    heading = f"<name>{escape(title)}</name>".encode()
    members["doc.kml"] = re.sub(rb"<name>.*?</name>|<name/>", lambda _: heading, members["doc.kml"], count=1)
    order = sorted(members, key=lambda name: (name != "doc.kml", name))
    with zipfile.ZipFile(path, "w") as archive:
        for name in order:
            kind = zipfile.ZIP_STORED if name.endswith((".png", ".jpg")) else zipfile.ZIP_DEFLATED
            archive.writestr(zipfile.ZipInfo(name, _DATE), members[name], compress_type=kind)
