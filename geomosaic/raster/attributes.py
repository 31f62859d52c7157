"""Attributes of features: their kinds, and the values that a GeoPackage keeps of them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, date, datetime
from typing import Any

from geomosaic.errors import InputError

# Kinds of attributes, and the types of the GeoPackage standard that they are read from.
KINDS = ("text", "integer", "real", "boolean", "date", "datetime")
_KIND_OF = {
    "TEXT": "text", "BOOLEAN": "boolean", "TINYINT": "integer", "SMALLINT": "integer", "MEDIUMINT": "integer",
    "INT": "integer", "INTEGER": "integer", "FLOAT": "real", "DOUBLE": "real", "REAL": "real", "DATE": "date",
    "DATETIME": "datetime",
}  # fmt: skip
# NumPy's types of the kinds that are not text.
EMPTY = {
    "date": "datetime64[D]", "datetime": "datetime64[ms]", "boolean": "bool", "integer": "int64", "real": "float64",
}  # fmt: skip


@dataclass(frozen=True)
class Field:
    """Attribute of a layer.

    Attributes
    ----------
    name : str
    kind : str
        One of `KINDS`.
    longest : int, optional
        Characters that a text may have.
    """

    name: str
    kind: str
    longest: int | None = None


def field_of(name: str, written: str) -> Field | None:
    """Attribute of a column; None for types that cannot be shown.

    Parameters
    ----------
    name : str
    written : str
        Type as SQLite declares it, such as 'TEXT(40)'.

    Returns
    -------
    Field or None
    """
    found = re.fullmatch(r"\s*(\w+)\s*(?:\(\s*(\d+)\s*\))?\s*", written)
    kind = _KIND_OF.get(found.group(1).upper()) if found else None
    return Field(name, kind, int(found.group(2)) if found.group(2) else None) if found and kind else None


def read_value(value: Any, field: Field) -> Any:
    """Value of an attribute as JSON has it.

    Parameters
    ----------
    value : object
        As SQLite gives it.
    field : Field
    """
    if field.kind == "boolean" and value is not None:
        return bool(value)
    return None if isinstance(value, bytes) else value


def checked_value(value: Any, field: Field) -> Any:
    """Value of an attribute as a GeoPackage keeps it.

    Parameters
    ----------
    value : object
        From JSON.
    field : Field

    Raises
    ------
    InputError
        It is of another kind.
    """
    if value is None or value == "":
        return None
    try:
        return _CHECKS[field.kind](value)
    except (TypeError, ValueError):
        raise InputError(
            f"'{str(value)[:60]}' is no {field.kind}", where=field.name, hint=f"give {_WANTED[field.kind]}"
        ) from None


def _text(value: Any) -> str:
    if not isinstance(value, str) or "\0" in value:
        raise ValueError
    value.encode()  # half a character of two is none
    return value


def _integer(value: Any) -> int:
    if isinstance(value, bool) or int(value) != float(value) or abs(int(value)) >= 2**63:
        raise ValueError
    return int(value)


def _real(value: Any) -> float:
    if isinstance(value, bool) or not math.isfinite(float(value)):
        raise ValueError
    return float(value)


def _boolean(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError
    return value


def _moment(value: Any) -> str:
    found = datetime.fromisoformat(value)
    found = found.replace(tzinfo=UTC) if found.tzinfo is None else found.astimezone(UTC)
    return found.strftime("%Y-%m-%dT%H:%M:%S.") + f"{found.microsecond // 1000:03d}Z"


_CHECKS: Mapping[str, Any] = {
    "text": _text, "integer": _integer, "real": _real, "boolean": _boolean,
    "date": lambda value: date.fromisoformat(value).isoformat(), "datetime": _moment,
}  # fmt: skip
_WANTED = {
    "text": "text", "integer": "a whole number", "real": "a number", "boolean": "true or false",
    "date": "year-month-day, such as 2026-11-24", "datetime": "a date and a time, such as 2026-11-24T12:30:00",
}  # fmt: skip
