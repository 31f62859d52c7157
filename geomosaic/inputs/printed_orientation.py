"""Printed lists of orientations (PATB, BINGO, BLUH, Inpho and others): nothing about them is guessed.

Their layouts differ from version to version, so the reader is told the columns, the unit, the sequence of the rotations
and the axes of the image, and holds the angles against a printed matrix where there is one. The result is the rotation
matrix ground → image with x right, y up.
"""

from __future__ import annotations

import csv
import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from geomosaic.errors import InputError
from geomosaic.geo.rotation import r1, r2, r3
from geomosaic.inputs.exterior_orientation import MATRIX, TO_DEGREES, ExteriorRow, ExteriorTable
from geomosaic.inputs.tables import read_text, stem
from geomosaic.options.inputs import PrintedList
from geomosaic.types import FloatArray

ANGLES = ("omega", "phi", "kappa")
TURNS = {"omega": r1, "phi": r2, "kappa": r3}
DIRECTIONS = {"right": (1.0, 0.0), "left": (-1.0, 0.0), "up": (0.0, 1.0), "down": (0.0, -1.0)}
SKIP = "-"
"""Name of a column that is passed over."""
AGREE = 2e-4
"""Largest difference of an element of a printed matrix from that of the angles: lists print as few as four decimals."""


def read_printed(path: Path, how: PrintedList, unit: str | None, direction: str | None) -> ExteriorTable:
    """Orientation table of a printed list.

    Parameters
    ----------
    path : Path
    how : PrintedList
    unit : str or None
        'deg', 'gon' or 'rad'; must be told where there are angles.
    direction : str or None
        'ground_to_image' or 'image_to_ground', of a printed matrix; must be told where there is one.

    Raises
    ------
    InputError
        Something is not told, a record is not as told, or angles and matrix of a record disagree; names the line.
    """
    where = str(path)
    has_angles, has_matrix = (set(names) <= set(how.columns) for names in (ANGLES, MATRIX))
    _complete(how, has_angles, has_matrix, unit, direction, where)
    to_image = image_axes(how.axes, where)
    rows: dict[str, ExteriorRow] = {}
    seen: dict[str, int] = {}
    for line, record in _records(path, how):
        here = f"{path}, line {line}"
        name = record["image"]
        if stem(name) in seen:
            raise InputError(f"image '{name}' has a record already, on line {seen[stem(name)]}", where=here)
        seen[stem(name)] = line
        values = {key: _number(text, key, here) for key, text in record.items() if key != "image"}
        printed = np.array([values[key] for key in MATRIX]).reshape(3, 3) if has_matrix else None
        if printed is not None and direction == "image_to_ground":
            printed = printed.T
        if has_angles:
            angles = {key: values[key] * TO_DEGREES[unit or "deg"] for key in ANGLES}
            rotation = turned(angles, how.sequence)
            if printed is not None:
                _hold(rotation, printed, angles, here)
        else:
            rotation = _nearest(printed, here) if printed is not None else np.eye(3)
        elements = dict(zip(MATRIX, (to_image.T @ rotation).ravel().tolist(), strict=True))
        rows[name] = ExteriorRow(name, (values["x"], values["y"], values["z"]), elements, line)
    if not rows:
        raise InputError("the list has no record", where=where, hint="check skip and lines")
    return ExteriorTable(where, "printed", rows)


def turned(angles: Mapping[str, float], sequence: Sequence[str]) -> FloatArray:
    """Rotation ground → image from angles in a printed sequence.

    Parameters
    ----------
    angles : mapping of str to float
        Omega, phi, kappa in degrees.
    sequence : sequence of str
        Their names, the rotation that is applied first in front: omega, phi, kappa gives R3(κ)·R2(φ)·R1(ω).

    Returns
    -------
    array (3, 3)
    """
    rotation = np.eye(3)
    for name in sequence:
        rotation = TURNS[name](math.radians(angles[name])) @ rotation
    return rotation


def image_axes(axes: str, where: str) -> FloatArray:
    """Declared image axes in the axes of geomosaic: x right, y up, z towards the viewer.

    Parameters
    ----------
    axes : str
        Directions of x and y in the image, such as 'right up'.
    where : str
        Input, for the message.

    Returns
    -------
    array (3, 3)
        Unit vectors of the declared x, y and z = x × y, as rows.

    Raises
    ------
    InputError
        They are not two directions at right angles.
    """
    words = axes.lower().split()
    if len(words) != 2 or any(word not in DIRECTIONS for word in words):
        raise InputError(
            f"axes = '{axes}' does not say where x and y of the image point",
            where=where,
            hint=f"give two of {', '.join(DIRECTIONS)}, such as 'right up'",
        )
    x, y = (np.array([*DIRECTIONS[word], 0.0]) for word in words)
    if x @ y:
        raise InputError(f"axes = '{axes}' are not at right angles", where=where)
    return np.array([x, y, np.cross(x, y)])


def _complete(
    how: PrintedList, has_angles: bool, has_matrix: bool, unit: str | None, direction: str | None, where: str
) -> None:
    """Check that a printed list is declared completely."""
    known = ("image", "x", "y", "z", *ANGLES, *MATRIX, SKIP)
    odd = [name for name in how.columns if name not in known]
    doubled = [name for name in known if name != SKIP and how.columns.count(name) > 1]
    missing = [name for name in ("image", "x", "y", "z") if name not in how.columns]
    problem = ""
    if odd:
        problem = f"there is no column '{odd[0]}': known are {', '.join(known)}"
    elif doubled:
        problem = f"column '{doubled[0]}' is named twice"
    elif missing:
        problem = f"columns do not say where {', '.join(missing)} stand"
    elif not (has_angles or has_matrix):
        problem = "columns name neither omega, phi, kappa nor r11 to r33"
    elif has_angles and unit is None:
        problem = "the unit of the angles is not told: angle_unit = 'deg', 'gon' or 'rad'"
    elif has_angles and sorted(how.sequence) != sorted(ANGLES):
        problem = "the sequence of the rotations is not told: sequence = ['omega', 'phi', 'kappa'], or as it is"
    elif has_matrix and direction is None:
        problem = "the direction of the matrix is not told: matrix = 'ground_to_image' or 'image_to_ground'"
    if problem:
        raise InputError(problem, where=where, hint="tell it under [exterior] and [exterior.printed]")


def _records(path: Path, how: PrintedList) -> list[tuple[int, dict[str, str]]]:
    """Records of the list: number of the first line, and text by column."""
    text = read_text(path, "list of orientations")
    lines = list(enumerate(text.splitlines(), 1))[how.skip :]
    lines = [(number, line) for number, line in lines if line.strip() and not line.lstrip().startswith("#")]
    found = []
    for first in range(0, len(lines), how.lines):
        part = lines[first : first + how.lines]
        words = [word for _, line in part for word in _words(line)]
        if len(part) < how.lines or len(words) != len(how.columns):
            raise InputError(
                f"{len(words)} values in {len(part)} line{'s' * (len(part) != 1)}, where a record has "
                f"{len(how.columns)} in {how.lines}",
                where=f"{path}, line {part[0][0]}",
                hint="check columns, lines and skip; '-' passes over a value",
            )
        found.append((part[0][0], {name: word for name, word in zip(how.columns, words, strict=True) if name != SKIP}))
    return found


def _words(line: str) -> list[str]:
    for mark in "\t;,":
        if mark in line:
            return [word.strip() for word in next(csv.reader([line], delimiter=mark)) if word.strip()]
    return line.split()


def _hold(rotation: FloatArray, printed: FloatArray, angles: Mapping[str, float], where: str) -> None:
    """Check of the angles against the printed matrix; the error names a sequence or sense that would agree."""
    off = float(np.abs(rotation - printed).max())
    if off <= AGREE:
        return
    hint = "check the unit, the order of the columns and the direction of the matrix"
    for sequence in itertools.permutations(ANGLES):
        other = turned(angles, sequence)
        if np.abs(other - printed).max() <= AGREE:
            hint = f"they agree with sequence = {list(sequence)}"
            break
        if np.abs(other.T - printed).max() <= AGREE:
            hint = f"they agree with sequence = {list(sequence)} and the matrix of the other direction"
            break
        against = turned({key: -value for key, value in angles.items()}, sequence)
        if np.abs(against - printed).max() <= AGREE:
            hint = f"they agree with sequence = {list(sequence)} and angles of the other sense"
            break
    raise InputError(f"the angles and the printed matrix disagree by {off:.1e} in an element", where=where, hint=hint)


def _nearest(printed: FloatArray, where: str) -> FloatArray:
    """Nearest rotation to a printed matrix, whose digits are few."""
    off = float(np.abs(printed @ printed.T - np.eye(3)).max())
    if off > AGREE or np.linalg.det(printed) < 0.0:
        raise InputError(
            f"r11 to r33 are no rotation: rows are off orthonormal by {off:.1e}, determinant "
            f"{np.linalg.det(printed):+.3f}",
            where=where,
            hint="check the order of the columns",
        )
    # The nearest orthogonal matrix in the sense of least squares (orthogonal Procrustes).
    left, _, right = np.linalg.svd(printed)
    rotation: FloatArray = left @ right
    return rotation


def _number(text: str, key: str, where: str) -> float:
    try:
        value = float(text.replace("D", "E").replace("d", "e"))  # as Fortran prints powers of ten
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{key} is '{text[:40]}', not a finite number", where=where, hint="check columns")
    return value
