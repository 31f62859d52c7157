"""Position, attitude and focal length of a photo from its EXIF and its maker's XMP."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from geomosaic.raster.photo_metadata import PhotoTags

LARGEST = 1e9
"""No tag of a photo is a larger number."""
FULL_FRAME_DIAGONAL = math.hypot(36.0, 24.0)
"""Millimetres: what '35 mm equivalent' focal lengths refer to (CIPA DCG-001)."""
UNITS = {"2": 25.4, "3": 10.0, "4": 1.0}
"""Millimetres of EXIF's FocalPlaneResolutionUnit."""
BELOW = ("1", "0x01", "3", "0x03")
"""EXIF's GPSAltitudeRef of depths: below the sea in version 2; in 3.0 below the ellipsoid (1) or the sea (3)."""
GIMBAL = ("GimbalYawDegree", "GimbalPitchDegree", "GimbalRollDegree")


@dataclass(frozen=True)
class PhotoFacts:
    """Position, attitude and focal length as a photo's tags give them.

    Attributes
    ----------
    position : tuple of float or None
        Longitude, latitude in degrees (WGS 84), altitude in metres as written; NaN where there is no altitude.
    gimbal : tuple of float or None
        Gimbal yaw, pitch, roll in degrees.
    above_start : float or None
        Height above the place of take-off, metres.
    focal : float or None
        Focal length in pixels of the photo.
    focal_from : str
        The tags that it comes from, in words.
    camera : str
        Maker and model.
    turned : bool
        Whether EXIF asks viewers to turn the picture.
    """

    position: tuple[float, float, float] | None
    gimbal: tuple[float, float, float] | None
    above_start: float | None
    focal: float | None
    focal_from: str
    camera: str
    turned: bool


def photo_facts(tags: PhotoTags, size: tuple[int, int]) -> PhotoFacts:
    """Position, attitude and focal length from the tags of a photo.

    Parameters
    ----------
    tags : PhotoTags
    size : tuple of int
        Width and height of the photo in pixels.

    Returns
    -------
    PhotoFacts
        What is damaged counts as missing.
    """
    exif = tags.exif
    yaw, pitch, roll = (_xmp(tags.xmp, name) for name in GIMBAL)
    focal, source = _focal(exif, tags.xmp, size)
    return PhotoFacts(
        _position(exif, tags.xmp),
        None if yaw is None or pitch is None or roll is None else (yaw, pitch, roll),
        _xmp(tags.xmp, "RelativeAltitude"),
        focal,
        source,
        " ".join(exif.get(name, "") for name in ("Make", "Model")).strip(),
        exif.get("Orientation", "1") not in ("", "0", "1"),
    )


def _xmp(xmp: str, name: str) -> float | None:
    """Number of a property of DJI's, written as an attribute or as an element."""
    found = re.search(rf"\bdrone-dji:{name}\s*(?:=\s*[\"']|>)\s*([-+0-9.eE]{{1,40}})\s*[\"'<]", xmp)
    return _number(found[1]) if found else None


def _position(exif: Mapping[str, str], xmp: str) -> tuple[float, float, float] | None:
    lat, lon = _angle(exif, "GPSLatitude", "NS"), _angle(exif, "GPSLongitude", "EW")
    altitude = _rational(exif.get("GPSAltitude", ""))
    if altitude is not None and exif.get("GPSAltitudeRef", "0").strip().lower() in BELOW:
        altitude = -altitude
    # The maker's own position, where it is whole, has more digits than EXIF's degrees, minutes and seconds. Some of
    # their cameras write 'Longtitude'.
    fine = _xmp(xmp, "GpsLatitude")
    east = [value for value in (_xmp(xmp, "GpsLongitude"), _xmp(xmp, "GpsLongtitude")) if value is not None]
    if fine is not None and east:
        lat, lon = fine, east[0]
    absolute = _xmp(xmp, "AbsoluteAltitude")
    altitude = absolute if absolute is not None else altitude
    # (0, 0) is what receivers write before they know their position.
    if lat is None or lon is None or abs(lat) > 90.0 or abs(lon) > 180.0 or (lat == 0.0 and lon == 0.0):
        return None
    return lon, lat, math.nan if altitude is None else altitude


def _angle(exif: Mapping[str, str], name: str, signs: str) -> float | None:
    """Degrees, minutes and seconds, as '(46) (50) (33.9993)'."""
    parts = [_number(text) for text in re.findall(r"\(([^)]{1,40})\)", exif.get(name, ""))]
    side = exif.get(f"{name}Ref", "").strip().upper()[:1]
    if not 1 <= len(parts) <= 3 or None in parts or not side or side not in signs:
        return None
    value = sum((part or 0.0) / 60.0**power for power, part in enumerate(parts))
    return -value if side == signs[1] else value


def _focal(exif: Mapping[str, str], xmp: str, size: tuple[int, int]) -> tuple[float | None, str]:
    """Focal length in pixels of the photo, and where it comes from; the photo may be a reduced copy."""
    full = _number(exif.get("PixelXDimension", "")) or float(size[0])
    shrink = size[0] / full if full >= 1.0 else 1.0
    calibrated = _xmp(xmp, "CalibratedFocalLength")
    if calibrated:
        return calibrated * shrink, "the maker's calibration"
    mm, pitch = _rational(exif.get("FocalLength", "")), _rational(exif.get("FocalPlaneXResolution", ""))
    unit = UNITS.get(exif.get("FocalPlaneResolutionUnit", ""))
    if mm and pitch and unit:
        return mm * pitch / unit * shrink, f"focal length {mm:g} mm and the resolution of the focal plane"
    equivalent = _number(exif.get("FocalLengthIn35mmFilm", ""))
    if equivalent:
        return equivalent * math.hypot(*size) / FULL_FRAME_DIAGONAL, f"{equivalent:g} mm in 35 mm film, rounded"
    return None, ""


def _rational(text: str) -> float | None:
    return _number(text.strip().strip("()"))


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if abs(value) < LARGEST else None
