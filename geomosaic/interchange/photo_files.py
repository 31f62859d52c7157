"""Orientations with one file for each photo: IGN's .ori.xml and the .tsai of the Ames Stereo Pipeline.

IGN (Institut national de l'information géographique et forestière): `<sommet>` is the projection centre in the map that
`<systeme>` and `<grid_alti>` name; `<mat3d>` the rotation row by row, from the image to the ground where
`<Image2Ground>` says so, with camera axes x right, y down, z forward. With (c, l) the ideal pixel, and R its distance
from the principal point of symmetry `<pps>` (libOri, conic model),

    c = ppa + focale · x / z,   c' = c + (c − pps) · (r3·R² + r5·R⁴ + r7·R⁶),   l likewise.

Pixels count from the outer corner of the upper-left pixel, as those of the spherical panoramas of the same system do,
whose full circle is as wide as the image.

Ames Stereo Pipeline (its manual, frame camera models): C is the projection centre and R turns camera axes, x right, y
down, z forward, into geocentric ones; lengths are in units of which a pixel has `pitch`. The centre of the upper-left
pixel is (0, 0), and pixel = (fu·x/z + cu) / pitch before the distortion.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, counted
from geomosaic.geo.local_frames import require_rotation
from geomosaic.interchange.reconstruction import Reconstruction, pixel_camera
from geomosaic.sensor.inputs import finite_numbers, parse_xml

# Pixels; no focal length is longer.
LONGEST = 1e9
# Real files print twelve decimals of matrices that are off orthonormal by 1e-5.
_ORTHONORMAL = 1e-4

# Our coefficients, IGN's, and the power of the focal length between them.
_POWERS = (("k1", "r3", 2), ("k2", "r5", 4), ("k3", "r7", 6))

# Name of the image, camera table, orientation row.
Photo = tuple[str, dict[str, Any], dict[str, Any]]


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
        lens = {
            "model": "brown",
            **{key: _number(sensor, f"distortion/{name}", where) * focal**power for key, name, power in _POWERS},
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
    nearest = require_rotation(matrix, "<mat3d>", where, _ORTHONORMAL)
    direction = (outside.findtext("rotation/Image2Ground") or "").strip().lower()
    if direction not in ("true", "false"):
        raise InputError(
            "nothing says which way <mat3d> turns: <Image2Ground> is missing", where=where, hint="write true or false"
        )
    to_image = nearest.T if direction == "true" else nearest
    position = [_number(outside, f"sommet/{name}", where) for name in ("easting", "northing", "altitude")]
    return {"system": "ori", "rotation": to_image.ravel().tolist(), "position": position}


def _child(parent: Element, path: str, where: str) -> Element:
    found = parent.find(path)
    if found is None:
        raise InputError(f"<{path.rpartition('/')[2]}> is missing", where=where, hint="get the file again")
    return found


def _number(parent: Element, path: str, where: str) -> float:
    return finite_numbers((_child(parent, path, where).text or "").split(), 1, f"<{path}>", where)[0]


def ori_texts(found: Reconstruction) -> dict[str, str]:
    """Texts of IGN's XML, one for each oriented image, by file name.

    Parameters
    ----------
    found : Reconstruction
        In the axes of a map.

    Raises
    ------
    InputError
        A camera has no size, two focal lengths, or a lens that is not radial about the principal point.
    """
    found.require_map("IGN")
    files = {}
    for image in found.images:
        if not image.oriented:
            continue
        rotation, centre = image.pose
        where = f"camera of {image.name}"
        camera = pixel_camera(found.camera_of(image), where)
        camera.known_only("IGN", where, none=(), brown=("k1", "k2", "k3"))
        if camera.size is None or camera.focal[0] != camera.focal[1]:
            raise InputError(
                "IGN's cameras have a size and one focal length", where=where, hint="adjust the camera so, or give it"
            )
        stem = Path(image.name).stem
        root = Element("orientation")
        _add(root, "auxiliarydata", image_name=stem)
        geometry = SubElement(root, "geometry")
        outside = SubElement(geometry, "extrinseque")
        _add(outside, "sommet", **dict(zip(("easting", "northing", "altitude"), centre.tolist(), strict=True)))
        turn = _add(outside, "rotation", Image2Ground="true")
        matrix = SubElement(turn, "mat3d")
        for number, row in enumerate(rotation.T.tolist(), 1):
            _add(SubElement(matrix, f"l{number}"), "pt3d", **dict(zip("xyz", row, strict=True)))
        sensor = SubElement(SubElement(geometry, "intrinseque"), "sensor")
        focal, (c, row_) = camera.focal[0], camera.principal
        _add(sensor, "image_size", width=camera.size[0], height=camera.size[1])
        _add(sensor, "ppa", c=c, l=row_, focale=focal)
        lens = _add(
            sensor,
            "distortion",
            **{tag: camera.lens.get(key, 0.0) / focal**power for key, tag, power in _POWERS},
        )
        _add(lens, "pps", c=c, l=row_)
        indent(root)
        files[f"{stem}.ori.xml"] = f'<?xml version="1.0" encoding="UTF-8"?>\n{tostring(root, encoding="unicode")}\n'
    return files


def _add(parent: Element, tag: str, **values: object) -> Element:
    """New child of an element, with a child for each value."""
    child = SubElement(parent, tag)
    for name, value in values.items():
        SubElement(child, name).text = value if isinstance(value, str) else repr(value)
    return child


PINHOLE = ("fu", "fv", "cu", "cv", "pitch", "C", "R")
_DIRECTIONS = {"u_direction": [1.0, 0.0, 0.0], "v_direction": [0.0, 1.0, 0.0], "w_direction": [0.0, 0.0, 1.0]}
_LENSES = ("NULL", "TSAI", "AdjustableTSAI", "Photometrix", "BrownConrady", "FISHEYE")
_CONVERT = "convert it to TSAI with convert_pinhole_model"
# Metres from the centre of the Earth to the lowest camera there can be.
_EARTH = 6.3e6


@lru_cache(maxsize=256)
def read_tsai(text: str, where: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Camera table and orientation row of one photo, from a pinhole camera of the Ames Stereo Pipeline.

    Parameters
    ----------
    text : str
        Whole file.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        The file is of another kind of camera or of another lens than `_LENSES`, or lacks a value; names it.
    """
    lines = [line.strip() for line in text.splitlines()]
    if "OPTICAL_BAR" in lines[:3]:
        raise InputError(
            "this is an optical bar camera, which scans as it flies: no photo of a frame camera",
            where=where,
            hint=f"take a sensor of optical bar cameras (`geomosaic sensors`): optical_bar = '{Path(where).name}'",
        )
    values = _assigned(lines, where)
    missing = [name for name in PINHOLE if name not in values]
    if "PINHOLE" not in lines[:3] or missing:
        what = f"{', '.join(missing)} missing" if missing else "PINHOLE is not among its first lines"
        raise InputError(f"this is no pinhole camera of the Ames Stereo Pipeline: {what}", where=where)
    for name, axis in _DIRECTIONS.items():
        if values.get(name, axis) != axis:
            raise InputError(f"{name} is not {axis}", where=where, hint="turn R instead, and leave the directions")
    fu, fv, cu, cv, pitch = (_counted(values, name, 1, where)[0] for name in PINHOLE[:5])
    centre, rotation = (np.array(_counted(values, name, count, where)) for name, count in (("C", 3), ("R", 9)))
    if min(fu, fv, pitch) <= 0.0:
        raise InputError("fu, fv or pitch is not positive", where=where)
    if np.linalg.norm(centre) < _EARTH:
        raise InputError(
            "C is not geocentric: it lies within the Earth",
            where=where,
            hint="georeference the cameras with bundle_adjust and control points first",
        )
    to_world = rotation.reshape(3, 3)
    require_rotation(to_world, "R", where, _ORTHONORMAL)
    point = np.array([cu, cv])
    lens, shift = _tsai_lens(lines, values, fu, where)
    if "corrects" in lens and fu != fv:
        raise InputError("fu and fv differ, and the lens is in their unit", where=where, hint=_CONVERT)
    camera = {
        "focal_length_px": [fu / pitch, fv / pitch],
        "principal_point_px": ((point + shift) / pitch + 0.5).tolist(),
        "distortion": lens,
    }
    row = {"system": "tsai", "rotation": to_world.T.ravel().tolist(), "position": centre.tolist()}
    return camera, row | {"world": CRS.from_epsg(4978).to_wkt()}


def _tsai_lens(
    lines: list[str], values: Mapping[str, list[float]], focal: float, where: str
) -> tuple[dict[str, Any], tuple[float, float]]:
    """Table of the lens, and what the principal point is moved by, in the unit of the file."""
    kind = next((name for name in _LENSES if name in lines), None)
    if kind is None:
        odd = next((line for line in lines if re.fullmatch(r"[A-Za-z]\w+", line) and line != "PINHOLE"), "none")
        what = f"the lens model is {odd[:40]}, not one of {', '.join(_LENSES)}"
        raise InputError(what, where=where, hint=_CONVERT)
    given = {name: _counted(values, name, 1, where)[0] for name in values if re.fullmatch(r"[kp]\d|[xy]p|phi", name)}
    powers = {name: given.get(name, 0.0) for name in ("k1", "k2", "k3", "k4", "p1", "p2")}
    if kind == "NULL":
        return {"model": "none"}, (0.0, 0.0)
    if kind == "FISHEYE":
        return {"model": "fisheye", **{name: powers[name] for name in ("k1", "k2", "k3", "k4")}}, (0.0, 0.0)
    if kind == "TSAI":
        return {"model": "brown", **{name: powers[name] for name in ("k1", "k2", "k3", "p1", "p2")}}, (0.0, 0.0)
    if kind == "AdjustableTSAI":
        radial, (p1, p2) = (values.get(name, [0.0, 0.0]) for name in ("Radial", "Tangential"))
        if len(radial) > 4:
            raise InputError(f"the lens has {len(radial)} radial coefficients, more than 4", where=where, hint=_CONVERT)
        table = {"model": "brown", **{f"k{i}": k for i, k in enumerate(radial, 1)}, "p1": p1, "p2": p2}
        return table | {"shear": values.get("Alpha", [0.0])[0]}, (0.0, 0.0)
    # Both of the others correct the measured image: x + dx(x − xp), with y DOWN, in the unit of the file.
    k = {f"k{i}": powers[f"k{i}"] * focal ** (2 * i) for i in (1, 2, 3)}
    offset = given.get("xp", 0.0), given.get("yp", 0.0)
    if kind == "BrownConrady":
        if powers["p1"] or powers["p2"]:
            raise InputError("the tangential part of BrownConrady is not known here", where=where, hint=_CONVERT)
        return {"model": "brown", "corrects": "measured", **k}, offset
    p = {"p1": powers["p2"] * focal, "p2": powers["p1"] * focal}
    return {"model": "brown", "corrects": "measured", **k, **p, "centre": [v / focal for v in offset]}, (0.0, 0.0)


def _assigned(lines: list[str], where: str) -> dict[str, list[float]]:
    """Numbers of the lines 'name = numbers' and 'Radial Coeff: Vector3(...)'."""
    found: dict[str, list[float]] = {}
    for line in lines:
        name, mark, text = line.partition("=" if "=" in line else ":")
        if mark:
            words = re.sub(r"Vector\d*\(|[(),]", " ", text).split()
            key = name.split()[0].replace("Tangental", "Tangential") if name.split() else ""
            found[key] = finite_numbers(words, max(len(words), 1), key[:40], where)
    return found


def _counted(values: Mapping[str, list[float]], name: str, count: int, where: str) -> list[float]:
    if len(values[name]) != count:
        raise InputError(f"{name} has {counted(len(values[name]), 'number')}, not {count}", where=where)
    return values[name]
