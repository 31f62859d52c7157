"""Reading values from the tables users write, with errors that name image, key and mend."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from typing import Any

from geomosaic.errors import InputError


def did_you_mean(word: str, names: Iterable[str], cutoff: float = 0.6) -> str:
    """'did you mean ...? ' with the nearest name, whatever the case; empty where none is near."""
    folded = {name.casefold(): name for name in names}
    close = difflib.get_close_matches(word.casefold(), folded, 1, cutoff)
    return f"did you mean '{folded[close[0]]}'? " if close else ""


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
            hint = did_you_mean(str(key), names, 0.5)
            raise InputError(f"unknown key '{key}'", where=where, mend=f"{hint}known keys are: {', '.join(names)}")


def need(table: Mapping[str, Any], key: str, where: str, text: str) -> Any:
    """Value of a key that must be there; `text` says what it is."""
    if key not in table or table[key] is None:
        raise InputError(f"'{key}' is missing", where=where, mend=f"give {key}: {text}")
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
        raise InputError(f"{key} = {result} is not positive", where=where)
    return result


def numbers(value: Any, count: int, key: str, where: str) -> tuple[float, ...]:
    """List of `count` finite numbers."""
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise InputError(f"{key} = {value!r} is not a list of {count} numbers", where=where)
    items = list(value)
    if len(items) != count:
        raise InputError(f"{key} has {len(items)} values, not {count}", where=where)
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
        hint = did_you_mean(str(value), names)
        raise InputError(f"{key} = {value!r} is not known", where=where, mend=f"{hint}choose from: {', '.join(names)}")
    return str(value)


def flag(table: Mapping[str, Any], key: str, where: str) -> bool:
    """True or false; false where not given."""
    value = table.get(key)
    if value is not None and not isinstance(value, bool):
        raise InputError(f"{key} = {value!r} is neither true nor false", where=where)
    return bool(value)
