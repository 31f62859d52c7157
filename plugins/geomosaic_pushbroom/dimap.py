"""DIMAP 1.1 of SPOT 1 to 5, level 1A: the METADATA.DIM of a scene."""

from __future__ import annotations

from xml.etree.ElementTree import Element

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import FloatArray
from geomosaic_pushbroom.look_angles import LookDirections, choose_band
from geomosaic_pushbroom.orbit import Orbit, require_cover, samples_in_order
from geomosaic_pushbroom.paths import AnglePath
from geomosaic_pushbroom.reported import (
    GYROSCOPES,
    STARS,
    SceneMetadata,
    children,
    each,
    find,
    number,
    since_times,
    text,
    utc_time,
)

_ANGLES = ("PITCH", "ROLL", "YAW")
_STRIP = ".//Data_Strip"


def read_spot(root: Element, where: str, band: str | None = None) -> SceneMetadata:
    """Metadata of a SPOT 1 to 5 scene, level 1A.

    Parameters
    ----------
    root : Element
        Of the document.
    where : str
        Named in errors.
    band : str, optional
        BAND_INDEX whose look angles are taken; needed where those of the bands differ by more than a tenth of a pixel.

    Returns
    -------
    SceneMetadata

    Raises
    ------
    InputError
        Something is missing or wrong; names it.

    Notes
    -----
    DIMAP counts lines, columns and detectors from 1 at the pixel's centre: line i is row i − 0.5 here.
    """
    level = _optional(root, ".//Data_Processing/PROCESSING_LEVEL")
    if level and level not in ("1A", "0"):
        raise InputError(
            f"this scene is of level {level}: it was resampled, and its rows are no scan lines any more",
            where=where,
            hint="use the level 1A scene, or the sensor 'planar' with control points",
        )
    size = (int(number(root, ".//Raster_Dimensions/NCOLS", where)), int(number(root, ".//NROWS", where)))
    stamp = find(root, f"{_STRIP}/Sensor_Configuration/Time_Stamp", where)
    centre = utc_time(text(stamp, "SCENE_CENTER_TIME", where), where)
    period = number(stamp, "LINE_PERIOD", where)
    orbit = _orbit(root, centre, where)
    stars, times, angles = _attitude(root, centre, where)
    middle = number(stamp, "SCENE_CENTER_LINE", where) - 0.5
    require_cover(times, size[1], middle, period, where)
    look, notes = _look(root, band, where)
    source = find(root, ".//Scene_Source", where)
    words = [text(source, name, where) for name in ("MISSION", "MISSION_INDEX", "INSTRUMENT", "INSTRUMENT_INDEX")]
    title = f"{words[0]} {words[1]} {words[2]} {words[3]}, {text(source, 'IMAGING_DATE', where)}"
    path = AnglePath(orbit, times, angles)
    return SceneMetadata(title, path, look, period, middle, size, STARS if stars else GYROSCOPES, notes)


def _optional(element: Element, path: str) -> str:
    found = element.find(path)
    return "" if found is None else (found.text or "").strip()


def _orbit(root: Element, centre: tuple[int, float], where: str) -> Orbit:
    points = list(each(root, f"{_STRIP}/Ephemeris/Points/Point"))
    times = since_times([text(point, "TIME", where) for point in points], where, centre)
    xyz = [[[number(point, f"{part}/{axis}", where) for axis in "XYZ"] for point in points] for part in _PARTS]
    return Orbit.through(times, np.array(xyz[0]).reshape(-1, 3), np.array(xyz[1]).reshape(-1, 3), where)


_PARTS = ("Location", "Velocity")


def _attitude(root: Element, centre: tuple[int, float], where: str) -> tuple[bool, FloatArray, FloatArray]:
    """Whether stars were used, times (K,) and pitch, roll, yaw (K, 3) in radians.

    SPOT 5 has corrected angles. SPOT 1 to 4 have angular speeds and angles of their own at the ends: the speeds are
    integrated by the trapezoidal rule, from the first angle.
    """
    whole = find(root, f"{_STRIP}/Satellite_Attitudes", where)
    corrected = whole.find("Corrected_Attitudes")
    if corrected is not None and corrected.find(".//Angles") is not None:
        times, angles = _table(corrected, ".//Angles", centre, where)
        return _optional(corrected, "STAR_TRACKER_USED") == "Y", times, angles
    times, speeds = _table(whole, ".//Angular_Speeds_List/Angular_Speeds", centre, where)
    starts, known = _table(whole, ".//Angles_List/Angles", centre, where)
    steps = np.diff(times)[:, None] * 0.5 * (speeds[1:] + speeds[:-1])
    angles = np.vstack([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    # A speed holds for the time about its moment, so one may reach half a step beyond it: the first angle lies there.
    at_start = np.array([np.interp(starts[0], times, column) for column in angles.T])
    return False, times, angles + known[0] - at_start


def _table(element: Element, path: str, centre: tuple[int, float], where: str) -> tuple[FloatArray, FloatArray]:
    """Times and three angles or speeds, those marked out of range left out."""
    rows = [row for row in each(element, path) if _optional(row, "OUT_OF_RANGE") != "Y"]
    times = since_times([text(row, "TIME", where) for row in rows], where, centre)
    values = np.array([[number(row, name, where) for name in _ANGLES] for row in rows]).reshape(-1, 3)
    return samples_in_order(times, values, f"the attitude list {path.removeprefix('.//')}", where)


def _look(root: Element, band: str | None, where: str) -> tuple[LookDirections, tuple[str, ...]]:
    """Look directions, u = (−tan ψy, tan ψx, −1), of the band asked for or of all where they are the same."""
    looks: dict[str, LookDirections] = {}
    for part in each(root, ".//Instrument_Look_Angles_List/Instrument_Look_Angles"):
        detector, psi_x, psi_y = children(
            part, "Look_Angles_List/Look_Angles", ("DETECTOR_ID", "PSI_X", "PSI_Y"), where
        ).T
        looks[text(part, "BAND_INDEX", where)] = LookDirections.of(detector - 0.5, -psi_y, psi_x, where, angular=True)
    if not looks:
        find(root, ".//Instrument_Look_Angles_List/Instrument_Look_Angles", where)
    return choose_band(looks, band, where)
