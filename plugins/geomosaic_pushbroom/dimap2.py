"""DIMAP 2 and the primary products of Pléiades, SPOT 6 and SPOT 7: ephemeris, quaternions, viewing directions."""

from __future__ import annotations

from dataclasses import replace
from xml.etree.ElementTree import Element

import numpy as np

from geomosaic.errors import InputError, counted
from geomosaic.types import FloatArray
from geomosaic_pushbroom.paths import NODES, Orbit, Path, QuaternionPath, QuaternionTable, horner
from geomosaic_pushbroom.pose import LookDirections, choose_band, same_side
from geomosaic_pushbroom.scene_metadata import (
    AGILE,
    SceneMetadata,
    children,
    find,
    number,
    numbers,
    since_times,
    text,
    utc_time,
)


def _triples(points: list[Element], name: str, where: str) -> FloatArray:
    """Triples (K, 3) of numbers of several elements."""
    rows = [numbers(point, name, where) for point in points]
    odd = [row for row in rows if len(row) != 3]
    if odd:
        what = f"<{name}> has {counted(len(odd[0]), 'number')}, not 3"
        raise InputError(what, where=where, hint="get the file again")
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def _quaternion_path(
    orbit: Orbit, element: Element, part: str, middle: tuple[int, float], half: float, where: str
) -> QuaternionPath:
    """Attitude by polynomials over (second of the day − OFFSET) / SCALE, `part` the path of component `{}`."""
    powers = [numbers(element, f"{part.format(i)}/COEFFICIENTS", where) for i in range(4)]
    offset, scale = (number(element, name, where) for name in ("OFFSET", "SCALE"))
    quaternion = np.zeros((max(1, *map(len, powers)), 4))
    for i, row in enumerate(powers):
        quaternion[: len(row), i] = row
    scene = np.linspace(-half, half, 11)[:, None] + (middle[1] - offset)
    with np.errstate(all="ignore"):
        lengths = np.linalg.norm(horner(quaternion, scene / scale), axis=1) if scale > 0.0 else np.zeros(1)
    if not (np.abs(lengths - 1.0) < 0.1).all():
        raise InputError(
            "the quaternion polynomials are no attitude over the scene: their length is not one",
            where=where,
            hint="get the file again",
        )
    return QuaternionPath(orbit, offset - middle[1], scale, quaternion)


CHARACTERISTICS = ".//Sensor_Model_Characteristics"


def read_pleiades(root: Element, where: str) -> SceneMetadata:
    """Metadata of a Pléiades primary scene.

    Parameters
    ----------
    root : Element
        Of the DIMAP document.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        Something is missing or wrong; names it.

    Notes
    -----
    Row 0.5 is scanned at START, one row later each SENSOR_LINE_PERIOD (ms). The quaternion polynomials run over
    (second of the day − OFFSET) / SCALE. Detector k counts from FIRST_COL, and its look direction is (ψy, −ψx, 1) along
    the satellite's axes forward, right, down, the polynomials of ψ running over k − FIRST_COL; ψ is a slope.
    """
    model = find(root, CHARACTERISTICS, where)
    size = (int(number(root, ".//Raster_Dimensions/NCOLS", where)), int(number(root, ".//NROWS", where)))
    first = utc_time(text(model, "UTC_Sensor_Model_Range/START", where), where)
    period = number(model, "SENSOR_LINE_PERIOD", where) * 1e-3
    if not 0.0 < period < 1.0:
        raise InputError(f"SENSOR_LINE_PERIOD is {period * 1e3:g} ms", where=where, hint="get the file again")
    half = 0.5 * size[1] * period
    middle = (first[0], first[1] + half)
    points = model.findall("Sensor_Ephemeris/Point_List/Point")
    times = since_times([text(point, "UTC_TIME", where) for point in points], where, middle)
    xyz, speed = (_triples(points, name, where) for name in ("LOCATION_VALUES", "VELOCITY_VALUES"))
    orbit = Orbit.through(times, xyz, speed, where)
    attitudes = find(model, "Sensor_Attitudes", where)
    path = _quaternion_path(orbit, attitudes, "Polynomial_Models/Q{}", middle, half, where)
    look, notes = _line(model, size[0], where)
    title = f"Pléiades, {text(model, 'UTC_Sensor_Model_Range/START', where)[:10]}"
    return SceneMetadata(title, path, look, period, 0.5 + half / period, size, AGILE, notes)


def _line(model: Element, width: int, where: str) -> tuple[LookDirections, tuple[str, ...]]:
    """Look directions of the line from the polynomials of its viewing angles, and what is odd about them."""
    view = find(model, "Sensor_Viewing_Model", where)
    first, last = (number(view, f"Position_In_Retina/{name}", where) for name in ("FIRST_COL", "LAST_COL"))
    psi = [numbers(view, f"Viewing_Directions/{name}/COEFFICIENTS", where) for name in ("PsiX_Model", "PsiY_Model")]
    # Real products also give the column behind the last one as LAST_COL; the RFM of such a file agrees, to 0.012 px,
    # with detectors that count from FIRST_COL all the same.
    beyond = last - first + 1.0 - width
    if beyond not in (0.0, 1.0) or not all(map(len, psi)):
        raise InputError(
            f"Position_In_Retina is {first:g} to {last:g} for {width} columns, and the viewing directions have "
            f"{len(psi[0])} and {len(psi[1])} coefficients: where each column looks is unknown",
            where=where,
            hint="get the file again, or use the sensor 'rpc' with this file or the scene's RPC file",
        )
    notes = (
        f"{where}: Position_In_Retina is {first:g} to {last:g} for {width} columns, one value more than there are; the "
        f"first column is taken for detector {first:g}",
    )
    # A straight line needs its two ends only; a curved one is interpolated linearly between many nodes.
    nodes = np.linspace(0.0, width - 1.0, 2 if max(map(len, psi)) <= 2 else 2001)
    with np.errstate(all="ignore"):
        x, y = (horner(c[:, None], nodes[:, None])[:, 0] for c in psi)
    return LookDirections.of(nodes + 0.5, -x, y, where), notes if beyond else ()


REFINED = ".//Refined_Model"
MISSIONS = {"PHR_SENSOR": "Pléiades", "PNEO_SENSOR": "Pléiades Neo", "S6_SENSOR": "SPOT 6", "S7_SENSOR": "SPOT 7"}
_UNITS = (1.0, 1e-3, 1e-6)
# Part of the scene by which a dense ephemeris is taken, and the orbit extended, beyond the first and last row.
_MARGIN = 0.25


def read_refined(root: Element, where: str, band: str | None = None) -> SceneMetadata:
    """Metadata of a Pléiades, Pléiades Neo, SPOT 6 or SPOT 7 product (DIMAP 2), level SENSOR.

    Parameters
    ----------
    root : Element
        Of the document.
    where : str
        Named in errors.
    band : str, optional
        BAND_ID whose look angles are taken; needed where those of the bands differ by more than a tenth of a pixel.

    Raises
    ------
    InputError
        Something is missing or wrong; names it.

    Notes
    -----
    The centre of the first row is scanned at START and that of the last one at END. This also tells whether LINE_PERIOD
    is in milliseconds (Pléiades) or microseconds (SPOT 6, Pléiades Neo): the unit with which the rows fill that time is
    taken. Quaternions, Q0 the scalar, turn from the satellite's axes (forward, right, to the ground) to geocentric
    ones; they are polynomials over (second of the day − OFFSET) / SCALE, or a table, linear between its times. The
    detector of column k of the whole line looks along (tan ψy, −tan ψx, 1) in the satellite's axes, with

        tan ψx = XLOS_0 + XLOS_1 · (k − 1),     tan ψy = YLOS_0 + YLOS_1 · (k − 1)

    and column 1 of the product is column FIRST_COL of the line (Pléiades Imagery User Guide, appendix on the physical
    model; corners that real products tell of themselves agree).
    """
    model = find(root, REFINED, where)
    processing = root.findtext(".//Product_Settings/PROCESSING_LEVEL")
    if processing is not None and processing.strip() not in ("SENSOR", "PRIMARY"):
        raise InputError(
            f"this product is of level {processing.strip()[:40]}: it was rectified, and its rows are no scan lines",
            where=where,
            hint="order the product as SENSOR (primary), or use the sensor 'planar'",
        )
    size = (int(number(root, ".//Raster_Dimensions/NCOLS", where)), int(number(root, ".//NROWS", where)))
    first = utc_time(text(model, "Time/Time_Range/START", where), where)
    (took,) = since_times([text(model, "Time/Time_Range/END", where)], where, first)
    period = _period(number(model, "Time/Time_Stamp/LINE_PERIOD", where), float(took), size[1], where)
    half = 0.5 * float(took)
    middle = (first[0], first[1] + half)
    profile = (root.findtext(".//METADATA_PROFILE") or "").strip()
    title = f"{MISSIONS.get(profile, f'DIMAP 2 {profile}'.strip())}, {text(model, 'Time/Time_Range/START', where)[:10]}"
    orbit = _orbit(model, middle, half, where)
    look, notes = _look(model, size[0], band, where)
    path = _attitude(model, orbit, middle, half, where)
    return SceneMetadata(title, path, look, period, 0.5 + half / period, size, AGILE, notes)


def _period(given: float, took: float, rows: int, where: str) -> float:
    """Seconds per row: LINE_PERIOD in the unit in which the rows take from START to END."""
    if rows > 1 and took > 0.0:
        for unit in _UNITS:
            if abs(given * unit * (rows - 1) / took - 1.0) < 1e-3:
                return given * unit
    raise InputError(
        f"{rows} rows of LINE_PERIOD {given:g} do not fill the {took:g} s from START to END, be it in s, ms or µs",
        where=where,
        hint="get the file again; it must be that of the whole product",
    )


def _orbit(model: Element, middle: tuple[int, float], half: float, where: str) -> Orbit:
    """Orbit over the scene."""
    points = model.findall("Ephemeris/Point_List/Point")
    times = since_times([text(point, "TIME", where) for point in points], where, middle)
    xyz, speed = (_triples(points, name, where) for name in ("LOCATION_XYZ", "VELOCITY_XYZ"))
    return orbit_about(times, xyz, speed, half, where)


def orbit_about(times: FloatArray, xyz: FloatArray, speed: FloatArray, half: float, where: str) -> Orbit:
    """Orbit over a scene, through points that may be dense.

    Parameters
    ----------
    times : array (K,)
        Seconds from the middle of the scene.
    xyz, speed : array (K, 3)
        Geocentric; metres, metres per second.
    half : float
        Seconds from there to the ends of the scene.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        The points do not cover the scene, or are no orbit.
    """
    # Pléiades and SPOT 6 have a point every 30 s or so. Pléiades Neo has hundreds within the scene; then eight of them,
    # evenly spread, are one smooth curve over all of it, which the last millisecond beyond its ends does not leave.
    reach = (1.0 + 2.0 * _MARGIN) * half
    inside = np.flatnonzero(np.abs(times) <= reach)
    if len(inside) <= NODES:
        return Orbit.through(times, xyz, speed, where)
    chosen = inside[np.argsort(times[inside])][np.linspace(0, len(inside) - 1, NODES).round().astype(int)]
    orbit = Orbit.through(times[chosen], xyz[chosen], speed[chosen], where)
    if max(abs(orbit.range[0] + half), abs(orbit.range[1] - half)) > 2.0 * _MARGIN * half:
        raise InputError(
            f"the ephemeris covers {orbit.range[0]:.3f} to {orbit.range[1]:.3f} s about the middle of the scene, which "
            f"takes {-half:.3f} to {half:.3f} s",
            where=where,
            hint="get the whole file",
        )
    return replace(orbit, range=(-reach, reach))


def _attitude(model: Element, orbit: Orbit, middle: tuple[int, float], half: float, where: str) -> Path:
    polynomials = model.find("Attitudes/Polynomial_Quaternions")
    if polynomials is not None:
        return _quaternion_path(orbit, polynomials, "Q{}", middle, half, where)
    rows = model.findall("Attitudes/Quaternion_List/Quaternion")
    if len(rows) < 2:
        find(model, "Attitudes/Quaternion_List/Quaternion", where)
    times = since_times([text(row, "TIME", where) for row in rows], where, middle)
    order = np.argsort(times, kind="stable")
    values = children(model, "Attitudes/Quaternion_List/Quaternion", ("Q0", "Q1", "Q2", "Q3"), where)[order]
    times = times[order]
    with np.errstate(over="ignore"):
        long = np.abs(np.linalg.norm(values, axis=1) - 1.0).max()
    if len(times) < 2 or not (np.diff(times) > 0.0).all() or long > 1e-3:
        raise InputError(
            "the quaternions are fewer than two, have two of one time, or are not of length one",
            where=where,
            hint="get the file again",
        )
    if max(times[0] + half, half - times[-1]) > 0.1 * half:
        raise InputError(
            f"the attitudes cover {times[0]:.3f} to {times[-1]:.3f} s about the middle of the scene, which takes "
            f"{-half:.3f} to {half:.3f} s",
            where=where,
            hint="get the whole file",
        )
    return QuaternionTable(orbit, times, same_side(values))


def _look(model: Element, width: int, band: str | None, where: str) -> tuple[LookDirections, tuple[str, ...]]:
    """Look directions over the columns of the product."""
    whole = find(model, "Geometric_Calibration", where)
    for name in ("YAW", "PITCH", "ROLL"):
        bias = whole.find(f".//Instrument_Biases/{name}")
        if bias is not None and (bias.text or "").strip() and number(whole, f".//Instrument_Biases/{name}", where):
            raise InputError(
                f"the instrument has a bias in {name.lower()}, whose unit and sense no file at hand has shown",
                where=where,
                hint="use the sensor 'rpc' with the scene's RPC file",
            )
    start, end = (number(whole, f".//Swath_Range/{name}", where) for name in ("FIRST_COL", "LAST_COL"))
    if end - start + 1.0 != width:
        raise InputError(
            f"Swath_Range is {start:g} to {end:g}, but the product has {width} columns: which detectors they are is "
            "unknown",
            where=where,
            hint="use the sensor 'rpc' with the scene's RPC file",
        )
    looks: dict[str, LookDirections] = {}
    bands = whole.findall(".//Band_Calibration") or [whole]
    for one in bands:
        name = one.findtext("BAND_ID", f"{len(looks) + 1}").strip()
        angles = find(one, ".//Polynomial_Look_Angles", where)
        x, y = (_polynomial(angles, axis, where) for axis in "XY")
        # A straight line needs its two ends only; a curved one is interpolated linearly between many nodes.
        nodes = np.linspace(0.0, width - 1.0, 2 if max(len(x), len(y)) <= 2 else 2001)
        with np.errstate(all="ignore"):
            across, along = (horner(c[:, None], (nodes + start - 1.0)[:, None])[:, 0] for c in (x, y))
        if not np.abs([across, along]).max() < 1.0:
            raise InputError("the look angles reach beyond 45°", where=where, hint="get the file again")
        looks[name] = LookDirections.of(nodes + 0.5, -across, along, where)
    return choose_band(looks, band, where)


def _polynomial(angles: Element, axis: str, where: str) -> FloatArray:
    """Coefficients XLOS_0, XLOS_1 and so on, as many as there are; the first is needed."""
    count = 1
    while angles.find(f"{axis}LOS_{count}") is not None:
        count += 1
    return np.array([number(angles, f"{axis}LOS_{i}", where) for i in range(count)])
