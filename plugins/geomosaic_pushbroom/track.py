"""An airborne strip: a table of positions and attitudes over time, and a plain line camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, SensorInputError
from geomosaic.geo.crs import geocentric, geographic
from geomosaic.geo.local_frames import enu_axes, map_place
from geomosaic.geo.transform import Transform
from geomosaic.sensor.inputs import choice, number, positive
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.types import FloatArray
from geomosaic.whole_files import read_records
from geomosaic_pushbroom.paths import TrackPath
from geomosaic_pushbroom.platform import ReportedFlight, omega_phi_kappa
from geomosaic_pushbroom.points import need_crs
from geomosaic_pushbroom.pose import LookDirections, quaternions_of
from geomosaic_pushbroom.scene_metadata import AprioriSigmas

# Boresight before it is calibrated; drift of a gyroscope; lever arm and GNSS.
AIRBORNE = AprioriSigmas(angles=0.5, rates=1e-3, position=1.0)
PLACE = ("time", "x", "y", "z")
SYSTEMS = {"rpy": ("roll", "pitch", "heading"), "opk": ("omega", "phi", "kappa")}
SIDES = {"right": 1.0, "left": -1.0}
UNITS = {"deg": np.pi / 180.0, "gon": np.pi / 200.0, "rad": 1.0}


# Inputs without which a track makes no model.
NEEDED = {
    "focal_length_px": "camera constant in pixels",
    "start_time": "time of the first row's middle in the clock of the track, s",
    "line_period": "time from one row to the next, s",
    "columns": "right or left, the side of the flight to which columns grow",
}


def read_track(request: SensorRequest) -> tuple[ReportedFlight, LookDirections, AprioriSigmas]:
    """Flight, look directions and a-priori sigmas of an airborne strip.

    Parameters
    ----------
    request : SensorRequest
        Size in pixels, CRS of the positions, and the options of a track, see `NEEDED`.

    Returns
    -------
    flight : ReportedFlight
    look : LookDirections
    sigmas : AprioriSigmas

    Raises
    ------
    InputError
        The table, the camera or the times are missing or wrong.
    """
    where, options = request.image, request.options
    for name, text in NEEDED.items():
        if options.get(name) is None:
            raise SensorInputError(
                f"'{name}' is missing, which a strip with a track needs",
                name=name,
                where=where,
                hint=f"give {name}: {text}",
            )
    unit = choice(options.get("angle_unit", "deg"), UNITS, "angle_unit", where)
    if not isinstance(options["track"], str):
        raise InputError(
            f"track = {options['track']!r} is not a file name",
            where=where,
            hint="give the name of a table: track = 'orbit.csv'",
        )
    period = positive(options["line_period"], "line_period", where)
    width, rows = request.size
    file = Path(request.base) / options["track"]
    try:
        system, table = _table(file)
    except InputError as error:
        error.where = f"{where} ({error.where})"
        raise
    first = number(options["start_time"], "start_time", where)
    middle = 0.5 * rows
    # The first row's middle is scanned at `first`; t = 0 is the middle of the strip, row `middle`.
    times = table[:, 0] - (first + (middle - 0.5) * period)
    _need_cover(times, middle * period, f"{where} ({file})")
    crs = need_crs(request)
    positions, axes = poses(crs, table[:, 1:4], system, table[:, 4:] * UNITS[unit], f"{where} ({file})")
    path = TrackPath(times, positions, quaternions_of(axes.transpose(0, 2, 1)))
    focal = positive(options["focal_length_px"], "focal_length_px", where)
    centre = options.get("principal_col")
    principal = width / 2.0 if centre is None else number(centre, "principal_col", where)
    side = SIDES[choice(options["columns"], SIDES, "columns", where)]
    sides = np.array([0.0, float(width)])
    look = LookDirections(sides, (sides - principal) * (side / focal), np.zeros(2))
    return ReportedFlight(path, period, middle), look, AIRBORNE


def _table(file: Path) -> tuple[str, FloatArray]:
    """Angle system and rows of time, x, y, z and three angles, in the order of time."""
    where = str(file)
    lines = read_records(file, "track")
    header = [name.strip().lower() for name in lines[0]] if lines else []
    system = next((name for name, angles in SYSTEMS.items() if set(angles) <= set(header)), None)
    if system is None or not set(PLACE) <= set(header):
        raise InputError(
            f"the columns of the track are {', '.join(header) or 'none'}",
            where=where,
            hint="give time, x, y, z, and roll, pitch, heading or omega, phi, kappa, separated by commas",
        )
    columns = [header.index(name) for name in (*PLACE, *SYSTEMS[system])]
    rows = []
    for number_of_row, row in enumerate(lines[1:], 1):
        if len(row) != len(header):
            raise InputError(
                f"row {number_of_row} has {len(row)} values, the header {len(header)}", where=where, hint="complete it"
            )
        rows.append([number(row[i], f"row {number_of_row}, {header[i]}", where) for i in columns])
    table = np.array(rows, dtype=np.float64).reshape(len(rows), 7)
    if len(table) < 2 or not (np.diff(table[:, 0]) > 0.0).all():
        raise InputError(
            "the times of the track do not grow from row to row", where=where, hint="two rows or more, in order of time"
        )
    return system, table


def _need_cover(times: FloatArray, half: float, where: str) -> None:
    """Check that the track covers `half` seconds before and after the middle of the strip."""
    if times[0] > -half or times[-1] < half:
        raise InputError(
            f"the track covers {times[0]:.3f} to {times[-1]:.3f} s about the middle of the strip, which takes "
            f"{-half:.3f} to {half:.3f} s",
            where=where,
            hint="check start_time, line_period and the clock of the track",
        )


def poses(crs: CRS, xyz: FloatArray, system: str, angles: FloatArray, where: str) -> tuple[FloatArray, FloatArray]:
    """Geocentric positions and axes of a track.

    Parameters
    ----------
    crs : CRS
        3-D, of the positions.
    xyz : array (K, 3)
        In `crs`.
    system : str
        'rpy': roll (right wing down), pitch (nose up), heading (clockwise from true north), turned in the order
        heading, pitch, roll. 'opk': M = R3(κ)·R2(φ)·R1(ω) from grid axes to right, forward, up.
    angles : array (K, 3)
        Radians.
    where : str
        Named in errors.

    Returns
    -------
    positions : array (K, 3)
        Geocentric metres.
    axes : array (K, 3, 3)
        Rows right, forward, up in geocentric components.

    Raises
    ------
    InputError
        A position lies outside the CRS.
    """
    to_geographic = Transform(crs, geographic(crs))
    places = to_geographic(xyz)
    positions = Transform(crs, geocentric(crs))(xyz)
    if not np.isfinite(positions).all():
        raise InputError("positions of the track lie outside the CRS", where=where, hint="check the CRS and its axes")
    enu = np.stack([enu_axes(longitude, latitude) for longitude, latitude, _ in places])
    if system == "rpy":
        return positions, _aircraft(*angles.T) @ enu
    matrices = omega_phi_kappa(*angles.T)
    if crs.is_projected:
        zero = np.zeros(len(xyz))
        # Omega, phi, kappa refer to grid axes, which differ from east and north by the meridian convergence.
        matrices = matrices @ omega_phi_kappa(zero, zero, -_convergence(crs, xyz))
    return positions, matrices @ enu


def _convergence(crs: CRS, xyz: FloatArray) -> FloatArray:
    """Meridian convergence (K,) in radians, linear between about a hundred of the places."""
    chosen = np.unique(np.linspace(0, len(xyz) - 1, 100).astype(int))
    known = [map_place(crs, float(x), float(y)).convergence for x, y in xyz[chosen, :2]]
    return np.radians(np.interp(np.arange(len(xyz)), chosen, known))


def _aircraft(roll: FloatArray, pitch: FloatArray, heading: FloatArray) -> FloatArray:
    """Rows right, forward, up (N, 3, 3) in east, north, up."""
    cr, sr, cp, sp, ch, sh = (f(a) for a in (roll, pitch, heading) for f in (np.cos, np.sin))
    zero = np.zeros_like(cr)
    level_right = np.stack([ch, -sh, zero], axis=1)
    forward = np.stack([sh * cp, ch * cp, sp], axis=1)
    level_up = np.stack([-sh * sp, -ch * sp, cp], axis=1)
    c, s = cr[:, None], sr[:, None]
    return np.stack([c * level_right - s * level_up, forward, s * level_right + c * level_up], axis=1)
