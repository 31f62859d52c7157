"""Exterior rotation from the angle systems in use: named readers, none of which guesses.

Every reader gives the ground→image rotation M of this program: ground axes east, north, up; image axes x right, y up,
the camera looking along −z. What "east, north" mean is the frame, see `Attitude`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.local_frames import angle_axis, omega_phi_kappa, r1, r2, r3, require_rotation
from geomosaic.sensor.inputs import choice, known_keys, need, number, numbers
from geomosaic.types import FloatArray
from geomosaic_frame.other_programs import read_pose

FULL_CIRCLE = {"deg": 360.0, "gon": 400.0, "rad": 2.0 * np.pi}
FRAMES = ("grid", "local")
DIRECTIONS = ("ground_to_image", "image_to_ground")
MATRIX = tuple(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))

# North, east, down ↔ east, north, up; and body axes (forward, right, down) ↔ image axes of a camera that looks down.
_SWAP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# Body axes ↔ image axes of a camera that looks forward: x right = body y, y up = −body z, z backwards = −body x.
_FORWARD = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
# Axes x right, y down, z forward ↔ x right, y up, z backwards.
FLIP = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Attitude:
    """Attitude of a photo: rotation and the frame it refers to.

    Attributes
    ----------
    rotation : array (3, 3)
        Ground → image, x right, y up.
    frame : str
        'grid' (axes of the map), 'local' (true north), 'topocentric' (that of a reference), 'offset' (grid, counted
        from the reference's map coordinates), 'map' (grid axes, position in the CRS) or 'geocentric'.
    position : array (3,), optional
        Projection centre in that frame where the system gives it.
    crs : CRS, optional
        Geocentric CRS of a geocentric frame, where the file names it.
    """

    rotation: FloatArray
    frame: str
    position: FloatArray | None = None
    crs: CRS | None = None


@dataclass(frozen=True, eq=False)
class AngleSystem:
    """Angle system: a named convention for the attitude of a photo.

    Attributes
    ----------
    name : str
    text : str
        Description.
    columns : tuple of str
        Values that must be given.
    frame : str
        Frame it refers to unless declared otherwise.
    read : callable
        (row, angle unit, where) → Attitude.
    optional : tuple of str
        Values that may be given.
    """

    name: str
    text: str
    columns: tuple[str, ...]
    frame: str
    read: Callable[[Mapping[str, Any], str, str], Attitude]
    optional: tuple[str, ...] = ()


def _angles(row: Mapping[str, Any], names: tuple[str, ...], unit: str, where: str) -> list[float]:
    """Angles of a row in radians; an error names one that is missing or beyond a full circle, and the unit meant."""
    values = {name: number(need(row, name, where, f"an angle in {unit}"), name, where) for name in names}
    limit = FULL_CIRCLE[unit]
    for name, value in values.items():
        if abs(value) > limit * (1.0 + 1e-9):
            raise InputError(
                f"{name} = {value:g} is more than a full circle in {unit} ({limit:g})",
                where=where,
                hint=_unit(value, unit),
            )
    return [2.0 * np.pi * value / limit for value in values.values()]


def _unit(value: float, unit: str) -> str:
    fits = [f"'{name}'" for name, full in FULL_CIRCLE.items() if name != unit and abs(value) <= full]
    if not fits:
        return "check the value and its column"
    return f"the unit is probably {' or '.join(fits)}: set angle_unit"


def _opk(row: Mapping[str, Any], unit: str, where: str) -> Attitude:
    omega, phi, kappa = _angles(row, ("omega", "phi", "kappa"), unit, where)
    return Attitude(omega_phi_kappa(omega, phi, kappa), "grid")


def _pok(row: Mapping[str, Any], unit: str, where: str) -> Attitude:
    phi, omega, kappa = _angles(row, ("phi", "omega", "kappa"), unit, where)
    return Attitude(r3(kappa) @ r1(omega) @ r2(phi), "grid")


def _matrix(row: Mapping[str, Any], unit: str, where: str) -> Attitude:
    """Nine elements row by row; refused unless they are a rotation, and unless given angles agree."""
    direction = choice(
        need(row, "matrix", where, f"the direction of the matrix, one of {', '.join(DIRECTIONS)}"),
        DIRECTIONS,
        "matrix",
        where,
    )
    values = [number(need(row, key, where, "an element of the rotation matrix"), key, where) for key in MATRIX]
    printed = np.array(values).reshape(3, 3)
    mend = "give the elements row by row with at least 7 decimals; check the order of rows and columns and the signs"
    rotation = require_rotation(printed, "r11 to r33", where, 1e-6, mend)
    rotation = rotation if direction == "ground_to_image" else rotation.T
    given = [name for name in ("omega", "phi", "kappa") if name in row]
    if given:
        off = float(np.abs(_opk(row, unit, where).rotation - rotation).max())
        if off > 1e-6:
            raise InputError(
                f"the matrix and omega, phi, kappa disagree by {off:.1e} in an element",
                where=where,
                hint="check matrix = 'ground_to_image' or 'image_to_ground' and the angle system, or leave the angles "
                "out",
            )
    return Attitude(rotation, "grid")


def _platform(yaw: float, pitch: float, roll: float) -> FloatArray:
    """Body (forward, right, down) → north, east, down: Rz(yaw)·Ry(pitch)·Rx(roll), active; angles in radians."""
    return (r1(roll) @ r2(pitch) @ r3(yaw)).T


def _rpy(row: Mapping[str, Any], unit: str, where: str) -> Attitude:
    roll, pitch, yaw = _angles(row, ("roll", "pitch", "yaw"), unit, where)
    return Attitude(_SWAP @ _platform(yaw, pitch, roll).T @ _SWAP, "local")


def _dji(row: Mapping[str, Any], unit: str, where: str) -> Attitude:
    yaw, pitch, roll = _angles(row, ("gimbal_yaw", "gimbal_pitch", "gimbal_roll"), unit, where)
    return Attitude(_FORWARD @ _platform(yaw, pitch, roll).T @ _SWAP, "local")


def _shot(row: Mapping[str, Any], unit: str, where: str, frame: str) -> Attitude:
    """Rotation vector in radians whatever the angle unit, as the files have it."""
    vector = numbers(need(row, "rotation", where, "rotation vector world → camera"), 3, "rotation", where)
    shift = numbers(need(row, "translation", where, "translation world → camera"), 3, "translation", where)
    to_camera = angle_axis(np.array(vector))
    return Attitude(FLIP @ to_camera, frame, -to_camera.T @ np.array(shift))


def _pose(row: Mapping[str, Any], unit: str, where: str) -> Attitude:
    rotation, position, frame, crs = read_pose(row, where)
    return Attitude(FLIP @ rotation, frame, position, crs)


SYSTEMS: Mapping[str, AngleSystem] = {
    system.name: system
    for system in (
        AngleSystem("opk", "R3(kappa) R2(phi) R1(omega), ground to image", ("omega", "phi", "kappa"), "grid", _opk),
        AngleSystem(
            "pok",
            "phi first: R3(kappa) R1(omega) R2(phi), ground to image",
            ("phi", "omega", "kappa"),
            "grid",
            _pok,
        ),
        AngleSystem(
            "matrix",
            "rotation matrix row by row; its direction is declared with matrix = 'ground_to_image' or "
            "'image_to_ground'",
            (*MATRIX, "matrix"),
            "grid",
            _matrix,
            ("omega", "phi", "kappa"),
        ),
        AngleSystem(
            "patb",
            "the matrix printed in a PATB orientation file; its direction is declared as for 'matrix'",
            (*MATRIX, "matrix"),
            "grid",
            _matrix,
            ("omega", "phi", "kappa"),
        ),
        AngleSystem(
            "rpy",
            "aircraft roll (right wing down), pitch (nose up), yaw (clockwise from north) of a camera that looks down, "
            "image top forward",
            ("roll", "pitch", "yaw"),
            "local",
            _rpy,
        ),
        AngleSystem(
            "dji",
            "gimbal yaw (clockwise from north), pitch (-90 looks down, 0 to the horizon), roll",
            ("gimbal_yaw", "gimbal_pitch", "gimbal_roll"),
            "local",
            _dji,
        ),
        AngleSystem(
            "opensfm",
            "rotation vector and translation world to camera (x right, y down, z forward) in the east-north-up frame "
            "at reference = [longitude, latitude, altitude]",
            ("rotation", "translation", "reference"),
            "topocentric",
            partial(_shot, frame="topocentric"),
        ),
        AngleSystem(
            "odm",
            "as opensfm, but in map axes about the reference: OpenDroneMap's reconstruction.json, which it has "
            "brought to its UTM zone (its reconstruction.topocentric.json is opensfm)",
            ("rotation", "translation", "reference"),
            "offset",
            partial(_shot, frame="offset"),
        ),
        *(
            AngleSystem(
                name,
                f"{what}: world to camera (x right, y down, z forward); world = map, geocentric or local",
                ("rotation", "position", "world"),
                "world",
                _pose,
                ("reference",),
            )
            for name, what in (
                ("colmap", "COLMAP's images.txt, with cameras.txt beside it"),
                ("pix4d", "Pix4D's calibrated camera parameters, with their offset beside them"),
                ("metashape", "cameras of Metashape, as XML or as omega, phi, kappa"),
                ("ori", "IGN's orientations, IMAGE.ori.xml for each image"),
                ("tsai", "pinhole cameras of the Ames Stereo Pipeline, IMAGE.tsai for each image"),
            )
        ),
    )
}


def read_attitude(row: Mapping[str, Any], unit: str, where: str) -> Attitude:
    """Attitude of a row {column: value} that names its `system`.

    Parameters
    ----------
    row : mapping
        `system`, the columns of that system, and `frame` ('grid' or 'local') where it differs from the system's own.
    unit : str
        'deg', 'gon' or 'rad'.
    where : str
        Image, named in errors.

    Raises
    ------
    InputError
        System, column or value are unknown, missing or out of range.
    """
    name = choice(need(row, "system", where, f"one of {', '.join(SYSTEMS)}"), SYSTEMS, "system", where)
    system = SYSTEMS[name]
    allowed = {"system", *system.columns, *system.optional}
    if system.frame in FRAMES:
        allowed.add("frame")
    known_keys(row, sorted(allowed), where)
    attitude = system.read(row, unit, where)
    frame = choice(row["frame"], FRAMES, "frame", where) if "frame" in row else attitude.frame
    return Attitude(attitude.rotation, frame, attitude.position, attitude.crs)
