"""Curved flights as they are declared: a table of positions and attitudes over time, or an orbit."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, did_you_mean
from geomosaic.geo.crs import geographic, horizontal
from geomosaic.geo.local import LocalFrame, enu_axes, map_place
from geomosaic.geo.transform import Transform
from geomosaic_panoramic.curve import Poses
from geomosaic_panoramic.orbit import orbit_poses
from geomosaic_panoramic.read import number, word
from geomosaic_panoramic.track import Turn

COLUMNS = ("time", "x", "y", "z", "heading", "pitch", "roll")
ORBIT = ("inclination", "pass")
_FORWARD, _RIGHT, _DOWN = np.eye(3)
_UNIT = _FORWARD, _RIGHT, _DOWN


def read_table(file: Path, where: str) -> np.ndarray:
    """Rows of time (s), x, y, z, heading, pitch, roll (degrees) of a CSV file, (K, 7) in the order of time.

    Raises
    ------
    InputError
        The file cannot be read, lacks a column or holds what is no number.
    """
    place = f"{where} ({file})"
    try:
        with file.open(newline="", encoding="utf-8-sig") as stream:
            lines = [row for row in csv.reader(stream) if row and not row[0].lstrip().startswith("#")]
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"the track cannot be read ({error})", where=place, mend="check the name") from error
    header = [name.strip().lower() for name in lines[0]] if lines else []
    missing = [name for name in COLUMNS if name not in header]
    if missing:
        raise InputError(
            f"the track has no column {missing[0]}", where=place, mend=f"give {', '.join(COLUMNS)}, parted by commas"
        )
    order = [header.index(name) for name in COLUMNS]
    try:
        table = np.array([[float(row[i]) for i in order] for row in lines[1:]]).reshape(-1, len(COLUMNS))
    except (ValueError, IndexError) as error:
        raise InputError(f"a row of the track is not whole ({error})", where=place, mend="complete it") from error
    if len(table) < 2 or not np.isfinite(table).all() or not (np.diff(table[:, 0]) > 0.0).all():
        raise InputError(
            "the times of the track do not grow from row to row", where=place, mend="two rows or more, in order of time"
        )
    return table


def cover(tau: np.ndarray, half: float, where: str) -> None:
    """Refuse a track that is shorter than the image."""
    if tau[0] > -half + 1e-9 or tau[-1] < half - 1e-9:
        raise InputError(
            f"the track covers {tau[0]:.1f} to {tau[-1]:.1f} lines or sweeps about the middle of the image, which "
            f"takes {-half:.1f} to {half:.1f}",
            where=where,
            mend="check start_time, period and the clock of the track",
        )


def table_poses(table: np.ndarray, tau: np.ndarray, crs: CRS, frame: LocalFrame, *, grid: bool) -> Poses:
    """Poses of a table in a frame.

    Parameters
    ----------
    table : array (K, 7)
        See `read_table`; positions in `crs`.
    tau : array (K,)
    crs : CRS
        3-D.
    frame : LocalFrame
    grid : bool
        Whether headings count from grid north.
    """
    heading, pitch, roll = np.radians(table[:, 4:]).T
    if grid and horizontal(crs).is_projected:
        chosen = np.unique(np.linspace(0, len(table) - 1, 50).astype(int))
        turns = [map_place(crs, float(x), float(y)).convergence for x, y in table[chosen, 1:3]]
        heading = heading + np.radians(np.interp(np.arange(len(table)), chosen, turns))
    lonlat = Transform(crs, geographic(crs))(table[:, 1:4])
    enu = np.stack([enu_axes(longitude, latitude) for longitude, latitude in lonlat[:, :2]]) @ frame.axes.T
    axes = np.empty((len(table), 3, 3))
    for i in range(len(table)):
        turn = Turn(np.array([heading[i], pitch[i], roll[i]]), np.zeros(3))
        north, east, down = turn.undo(*_UNIT, np.zeros(3))
        axes[i] = np.column_stack([east, north, -down]) @ enu[i]
    places = frame.to_enu(Transform(crs, frame.crs)(table[:, 1:4]))
    return Poses(tau, places, axes)


def declared_orbit(options: Mapping[str, Any], frame: LocalFrame, half: float, where: str) -> Poses:
    """Poses of the orbit that the inputs `orbit` and `period` declare."""
    orbit = options["orbit"]
    if not isinstance(orbit, Mapping):
        raise InputError(f"input 'orbit' is no table: {orbit!r}", where=where, mend="give inclination and pass")
    for key in orbit:
        if key not in ORBIT:
            raise InputError(f"an orbit has no '{key}'", where=where, mend=did_you_mean(str(key), ORBIT) or "see docs")
    inclination = math.radians(number(orbit, "inclination", where))
    ascending = word(orbit, "pass", ("ascending", "descending"), where) == "ascending"
    period = number(options, "period", where)
    if period <= 0.0:
        raise InputError(f"period is {period:g} s", where=where, mend="give the seconds of one line or sweep")
    try:
        return orbit_poses(frame, inclination, ascending, period, half)
    except InputError as error:
        error.where = where
        raise
