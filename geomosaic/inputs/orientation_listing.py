"""Printed lists of orientations (PATB, BINGO, BLUH, Inpho and others), read as declared.

Layouts differ from version to version, so nothing is guessed: columns, angular unit, sequence of the rotations and
image axes are declared, and the angles are compared with a printed matrix where there is one. The result is the
rotation matrix ground → image with x right, y up.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from geomosaic.errors import InputError, counted
from geomosaic.geo.local_frames import r1, r2, r3, require_rotation
from geomosaic.image_names import stem
from geomosaic.inputs.exterior_orientation import MATRIX, TO_DEGREES, ExteriorRow, ExteriorTable
from geomosaic.inputs.tables import fields_of
from geomosaic.options.inputs import ListingLayout
from geomosaic.types import FloatArray
from geomosaic.whole_files import read_lines

ANGLES = ("omega", "phi", "kappa")
_TURNS = {"omega": r1, "phi": r2, "kappa": r3}
_DIRECTIONS = {"right": (1.0, 0.0), "left": (-1.0, 0.0), "up": (0.0, 1.0), "down": (0.0, -1.0)}
# Name of a column that is skipped.
_SKIP = "-"
# Largest difference of an element of a printed matrix from that of the angles: lists print as few as four decimals.
_AGREE = 2e-4


def read_listing(path: Path, how: ListingLayout, unit: str | None, direction: str | None) -> ExteriorTable:
    """Orientation table of a printed list.

    Parameters
    ----------
    path : Path
    how : ListingLayout
    unit : str or None
        'deg', 'gon' or 'rad'; required with angles.
    direction : str or None
        'ground_to_image' or 'image_to_ground'; required with a printed matrix.

    Raises
    ------
    InputError
        A declaration is missing, a record does not follow it, or angles and matrix disagree; names the line.
    """
    where = str(path)
    has_angles, has_matrix = (set(names) <= set(how.columns) for names in (ANGLES, MATRIX))
    _complete(how, has_angles, has_matrix, unit, direction, where)
    to_image = _image_axes(how.axes, where)
    rows: dict[str, ExteriorRow] = {}
    seen: dict[str, int] = {}
    for line, record in _records(path, how):
        here = f"{path}, line {line}"
        name = record["image"]
        if stem(name) in seen:
            raise InputError(
                f"image '{name}' has a record already, on line {seen[stem(name)]}", where=here,
                hint="leave one of them out",
            )  # fmt: skip
        seen[stem(name)] = line
        values = {key: _number(text, key, here) for key, text in record.items() if key != "image"}
        printed = np.array([values[key] for key in MATRIX]).reshape(3, 3) if has_matrix else None
        if printed is not None and direction == "image_to_ground":
            printed = printed.T
        if has_angles:
            angles = {key: values[key] * TO_DEGREES[unit or "deg"] for key in ANGLES}
            rotation = _turned(angles, how.sequence)
            if printed is not None:
                _compare(rotation, printed, angles, here)
        else:
            mend = "check the order of the columns"
            rotation = np.eye(3) if printed is None else require_rotation(printed, "r11 to r33", here, _AGREE, mend)
        # The rotation leads to the declared image axes; the transpose of these axes leads on to x right, y up.
        elements = dict(zip(MATRIX, (to_image.T @ rotation).ravel().tolist(), strict=True))
        rows[name] = ExteriorRow(name, (values["x"], values["y"], values["z"]), elements, line)
    if not rows:
        raise InputError("the list has no record", where=where, hint="check skip and lines")
    return ExteriorTable(where, "printed", rows)


def _turned(angles: Mapping[str, float], sequence: Sequence[str]) -> FloatArray:
    """Rotation ground → image (3, 3) from angles in degrees; the sequence omega, phi, kappa gives R3(κ)·R2(φ)·R1(ω)."""
    rotation = np.eye(3)
    for name in sequence:
        rotation = _TURNS[name](math.radians(angles[name])) @ rotation
    return rotation


def _image_axes(axes: str, where: str) -> FloatArray:
    """Unit vectors (3, 3) of the declared x, y and z = x × y as rows; in x right, y up, z towards the viewer."""
    words = axes.lower().split()
    if len(words) != 2 or any(word not in _DIRECTIONS for word in words):
        raise InputError(
            f"axes = '{axes}' does not give the directions of the image's x and y",
            where=where,
            hint=f"give two of {', '.join(_DIRECTIONS)}, such as 'right up'",
        )
    x, y = (np.array([*_DIRECTIONS[word], 0.0]) for word in words)
    if x @ y:
        raise InputError(
            f"axes = '{axes}' are not at right angles",
            where=where,
            hint="give one direction to the side and one up or down, such as 'right up'",
        )
    return np.array([x, y, np.cross(x, y)])


def _complete(
    how: ListingLayout, has_angles: bool, has_matrix: bool, unit: str | None, direction: str | None, where: str
) -> None:
    """Check that a printed list is declared completely."""
    known = ("image", "x", "y", "z", *ANGLES, *MATRIX, _SKIP)
    odd = [name for name in how.columns if name not in known]
    doubled = [name for name in known if name != _SKIP and how.columns.count(name) > 1]
    missing = [name for name in ("image", "x", "y", "z") if name not in how.columns]
    problem = ""
    if odd:
        problem = f"there is no column '{odd[0]}': known are {', '.join(known)}"
    elif doubled:
        problem = f"column '{doubled[0]}' is named twice"
    elif missing:
        problem = f"columns has no {', '.join(missing)}"
    elif not (has_angles or has_matrix):
        problem = "columns name neither omega, phi, kappa nor r11 to r33"
    elif has_angles and unit is None:
        problem = "the unit of the angles is not declared: angle_unit = 'deg', 'gon' or 'rad'"
    elif has_angles and sorted(how.sequence) != sorted(ANGLES):
        problem = "the sequence of the rotations is not declared: sequence = ['omega', 'phi', 'kappa'], or as it is"
    elif has_matrix and direction is None:
        problem = "the direction of the matrix is not declared: matrix = 'ground_to_image' or 'image_to_ground'"
    if problem:
        raise InputError(problem, where=where, hint="correct [exterior] and [exterior.printed]")


def _records(path: Path, how: ListingLayout) -> list[tuple[int, dict[str, str]]]:
    """Records of the list: number of the first line, and text by column."""
    lines = read_lines(path, "list of orientations")
    lines = [(number, line) for number, line in lines if number > how.skip and not line.lstrip().startswith("#")]
    found = []
    for first in range(0, len(lines), how.lines):
        part = lines[first : first + how.lines]
        words = [word for number, line in part for word in _words(line, f"{path}, line {number}")]
        if len(part) < how.lines or len(words) != len(how.columns):
            raise InputError(
                f"{counted(len(words), 'value')} in {counted(len(part), 'line')}, where a record has "
                f"{len(how.columns)} in {how.lines}",
                where=f"{path}, line {part[0][0]}",
                hint="check columns, lines and skip; '-' skips a value",
            )
        found.append((part[0][0], {name: word for name, word in zip(how.columns, words, strict=True) if name != _SKIP}))
    return found


def _words(line: str, where: str) -> list[str]:
    for mark in "\t;,":
        if mark in line:
            return [word.strip() for word in fields_of(line, mark, where) if word.strip()]
    return line.split()


def _compare(rotation: FloatArray, printed: FloatArray, angles: Mapping[str, float], where: str) -> None:
    """Check of the angles against the printed matrix; the error names a sequence or sign that would agree."""
    off = float(np.abs(rotation - printed).max())
    if off <= _AGREE:
        return
    hint = "check the unit, the order of the columns and the direction of the matrix"
    for sequence in itertools.permutations(ANGLES):
        other = _turned(angles, sequence)
        if np.abs(other - printed).max() <= _AGREE:
            hint = f"they agree with sequence = {list(sequence)}"
            break
        if np.abs(other.T - printed).max() <= _AGREE:
            hint = f"they agree with sequence = {list(sequence)} and the matrix of the other direction"
            break
        against = _turned({key: -value for key, value in angles.items()}, sequence)
        if np.abs(against - printed).max() <= _AGREE:
            hint = f"they agree with sequence = {list(sequence)} and angles of the other sense"
            break
    raise InputError(f"the angles and the printed matrix disagree by {off:.1e} in an element", where=where, hint=hint)


def _number(text: str, key: str, where: str) -> float:
    try:
        value = float(text.replace("D", "E").replace("d", "e"))  # as Fortran prints powers of ten
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{key} is '{text[:40]}', not a finite number", where=where, hint="check columns")
    return value
