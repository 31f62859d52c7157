"""Pixels as a georeferenced PDF, written by GDAL: one page that is filled by one picture."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import rasterio
import rasterio.crs
import rasterio.shutil
from rasterio.errors import RasterioError
from rasterio.io import MemoryFile

from geomosaic.errors import InputError
from geomosaic.geo.grid import Grid
from geomosaic.raster.environment import environment
from geomosaic.raster.output_files import check_output
from geomosaic.types import ByteArray, PathLike
from geomosaic.whole_files import under_construction


def write_raster_pdf(
    path: PathLike, grid: Grid, pixels: ByteArray, *, dpi: int, title: str, overwrite: bool = False
) -> Path:
    """Write a picture as a raster GeoPDF: viewport and measure dictionary of ISO 32000, no dates.

    Parameters
    ----------
    path : path
    grid : Grid
        Of the pixels, in a CRS that is tied to the Earth.
    pixels : uint8 array (rows, cols, 3 or 4)
        Red, green, blue; 255 where there is a picture, 0 where the paper shows.
    dpi : int
        Pixels of the page per inch.
    title : str
    overwrite : bool

    Raises
    ------
    InputError
        GDAL was built without the driver.
    OutputExistsError, OutputError
    """
    path = Path(path)
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
        bands = np.moveaxis(pixels, 2, 0)
        crs = rasterio.crs.CRS.from_wkt(grid.crs.to_wkt())
        with under_construction(path, failures=(RasterioError,)) as unfinished, MemoryFile() as memory:
            with memory.open(
                driver="GTiff", width=grid.width, height=grid.height, count=len(bands), dtype="uint8", crs=crs,
                transform=grid.transform, photometric="RGB",
            ) as made:  # fmt: skip
                made.write(bands)
                # As options they would become capitals.
                made.update_tags(TITLE=title, CREATOR="geomosaic", PRODUCER="GDAL")
            with memory.open() as source:
                try:
                    rasterio.shutil.copy(
                        source, unfinished, driver="PDF", DPI=dpi, COMPRESS="DEFLATE", PREDICTOR=2,
                        GEO_ENCODING="ISO32000",
                    )  # fmt: skip
                except Exception as error:  # rasterio's copy raises GDAL's errors in a class that is private
                    raise OSError(str(error)) from error
    return path
