"""When an image was taken, as its file says it."""

from __future__ import annotations

import re

from geomosaic.raster.environment import environment
from geomosaic.raster.info import open_raster
from geomosaic.types import PathLike

_TAGS = (
    (None, "EXIF_DateTimeOriginal"),
    (None, "ACQUISITION_DATE"),
    (None, "ACQUISITION_DATETIME"),
    (None, "acquired"),
    (None, "datetime"),
    (None, "TIFFTAG_DATETIME"),
    (None, "EXIF_DateTime"),
)


def acquired(path: PathLike) -> str | None:
    """Acquisition time as digits, year first, that sort by time; None where the file does not say it.

    Read are, in this order, the acquisition time of satellite images (GDAL's domain IMAGERY), EXIF, `ACQUISITION_DATE`
    and the like, and the date of the TIFF file.
    """
    with environment(), open_raster(path) as dataset:
        found = [dataset.tags(ns="IMAGERY").get("ACQUISITIONDATETIME")]
        found += [dataset.tags(ns=space).get(name) for space, name in _TAGS]
    for text in found:
        digits = re.sub(r"[^0-9]", "", text or "")[:14]
        if len(digits) >= 8:
            return digits.ljust(14, "0")
    return None
