"""Tables of a TOML file to frozen dataclasses: each key and value is checked, an error says where it is wrong."""

from __future__ import annotations

import math
import re
import types
from collections.abc import Mapping
from dataclasses import MISSING, Field, field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeVar, Union, get_args, get_origin, get_type_hints

from geomosaic.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


T = TypeVar("T", bound="DataclassInstance")

COLORS = {
    "black": "#000000", "white": "#ffffff", "red": "#d7191c", "green": "#1a9641", "blue": "#2c6fbb",
    "yellow": "#ffe119", "orange": "#f58231", "brown": "#8c4a16", "grey": "#808080", "gray": "#808080",
    "purple": "#7b3294", "cyan": "#00a6c8", "magenta": "#c51b8a",
}  # fmt: skip
"""Colours that have names here; any other is written #rrggbb."""

_WORDS: dict[Any, str] = {str: "text in quotes", float: "a number", int: "a whole number", bool: "true or false"}


def a_number(
    default: Any = MISSING, *, above: float = -math.inf, least: float = -math.inf, most: float = math.inf
) -> Any:
    """Make a field that holds a number within limits."""
    return field(default=default, metadata={"above": above, "least": least, "most": most})


def a_choice(default: Any, *values: str) -> Any:
    """Make a field that holds one of some words."""
    return field(default=default, metadata={"choices": values})


def a_color(default: Any) -> Any:
    """Make a field that holds a colour."""
    return field(default=default, metadata={"color": True})


def build(kind: type[T], values: Mapping[str, Any], where: str, table: str = "") -> T:
    """Make a dataclass of a table.

    Parameters
    ----------
    kind : type
        Frozen dataclass; nested dataclasses are tables, tuples of them arrays of tables.
    values : mapping
        As read from TOML.
    where : str
        File, named in errors.
    table : str
        Name of the table in the file; empty at its top.

    Raises
    ------
    InputError
        An unknown key (with the one that was probably meant), a value of another kind, out of its limits, or missing.
    """
    known = {item.name.rstrip("_"): item for item in fields(kind) if item.init}
    hints = get_type_hints(kind)
    place = f"{where}, [{table}]" if table else where
    for key in values:
        if key not in known:
            hint = did_you_mean(key, known)
            raise InputError(
                f"unknown key '{key}'", where=place, hint=hint or f"the keys here are {', '.join(sorted(known))}"
            )
    found = {}
    for key, item in known.items():
        if key in values:
            name = f"{table}.{key}" if table else key
            found[item.name] = _value(values[key], hints[item.name], item, where, name)
        elif item.default is MISSING and item.default_factory is MISSING:
            raise InputError(f"'{key}' is missing", where=place, hint=f"write {key} = ...")
    return kind(**found)


def _value(value: Any, kind: Any, item: Field[Any], where: str, name: str) -> Any:
    """Check one value against its kind and limits."""
    table, _, key = name.rpartition(".")
    place = f"{where}, [{table}] {key}" if table else f"{where}, {key}"
    if get_origin(kind) in (Union, types.UnionType):
        kind = next(part for part in get_args(kind) if part is not type(None))
    if is_dataclass(kind) and isinstance(kind, type):
        if not isinstance(value, Mapping):
            raise InputError("this is a table of keys", where=place, hint=f"write [{name}] and its keys below")
        return build(kind, value, where, name)
    if get_origin(kind) is tuple:
        return _list(value, get_args(kind), item, where, name, place)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if not isinstance(value, kind) or (kind is not bool and isinstance(value, bool)):
        raise InputError(f"'{value}' is not {_WORDS[kind]}", where=place, hint=f"write {_WORDS[kind]}")
    _limits(value, item, place)
    if item.metadata.get("color"):
        return checked_color(value, place)
    return value


def _list(value: Any, kinds: tuple[Any, ...], item: Field[Any], where: str, name: str, place: str) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise InputError(f"'{value}' is not a list", where=place, hint="write values in brackets: [...]")
    if kinds[-1] is Ellipsis:
        kinds = (kinds[0],) * len(value)
    if len(value) != len(kinds):
        raise InputError(f"{len(value)} values where {len(kinds)} belong", where=place, hint=f"give {len(kinds)}")
    return tuple(_value(part, kind, item, where, name) for part, kind in zip(value, kinds, strict=True))


def _limits(value: Any, item: Field[Any], place: str) -> None:
    choices = item.metadata.get("choices")
    if choices and value not in choices:
        hint = did_you_mean(str(value), choices)
        raise InputError(f"'{value}' is not known here", where=place, hint=hint or f"one of {', '.join(choices)}")
    if isinstance(value, float | int) and not isinstance(value, bool):
        above, least, most = (item.metadata.get(key) for key in ("above", "least", "most"))
        if not math.isfinite(value):
            raise InputError(f"{value} is no finite number", where=place, hint="give a number")
        if above is not None and not value > above:
            raise InputError(f"{value:g} is too small", where=place, hint=f"give a number above {above:g}")
        if (least is not None and value < least) or (most is not None and value > most):
            low = max(v for v in (least, above, -math.inf) if v is not None)
            limits = f"from {low:g} to {most:g}" if most is not None and math.isfinite(most) else f"of {low:g} or more"
            raise InputError(f"{value:g} is out of range", where=place, hint=f"give a number {limits}")


def checked_color(value: str, place: str) -> str:
    """Return a colour as #rrggbb.

    Raises
    ------
    InputError
    """
    if re.fullmatch(r"#[0-9a-fA-F]{6}", value):
        return value.lower()
    if value.lower() in COLORS:
        return COLORS[value.lower()]
    hint = did_you_mean(value, COLORS)
    raise InputError(f"'{value}' is no colour", where=place, hint=hint or f"write #rrggbb, or {', '.join(COLORS)}")
