"""Rational polynomial coefficients that a raster carries: GDAL's RPC domain, read and written as text."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import rasterio
from rasterio.errors import RasterioError

from geomosaic.errors import OutputError
from geomosaic.raster.environment import environment
from geomosaic.raster.info import open_raster
from geomosaic.types import PathLike


def read_rpc_tags(path: PathLike) -> dict[str, str]:
    """Read GDAL's RPC domain of a raster: LINE_OFF, SAMP_NUM_COEFF ... as text; empty where there is none.

    GDAL fills it from the TIFF tag 50844, the NITF extension RPC00B, a PAM file (.aux.xml), a VRT, or files of known
    names beside the raster. Whatever the source, it counts image coordinates from the centre of the first pixel.

    Raises
    ------
    RasterReadError
        The file is missing or no raster.
    """
    with environment(), open_raster(path) as dataset:
        return {str(key): str(value) for key, value in dataset.tags(ns="RPC").items()}


def write_rpc_tags(path: PathLike, tags: Mapping[str, str]) -> None:
    """Write GDAL's RPC domain into an existing TIFF (tag 50844), in place; the pixels are not touched.

    Raises
    ------
    OutputError
        The file is no TIFF that can be changed.
    """
    try:
        with environment(), rasterio.open(str(Path(path)), "r+", driver="GTiff") as dataset:
            dataset.update_tags(ns="RPC", **tags)
    except (RasterioError, OSError) as error:
        raise OutputError(
            f"the RPC cannot be written into this file ({error})",
            where=str(path),
            mend="give an existing GeoTIFF that may be changed, or write an _RPC.TXT file beside the image",
        ) from error
