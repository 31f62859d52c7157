"""Radar scenes of any mission as a JSON table, from which and into which other formats can be turned by hand."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.sensor.inputs import choice, known_keys, need, number, numbers, positive, table_of
from geomosaic.types import FloatArray
from geomosaic_sar.calibration import QUANTITIES, PixelTable, SarCalibration, ThermalNoise
from geomosaic_sar.geometry import GroundRange, SlantRange
from geomosaic_sar.orbit import StateVectors
from geomosaic_sar.scene import RadarScene, checked_geometry, growing, orbit_note

KEYS = (
    "title",
    "size",
    "looking",
    "first_row_time",
    "row_interval",
    "slant_range",
    "ground_range",
    "orbit",
    "ground_height",
    "calibration",
)
SIDES = {"right": 1, "left": -1}
# Orders of the polynomials of ground range, and records of a table: annotations have some ten of both.
_MOST_POWERS, _MOST_RECORDS = 12, 10_000


def read_table(text: str, where: str) -> RadarScene:
    """Radar scene of a JSON table.

    Parameters
    ----------
    text : str
        Content of the file; its keys are described in the docs (radar, JSON table).
    where : str
        File, named in errors.

    Raises
    ------
    InputError
        It is no JSON, or a value is missing, unknown or out of range.
    """
    try:
        table = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"this is no JSON ({str(error)[:80]})", where=where, hint="correct it") from None
    table = table_of(table, "the file", where)
    known_keys(table, KEYS, where)
    size = numbers(need(table, "size", where, _SIZE), 2, "size", where)
    width, height = (int(value) for value in size)
    if size != (width, height) or min(size) < 1:
        raise InputError(
            f"size = {list(size)} is no size of an image", where=where, hint=f"give {_SIZE}, whole numbers"
        )
    looking = choice(need(table, "looking", where, "right or left of the flight"), SIDES, "looking", where)
    first = number(
        need(table, "first_row_time", where, "zero-Doppler time of the first row, seconds"), "first_row_time", where
    )
    interval = positive(need(table, "row_interval", where, "seconds from row to row"), "row_interval", where)
    # A time since 1970 has 7 digits after the point, one since the scene began has 14.
    epoch = math.floor(first)
    states = _states(table_of(need(table, "orbit", where, _ORBIT), "orbit", where), epoch, where)
    if ("slant_range" in table) == ("ground_range" in table):
        raise InputError(
            "one of slant_range and ground_range must be given",
            where=where,
            hint="slant_range = {near, spacing} in metres, or ground_range = {first, spacing, polynomials}",
        )
    axis: SlantRange | GroundRange
    if "slant_range" in table:
        slant = table_of(table["slant_range"], "slant_range", where)
        known_keys(slant, ("near", "spacing"), f"{where}, slant_range")
        near, spacing = (
            positive(need(slant, key, where, "metres"), f"slant_range, {key}", where) for key in ("near", "spacing")
        )
        axis = SlantRange(near, spacing)
    else:
        axis = _ground_range(table_of(table["ground_range"], "ground_range", where), width, epoch, where)
    geometry = checked_geometry(states, (width, height), (first - epoch, interval), SIDES[looking], axis, where)
    title = str(table.get("title", "radar scene"))[:100]
    ground = number(table.get("ground_height", 0.0), "ground_height", where)
    known = {} if "calibration" not in table else {"": _calibration(table["calibration"], where)}
    return RadarScene(title, (width, height), geometry, (orbit_note(geometry.orbit),), ground, calibrations=known)


def _calibration(value: Any, where: str) -> SarCalibration:
    """Quantity = factor · (DN² − noise), the factor one number or linear between some columns."""
    table, where = table_of(value, "calibration", where), f"{where}, calibration"
    known_keys(table, ("quantity", "factor", "columns", "noise"), where)
    quantity = choice(need(table, "quantity", where, " or ".join(QUANTITIES)), QUANTITIES, "quantity", where)
    given = need(table, "factor", where, "of squared amplitudes, one number or one at each of `columns`")
    if "columns" in table:
        count = len(given) if isinstance(given, list) and 0 < len(given) <= _MOST_RECORDS else 1
        columns = growing(numbers(table["columns"], count, "columns", where), "columns", where)
        factors = np.array([positive(one, "factor", where) for one in numbers(given, count, "factor", where)])
        amplitude = PixelTable(columns, np.zeros(1), factors[None] ** -0.5)
    else:
        amplitude = PixelTable.constant(positive(given, "factor", where) ** -0.5)
    noise = None if "noise" not in table else positive(table["noise"], "noise", where)
    return SarCalibration(quantity, amplitude, None if noise is None else ThermalNoise(PixelTable.constant(noise)))


_SIZE = "[width, height] in whole pixels"
_ORBIT = "{times, positions, velocities} of the state vectors"


def _states(orbit: Mapping[str, Any], epoch: float, where: str) -> StateVectors:
    known_keys(orbit, ("times", "positions", "velocities"), f"{where}, orbit")
    rows = need(orbit, "times", where, "seconds from the same epoch as first_row_time")
    count = len(rows) if isinstance(rows, list) and len(rows) <= _MOST_RECORDS else 0
    times = np.array(numbers(rows, count, "orbit, times", where)) - epoch
    positions = _vectors(need(orbit, "positions", where, "[x, y, z] of each state"), count, "orbit, positions", where)
    given = orbit.get("velocities")
    velocities = None if given is None else _vectors(given, count, "orbit, velocities", where)
    return StateVectors.checked(times, positions, velocities, where)


def _vectors(value: Any, count: int, key: str, where: str) -> FloatArray:
    if not isinstance(value, list) or len(value) != count:
        raise InputError(f"{key} is no list of {count} vectors", where=where, hint="give one [x, y, z] for each time")
    return np.array([numbers(vector, 3, key, where) for vector in value]).reshape(-1, 3)


def _ground_range(table: Mapping[str, Any], width: int, epoch: float, where: str) -> GroundRange:
    """Columns over ground range, and the slant ranges at which they begin and end."""
    known_keys(table, ("first", "spacing", "polynomials"), f"{where}, ground_range")
    first = number(table.get("first", 0.0), "ground_range, first", where)
    spacing = positive(need(table, "spacing", where, "metres"), "ground_range, spacing", where)
    records = need(table, "polynomials", where, "list of {time, origin, coefficients}")
    if not isinstance(records, list) or not 0 < len(records) <= _MOST_RECORDS:
        raise InputError("ground_range, polynomials is no list of them", where=where, hint="give one or more")
    times, origins, rows = [], [], []
    for record in records:
        known_keys(table_of(record, "polynomials", where), ("time", "origin", "coefficients"), f"{where}, polynomials")
        time = number(need(record, "time", where, "azimuth time, seconds"), "polynomials, time", where)
        times.append(time - epoch)
        origins.append(number(need(record, "origin", where, "slant range, metres"), "polynomials, origin", where))
        given = need(record, "coefficients", where, "lowest power first")
        count = len(given) if isinstance(given, list) else 0
        rows.append(numbers(given, min(count, _MOST_POWERS), "polynomials, coefficients", where))
    return ground_range(growing(times, "polynomials", where), origins, rows, (first, spacing), width, where)


def ground_range(
    times: FloatArray,
    origins: list[float],
    coefficients: list[tuple[float, ...]],
    columns: tuple[float, float],
    width: int,
    where: str,
) -> GroundRange:
    """Columns over ground range, from polynomials that grow over the scene.

    Parameters
    ----------
    times : array (T,)
        Azimuth times of the polynomials, seconds from the epoch.
    origins : list of float
        Slant range from which each counts, metres.
    coefficients : list of tuple of float
        Ground range in metres by powers of slant range, lowest first.
    columns : tuple of float
        Ground range of the first column, and from one to the next, metres.
    width : int
        Columns.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        The polynomials do not give each column a slant range.
    """
    first, spacing = columns
    count = max(map(len, coefficients))
    table = np.array([[*row, *[0.0] * (count - len(row))] for row in coefficients])
    ends = np.array([first, first + (width - 1) * spacing])
    reach = np.array([_slant(row, origin, ends) for row, origin in zip(table, origins, strict=True)])
    low, high = float(reach[:, 0].min()), float(reach[:, 1].max())
    axis = GroundRange(times, np.array(origins), table, first, spacing, (low, high))
    if np.isfinite(reach).all() and low > 0.0 and high > low:
        u = np.linspace(low, high, 50)
        if all((axis.columns(u, np.full(len(u), time))[1] > 0.0).all() for time in times):
            return axis
    raise InputError(
        "the polynomials of ground range do not grow with slant range over the columns of the scene",
        where=where,
        hint="they must give ground range in metres from slant range in metres, lowest power first",
    )


def _slant(coefficients: FloatArray, origin: float, ground: FloatArray) -> FloatArray:
    """Slant ranges (M,) of ground ranges (M,), NaN where Newton's method from the origin does not find them."""
    value = np.polynomial.Polynomial(coefficients)
    slope = value.deriv()
    away = np.zeros(len(ground))
    with np.errstate(all="ignore"):
        for _ in range(60):
            step = (ground - value(away)) / slope(away)
            away = away + np.clip(step, -1e5, 1e5)
        good = np.abs(value(away) - ground) < 1e-3
    return np.where(good, away + origin, np.nan)
