"""What both profiles of Pléiades' metadata have: triples of coordinates, and quaternions as polynomials of time."""

from __future__ import annotations

from xml.etree.ElementTree import Element

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import FloatArray
from geomosaic_pushbroom.orbit import Orbit, horner
from geomosaic_pushbroom.paths import QuaternionPath
from geomosaic_pushbroom.xml import number, numbers


def triples(points: list[Element], name: str, where: str) -> FloatArray:
    """Three numbers of each point, (K, 3).

    Raises
    ------
    InputError
        A point has more or fewer.
    """
    rows = [numbers(point, name, where) for point in points]
    odd = [row for row in rows if len(row) != 3]
    if odd:
        raise InputError(f"<{name}> has {len(odd[0])} numbers, not 3", where=where, mend="get the file again")
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
            mend="get the file again",
        )
    return QuaternionPath(orbit, offset - middle[1], scale, quaternion)
