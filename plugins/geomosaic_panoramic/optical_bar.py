"""Optical bar cameras of the Ames Stereo Pipeline (.tsai): panoramic cameras of satellites, such as KH-4 and KH-9.

Pixels count from the centre of the first, lengths are metres, axes geocentric. With α = (col − c)·p / f, c and r the
image centre, p the pitch of the pixels, the ray of a pixel in the camera's axes right, down the image and outwards is

    (f·sin α, (row − r)·p ± k·sin α, f·cos α)

which iR turns to the Earth's; + where the scan runs to the right. The camera moves straight on while it scans, from iC
at the first pixel centre of the scan to the last. Files with `velocity` hold the whole way, and k = f·F with the
compensation factor F; others hold the speed along the image's rows before the forward tilt, and k = f·F·v / (ω·H) with
the rate ω of the scan and the height H above the mean surface (OpticalBarModel of NASA's Vision Workbench).
"""

from __future__ import annotations

import math

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import geographic
from geomosaic.geo.local_frames import LocalFrame, r1, require_rotation
from geomosaic.geo.transform import Transform
from geomosaic.sensor.inputs import finite_numbers
from geomosaic.types import FloatArray
from geomosaic_panoramic.geometry import Scan

_NUMBERS = {
    "image_size": 2, "image_center": 2, "pitch": 1, "f": 1, "scan_time": 1, "forward_tilt": 1, "iC": 3, "iR": 9,
    "speed": 1, "mean_earth_radius": 1, "mean_surface_elevation": 1, "motion_compensation_factor": 1, "velocity": 3,
}  # fmt: skip
_POSITIVE = ("image_size", "pitch", "f", "scan_time", "mean_earth_radius")
_DIRECTIONS = {"right": 1.0, "left": -1.0}
_INSTEAD = "make RPCs of it with cam2rpc of the Ames Stereo Pipeline, and use the sensor 'rpc' with them"


def read_optical_bar(text: str, size: tuple[int, int], where: str) -> tuple[Scan, LocalFrame, FloatArray, float]:
    """Scan, frame and parameters of an optical bar camera.

    Parameters
    ----------
    text : str
        Whole file.
    size : tuple of int
        Width and height of the image, pixels.
    where : str
        Named in errors.

    Returns
    -------
    scan : Scan
    frame : LocalFrame
        At the camera in the middle of the scan.
    values : array (15,)
        Of `geomosaic_panoramic.model.NAMES`.
    above : float
        Height of the camera above the mean surface, metres.

    Raises
    ------
    InputError
        It is no optical bar camera, lacks a value or has one that is not known here, or is of an image of another size.
    """
    given, direction = _values(text, where)
    width, height = (int(side) for side in given["image_size"])
    if (width, height) != size:
        raise InputError(
            f"the camera is of an image of {width} x {height} pixels, and this one has {size[0]} x {size[1]}",
            where=where,
            hint=f"of a copy k = {width / size[0]:.4g} times as coarse, divide image_size by k, multiply pitch by it, "
            "and make (image_center + 0.5) / k - 0.5 of image_center",
        )
    focal, pitch = float(given["f"][0]), float(given["pitch"][0])
    turn = given["iR"].reshape(3, 3)
    require_rotation(turn, "iR", where)
    seconds, speed = given["scan_time"][0], given["speed"][0]
    way = given.get("velocity", np.zeros(3))
    of_speed = not way.any()
    if of_speed:
        # Turned by the tilt about the camera's x axis; r1 turns the axes, and so a vector the other way.
        way = seconds * (turn @ r1(-given["forward_tilt"][0]) @ np.array([0.0, speed, 0.0]))
    middle = given["iC"] + way / 2
    earth = CRS.from_epsg(4978)
    frame = LocalFrame.at(earth, middle)
    compensation = given["motion_compensation_factor"][0]
    if of_speed:
        # H changes by tens of metres while the camera scans, rows by hundredths of a pixel: that of the middle serves.
        over = float(np.linalg.norm(middle) - given["mean_earth_radius"][0] - given["mean_surface_elevation"][0])
        compensation *= speed * seconds / (over * (width - 1) * pitch / focal)
    above = float(Transform(earth, geographic(earth))(middle[None])[0, 2] - given["mean_surface_elevation"][0])
    if above <= 0.0:
        raise InputError("iC lies below the mean surface", where=where, hint="give geocentric metres")
    # Rows of `axes` are east, north, up: columns of the product are forward, right and down in these.
    forward, right, down = (frame.axes @ np.column_stack([-turn[:, 1], turn[:, 0], turn[:, 2]])).T
    attitude = (
        math.atan2(forward[0], forward[1]),
        math.atan2(forward[2], math.hypot(forward[0], forward[1])),
        math.atan2(-right[2], -down[2]),
    )
    # The way is from the first pixel's centre to the last; our unit is the whole width, from edge to edge.
    per_sweep = direction * (frame.axes @ way) * width / (width - 1)
    values = np.array([
        0.0, 0.0, 0.0, *per_sweep, *np.degrees(attitude), 0.0, 0.0, 0.0, math.degrees(pitch / focal), focal / pitch,
        -direction * compensation * focal / pitch,
    ])  # fmt: skip
    col, row = given["image_center"] + 0.5
    return Scan("panoramic", size, 1, centre=(float(col), float(row))), frame, values, above


def _values(text: str, where: str) -> tuple[dict[str, FloatArray], float]:
    """Numbers of the file by name, and 1 where the scan runs to the right, −1 to the left."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    if "OPTICAL_BAR" not in lines[:3]:
        raise InputError(
            "this is no optical bar camera: OPTICAL_BAR is not among its first lines",
            where=where,
            hint="pinhole cameras are of the sensor 'frame': `exterior` is the file, `angles` is tsai",
        )
    pairs = {name.strip(): rest.strip() for name, sign, rest in (line.partition("=") for line in lines) if sign}
    direction = _DIRECTIONS.get(pairs.pop("scan_dir", "right"))
    unknown = [name for name in pairs if name not in _NUMBERS]
    if unknown or direction is None:
        what = f"{unknown[0][:40]} is not known here" if unknown else "scan_dir is neither right nor left"
        raise InputError(what, where=where, hint=_INSTEAD)
    found = {}
    for name, count in _NUMBERS.items():
        if name == "velocity" and name not in pairs:
            continue
        found[name] = np.array(finite_numbers(pairs.get(name, "").split(), count, name, where))
        if name in _POSITIVE and not (found[name] > 0.0).all():
            raise InputError(f"{name} is '{pairs[name][:40]}', not above 0", where=where, hint="give positive numbers")
    return found, direction
