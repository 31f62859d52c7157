"""Maps for the web and for globes: MBTiles and KML super-overlays, through GDAL's drivers."""

from __future__ import annotations

import sqlite3
import warnings
import zipfile
from pathlib import Path

import numpy as np
import rasterio
import rasterio.crs
import rasterio.shutil
from affine import Affine
from rasterio.enums import Resampling
from rasterio.io import MemoryFile
from rasterio.warp import calculate_default_transform, reproject

from geomosaic.errors import OutputError
from geomosaic.geo.grid import Grid
from geomosaic.raster.output import check_output, partial, remove, sync
from geomosaic.types import ByteArray, PathLike

MERCATOR, SIDE = 20037508.342789244, 256
"""Half the side of the world in web Mercator, metres, and the pixels of a tile."""
FORMATS = {".mbtiles": "MBTiles", ".kmz": "KMLSUPEROVERLAY"}
_DATE = (1980, 1, 1, 0, 0, 0)


def write_web(path: PathLike, grid: Grid, pixels: ByteArray, *, title: str, overwrite: bool = False) -> Path:
    """Write a picture as MBTiles (web Mercator, PNG, all levels) or as a KMZ of tiles (longitude, latitude).

    Parameters
    ----------
    path : path
        Ends in .mbtiles or .kmz.
    grid : Grid
        Of the pixels.
    pixels : uint8 array (rows, cols, 4)
        Red, green, blue, and 255 where there is a picture.
    title : str
    overwrite : bool

    Raises
    ------
    OutputExistsError, OutputError
    """
    path = Path(path)
    check_output(path, overwrite=overwrite)
    driver = FORMATS[path.suffix.lower()]
    target = rasterio.crs.CRS.from_epsg(3857 if driver == "MBTiles" else 4326)
    unfinished: Path | None = None
    try:
        # The drivers look at the end of the name, and that of KMZ takes the first .kmz in it for the archive.
        unfinished = partial(path.resolve().with_suffix(""), path.suffix.lower())
        with MemoryFile() as memory, warnings.catch_warnings():
            # rasterio multiplies affines in a way that the affine library wants to end.
            warnings.simplefilter("ignore", PendingDeprecationWarning)
            _warped(memory, grid, pixels, target)
            with memory.open() as source:
                if driver == "MBTiles":
                    rasterio.shutil.copy(
                        source, unfinished, driver=driver, NAME=title, TYPE="overlay", TILE_FORMAT="PNG",
                        DESCRIPTION=title, ZOOM_LEVEL_STRATEGY="UPPER", RESAMPLING="CUBIC",
                    )  # fmt: skip
                else:
                    rasterio.shutil.copy(source, unfinished, driver=driver, NAME=title, FORMAT="PNG")
        if driver == "MBTiles":
            _pyramid(unfinished)
        else:
            _undated(unfinished)
        sync(unfinished)
        unfinished.replace(path)
        sync(path.parent)
    except (OSError, rasterio.errors.RasterioError, sqlite3.Error) as error:
        raise OutputError(f"writing failed ({error})", where=str(path), mend="check the space on the disk") from error
    finally:
        if unfinished is not None:
            remove(unfinished)
    return path


def _warped(memory: MemoryFile, grid: Grid, pixels: ByteArray, target: rasterio.crs.CRS) -> None:
    """Bring the pixels to the CRS of the web: cubic, on pixels of about the same size; those of tiles in Mercator."""
    source = rasterio.crs.CRS.from_wkt(grid.crs.to_wkt())
    affine, width, height = calculate_default_transform(source, target, grid.width, grid.height, *grid.bounds)
    if target.to_epsg() == 3857:
        # Pixels of the zoom level above: nothing is lost, and GDAL copies them as they are.
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
    with memory.open(
        driver="GTiff", width=width, height=height, count=4, dtype="uint8", crs=target, transform=affine,
        photometric="RGB", alpha="YES",
    ) as made:  # fmt: skip
        made.write(out)


def _pyramid(path: Path) -> None:
    """Add the levels below, down to the one on which the map is a single tile."""
    with rasterio.open(path, "r+") as made:
        factors: list[int] = []
        while max(made.width, made.height) / 2 ** len(factors) > SIDE:
            factors.append(2 ** (len(factors) + 1))
        if factors:
            made.build_overviews(factors, Resampling.average)


def _undated(path: Path) -> None:
    """Write the members of a KMZ again without the time, in the order of their names, doc.kml first."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    order = sorted(members, key=lambda name: (name != "doc.kml", name))
    with zipfile.ZipFile(path, "w") as archive:
        for name in order:
            kind = zipfile.ZIP_STORED if name.endswith((".png", ".jpg")) else zipfile.ZIP_DEFLATED
            archive.writestr(zipfile.ZipInfo(name, _DATE), members[name], compress_type=kind)
