"""Exterior orientation tables: position and angles of a named system, plausible units, and files of other programs."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import combinations
from pathlib import Path
from typing import SupportsFloat

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, did_you_mean, warn
from geomosaic.geo.crs import parse_crs
from geomosaic.image_names import find_by_name, missing_row, stem
from geomosaic.inputs.tables import Row, Table, read_table
from geomosaic.types import FloatArray, PathLike

MATRIX = tuple(f"r{row}{col}" for row in (1, 2, 3) for col in (1, 2, 3))

# Columns of each angle system.
SYSTEMS: Mapping[str, tuple[str, ...]] = {
    "opk": ("omega", "phi", "kappa"),
    "pok": ("phi", "omega", "kappa"),
    "matrix": MATRIX,
    "patb": MATRIX,
    "rpy": ("roll", "pitch", "yaw"),
    "dji": ("gimbal_yaw", "gimbal_pitch", "gimbal_roll"),
    "none": (),
}

# Table of simple-ortho and orthority, which has no header: name, x, y, z, omega, phi, kappa in degrees.
HEADLESS = "camera_pos_ori.txt"

# Elements of an exterior orientation, of which tables may tell standard deviations and correlations.
ELEMENTS = ("x", "y", "z", *SYSTEMS["opk"])

# Redundant columns: where a table has all of them, the sensor compares them with the matrix.
_CHECKED: Mapping[str, tuple[str, ...]] = {
    "matrix": ("omega", "phi", "kappa"),
    "patb": ("omega", "phi", "kappa"),
}

# Angle systems of which the sensor itself reads camera and orientation from another program's file.
RECONSTRUCTIONS = ("opensfm", "odm", "pix4d", "metashape", "colmap", "ori", "tsai")

# Those of them whose files may carry their own coordinate reference.
SELF_PLACED = ("opensfm", "metashape", "colmap", "tsai")

# Choice of the system of a reconstruction, which the file itself does not tell.
RECONSTRUCTION_SYSTEM = (
    "opensfm (OpenSfM's own, from its reference) or odm (OpenDroneMap's, brought to its map: needs crs and heights)"
)


# Columns of the motion of a photo during its exposure, see `HasMotion`.
MOTION = ("velocity_x", "velocity_y", "velocity_z", "rate_right", "rate_down", "rate_forward")


@lru_cache
def _check_crs(crs: str) -> None:
    parse_crs(crs, "`crs`")


def _number(value: object, name: str) -> float:
    with suppress(TypeError, ValueError):
        if isinstance(value, str | SupportsFloat):
            return float(value)
    raise InputError(f"'{value}' is not a number", where=f"`{name}`", hint="give a number")


@dataclass(frozen=True, init=False)
class Exterior:
    """Exterior orientation of one image: projection centre and attitude.

    The names of the angles imply their system: omega, phi, kappa; roll, pitch, yaw; gimbal_yaw, gimbal_pitch,
    gimbal_roll; or r11 to r33 of a rotation matrix.

    Parameters
    ----------
    x, y, z : float
        Projection centre in `crs`, z in metres above `heights`.
    omega, phi, kappa : float, optional
        Degrees unless `angle_unit` says otherwise.
    crs : str, optional
        CRS of x and y.
    heights : str, optional
        Vertical datum of z: 'ellipsoidal', 'egm96', an EPSG code or the path of a geoid grid.
    system : str, optional
        One of `SYSTEMS` where the names leave a choice, as 'opk' and 'pok', 'matrix' and 'patb'.
    angle_unit : str, optional
        'deg', 'gon' or 'rad'.
    **angles : float
        Angles of another system by name.

    Raises
    ------
    InputError
        The angles are those of no system, or `crs` is none.

    Examples
    --------
    >>> Exterior(500000.0, 5400000.0, 1200.0, omega=0.1, phi=-0.2, kappa=91.0, crs="EPSG:32633").system
    'opk'
    >>> Exterior(11.0, 47.5, 1200.0, roll=0.1, pitch=-0.2, yaw=91.0, crs="EPSG:4326").system
    'rpy'
    """

    position: tuple[float, float, float]
    angles: Mapping[str, float]
    system: str
    crs: str | None
    heights: str | None
    angle_unit: str | None

    def __init__(
        self,
        x: float,
        y: float,
        z: float,
        omega: float | None = None,
        phi: float | None = None,
        kappa: float | None = None,
        *,
        crs: str | None = None,
        heights: str | None = None,
        system: str | None = None,
        angle_unit: str | None = None,
        **angles: float,
    ) -> None:
        named = {"omega": omega, "phi": phi, "kappa": kappa, **angles}
        given = {name: _number(value, name) for name, value in named.items() if value is not None}
        fitting = [name for name, columns in SYSTEMS.items() if set(columns) == set(given)]
        if system is None and fitting:
            system = fitting[0]
        if system not in fitting:
            raise InputError(
                f"{', '.join(given) or 'no angles'} are not the angles of {system or 'any system'}",
                where="Exterior",
                hint="; ".join(f"{name}: {', '.join(columns)}" for name, columns in SYSTEMS.items() if name != "patb"),
            )
        if angle_unit not in (None, *TO_DEGREES):
            raise InputError(f"no angle unit named '{angle_unit}'", hint=f"use one of {', '.join(TO_DEGREES)}")
        if crs is not None and not crs.lower().endswith(".prj"):
            _check_crs(crs)
        position = (_number(x, "x"), _number(y, "y"), _number(z, "z"))
        if not all(map(math.isfinite, (*position, *given.values()))):
            raise InputError("a coordinate or an angle is not finite", where="Exterior", hint="give numbers")
        for field, value in zip(fields(self), (position, given, system, crs, heights, angle_unit), strict=True):
            object.__setattr__(self, field.name, value)


@dataclass(frozen=True, eq=False)
class ExteriorRow:
    """Position and attitude of one image as the table has them.

    Attributes
    ----------
    image : str
        Name in the table.
    position : tuple of float
        x, y, z in the table's CRS; NaN where it is not known.
    angles : mapping of str to float
        Angles by column, in the table's unit; NaN where they are not known.
    line : int
        Line of the table.
    covariance : array (6, 6), optional
        Of `ELEMENTS`, angles in degrees, where the table tells standard deviations.
    velocity : tuple of float, optional
        In units of the CRS per second, where the table tells it, or times.
    rates : tuple of float, optional
        Turn about the camera's axes right, down and forward, degrees per second, where the table tells it.
    """

    image: str
    position: tuple[float, float, float]
    angles: Mapping[str, float]
    line: int
    covariance: FloatArray | None = None
    velocity: tuple[float, float, float] | None = None
    rates: tuple[float, float, float] | None = None

    @property
    def placed(self) -> bool:
        """Whether the position is known."""
        return all(map(math.isfinite, self.position))

    @property
    def turned(self) -> bool:
        """Whether the angles are known."""
        return bool(self.angles) and all(map(math.isfinite, self.angles.values()))


@dataclass(frozen=True, eq=False)
class ExteriorTable:
    """Rows of an orientation table, by image name.

    Attributes
    ----------
    path : str
        File; of values the name of their parameter.
    system : str
        Angle system, one of `ANGLE_SYSTEMS`.
    rows : mapping of str to ExteriorRow
        Rows by image name as the table writes it.
    """

    path: str
    system: str
    rows: Mapping[str, ExteriorRow]

    @property
    def name(self) -> str:
        """Name of the file or parameter, for messages."""
        return Path(self.path).name

    def __str__(self) -> str:
        return self.path

    def row(self, image: str) -> ExteriorRow:
        """Row of an image file, by name with or without extension."""
        found = find_by_name(self.rows, image)
        if found is None:
            raise missing_row(self.path, image, [stem(name) for name in self.rows])
        return found


def exterior_values(given: Mapping[str, Exterior]) -> tuple[ExteriorTable, dict[str, str]]:
    """Orientation table of values, and the declarations that they have in common.

    Parameters
    ----------
    given : mapping of str to Exterior
        Orientations by image name.

    Returns
    -------
    table : ExteriorTable
    common : dict of str
        `angles`, and `crs`, `heights`, `angle_unit` where they are given.

    Raises
    ------
    InputError
        Two of them differ in system, unit, CRS or vertical datum.
    """
    common: dict[str, str] = {}
    for parameter, name in (("angles", "system"), ("crs", "crs"), ("heights", "heights"), ("angle_unit", "angle_unit")):
        found = {getattr(exterior, name) for exterior in given.values()}
        if len(found) > 1:
            raise InputError(
                f"the orientations have different {name}: {', '.join(map(str, sorted(map(str, found))))}",
                where="`exterior`",
                hint="bring them to the same; a block has one",
            )
        value = found.pop() if found else None
        if value is not None:
            common[parameter] = value
    rows = {
        image: ExteriorRow(image, exterior.position, exterior.angles, number)
        for number, (image, exterior) in enumerate(given.items(), start=1)
    }
    return ExteriorTable("exterior", common.get("angles", "opk"), rows), common


def undeclared_reconstruction(path: PathLike | ExteriorTable | None, system: str) -> bool:
    """Whether an orientation input is a reconstruction whose angle system is not declared.

    Parameters
    ----------
    path : path-like, ExteriorTable or None
        Orientation input.
    system : str
        Angle system as declared.
    """
    # OpenSfM's and OpenDroneMap's files look the same inside, and count from different origins.
    return (
        path is not None
        and not isinstance(path, ExteriorTable)
        and Path(path).suffix.lower() == ".json"
        and system not in RECONSTRUCTIONS
    )


def read_exterior(path: PathLike, system: str, unit: str | None = None) -> ExteriorTable:
    """Orientation table of a file.

    Parameters
    ----------
    path : path-like
        Text with the columns image, x, y, z and those of the angle system, where the position or all angles of an
        image may be left empty; sigma_x ... sigma_kappa and cor_x_y ... of 'opk' are read where they are there.
    system : str
        Angle system, one of `SYSTEMS`.
    unit : str, optional
        Unit of the angles and their standard deviations; degrees unless given.

    Raises
    ------
    InputError
        Names file and line.
    """
    if system not in SYSTEMS:
        hint = f"{did_you_mean(system, SYSTEMS)} one of {', '.join(SYSTEMS)}".strip()
        raise InputError(f"`angles={system}` is no angle system of a table", where=str(path), hint=hint)
    if undeclared_reconstruction(path, system):
        raise InputError(
            "this is a reconstruction, and its angle system is not declared",
            where=str(path),
            hint=f"declare it with `angles`: {RECONSTRUCTION_SYSTEM}",
        )
    columns = SYSTEMS[system]
    wanted = ("image", "x", "y", "z", *columns)
    table = orientation_table(path, system)
    try:
        table.require(*wanted, what=f"orientations in the system '{system}'")
    except InputError as error:
        other = systems_of(table)
        if other:
            error.hint = f"these columns look like the system '{other[0]}'; declare it, or rename the columns"
        raise
    # Angles beside a matrix are redundant: they are read to check its direction and order.
    checked = _CHECKED.get(system, ())
    if set(checked) <= set(table.columns):
        columns = (*columns, *checked)
    rows: dict[str, ExteriorRow] = {}
    lines: dict[str, int] = {}
    for row in table:
        image = row.text("image")
        # Photos are found without folder and extension: two rows that differ in these alone would be one photo's.
        bare = stem(image)
        if bare in lines:
            raise InputError(
                f"image '{image}' has a row already, on line {lines[bare]}",
                where=row.where,
                hint="keep the one that is right; names are compared without folder and extension",
            )
        lines[bare] = row.line
        x, y, z = _together(row, "xyz")
        known = _covariance(row, table.columns, unit) if system == "opk" else None
        angles = dict(zip(columns, _together(row, columns), strict=True))
        rows[image] = ExteriorRow(image, (x, y, z), angles, row.line, known)
    if "time" in table.columns:
        rows = _with_velocities(table, rows)
    return ExteriorTable(str(path), system, _with_motion(table, rows) if set(MOTION) & set(table.columns) else rows)


def _together(row: Row, columns: Sequence[str]) -> list[float]:
    """Numbers of columns that are known together; NaN where all of them are empty."""
    empty = not any(row.values.get(name, "").strip() for name in columns)
    return [math.nan if empty else row.number(name) for name in columns]


def _with_motion(table: Table, rows: Mapping[str, ExteriorRow]) -> dict[str, ExteriorRow]:
    """Rows with the motion that columns tell, which comes before that of times; of empty fields nothing is known."""
    table.require(*MOTION[:3], what="velocities")
    found = dict(rows)
    for row in table:
        velocity = _together(row, MOTION[:3])
        if math.isnan(velocity[0]):
            continue
        rates = _together(row, MOTION[3:]) if set(MOTION[3:]) <= set(table.columns) else [math.nan] * 3
        name = row.text("image")
        found[name] = replace(
            found[name],
            velocity=(velocity[0], velocity[1], velocity[2]),
            rates=None if math.isnan(rates[0]) else (rates[0], rates[1], rates[2]),
        )
    return found


def _with_velocities(table: Table, rows: Mapping[str, ExteriorRow]) -> dict[str, ExteriorRow]:
    from geomosaic.inputs.velocities import time_of, velocities

    found = velocities(
        {name: (time_of(row), rows[name].position) for row in table if rows[name := row.text("image")].placed}
    )
    return {name: replace(row, velocity=found.get(name)) for name, row in rows.items()}


def orientation_table(path: PathLike, system: str = "opk") -> Table:
    """Table of a file of orientations.

    Parameters
    ----------
    path : path-like
    system : str
        Angle system whose columns an error names, and which a file without a header must have.
    """
    columns = ("image", "x", "y", "z", *SYSTEMS[system])
    headless = columns if Path(path).name == HEADLESS and system == "opk" else ()
    return read_table(path, "orientation table", ",".join(columns), headless)


def _covariance(row: Row, columns: Sequence[str], unit: str | None) -> FloatArray | None:
    """Covariance (6, 6) of a row's elements, angles in degrees: sigma_x ..., and cor_x_y ..., 0 where not told.

    None without those columns, or where all of them are empty.
    """
    names = [f"sigma_{name}" for name in ELEMENTS]
    if not set(names) <= set(columns) or not any(row.values.get(name, "").strip() for name in names):
        return None
    sigmas = np.array([row.number(name) for name in names])
    if not (sigmas >= 0.0).all():
        raise InputError("a standard deviation is negative", where=row.where, hint="write 0 or more")
    sigmas[3:] *= TO_DEGREES.get(unit or "deg", 1.0)
    found = np.eye(6)
    for i, j in combinations(range(6), 2):
        found[i, j] = found[j, i] = row.number(f"cor_{ELEMENTS[i]}_{ELEMENTS[j]}", 0.0)
    # Less than 0 by more than the rounding of nine digits: no correlations of anything.
    if not np.linalg.eigvalsh(found)[0] > -1e-6:
        raise InputError(
            "the correlations of the orientation cannot be (cor_x_y and so on)",
            where=row.where,
            hint="check them, or leave these columns out",
        )
    return found * np.outer(sigmas, sigmas)


def systems_of(table: Table) -> list[str]:
    """Angle systems whose columns a table has; some share theirs (opk and pok, matrix and patb).

    Parameters
    ----------
    table : Table

    Returns
    -------
    list of str
        Keys of `SYSTEMS`.
    """
    fitting = [system for system, columns in SYSTEMS.items() if columns and set(columns) <= set(table.columns)]
    # A table with angles of which one is missing is damaged, and none of positions.
    every = {name for columns in SYSTEMS.values() for name in columns}
    return fitting or ([] if every & set(table.columns) else ["none"])


TO_DEGREES = {"deg": 1.0, "gon": 0.9, "rad": 180.0 / math.pi}

# Two tilts and the turn of each system, the turn counted counter-clockwise as kappa is, up to multiples of 90°.
_HEADINGS: Mapping[str, tuple[tuple[str, float], ...]] = {
    "opk": (("omega", 1.0), ("phi", 1.0), ("kappa", 1.0)),
    "pok": (("omega", 1.0), ("phi", 1.0), ("kappa", 1.0)),
    "rpy": (("roll", 1.0), ("pitch", 1.0), ("yaw", -1.0)),
    "dji": (("gimbal_roll", 1.0), ("gimbal_pitch", 1.0), ("gimbal_yaw", -1.0)),
}


def check_units(table: ExteriorTable, unit: str | None, crs: CRS | None = None) -> None:
    """Check of the angular unit: an error where it is undeclared and the angles look like another than degrees.

    Parameters
    ----------
    table : ExteriorTable
        All its rows count: one image alone tells nothing of the unit, its neighbours do.
    unit : str or None
        Unit as declared; None is degrees. Angles that do not fit a declared one are warned of.
    crs : CRS, optional
        CRS of the positions.

    Raises
    ------
    InputError
        Names the unit that the angles look like.
    """
    rows = [row for row in table.rows.values() if row.placed and row.turned]
    if unit is not None and unit not in TO_DEGREES:
        raise InputError(f"no angle unit named '{unit}'", hint=f"use one of {', '.join(TO_DEGREES)}")
    turns = _HEADINGS.get(table.system)
    if turns is None or not rows:
        return
    from geomosaic.sensor.plausibility import unit_suspicion

    given = np.array([[sign * row.angles[name] for name, sign in turns] for row in rows])
    angles = given * TO_DEGREES[unit or "deg"]
    text = unit_suspicion(angles, np.array([row.position for row in rows]), crs)
    if text is None and _half_turns_in_radians(angles):
        text = "the angles look like radians: read as degrees, no tilt reaches 0.15° and every heading is near 0 or π"
    if text is None:
        return
    if unit is not None:
        warn(f"{table.path}: declared as '{unit}', but {text}")
        return
    raise InputError(text, where=table.path, hint="declare the unit, whichever it is: `angle_unit`")


def _half_turns_in_radians(angles: FloatArray) -> bool:
    """Whether two tilts and a heading (N, 3), taken for degrees, are radians of strips flown to and fro along x."""
    # Headings of such strips are near 0 and π radians. Read as degrees both are small turns that follow the flight, so
    # the direction of flight gives nothing away; but such small tilts, with headings at 0 and at 3.14 and nowhere
    # between, do not happen.
    tilts, turns = np.abs(angles[:, :2]), np.abs(angles[:, 2])
    to, fro = turns < 0.25, np.abs(turns - math.pi) < 0.25
    return bool(tilts.max() < 0.15 and (to | fro).all() and to.any() and fro.any() and tilts.max() > 0.0)


# Bytes of a file that are looked at.
_FIRST = 4096


def ign_reference_names(path: Path | None) -> tuple[str, str]:
    """Names that an orientation file of IGN gives its map and its heights, for hints.

    Parameters
    ----------
    path : Path or None

    Returns
    -------
    map_name, heights : str
        ' (the file calls it NAME)'; '' where it has none or cannot be read.
    """
    try:
        text = "" if path is None else path.read_bytes()[:_FIRST].decode("utf-8", "replace")
    except OSError:
        text = ""
    found = (re.search(rf"<{tag}>\s*([^<]{{1,40}}?)\s*</", text) for tag in ("systeme", "grid_alti"))
    map_name, heights = (f" (the file calls it {match[1]})" if match else "" for match in found)
    return map_name, heights
