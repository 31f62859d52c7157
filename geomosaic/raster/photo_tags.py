"""What a camera wrote into a photo: EXIF tags, and the XMP packet where makers keep the attitude."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from geomosaic.raster.environment import environment
from geomosaic.raster.info import open_raster
from geomosaic.types import PathLike


@dataclass(frozen=True)
class PhotoTags:
    """Tags as text.

    Attributes
    ----------
    exif : mapping
        By EXIF's own names, such as 'GPSLatitude'; as GDAL writes their values.
    xmp : str
        The packet; empty where there is none.
    """

    exif: Mapping[str, str]
    xmp: str


def read_photo_tags(path: PathLike) -> PhotoTags:
    """Read the tags of a photo; no pixel is read.

    Raises
    ------
    RasterReadError
        The file is missing or no raster.
    """
    with environment(), open_raster(path) as dataset:
        tags = {**dataset.tags(ns="EXIF"), **dataset.tags()}
        xmp = dataset.tags(ns="xml:XMP")
    exif = {key.removeprefix("EXIF_"): str(value).strip() for key, value in tags.items() if key.startswith("EXIF_")}
    return PhotoTags(exif, str(xmp.get("xml:XMP", "")))
