"""Flight paths as they are declared: straight, by a table over time, or an orbit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, SensorInputError, default_where, did_you_mean, warn
from geomosaic.geo.crs import geographic, horizontal
from geomosaic.geo.local_frames import LocalFrame, enu_axes, map_place
from geomosaic.geo.transform import Transform
from geomosaic.sensor import inputs as read
from geomosaic.whole_files import read_records
from geomosaic_panoramic.trajectory import Poses, Turn, orbit_poses

TEXT = "see `geomosaic sensors panoramic`"


def word(options: Mapping[str, Any], name: str, words: Sequence[str], where: str, default: str | None = None) -> str:
    """Option that is one of a list of words.

    Parameters
    ----------
    options : mapping
    name : str
        Of the option.
    words : sequence of str
    where : str
        Named in errors.
    default : str, optional
        Where the option is not given; without it the option is needed.

    Raises
    ------
    InputError
        The option is missing, or another word.
    """
    return read.choice(read.need({name: default, **options}, name, where, " or ".join(words)), words, name, where)


def number_option(options: Mapping[str, Any], name: str, where: str, default: float | None = None) -> float:
    """Option that is a finite number.

    Parameters
    ----------
    options, name, where
        As for `word`.
    default : float, optional
        Where the option is not given; without it the option is needed.

    Raises
    ------
    InputError
        The option is missing, or no number.
    """
    return read.number(read.need({name: default, **options}, name, where, TEXT), name, where)


def triple_option(
    options: Mapping[str, Any], name: str, where: str, default: Sequence[float] | None = None
) -> tuple[float, ...]:
    """Option that is a list of three finite numbers.

    Parameters
    ----------
    options : mapping
    name : str
        Of the option.
    where : str
        Named in errors.
    default : sequence of float, optional
        Where the option is not given; without it the option is needed.

    Raises
    ------
    InputError
        The option is missing, or not three numbers.
    """
    return read.numbers(read.need({name: default, **options}, name, where, TEXT), 3, name, where)


COLUMNS = ("time", "x", "y", "z", "heading", "pitch", "roll")
ORBIT = ("inclination", "pass")


def read_table(file: Path, where: str) -> np.ndarray:
    """Track of a CSV file, in the order of time.

    Parameters
    ----------
    file : Path
        With a header of the names `COLUMNS`, in any order; further columns are ignored.
    where : str
        Named in errors.

    Returns
    -------
    array (K, 7)
        Time (s), x, y, z in the CRS of the track, heading, pitch, roll (degrees).

    Raises
    ------
    InputError
        The file cannot be read, lacks a column or holds what is no number.
    """
    place = f"{where} ({file})"
    lines = read_records(file, "track")
    header = [name.strip().lower() for name in lines[0]] if lines else []
    missing = [name for name in COLUMNS if name not in header]
    if missing:
        raise InputError(
            f"the track has no column {missing[0]}", where=place, hint=f"give {', '.join(COLUMNS)}, separated by commas"
        )
    order = [header.index(name) for name in COLUMNS]
    try:
        table = np.array([[float(row[i]) for i in order] for row in lines[1:]]).reshape(-1, len(COLUMNS))
    except (ValueError, IndexError) as error:
        raise InputError(f"a row of the track is not whole ({error})", where=place, hint="complete it") from error
    if len(table) < 2 or not np.isfinite(table).all() or not (np.diff(table[:, 0]) > 0.0).all():
        raise InputError(
            "the times of the track do not grow from row to row", where=place, hint="two rows or more, in order of time"
        )
    return table


def require_cover(tau: np.ndarray, half: float, where: str) -> None:
    """Check that a track is no shorter than the image.

    Parameters
    ----------
    tau : array (K,)
        Times in lines or sweeps from the middle of the image.
    half : float
        τ at the end of the image.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        The track begins after the image, or ends before it.
    """
    # Times are divided by the period, so a track that ends with the image may miss it by rounding.
    if tau[0] > -half + 1e-9 or tau[-1] < half - 1e-9:
        raise InputError(
            f"the track covers {tau[0]:.1f} to {tau[-1]:.1f} lines or sweeps about the middle of the image, which "
            f"takes {-half:.1f} to {half:.1f}",
            where=where,
            hint="check start_time, period and the clock of the track",
        )


def table_poses(table: np.ndarray, tau: np.ndarray, crs: CRS, frame: LocalFrame, *, grid: bool) -> Poses:
    """Poses of a track in a local frame.

    Parameters
    ----------
    table : array (K, 7)
        See `read_table`; positions in `crs`.
    tau : array (K,)
        Times in lines or sweeps from the middle of the image.
    crs : CRS
        3-D.
    frame : LocalFrame
        East, north, up at the middle of the image; or the map's axes.
    grid : bool
        Whether headings count from grid north.
    """
    heading, pitch, roll = np.radians(table[:, 4:]).T
    if horizontal(crs).is_projected and grid == frame.crs.is_geocentric:
        chosen = np.unique(np.linspace(0, len(table) - 1, 50).astype(int))
        # Convergence changes slowly along a flight: 50 places and a line between them are enough.
        turns = [map_place(crs, float(x), float(y)).convergence for x, y in table[chosen, 1:3]]
        convergence = np.radians(np.interp(np.arange(len(table)), chosen, turns))
        heading = heading + convergence if grid else heading - convergence
    if frame.crs.is_geocentric:
        lonlat = Transform(crs, geographic(crs))(table[:, 1:4])
        enu = np.stack([enu_axes(longitude, latitude) for longitude, latitude in lonlat[:, :2]]) @ frame.axes.T
    else:
        enu = np.broadcast_to(np.eye(3), (len(table), 3, 3))
    turn = Turn(np.stack([heading, pitch, roll]), np.zeros(3))
    body = (turn.undo(forward, right, down, np.zeros(1)) for forward, right, down in np.eye(3))
    axes = np.stack([np.column_stack([east, north, -down]) for north, east, down in body], axis=1) @ enu
    places = frame.to_enu(Transform(crs, frame.crs)(table[:, 1:4]))
    return Poses(tau, places, axes)


def declared_orbit(options: Mapping[str, Any], frame: LocalFrame, half: float, where: str) -> Poses:
    """Poses of the circular orbit that the options `orbit` and `period` declare.

    Parameters
    ----------
    options : mapping
    frame : LocalFrame
        At the satellite's position at the middle of the image.
    half : float
        τ at the end of the image, lines or sweeps.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        An input is missing or wrong, or the orbit does not reach the latitude of the position.
    """
    orbit = options["orbit"]
    if not isinstance(orbit, Mapping):
        raise SensorInputError(
            f"input 'orbit' is no table: {orbit!r}", name="orbit", where=where, hint="give inclination and pass"
        )
    for key in orbit:
        if key not in ORBIT:
            raise SensorInputError(
                f"an orbit has no '{key}'", name="orbit", where=where, hint=did_you_mean(str(key), ORBIT) or "see docs"
            )
    inclination = math.radians(number_option(orbit, "inclination", where))
    ascending = word(orbit, "pass", ("ascending", "descending"), where) == "ascending"
    period = number_option(options, "period", where)
    if period <= 0.0:
        raise SensorInputError(
            f"period is {period:g} s", name="period", where=where, hint="give the seconds of one line or sweep"
        )
    with default_where(where):
        return orbit_poses(frame, inclination, ascending, period, half)


PER_STEP = {"scanner": "line", "sweeps": "sweep", "panoramic": "sweep"}
# How many times longer than wide, or wider than long, cells of a scanner may be without a word.
ODD = 20.0


def straight_motion(options: Mapping[str, Any], kind: str, above: float, turn: float, where: str) -> np.ndarray:
    """Parameters of a straight flight.

    Parameters
    ----------
    options : mapping
        Heading and course in degrees, advance in metres or v_over_h, climb, pitch, roll, rates.
    kind : str
        Of the scan, a key of `PER_STEP`.
    above : float
        Height above ground, metres.
    turn : float
        Meridian convergence in degrees, added to heading and course where these count from grid north.
    where : str
        Named in errors.

    Returns
    -------
    array (12,)
        East, north, up (metres), their speeds (metres per line or sweep), heading, pitch, roll (degrees), their rates.

    Raises
    ------
    InputError
        An input is missing or wrong.
    """
    heading = number_option(options, "heading", where) + turn
    course = math.radians(number_option(options, "course", where, heading - turn) + turn)
    advance = _advance(options, kind, above, where)
    return np.array(
        [
            0.0, 0.0, 0.0,
            advance * math.sin(course), advance * math.cos(course), number_option(options, "climb", where, 0.0),
            heading, number_option(options, "pitch", where, 0.0), number_option(options, "roll", where, 0.0),
            *triple_option(options, "rates", where, (0.0, 0.0, 0.0)),
        ]
    )  # fmt: skip


def _advance(options: Mapping[str, Any], kind: str, above: float, where: str) -> float:
    """Advance in metres per line or sweep, given as such or as v/h times the height above ground."""
    if "advance" in options and "v_over_h" in options:
        raise SensorInputError(
            "advance and v_over_h are given together", name="advance", where=where, hint="give one of them"
        )
    if "v_over_h" in options:
        if "ground_height" not in options:
            raise SensorInputError(
                "v_over_h needs the height above ground", name="v_over_h", where=where, hint="give ground_height"
            )
        advance = number_option(options, "v_over_h", where) * above
    else:
        if "advance" not in options and kind != "panoramic":
            raise SensorInputError(
                "nothing says how fast the scanner advances",
                name="advance",
                where=where,
                hint="give advance or v_over_h",
            )
        advance = number_option(options, "advance", where, 0.0)
    if kind != "panoramic" and advance <= 0.0:
        raise SensorInputError(
            f"the scanner advances by {advance:g} m per {PER_STEP[kind]}",
            name="advance",
            where=where,
            hint="give a positive advance",
        )
    return advance


def warn_of_cell_shape(along: float, across: float, where: str) -> None:
    """Warning about ground cells so far from square that an angle must be in another unit.

    Parameters
    ----------
    along, across : float
        Size of a pixel below the scanner in metres.
    where : str
        Named in the warning.
    """
    if not 1.0 / ODD <= along / across <= ODD:
        warn(
            f"{where}: below the scanner a pixel is {across:.3g} m across and {along:.3g} m along the flight; is "
            "field_of_view in degrees, and advance (or v_over_h) that of one line?"
        )
