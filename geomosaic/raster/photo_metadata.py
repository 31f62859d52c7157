"""Photo metadata: EXIF tags, XMP packets, acquisition times."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from rasterio.errors import RasterioError

from geomosaic.errors import GeomosaicError
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
    """EXIF and XMP tags of a photo; no pixel is read.

    Parameters
    ----------
    path : path

    Returns
    -------
    PhotoTags

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


TAGS = ("EXIF_DateTimeOriginal", "EXIF_DateTimeDigitized", "ACQUISITIONDATETIME")
"""The first that is there counts. Not TIFF's DateTime and EXIF_DateTime: those tell when the file was written."""
_OFFSETS = {"EXIF_DateTimeOriginal": "EXIF_OffsetTimeOriginal", "EXIF_DateTimeDigitized": "EXIF_OffsetTimeDigitized"}
_FORM = re.compile(r"(\d{4})[:-](\d\d)[:-](\d\d)[ T](\d\d):(\d\d):(\d\d)(?:\.\d+)?(Z|[+-]\d\d:\d\d)?")


_DATES = (
    "EXIF_DateTimeOriginal", "ACQUISITION_DATE", "ACQUISITION_DATETIME", "acquired", "datetime", "TIFFTAG_DATETIME",
    "EXIF_DateTime",
)  # fmt: skip
"""Tags that put images in order of time, the surest first."""


def acquired(path: PathLike) -> str | None:
    """Time of acquisition of an image.

    Without a zone it is the camera's clock: nothing is added that the file does not say.

    Parameters
    ----------
    path : path

    Returns
    -------
    str or None
        ISO 8601, with its zone where the file names one; None where the file says nothing or cannot be read.
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


def dated(path: PathLike) -> str | None:
    """Acquisition time as digits that sort by time.

    Read are, in this order, the acquisition time of satellite images (GDAL's domain IMAGERY), EXIF, `ACQUISITION_DATE`
    and the like, and the date of the TIFF file.

    Parameters
    ----------
    path : path

    Returns
    -------
    str or None
        14 digits, year first; None where the file does not say it.

    Raises
    ------
    RasterReadError
        The file is missing or no raster.
    """
    with environment(), open_raster(path) as dataset:
        found = [dataset.tags(ns="IMAGERY").get("ACQUISITIONDATETIME")]
        found += [dataset.tags().get(name) for name in _DATES]
    for text in found:
        digits = re.sub(r"[^0-9]", "", text or "")[:14]
        if len(digits) >= 8:
            return digits.ljust(14, "0")
    return None
