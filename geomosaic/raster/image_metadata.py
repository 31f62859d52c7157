"""Metadata that images carry: EXIF tags, XMP packets, acquisition times, rational polynomial coefficients."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rasterio
from rasterio.errors import RasterioError

from geomosaic.errors import GeomosaicError, OutputError
from geomosaic.raster.environment import environment, opening
from geomosaic.raster.info import open_raster
from geomosaic.stores.path import to_path
from geomosaic.types import PathLike


@dataclass(frozen=True)
class PhotoTags:
    """Tags as text.

    Attributes
    ----------
    exif : mapping, by EXIF's own names, such as 'GPSLatitude'; as GDAL writes their values
    xmp : str, the packet; empty where there is none
    """

    exif: Mapping[str, str]
    xmp: str


def read_photo_tags(path: PathLike) -> PhotoTags:
    """EXIF and XMP tags of a photo; no pixel is read.

    Parameters
    ----------
    path : path

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


# No tag of a photo is a larger number.
_LARGEST = 1e9


def maker_number(xmp: str, name: str) -> float | None:
    """Number of a property that DJI's cameras write, as an attribute or as an element.

    Parameters
    ----------
    xmp : str
        Packet of a photo.
    name : str
        Of the property, without its namespace.

    Returns
    -------
    float or None
        None where there is none, or it is damaged.
    """
    found = re.search(rf"\bdrone-dji:{name}\s*(?:=\s*[\"']|>)\s*([-+0-9.eE]{{1,40}})\s*[\"'<]", xmp)
    return tag_number(found[1]) if found else None


def tag_number(text: str) -> float | None:
    """Number in the text of a tag; None where it is none.

    Parameters
    ----------
    text : str
    """
    try:
        value = float(text)
    except ValueError:
        return None
    return value if abs(value) < _LARGEST else None


# EXIF's GPSAltitudeRef of depths: below the sea in version 2; in 3.0 below the ellipsoid (1) or the sea (3).
BELOW = ("1", "0x01", "3", "0x03")


def recorded_position(tags: PhotoTags) -> tuple[float, float, float] | None:
    """Longitude, latitude in degrees and height in metres that a photo records, NaN without one; None where none is.

    Parameters
    ----------
    tags : PhotoTags
    """
    exif, xmp = tags.exif, tags.xmp
    lat, lon = _angle(exif, "GPSLatitude", "NS"), _angle(exif, "GPSLongitude", "EW")
    altitude = tag_number(exif.get("GPSAltitude", "").strip().strip("()"))
    if altitude is not None and exif.get("GPSAltitudeRef", "0").strip().lower() in BELOW:
        altitude = -altitude
    # The maker's own position, where it is whole, has more digits than EXIF's degrees, minutes and seconds. Some of
    # their cameras write 'Longtitude'.
    fine = maker_number(xmp, "GpsLatitude")
    both = (maker_number(xmp, name) for name in ("GpsLongitude", "GpsLongtitude"))
    east = [value for value in both if value is not None]
    if fine is not None and east:
        lat, lon = fine, east[0]
    absolute = maker_number(xmp, "AbsoluteAltitude")
    altitude = absolute if absolute is not None else altitude
    if lat is None or lon is None or abs(lat) > 90.0 or abs(lon) > 180.0:
        return None
    return lon, lat, math.nan if altitude is None else altitude


def _angle(exif: Mapping[str, str], name: str, signs: str) -> float | None:
    """Degrees, minutes and seconds, as '(46) (50) (33.9993)'."""
    parts = [tag_number(text) for text in re.findall(r"\(([^)]{1,40})\)", exif.get(name, ""))]
    side = exif.get(f"{name}Ref", "").strip().upper()[:1]
    if not 1 <= len(parts) <= 3 or None in parts or not side or side not in signs:
        return None
    value = sum((part or 0.0) / 60.0**power for power, part in enumerate(parts))
    return -value if side == signs[1] else value


# Tags of the time of acquisition: the first that is there counts. Not TIFF's DateTime and EXIF_DateTime: those are
# times at which the file was written.
_ACQUIRED = ("EXIF_DateTimeOriginal", "EXIF_DateTimeDigitized", "ACQUISITIONDATETIME")
_OFFSETS = {"EXIF_DateTimeOriginal": "EXIF_OffsetTimeOriginal", "EXIF_DateTimeDigitized": "EXIF_OffsetTimeDigitized"}
_FORM = re.compile(r"(\d{4})[:-](\d\d)[:-](\d\d)[ T](\d\d):(\d\d):(\d\d)(?:\.\d+)?(Z|[+-]\d\d:\d\d)?")
# Tags that put images in order of time, the surest first.
_DATES = (
    "EXIF_DateTimeOriginal", "ACQUISITION_DATE", "ACQUISITION_DATETIME", "acquired", "datetime", "TIFFTAG_DATETIME",
    "EXIF_DateTime",
)  # fmt: skip


def acquisition_time(path: PathLike) -> str | None:
    """Time of acquisition of an image.

    Parameters
    ----------
    path : path

    Returns
    -------
    str or None, ISO 8601, with its zone where the file names one; None where the file says nothing or cannot be read
    """
    try:
        with environment(), open_raster(path) as dataset:
            tags = {**dataset.tags(ns="IMAGERY"), **dataset.tags()}
    except (GeomosaicError, RasterioError, OSError):
        return None
    for name in _ACQUIRED:
        found = _FORM.fullmatch(tags.get(name, "").strip())
        if found and found.group(1) != "0000":
            year, month, day, hour, minute, second, zone = found.groups()
            # Without a zone it stays the camera's clock.
            zone = zone or tags.get(_OFFSETS.get(name, ""), "").strip()
            return f"{year}-{month}-{day}T{hour}:{minute}:{second}{zone or ''}"
    return None


def acquisition_digits(path: PathLike) -> str | None:
    """Acquisition time as digits that sort by time.

    Parameters
    ----------
    path : path

    Returns
    -------
    str or None, 14 digits, year first; None where the file does not say it

    Raises
    ------
    RasterReadError
        The file is missing or no raster.
    """
    with environment(), open_raster(path) as dataset:
        # The surest first: satellite images (GDAL's domain IMAGERY), EXIF, `ACQUISITION_DATE` and the like, the TIFF
        # file.
        found = [dataset.tags(ns="IMAGERY").get("ACQUISITIONDATETIME")]
        found += [dataset.tags().get(name) for name in _DATES]
    for text in found:
        digits = re.sub(r"[^0-9]", "", text or "")[:14]
        if len(digits) >= 8:
            return digits.ljust(14, "0")
    return None


# Tags of the percentage of an image that is cloud: GDAL's domain IMAGERY, Sentinel-2, Landsat, STAC.
_CLOUD_COVER = ("CLOUDCOVER", "CLOUD_COVERAGE_ASSESSMENT", "CLOUD_COVER", "eo:cloud_cover")


def recorded_cloud_cover(path: PathLike) -> float | None:
    """Percentage of an image that is cloud, as its metadata tell it.

    Parameters
    ----------
    path : path

    Returns
    -------
    float or None
        None where the file says nothing, or no percentage, such as GDAL's 999 for an unknown one.

    Raises
    ------
    RasterReadError
        The file is missing or no raster.
    """
    with environment(), open_raster(path) as dataset:
        tags = {**dataset.tags(ns="IMAGERY"), **dataset.tags()}
    found = (tag_number(tags.get(name, "")) for name in _CLOUD_COVER)
    return next((value for value in found if value is not None and 0.0 <= value <= 100.0), None)


def read_rpc_tags(path: PathLike) -> dict[str, str]:
    """GDAL's RPC domain of a raster: LINE_OFF, SAMP_NUM_COEFF ... as text.

    That of the raster itself (TIFF tag 50844, NITF extension RPC00B, a PAM file, a VRT), else that of files of known
    names beside it. Image coordinates count from the centre of the first pixel.

    Parameters
    ----------
    path : path

    Returns
    -------
    dict of str to str, empty where there is none

    Raises
    ------
    RasterReadError
        The file is missing or no raster.
    """
    with environment(), open_raster(path) as dataset:
        found, driver = _tags(dataset), dataset.driver
    # GDAL prefers files of known names beside the raster to a tag: opened again without a list of the folder, it
    # sees the tag alone.
    if not found or pam_has_rpc(path):
        return found
    with (
        suppress(RasterioError, OSError),
        environment(GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR"),
        opening(),
        rasterio.open(str(path), driver=driver) as dataset,
    ):
        return _tags(dataset) or found
    return found


def pam_has_rpc(path: PathLike) -> bool:
    """Whether the PAM file beside a raster (.aux.xml) holds an RPC, which then counts for more than a tag.

    Parameters
    ----------
    path : path, of the raster
    """
    notes = to_path(path).with_name(f"{to_path(path).name}.aux.xml")
    with suppress(OSError):
        return b'"RPC"' in notes.read_bytes()
    return False


def _tags(dataset: Any) -> dict[str, str]:
    return {str(key): str(value) for key, value in dataset.tags(ns="RPC").items()}


def write_rpc_tags(path: PathLike, tags: Mapping[str, str]) -> None:
    """Change of GDAL's RPC domain in an existing TIFF (tag 50844), in place; the pixels are not touched.

    Parameters
    ----------
    path : path
    tags : mapping of str to str, as `read_rpc_tags` gives them

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
