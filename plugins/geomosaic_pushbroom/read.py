"""Reading values from the tables users write, with errors that name image, key and mend."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from geomosaic.errors import InputError, did_you_mean


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
