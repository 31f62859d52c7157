"""Metadata of Pléiades primary scenes: ephemeris, quaternion polynomials, viewing directions."""

from __future__ import annotations

from xml.etree.ElementTree import Element

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import FloatArray
from geomosaic_pushbroom.look_angles import LookDirections
from geomosaic_pushbroom.orbit import Orbit, horner
from geomosaic_pushbroom.paths import QuaternionPath
from geomosaic_pushbroom.reported import AGILE, SceneMetadata, each, find, number, numbers, since_times, text, utc_time


def triples(points: list[Element], name: str, where: str) -> FloatArray:
    """Triples of numbers of several elements.

    Parameters
    ----------
    points : list of Element
    name : str
        Path of the element that holds them, below each.
    where : str
        Named in errors.

    Returns
    -------
    array (K, 3)

    Raises
    ------
    InputError
        An element has more or fewer than three numbers.
    """
    rows = [numbers(point, name, where) for point in points]
    odd = [row for row in rows if len(row) != 3]
    if odd:
        raise InputError(f"<{name}> has {len(odd[0])} numbers, not 3", where=where, hint="get the file again")
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def quaternion_path(
    orbit: Orbit, element: Element, part: str, middle: tuple[int, float], half: float, where: str
) -> QuaternionPath:
    """Attitude by polynomials over (second of the day − OFFSET) / SCALE.

    Parameters
    ----------
    orbit : Orbit
    element : Element
        With OFFSET and SCALE.
    part : str
        Path of component `{}` of the quaternion below it.
    middle : tuple
        Day and second of the middle of the scene.
    half : float
        Seconds from there to its ends.
    where : str
        Named in errors.

    Returns
    -------
    QuaternionPath

    Raises
    ------
    InputError
        They are no attitude over the scene.
    """
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


PART = ".//Sensor_Model_Characteristics"


def read_pleiades(root: Element, where: str) -> SceneMetadata:
    """Metadata of a Pléiades primary scene.

    Parameters
    ----------
    root : Element
        Of the DIMAP document.
    where : str
        Named in errors.

    Returns
    -------
    SceneMetadata

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
    model = find(root, PART, where)
    size = (int(number(root, ".//Raster_Dimensions/NCOLS", where)), int(number(root, ".//NROWS", where)))
    first = utc_time(text(model, "UTC_Sensor_Model_Range/START", where), where)
    period = number(model, "SENSOR_LINE_PERIOD", where) * 1e-3
    if not 0.0 < period < 1.0:
        raise InputError(f"SENSOR_LINE_PERIOD is {period * 1e3:g} ms", where=where, hint="get the file again")
    half = 0.5 * size[1] * period
    middle = (first[0], first[1] + half)
    points = list(each(model, "Sensor_Ephemeris/Point_List/Point"))
    times = since_times([text(point, "UTC_TIME", where) for point in points], where, middle)
    xyz, speed = (triples(points, name, where) for name in ("LOCATION_VALUES", "VELOCITY_VALUES"))
    orbit = Orbit.through(times, xyz, speed, where)
    attitudes = find(model, "Sensor_Attitudes", where)
    path = quaternion_path(orbit, attitudes, "Polynomial_Models/Q{}", middle, half, where)
    look = _line(model, size[0], where)
    title = f"Pléiades, {text(model, 'UTC_Sensor_Model_Range/START', where)[:10]}"
    return SceneMetadata(title, path, look, period, 0.5 + half / period, size, AGILE)


def _line(model: Element, width: int, where: str) -> LookDirections:
    """Look directions of the line from the polynomials of its viewing angles."""
    view = find(model, "Sensor_Viewing_Model", where)
    first, last = (number(view, f"Position_In_Retina/{name}", where) for name in ("FIRST_COL", "LAST_COL"))
    psi = [numbers(view, f"Viewing_Directions/{name}/COEFFICIENTS", where) for name in ("PsiX_Model", "PsiY_Model")]
    if last - first + 1.0 != width or not all(map(len, psi)):
        raise InputError(
            f"Position_In_Retina is {first:g} to {last:g} for {width} columns, and the viewing directions have "
            f"{len(psi[0])} and {len(psi[1])} coefficients: where each column looks is not told",
            where=where,
            hint="get the file again, or use the sensor 'rpc' with the scene's RPC file",
        )
    # A straight line needs its two ends only; a curved one is interpolated linearly between many nodes.
    nodes = np.linspace(0.0, last - first, 2 if max(map(len, psi)) <= 2 else 2001)
    with np.errstate(all="ignore"):
        x, y = (horner(c[:, None], nodes[:, None])[:, 0] for c in psi)
    return LookDirections.of(nodes + 0.5, -x, y, where)
