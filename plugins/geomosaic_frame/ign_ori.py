"""Orientations of IGN (Institut national de l'information géographique et forestière): one XML file for each photo.

`<sommet>` is the projection centre in the map that `<systeme>` and `<grid_alti>` name; `<mat3d>` the rotation row by
row, from the image to the ground where `<Image2Ground>` says so, with camera axes x right, y down, z forward. With
(c, l) the ideal pixel, and R its distance from the principal point of symmetry `<pps>` (libOri, conic model),

    c = ppa + focale · x / z,   c' = c + (c − pps) · (r3·R² + r5·R⁴ + r7·R⁶),   l likewise.

Pixels count from the outer corner of the upper-left pixel, as those of the spherical panoramas of the same system do,
whose full circle is as wide as the image.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from geomosaic.errors import InputError
from geomosaic.sensor.inputs import finite_number, parse_xml

ENDING = ".ori.xml"
# Pixels; no focal length is longer.
LONGEST = 1e9
# Real files print twelve decimals of matrices that are off orthonormal by 1e-5.
_ORTHONORMAL = 1e-4

Photo = tuple[str, dict[str, Any], dict[str, Any]]
"""Name of the image, camera table, orientation row."""


@lru_cache(maxsize=256)
def read_ori(data: bytes, where: str) -> Photo:
    """Camera and orientation of one photo.

    Parameters
    ----------
    data : bytes
        Whole file.
    where : str
        Named in errors.

    Returns
    -------
    tuple
        Name of the image, camera table, orientation row.

    Raises
    ------
    InputError
        The XML is damaged, has entities, is no orientation of a frame camera, or lacks a value; names it.
    """
    root = parse_xml(data, where)
    if root.tag != "orientation" or root.find("geometry") is None:
        raise InputError("this is no orientation of IGN: <orientation> or <geometry> is missing", where=where)
    if root.find("geometry/intrinseque/spherique") is not None:
        raise InputError(
            "this is a spherical panorama, not a photo of a frame camera",
            where=where,
            hint="give the orientations of the photos it was made of (<sensor>, conic)",
        )
    sensor = _child(root, "geometry/intrinseque/sensor", where)
    outside = _child(root, "geometry/extrinseque", where)
    return (root.findtext("auxiliarydata/image_name") or "").strip(), _camera(sensor, where), _row(outside, where)


def _camera(sensor: Element, where: str) -> dict[str, Any]:
    focal = _number(sensor, "ppa/focale", where)
    if not 0.0 < focal < LONGEST:
        raise InputError(f"the focal length is {focal:g} pixels", where=where)
    point = [_number(sensor, f"ppa/{name}", where) for name in ("c", "l")]
    lens: dict[str, Any] = {"model": "none"}
    if sensor.find("distortion") is not None:
        centre = [_number(sensor, f"distortion/pps/{name}", where) for name in ("c", "l")]
        powers = (("k1", "r3", 2), ("k2", "r5", 4), ("k3", "r7", 6))
        lens = {
            "model": "brown",
            **{key: _number(sensor, f"distortion/{name}", where) * focal**power for key, name, power in powers},
            "centre": [(a - b) / focal for a, b in zip(centre, point, strict=True)],
        }
    return {
        "size": [_number(sensor, f"image_size/{name}", where) for name in ("width", "height")],
        "focal_length_px": focal,
        "principal_point_px": point,
        "distortion": lens,
    }


def _row(outside: Element, where: str) -> dict[str, Any]:
    rows = [[_number(outside, f"rotation/mat3d/l{i}/pt3d/{axis}", where) for axis in "xyz"] for i in (1, 2, 3)]
    matrix = np.array(rows)
    off = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if off > _ORTHONORMAL or np.linalg.det(matrix) < 0.0:
        raise InputError(f"<mat3d> is no rotation: its rows are off orthonormal by {off:.1e}, or mirrored", where=where)
    direction = (outside.findtext("rotation/Image2Ground") or "").strip().lower()
    if direction not in ("true", "false"):
        raise InputError(
            "nothing says which way <mat3d> turns: <Image2Ground> is missing", where=where, hint="write true or false"
        )
    left, _, right = np.linalg.svd(matrix)
    nearest = left @ right
    to_image = nearest.T if direction == "true" else nearest
    position = [_number(outside, f"sommet/{name}", where) for name in ("easting", "northing", "altitude")]
    return {"system": "ori", "rotation": to_image.ravel().tolist(), "position": position}


def _child(parent: Element, path: str, where: str) -> Element:
    found = parent.find(path)
    if found is None:
        raise InputError(f"<{path.rpartition('/')[2]}> is missing", where=where, hint="get the file again")
    return found


def _number(parent: Element, path: str, where: str) -> float:
    text = (_child(parent, path, where).text or "").strip()
    value = finite_number(text)
    if math.isnan(value):
        raise InputError(f"<{path}> is '{text[:60]}', not a finite number of a sensible size", where=where)
    return value
