"""Metadata of SPOT 1 to 5 scenes: DIMAP 1.1 (METADATA.DIM), and OSSIM keyword lists (.geom) of SPOT 5."""

from __future__ import annotations

import re
from xml.etree.ElementTree import Element

import numpy as np

from geomosaic.errors import InputError
from geomosaic.sensor.inputs import finite_numbers
from geomosaic.types import FloatArray
from geomosaic_pushbroom.paths import AnglePath, Orbit, require_cover, samples_in_order
from geomosaic_pushbroom.pose import LookDirections, choose_band
from geomosaic_pushbroom.scene_metadata import (
    GYROSCOPES,
    STARS,
    SceneMetadata,
    children,
    find,
    number,
    since_times,
    text,
    utc_time,
)

_ANGLES = ("PITCH", "ROLL", "YAW")
_STRIP = ".//Data_Strip"
BY_POINTS = (
    "take its RPC with the sensor 'rpc' if it has one, or place it by control points alone: metadata = 'none', "
    "flying_height in metres (891000 of Formosat-2), and a table of 6 points or more in `control`"
)


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

    Raises
    ------
    InputError
        Something is missing or wrong; names it.

    Notes
    -----
    DIMAP counts lines, columns and detectors from 1 at the pixel's centre: line i is row i − 0.5 here.
    """
    source = find(root, ".//Scene_Source", where)
    words = [text(source, name, where) for name in ("MISSION", "MISSION_INDEX", "INSTRUMENT", "INSTRUMENT_INDEX")]
    if words[0].upper() != "SPOT":
        raise InputError(
            f"these are metadata of {words[0][:20]} {words[1][:5]}, whose attitude and look angles are written in "
            "another way than those of SPOT and are not read",
            where=where,
            hint=BY_POINTS,
        )
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
    title = f"{words[0]} {words[1]} {words[2]} {words[3]}, {text(source, 'IMAGING_DATE', where)}"
    path = AnglePath(orbit, times, angles)
    return SceneMetadata(title, path, look, period, middle, size, STARS if stars else GYROSCOPES, notes)


def _optional(element: Element, path: str) -> str:
    found = element.find(path)
    return "" if found is None else (found.text or "").strip()


def _orbit(root: Element, centre: tuple[int, float], where: str) -> Orbit:
    points = root.findall(f"{_STRIP}/Ephemeris/Points/Point")
    times = since_times([text(point, "TIME", where) for point in points], where, centre)
    xyz = [[[number(point, f"{part}/{axis}", where) for axis in "XYZ"] for point in points] for part in _PARTS]
    return Orbit.through(times, np.array(xyz[0]).reshape(-1, 3), np.array(xyz[1]).reshape(-1, 3), where)


_PARTS = ("Location", "Velocity")


def _attitude(root: Element, centre: tuple[int, float], where: str) -> tuple[bool, FloatArray, FloatArray]:
    """Whether stars were used, times (K,) and pitch, roll, yaw (K, 3) in radians."""
    # SPOT 5 has corrected angles. SPOT 1 to 4 have angular speeds and angles of their own at the ends: the speeds are
    # integrated by the trapezoidal rule, from the first angle.
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
    rows = [row for row in element.iterfind(path) if _optional(row, "OUT_OF_RANGE") != "Y"]
    times = since_times([text(row, "TIME", where) for row in rows], where, centre)
    values = np.array([[number(row, name, where) for name in _ANGLES] for row in rows]).reshape(-1, 3)
    return samples_in_order(times, values, f"the attitude list {path.removeprefix('.//')}", where)


def _look(root: Element, band: str | None, where: str) -> tuple[LookDirections, tuple[str, ...]]:
    """Look directions, u = (−tan ψy, tan ψx, −1), of the band asked for or of all where they are the same."""
    looks: dict[str, LookDirections] = {}
    for part in root.iterfind(".//Instrument_Look_Angles_List/Instrument_Look_Angles"):
        detector, psi_x, psi_y = children(
            part, "Look_Angles_List/Look_Angles", ("DETECTOR_ID", "PSI_X", "PSI_Y"), where
        ).T
        looks[text(part, "BAND_INDEX", where)] = LookDirections.of(detector - 0.5, -psi_y, psi_x, where, angular=True)
    if not looks:
        find(root, ".//Instrument_Look_Angles_List/Instrument_Look_Angles", where)
    return choose_band(looks, band, where)


KIND = "ossimSpot5Model"
_PREFIX = "support_data."


def read_ossim(data: bytes, where: str) -> SceneMetadata:
    """Metadata of a SPOT 5 scene in an OSSIM keyword list.

    Attitudes are pitch, roll, yaw; lines and detectors count from 1 at the pixel's centre.

    Parameters
    ----------
    data : bytes
        Whole file.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        The list is of another type, not whole, of a part of a scene, or adjusted by OSSIM.
    """
    words = _words(data.decode("utf-8", "replace"), where)
    if words.get("type") != KIND:
        raise InputError(
            f"this keyword list is of type '{words.get('type', 'none')[:40]}', not {KIND}",
            where=where,
            hint=f"give the metadata of the product if it is of SPOT; or {BY_POINTS}",
        )
    _need_whole(words, where)
    reference = _list(words, "reference_line_time", 1, where)[0]
    line = _list(words, "reference_line_time_line", 1, where)[0]
    period = _list(words, "line_sampling_period", 1, where)[0]
    times = _list(words, "ephemeris_sample_times", 0, where) - reference
    positions, velocities = (
        _list(words, f"{name}_ecf_samples", 3 * len(times), where).reshape(-1, 3) for name in ("position", "velocity")
    )
    at = _list(words, "attitude_sample_times", 0, where) - reference
    attitude = _list(words, "attitude_samples", 3 * len(at), where).reshape(-1, 3)
    at, attitude = samples_in_order(at, attitude, f"{_PREFIX}attitude_samples", where)
    count = int(_list(words, "detector_count", 1, where)[0])
    psi_x, psi_y = (_list(words, f"pixel_lookat_angle_{axis}", count, where) for axis in "xy")
    cols: FloatArray = np.arange(0.5, count, dtype=np.float64)
    look = LookDirections.of(cols, -psi_y, psi_x, where, angular=True)
    orbit = Orbit.through(times, positions, velocities, where)
    width, height = (int(v) for v in _list(words, "image_size", 2, where))
    if width != count:
        raise InputError(f"{count} detectors for {width} columns", where=where, hint="get the whole file")
    require_cover(at, height, float(line) - 0.5, float(period), where)
    stars = words.get(f"{_PREFIX}star_tracker_used_flag", "0").strip() == "1"
    title = f"SPOT 5 HRG, {words.get(f'{_PREFIX}image_date', 'no date')[:10]}"
    path, quality = AnglePath(orbit, at, attitude), STARS if stars else GYROSCOPES
    return SceneMetadata(title, path, look, float(period), float(line) - 0.5, (width, height), quality)


def _need_whole(words: dict[str, str], where: str) -> None:
    """Check that the list holds no adjustment made by OSSIM and no part of a scene, which have no effect here."""
    for name, value in words.items():
        changed = re.fullmatch(r"adjustment_\d+\.adj_param_\d+\.(parameter|center)", name)
        if (changed or name == f"{_PREFIX}sub_image_offset") and not all(_is_zero(word) for word in value.split()):
            raise InputError(
                f"{name} is '{value[:40]}', not 0: "
                + ("an adjustment made by OSSIM is not applied" if changed else "this is a part of the scene"),
                where=where,
                hint="set it to 0, and "
                + ("refine here with control points" if changed else "say where the part lies: offset = [col, row]"),
            )


def _is_zero(word: str) -> bool:
    try:
        return float(word) == 0.0
    except ValueError:
        return False


def _words(content: str, where: str) -> dict[str, str]:
    words = {}
    for row in content.splitlines():
        name, colon, value = row.partition(":")
        if colon:
            words[name.strip()] = value.strip().strip('"').strip()
    if not words:
        raise InputError(
            "this is no keyword list", where=where, hint="give the metadata of the product, or a .geom file of SPOT 5"
        )
    return words


def _list(words: dict[str, str], name: str, count: int, where: str) -> FloatArray:
    """Finite numbers of a key, `count` of them (0: any number)."""
    given = words.get(f"{_PREFIX}{name}")
    if given is None:
        raise InputError(f"the keyword list has no {_PREFIX}{name}", where=where, hint="get the whole file")
    return np.array(finite_numbers(given.split(), count or max(len(given.split()), 1), f"{_PREFIX}{name}", where))
