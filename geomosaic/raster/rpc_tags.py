"""Rational polynomial coefficients that a raster carries: GDAL's RPC domain, read and written as text."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import rasterio
from rasterio.errors import RasterioError

from geomosaic.errors import OutputError
from geomosaic.raster.environment import environment, opening
from geomosaic.raster.info import open_raster
from geomosaic.types import PathLike


def read_rpc_tags(path: PathLike) -> dict[str, str]:
    """GDAL's RPC domain of a raster: LINE_OFF, SAMP_NUM_COEFF ... as text.

    It is what the raster itself carries: the TIFF tag 50844, the NITF extension RPC00B, a PAM file (.aux.xml), a VRT.
    Where that is nothing, it is what GDAL finds in files of known names beside the raster; GDAL alone would let these
    hide a tag that says otherwise. Whatever the source, image coordinates count from the centre of the first pixel.

    Parameters
    ----------
    path : path

    Returns
    -------
    dict of str to str
        Empty where there is none.

    Raises
    ------
    RasterReadError
        The file is missing or no raster.
    """
    with environment(), open_raster(path) as dataset:
        told, driver = _tags(dataset), dataset.driver
    if not told or pam_has_rpc(path):
        return told
    with (
        suppress(RasterioError, OSError),
        environment(GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR"),
        opening(),
        rasterio.open(str(path), driver=driver) as dataset,
    ):
        return _tags(dataset) or told
    return told


def pam_has_rpc(path: PathLike) -> bool:
    """Whether GDAL's notes beside a raster (.aux.xml) hold an RPC, which then counts for more than a tag.

    Parameters
    ----------
    path : path
        Of the raster.

    Returns
    -------
    bool
    """
    notes = Path(path).with_name(f"{Path(path).name}.aux.xml")
    with suppress(OSError):
        return b'"RPC"' in notes.read_bytes()
    return False


def _tags(dataset: Any) -> dict[str, str]:
    return {str(key): str(value) for key, value in dataset.tags(ns="RPC").items()}


def write_rpc_tags(path: PathLike, tags: Mapping[str, str]) -> None:
    """Write of GDAL's RPC domain into an existing TIFF (tag 50844), in place; the pixels are not touched.

    Parameters
    ----------
    path : path
    tags : mapping of str to str
        As `read_rpc_tags` gives them.

    Raises
    ------
    OutputError
        The file is no TIFF that can be changed.
    """
    try:
        with environment(), opening(), rasterio.open(str(Path(path)), "r+", driver="GTiff") as dataset:
            dataset.update_tags(ns="RPC", **tags)
    except (RasterioError, OSError) as error:
        raise OutputError(
            f"the RPC cannot be written into this file ({error})",
            where=str(path),
            hint="give an existing GeoTIFF that may be changed, or write an _RPC.TXT file beside the image",
        ) from error
