"""Cameras exported from Agisoft Metashape as XML: sensors with their calibration, cameras with their transforms.

A camera's transform (4 × 4, row by row) takes camera axes (x right, y down, z forward) to the chunk or component; the
transform of the component, else of the chunk (rotation, translation, scale), takes that to geocentric coordinates of
the datum of the chunk's CRS, or to the local coordinates of a chunk without one. Calibration, after the manual
(Appendix "Camera models", frame cameras), with x = X/Z, y = Y/Z, r² = x² + y²:

    x' = x·(1 + K1·r² + K2·r⁴ + K3·r⁶ + K4·r⁸) + P1·(r² + 2x²) + 2·P2·x·y
    y' = y·(1 + K1·r² + K2·r⁴ + K3·r⁶ + K4·r⁸) + P2·(r² + 2y²) + 2·P1·x·y
    col = w/2 + cx + x'·(f + B1) + y'·B2,   row = h/2 + cy + y'·f

For fisheye cameras x, y are replaced by θ/r·(x, y), θ = arctan r, which is the equidistant lens of `fisheye.py`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from geomosaic.errors import InputError
from geomosaic.sensor.plain_xml import parse
from geomosaic.types import FloatArray

Cameras = dict[str, tuple[dict[str, Any], dict[str, Any]]]
CALIBRATION = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")


@lru_cache(maxsize=4)
def read_metashape(data: bytes, where: str) -> Cameras:
    """Read all oriented cameras.

    Returns
    -------
    dict
        Label → camera table and orientation row.

    Raises
    ------
    InputError
        The XML is damaged, has entities, or is no export of cameras; a camera is of a kind that is not supported.
    """
    root = parse(data, where)
    chunks = [root] if root.tag == "chunk" else root.findall("chunk")
    if not chunks:
        raise InputError("the XML has no <chunk>", where=where, mend="export the cameras from Metashape as XML")
    found: Cameras = {}
    for chunk in chunks:
        sensors = {sensor.get("id"): sensor for sensor in chunk.iterfind("sensors//sensor")}
        components = {item.get("id"): item.find("transform") for item in chunk.iterfind("components/component")}
        world = (chunk.findtext("reference") or "").strip()
        for camera in chunk.iterfind("cameras//camera"):
            label = camera.get("label", "")
            if camera.find("transform") is None:
                continue  # not aligned
            here = f"{where}, camera {label}"
            sensor = sensors.get(camera.get("sensor_id"))
            if sensor is None:
                raise InputError("the camera's sensor is not in the file", where=here)
            transform = components.get(camera.get("component_id"))
            transform = chunk.find("transform") if transform is None else transform
            found[label] = (_camera(sensor, here), _row(camera, transform, world, here))
    if not found:
        raise InputError("the file has no oriented camera", where=where, mend="align the photos first")
    return found


def _row(camera: Element, transform: Element | None, world: str, where: str) -> dict[str, Any]:
    if transform is None or transform.find("rotation") is None:
        raise InputError(
            "the chunk has no transform: it is not georeferenced",
            where=where,
            mend="give it coordinates of the cameras or markers in Metashape, and export again",
        )
    local = _numbers(camera.findtext("transform"), 16, "transform", where).reshape(4, 4)
    turn = _numbers(transform.findtext("rotation"), 9, "rotation", where).reshape(3, 3)
    shift = _numbers(transform.findtext("translation"), 3, "translation", where)
    scale = float(_numbers(transform.findtext("scale") or "1", 1, "scale", where)[0])
    to_world = turn @ local[:3, :3]
    return {
        "system": "metashape",
        "rotation": to_world.T.ravel().tolist(),
        "position": (scale * turn @ local[:3, 3] + shift).tolist(),
        "world": world,
    }


def _camera(sensor: Element, where: str) -> dict[str, Any]:
    kind = sensor.get("type", "frame")
    calibrations = sensor.findall("calibration")
    best = [item for item in calibrations if item.get("class") == "adjusted"] or calibrations
    if not best:
        raise InputError("the sensor has no calibration", where=where, mend="export the cameras after alignment")
    size = best[0].find("resolution")
    size = sensor.find("resolution") if size is None else size
    if size is None:
        raise InputError("the sensor has no resolution", where=where)
    width, height = (float(_numbers(size.get(name), 1, name, where)[0]) for name in ("width", "height"))
    if best[0].find("fx") is not None:
        raise InputError(
            "the calibration has fx and fy, as versions before 1.2 wrote it, with another principal point",
            where=where,
            mend="open the project in a newer version and export again",
        )
    value = {
        name: float(_numbers(best[0].findtext(name), 1, name, where)[0]) if best[0].find(name) is not None else 0.0
        for name in CALIBRATION
    }
    if value["f"] <= 0.0:
        raise InputError(f"the focal length is {value['f']:g}", where=where)
    if value["p3"] or value["p4"]:
        raise InputError("p3 and p4, of versions before 1.7, are not supported", where=where)
    return {
        "size": [width, height],
        "focal_length_px": [value["f"] + value["b1"], value["f"]],
        "principal_point_px": [width / 2 + value["cx"], height / 2 + value["cy"]],
        "distortion": _lens(kind, value, where),
    }


def _lens(kind: str, value: Mapping[str, float], where: str) -> dict[str, Any]:
    radial = {name: value[name] for name in ("k1", "k2", "k3", "k4")}
    shear = value["b2"] / (value["f"] + value["b1"])
    if kind == "frame":
        return {"model": "brown", **radial, "p1": value["p2"], "p2": value["p1"], "shear": shear}
    if kind in ("fisheye", "equidistant_fisheye"):
        if value["p1"] or value["p2"]:
            raise InputError("tangential distortion of a fisheye is not supported", where=where)
        return {"model": "fisheye", **radial, "shear": shear}
    raise InputError(f"cameras of the type '{kind}' are not supported", where=where, mend="frame and fisheye are")


def _numbers(text: str | None, count: int, what: str, where: str) -> FloatArray:
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise InputError(f"<{what}> is '{(text or '')[:60]}', not {count} finite numbers", where=where)
    return np.array(values)
