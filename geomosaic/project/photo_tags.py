"""Position, attitude, focal length and time of photos from EXIF and their makers' XMP."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from geomosaic.raster.image_metadata import PhotoTags, maker_number, recorded_position, tag_number

# Millimetres: what '35 mm equivalent' focal lengths refer to (CIPA DCG-001).
FULL_FRAME_DIAGONAL = math.hypot(36.0, 24.0)
# Millimetres of EXIF's FocalPlaneResolutionUnit.
UNITS = {"2": 25.4, "3": 10.0, "4": 1.0}
# EXIF's GPSAltitudeRef of heights above and below the sea in version 3.0; before, it told nothing but the sign.
ABOVE_SEA = ("2", "0x02", "3", "0x03")
GIMBAL = ("GimbalYawDegree", "GimbalPitchDegree", "GimbalRollDegree")
# Of a position by differential phases, in metres; the flag of a solution whose ambiguities are whole numbers.
RTK_SIGMAS = ("RtkStdLon", "RtkStdLat", "RtkStdHgt")
RTK_FIXED = 50.0
# Of focal lengths by their source, as shares: makers calibrate a type of camera and no single one, the size of a sensor
# is rounded, and equivalents are rounded to millimetres besides.
CALIBRATED, BY_PITCH, BY_EQUIVALENT = 0.01, 0.02, 0.04


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
    focal_sigma : float
        Standard deviation of the focal length, as a share of it.
    serial : str
        Serial number of the camera.
    time : str
        Of exposure, as EXIF writes it; digits sort by time.
    sigma : float or None
        Standard deviation of the position in metres, as the receiver estimates it.
    heights : str
        Vertical datum of the altitude as the tags tell it: 'ellipsoidal', 'egm96', or '' where they do not.
    no_place : bool
        Whether the position is 0, 0: what receivers write before they know theirs.
    """

    position: tuple[float, float, float] | None
    gimbal: tuple[float, float, float] | None
    above_start: float | None
    focal: float | None
    focal_from: str
    camera: str
    turned: bool
    focal_sigma: float = BY_EQUIVALENT
    serial: str = ""
    time: str = ""
    sigma: float | None = None
    heights: str = ""
    no_place: bool = False


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
    yaw, pitch, roll = (maker_number(tags.xmp, name) for name in GIMBAL)
    focal, source, share = _focal(exif, tags.xmp, size)
    position = recorded_position(tags)
    nowhere = position is not None and position[:2] == (0.0, 0.0)
    rtk, sigma = _accuracy(exif, tags.xmp)
    sea = exif.get("GPSAltitudeRef", "").strip().lower() in ABOVE_SEA
    return PhotoFacts(
        None if nowhere else position,
        None if yaw is None or pitch is None or roll is None else (yaw, pitch, roll),
        maker_number(tags.xmp, "RelativeAltitude"),
        focal,
        source,
        _camera_name(exif.get("Make", ""), exif.get("Model", "")),
        exif.get("Orientation", "1") not in ("", "0", "1"),
        share,
        exif.get("BodySerialNumber", "") or exif.get("CameraSerialNumber", ""),
        exif.get("DateTimeOriginal", "") + exif.get("SubSecTime_Original", exif.get("SubSecTimeOriginal", "")),
        sigma,
        "ellipsoidal" if rtk else "egm96" if sea else "",
        nowhere,
    )


def _camera_name(make: str, model: str) -> str:
    """Maker and model; many makers begin the model with their name."""
    return model if model.lower().startswith(make.lower()) else f"{make} {model}".strip()


def _accuracy(exif: Mapping[str, str], xmp: str) -> tuple[bool, float | None]:
    """Whether a position is one of RTK, and its standard deviation in metres where the receiver tells it."""
    given = [maker_number(xmp, name) for name in RTK_SIGMAS]
    known = [value for value in given if value is not None and value > 0.0]
    if maker_number(xmp, "RtkFlag") == RTK_FIXED and len(known) == len(RTK_SIGMAS):
        return True, max(known)
    error = _rational(exif.get("GPSHPositioningError", ""))
    return False, error if error is not None and error > 0.0 else None


def _focal(exif: Mapping[str, str], xmp: str, size: tuple[int, int]) -> tuple[float | None, str, float]:
    """Focal length in pixels of the photo, where it comes from, and its standard deviation as a share of it."""
    # The photo may be a reduced copy, or stored turned: longer sides are compared.
    sides = (tag_number(exif.get(f"Pixel{axis}Dimension", "")) for axis in "XY")
    full = max((side for side in sides if side is not None), default=0.0)
    shrink = max(size) / full if full >= 1.0 else 1.0
    calibrated = maker_number(xmp, "CalibratedFocalLength")
    if calibrated:
        return calibrated * shrink, "the maker's calibration", CALIBRATED
    mm, pitch = _rational(exif.get("FocalLength", "")), _rational(exif.get("FocalPlaneXResolution", ""))
    unit = UNITS.get(exif.get("FocalPlaneResolutionUnit", ""))
    if mm and pitch and unit:
        text = f"focal length {mm:g} mm and the resolution of the focal plane"
        return mm * pitch / unit * shrink, text, BY_PITCH
    equivalent = tag_number(exif.get("FocalLengthIn35mmFilm", ""))
    if equivalent:
        text = f"{equivalent:g} mm in 35 mm film, rounded"
        return equivalent * math.hypot(*size) / FULL_FRAME_DIAGONAL, text, BY_EQUIVALENT
    return None, "", math.inf


def _rational(text: str) -> float | None:
    return tag_number(text.strip().strip("()"))
