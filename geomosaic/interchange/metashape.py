"""Metashape exports: XML cameras, and tables of omega, phi, kappa.

A camera's transform (4 × 4, row by row) takes camera axes (x right, y down, z forward) to the chunk or component; the
transform of the component, else of the chunk (rotation, translation, scale), takes that to geocentric coordinates of
the datum of the chunk's CRS, or to the local coordinates of a chunk without one. Calibration, after the manual
(Appendix "Camera models", frame cameras), with x = X/Z, y = Y/Z, r² = x² + y²:

    x' = x·(1 + K1·r² + K2·r⁴ + K3·r⁶ + K4·r⁸) + P1·(r² + 2x²) + 2·P2·x·y
    y' = y·(1 + K1·r² + K2·r⁴ + K3·r⁶ + K4·r⁸) + P2·(r² + 2y²) + 2·P1·x·y
    col = w/2 + cx + x'·(f + B1) + y'·B2,   row = h/2 + cy + y'·f

For fisheye cameras x, y are replaced by θ/r·(x, y), θ = arctan r, which is the equidistant lens of `fisheye.py`.

    # Cameras (2)
    # PhotoID, X, Y, Z, Omega, Phi, Kappa, r11, r12, r13, r21, r22, r23, r31, r32, r33

X, Y, Z are in the CRS of the export, and angles refer to its axes. The camera is not in the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
from pyproj import CRS
from pyproj.exceptions import CRSError

from geomosaic.errors import InputError, counted
from geomosaic.geo.crs import geocentric
from geomosaic.geo.local_frames import omega_phi_kappa
from geomosaic.interchange.files import number_text
from geomosaic.interchange.reconstruction import Reconstruction, Tables, pixel_camera
from geomosaic.sensor.inputs import finite_numbers, parse_xml
from geomosaic.types import FloatArray
from geomosaic.whole_files import check_rows

Cameras = dict[str, tuple[dict[str, Any], dict[str, Any]]]
CALIBRATION = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")


@lru_cache(maxsize=4)
def read_metashape(data: bytes, where: str) -> Cameras:
    """Oriented cameras of Metashape's XML export.

    Parameters
    ----------
    data : bytes
        Whole file.
    where : str
        Named in errors.

    Returns
    -------
    dict
        Label → camera table and orientation row.

    Raises
    ------
    InputError
        The XML is damaged, has entities, or is no export of cameras; a camera is of a kind that is not supported.
    """
    root = parse_xml(data, where)
    chunks = [root] if root.tag == "chunk" else root.findall("chunk")
    if not chunks:
        raise InputError("the XML has no <chunk>", where=where, hint="export the cameras from Metashape as XML")
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
        raise InputError("the file has no oriented camera", where=where, hint="align the photos first")
    return found


def _row(camera: Element, transform: Element | None, world: str, where: str) -> dict[str, Any]:
    if transform is None or transform.find("rotation") is None:
        raise InputError(
            "the chunk has no transform: it is not georeferenced",
            where=where,
            hint="give it coordinates of the cameras or markers in Metashape, and export again",
        )
    local = _numbers(camera, "transform", 16, where).reshape(4, 4)
    turn = _numbers(transform, "rotation", 9, where).reshape(3, 3)
    shift = _numbers(transform, "translation", 3, where)
    scale = float(_numbers(transform, "scale", 1, where)[0]) if transform.findtext("scale") else 1.0
    to_world = turn @ local[:3, :3]
    return {
        "system": "metashape",
        "rotation": to_world.T.ravel().tolist(),
        "position": (scale * turn @ local[:3, 3] + shift).tolist(),
        "world": world,
    }


def _camera(sensor: Element, where: str) -> dict[str, Any]:
    kind = sensor.get("type", _ORDINARY)
    calibrations = sensor.findall("calibration")
    best = [item for item in calibrations if item.get("class") == "adjusted"] or calibrations
    if not best:
        raise InputError("the sensor has no calibration", where=where, hint="export the cameras after alignment")
    size = best[0].find("resolution")
    size = sensor.find("resolution") if size is None else size
    if size is None:
        raise InputError("the sensor has no resolution", where=where)
    width, height = (finite_numbers([size.get(name, "")], 1, name, where)[0] for name in ("width", "height"))
    if best[0].find("fx") is not None:
        raise InputError(
            "the calibration has fx and fy, as versions before 1.2 wrote it, with another principal point",
            where=where,
            hint="open the project in a newer version and export again",
        )
    value = {
        name: float(_numbers(best[0], name, 1, where)[0]) if best[0].find(name) is not None else 0.0
        for name in CALIBRATION
    }
    if value["f"] <= 0.0:
        raise InputError(f"the focal length is {value['f']:g}", where=where)
    if value["p3"] or value["p4"]:
        raise InputError(
            "p3 and p4, of versions before 1.7, are not supported",
            where=where,
            hint="optimise the cameras without them, and export them again",
        )
    return {
        "size": [width, height],
        "focal_length_px": [value["f"] + value["b1"], value["f"]],
        "principal_point_px": [width / 2 + value["cx"], height / 2 + value["cy"]],
        "distortion": _lens(kind, value, where),
    }


def _perspective(value: Mapping[str, float], where: str) -> dict[str, Any]:
    return {"model": "brown", **_radial(value), "p1": value["p2"], "p2": value["p1"]}


def _fisheye(value: Mapping[str, float], where: str) -> dict[str, Any]:
    if value["p1"] or value["p2"]:
        raise InputError(
            "tangential distortion of a fisheye is not supported",
            where=where,
            hint="optimise the cameras without p1 and p2, and export them again",
        )
    return {"model": "fisheye", **_radial(value)}


def _radial(value: Mapping[str, float]) -> dict[str, float]:
    return {name: value[name] for name in ("k1", "k2", "k3", "k4")}


# Lens of each type of sensor.
_KINDS = {"frame": _perspective, "fisheye": _fisheye, "equidistant_fisheye": _fisheye}
_ORDINARY = next(iter(_KINDS))


def _lens(kind: str, value: Mapping[str, float], where: str) -> dict[str, Any]:
    if kind not in _KINDS:
        raise InputError(f"cameras of the type '{kind}' are not supported", where=where, hint="frame and fisheye are")
    return {**_KINDS[kind](value, where), "shear": value["b2"] / (value["f"] + value["b1"])}


def _numbers(parent: Element, name: str, count: int, where: str) -> FloatArray:
    return np.array(finite_numbers((parent.findtext(name) or "").split(), count, f"<{name}>", where))


# Largest difference of an element of the printed matrix, which has few digits, from that of the angles.
AGREE = 1e-4


@lru_cache(maxsize=4)
def read_metashape_text(text: str, where: str) -> dict[str, dict[str, Any]]:
    """Orientation rows of Metashape's text export.

    Parameters
    ----------
    text : str
        Whole file.
    where : str
        Named in errors.

    Returns
    -------
    dict
        Camera label → orientation row.

    Raises
    ------
    InputError
        It is no such list, or the printed matrix is not that of the angles; names the line.
    """
    if "omega, phi, kappa" not in text[:400].lower():
        raise InputError(
            "this is not Metashape's list of omega, phi, kappa: its header is missing",
            where=where,
            hint="export the cameras as 'Omega Phi Kappa' text or as XML; other tables are read with angles = 'opk'",
        )
    check_rows(text.count("\n"), where)
    found: dict[str, dict[str, Any]] = {}
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        here = f"{where}, line {number}"
        words = line.strip().split("\t") if "\t" in line else line.rsplit(maxsplit=15)
        if len(words) not in (7, 16):
            raise InputError(f"{counted(len(words), 'value')} where a camera has 7 or 16", where=here)
        values = finite_numbers(words[1:], len(words) - 1, "the row", here)
        m = omega_phi_kappa(*np.radians(values[3:6]))
        if len(values) == 15:
            printed = np.array(values[6:]).reshape(3, 3)
            off = min(float(np.abs(m - printed).max()), float(np.abs(m - printed.T).max()))
            if off > AGREE:
                raise InputError(
                    f"the printed matrix is not that of omega, phi, kappa: an element is off by {off:.1e}",
                    where=here,
                    hint="the export has other angles, or another unit: export omega, phi, kappa in degrees",
                )
        flipped = np.diag([1.0, -1.0, -1.0]) @ m
        found[words[0]] = {"system": "metashape", "rotation": flipped.ravel().tolist(), "position": values[:3]}
    return found


# Beginnings of the WKT of coordinates that are nowhere on the Earth.
LOCAL = ("LOCAL_CS", "ENGCRS", "ENGINEERINGCRS")


def world_of(found: Reconstruction, tables: Tables) -> Reconstruction:
    """Reconstruction with the CRS that the rows of `read_metashape` name, geocentric, or a note that they name none.

    Parameters
    ----------
    found : Reconstruction
        As its cameras were read.
    tables : Tables
        Rows of the images, of which each has the WKT of the chunk as its `world`.
    """
    text = next((str(row["world"]) for _, row in tables.values()), "")
    if text.lstrip().upper().startswith(LOCAL) or not text:
        return replace(found, notes=(*found.notes, "the chunk counts in local coordinates that are nowhere told"))
    try:
        return replace(found, crs=geocentric(CRS.from_wkt(text)).to_wkt())
    except (CRSError, InputError):
        return replace(found, notes=(*found.notes, f"the CRS of the chunk is not understood: {text[:60]}"))


def metashape_xml(found: Reconstruction) -> str:
    """Text of Metashape's XML of cameras; tie points have no place in it.

    Parameters
    ----------
    found : Reconstruction
        Geocentric where `crs` says so, east, north, up at its `reference`, or of local coordinates.

    Raises
    ------
    InputError
        A camera has no size, or a lens that Metashape has not; the CRS is a map.
    """
    frame = found.on_earth
    if frame is None and found.crs is not None:
        raise InputError(
            f"Metashape's chunks are geocentric, this reconstruction is in '{CRS.from_user_input(found.crs).name}'",
            where="reconstruction",
            hint="bring it to geocentric coordinates",
        )
    axes, origin = (np.eye(3), np.zeros(3)) if frame is None else (frame.axes.T, frame.origin)
    root = Element("document", version="2.0.0")
    chunk = SubElement(root, "chunk", label="Chunk 1", enabled="true")
    sensors, numbers = SubElement(chunk, "sensors", next_id=str(len(found.cameras))), {}
    for number, (name, table) in enumerate(found.cameras.items()):
        numbers[name] = str(number)
        _add_sensor(sensors, str(number), name, table)
    cameras = SubElement(chunk, "cameras", next_id=str(len(found.images)), next_group_id="0")
    for number, image in enumerate(found.images):
        found.camera_of(image)
        camera = SubElement(
            cameras, "camera", id=str(number), sensor_id=numbers[str(image.camera)], label=image.name, enabled="true"
        )
        if image.oriented:
            pose = np.eye(4)
            rotation, pose[:3, 3] = image.pose
            pose[:3, :3] = rotation.T
            SubElement(camera, "transform").text = number_text(pose)
    transform = SubElement(chunk, "transform")
    for tag, values in (("rotation", axes), ("translation", origin), ("scale", np.ones(1))):
        SubElement(transform, tag).text = number_text(values)
    # Of a geocentric CRS Metashape takes the datum: its own default is the same axes.
    text = 'LOCAL_CS["Local Coordinates (m)",UNIT["metre",1]]' if frame is None else frame.crs.to_wkt("WKT1_GDAL")
    SubElement(chunk, "reference").text = text
    indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root, encoding="unicode") + "\n"


def _add_sensor(sensors: Element, number: str, name: str, table: Mapping[str, Any]) -> None:
    """Entry of a camera table."""
    where = f"camera {name}"
    camera = pixel_camera(table, where)
    radial = ("k1", "k2", "k3", "k4")
    camera.known_only(
        "Metashape", where, none=("shear",), brown=(*radial, "p1", "p2", "shear"), fisheye=(*radial, "shear")
    )
    kind = camera.model if camera.model in _KINDS else _ORDINARY
    width, height = map(str, camera.known_size(where))
    sensor = SubElement(sensors, "sensor", id=number, label=name, type=kind)
    SubElement(sensor, "resolution", width=width, height=height)
    calibration = SubElement(sensor, "calibration", {"class": "adjusted"}, type=kind)
    SubElement(calibration, "resolution", width=width, height=height)
    along, across = camera.focal
    x, y = camera.from_middle
    values = {"f": across, "cx": x, "cy": y, "b1": along - across, "b2": camera.shear * along}
    values |= {key: camera.lens.get(key, 0.0) for key in radial}
    values |= {"p1": camera.lens.get("p2", 0.0), "p2": camera.lens.get("p1", 0.0)}
    for tag, value in values.items():
        if value or tag == "f":
            SubElement(calibration, tag).text = repr(float(value))
