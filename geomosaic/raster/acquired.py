"""When an image was taken, as its file says."""

from __future__ import annotations

import re

from rasterio.errors import RasterioError

from geomosaic.errors import GeomosaicError
from geomosaic.raster.environment import environment
from geomosaic.raster.info import open_raster
from geomosaic.types import PathLike

TAGS = ("EXIF_DateTimeOriginal", "EXIF_DateTimeDigitized", "ACQUISITIONDATETIME")
"""The first that is there counts. Not TIFF's DateTime and EXIF_DateTime: those tell when the file was written."""
_OFFSETS = {"EXIF_DateTimeOriginal": "EXIF_OffsetTimeOriginal", "EXIF_DateTimeDigitized": "EXIF_OffsetTimeDigitized"}
_FORM = re.compile(r"(\d{4})[:-](\d\d)[:-](\d\d)[ T](\d\d):(\d\d):(\d\d)(?:\.\d+)?(Z|[+-]\d\d:\d\d)?")


def acquired(path: PathLike) -> str | None:
    """Time of acquisition in ISO 8601, with its zone where the file names one; None where the file says nothing.

    Without a zone it is the camera's clock: nothing is added that the file does not say.
    """
    try:
        with environment(), open_raster(path) as dataset:
            tags = {**dataset.tags(ns="IMAGERY"), **dataset.tags()}
    except (GeomosaicError, RasterioError, OSError):
        return None
    for name in TAGS:
        found = _FORM.fullmatch(tags.get(name, "").strip())
        if found and found.group(1) != "0000":
            year, month, day, hour, minute, second, zone = found.groups()
            zone = zone or tags.get(_OFFSETS.get(name, ""), "").strip()
            return f"{year}-{month}-{day}T{hour}:{minute}:{second}{zone or ''}"
    return None
