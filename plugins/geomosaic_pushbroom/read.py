"""Reading values from the tables users write, with errors that name image, key and mend."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.errors import InputError, did_you_mean
from geomosaic.types import FloatArray

POINT = ("x", "y", "z", "col", "row")


def known_keys(table: Mapping[str, Any], allowed: Iterable[str], where: str) -> None:
    """Refuse keys that mean nothing here.

    Raises
    ------
    InputError
        Names the key, the nearest one that exists, and all of them.
    """
    names = list(allowed)
    for key in table:
        if key not in names:
            mend = f"{did_you_mean(str(key), names)} known are: {', '.join(names)}".strip()
            raise InputError(f"unknown input '{key}'", where=where, mend=mend)


def number(value: Any, key: str, where: str) -> float:
    """Finite number from a number or its text.

    Raises
    ------
    InputError
        Not a number, NaN or infinite.
    """
    try:
        result = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        result = math.nan
    if not math.isfinite(result):
        raise InputError(f"{key} = {value!r} is not a finite number", where=where)
    return result


def positive(value: Any, key: str, where: str) -> float:
    """Finite number above zero."""
    result = number(value, key, where)
    if result <= 0.0:
        raise InputError(f"{key} = {result:g} is not greater than 0", where=where)
    return result


def numbers(value: Any, count: int, key: str, where: str) -> list[float]:
    """List of `count` finite numbers."""
    good = isinstance(value, Iterable) and not isinstance(value, str | Mapping)
    items = list(value) if good else []
    if len(items) != count:
        raise InputError(f"{key} = {value!r} is not a list of {count} numbers", where=where)
    return [number(item, f"{key}[{index}]", where) for index, item in enumerate(items)]


@dataclass(frozen=True)
class Control:
    """Control points of one image.

    Attributes
    ----------
    names : tuple of str
    xyz : array (N, 3)
        In the CRS of the request.
    colrow : array (N, 2)
        Pixels.
    sigmas : array (N,)
        Pixels.
    """

    names: tuple[str, ...]
    xyz: FloatArray
    colrow: FloatArray
    sigmas: FloatArray

    def __len__(self) -> int:
        return len(self.names)


def read_points(points: Any, where: str) -> Control:
    """Read the input 'points'.

    Raises
    ------
    InputError
        It is no list of tables, or a point lacks a coordinate; names the point.
    """
    if not isinstance(points, Iterable) or isinstance(points, str | Mapping) or not list(points):
        raise InputError("'points' is not a list of control points", where=where, mend=f"each with {', '.join(POINT)}")
    names, rows = [], []
    for index, point in enumerate(points, 1):
        if not isinstance(point, Mapping):
            raise InputError(f"control point {index} is not a table", where=where, mend=f"give {', '.join(POINT)}")
        known_keys(point, (*POINT, "id", "sigma"), f"{where}, control point {index}")
        name = str(point.get("id", index))
        missing = [key for key in POINT if point.get(key) is None]
        if missing:
            raise InputError(
                f"control point {name} has no {', '.join(missing)}", where=where, mend=f"give {', '.join(POINT)}"
            )
        label = f"control point {name}, "
        row = [number(point[key], label + key, where) for key in POINT]
        rows.append([*row, positive(point.get("sigma", 1.0), f"{label}sigma", where)])
        names.append(name)
    table = np.array(rows)
    return Control(tuple(names), table[:, :3], table[:, 3:5], table[:, 5])
