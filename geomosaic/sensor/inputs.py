"""Reading the inputs of sensors from the tables users write, with errors that name image, key and a hint."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from geomosaic.errors import InputError, did_you_mean
from geomosaic.sensor.plugin import SensorInput


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
            raise InputError(f"unknown key '{key}'", where=where, hint=meant(key, "known keys are:", names))


def known_inputs(options: Mapping[str, Any], inputs: Iterable[SensorInput], sensor: str, where: str) -> None:
    """Refuse inputs that a sensor has not; as `known_keys`."""
    names = [entry.name for entry in inputs]
    for key in options:
        if key not in names:
            raise InputError(f"sensor '{sensor}' has no input '{key}'", where=where, hint=meant(key, "it has", names))


def meant(word: Any, words: str, known: Iterable[str]) -> str:
    """What was probably meant, and all there is, as a hint."""
    names = list(known)
    return f"{did_you_mean(str(word), names)} {words} {', '.join(names)}".strip()


def need(table: Mapping[str, Any], key: str, where: str, text: str) -> Any:
    """Value of a key that must be there; `text` says what it is."""
    if key not in table or table[key] is None:
        raise InputError(f"'{key}' is missing", where=where, hint=f"give {key}: {text}")
    return table[key]


def table_of(value: Any, key: str, where: str) -> Mapping[str, Any]:
    """Value that must be a table."""
    if not isinstance(value, Mapping):
        raise InputError(f"'{key}' is {value!r}, not a table", where=where)
    return value


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


def numbers(value: Any, count: int, key: str, where: str) -> tuple[float, ...]:
    """List of `count` finite numbers."""
    if isinstance(value, str | Mapping) or not isinstance(value, Iterable):
        raise InputError(f"{key} = {value!r} is not a list of {count} finite numbers", where=where)
    items = list(value)
    if len(items) != count:
        raise InputError(f"{key} has {len(items)} values, not {count} finite numbers", where=where)
    return tuple(number(item, f"{key}[{i}]", where) for i, item in enumerate(items))


def pair(value: Any, key: str, where: str) -> tuple[float, float]:
    """Two positive numbers, or one that stands for both."""
    if isinstance(value, Iterable) and not isinstance(value, str):
        first, second = numbers(value, 2, key, where)
    else:
        first = second = number(value, key, where)
    return positive(first, key, where), positive(second, key, where)


def choice(value: Any, allowed: Iterable[str], key: str, where: str) -> str:
    """One of some words.

    Raises
    ------
    InputError
        Another word; names the nearest.
    """
    names = list(allowed)
    if value not in names:
        raise InputError(f"{key} = {value!r} is not known", where=where, hint=meant(value, "choose from:", names))
    return str(value)


def flag(table: Mapping[str, Any], key: str, where: str) -> bool:
    """True or false; false where not given."""
    value = table.get(key)
    if value is not None and not isinstance(value, bool):
        raise InputError(f"{key} = {value!r} is neither true nor false", where=where)
    return bool(value)


def point_rows(
    points: Any, keys: Sequence[str], where: str, more: Sequence[str] = ("id", "sigma")
) -> tuple[list[str], list[tuple[float, ...]]]:
    """Names of control points, and their numbers under `keys` with sigma behind, 1 unless given.

    Parameters
    ----------
    points : list of tables
    keys : sequence of str
        What each must have.
    where : str
    more : sequence of str
        What each may have besides.
    """
    if not isinstance(points, Sequence) or isinstance(points, str):
        raise InputError("input 'points' is not a list of points", where=where)
    names, rows = list[str](), list[tuple[float, ...]]()
    for index, point in enumerate(points, 1):
        if not isinstance(point, Mapping):
            raise InputError(f"control point {index} is not a table of {', '.join(keys)}", where=where)
        missing = [key for key in keys if key not in point]
        if missing:
            hints = (did_you_mean(str(key), missing) for key in point if key not in (*keys, *more))
            raise InputError(
                f"control point {index} has no {', '.join(missing)}",
                where=where,
                hint=f"{' '.join(filter(None, hints))} give each point {', '.join(keys)}".strip(),
            )
        names.append(str(point.get("id", index)))
        own = f"points, {'' if 'id' in point else 'number '}{names[-1]}"
        row = [number(point[key], f"{own}: {key}", where) for key in keys]
        rows.append((*row, positive(point.get("sigma", 1.0), f"{own}: sigma", where)))
    return names, rows
