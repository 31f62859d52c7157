"""Frozen dataclasses from tables of a TOML file; each key and value is checked, an error says where it is wrong."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeVar, get_args, get_origin

from geomosaic.errors import InputError, did_you_mean
from geomosaic.options.check import checked
from geomosaic.options.declaration import Option, field_kind

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


T = TypeVar("T", bound="DataclassInstance")

COLORS = {
    "black": "#000000", "white": "#ffffff", "red": "#d7191c", "green": "#1a9641", "blue": "#2c6fbb",
    "yellow": "#ffe119", "orange": "#f58231", "brown": "#8c4a16", "grey": "#808080", "gray": "#808080",
    "purple": "#7b3294", "cyan": "#00a6c8", "magenta": "#c51b8a",
}  # fmt: skip
"""Colours that have names here; any other is written #rrggbb."""


def build(kind: type[T], values: Mapping[str, Any], where: str, table: str = "") -> T:
    """Dataclass value of a TOML table.

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

    Returns
    -------
    dataclass value
        Of type `kind`.

    Raises
    ------
    InputError
        An unknown key (with the one that was probably meant), a value of another kind, out of its limits, or missing.
    """
    # A key that is a word of Python, such as "class", has a field with an underscore.
    known = {item.name.rstrip("_"): item for item in fields(kind) if item.init}
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
            found[item.name] = _value(values[key], field_kind(kind, item)[0], item, where, name)
        elif item.default is MISSING and item.default_factory is MISSING:
            raise InputError(f"'{key}' is missing", where=place, hint=f"write {key} = ...")
    return kind(**found)


def _value(value: Any, kind: Any, item: Field[Any], where: str, name: str) -> Any:
    """Value of a key in its type: a table, a list of tables, or a plain value."""
    table, _, key = name.rpartition(".")
    place = f"{where}, [{table}] {key}" if table else f"{where}, {key}"
    if is_dataclass(kind) and isinstance(kind, type):
        if not isinstance(value, Mapping):
            raise InputError("this is a table of keys", where=place, hint=f"write [{name}] and its keys below")
        return build(kind, value, where, name)
    inner = get_args(kind)[0] if get_origin(kind) is tuple else None
    if is_dataclass(inner) and isinstance(value, list):
        return tuple(_value(part, inner, item, where, name) for part in value)
    return checked(value, kind, item.metadata.get("option", Option()), place)


def parse_color(value: Any) -> str:
    """Colour as #rrggbb.

    Parameters
    ----------
    value : object
        #rrggbb, or a name out of `COLORS`.

    Returns
    -------
    str
        In lower case.

    Raises
    ------
    InputError
    """
    text = str(value)
    if re.fullmatch(r"#[0-9a-fA-F]{6}", text):
        return text.lower()
    if text.lower() in COLORS:
        return COLORS[text.lower()]
    hint = did_you_mean(text, COLORS)
    raise InputError(f"'{text}' is no colour", hint=hint or f"write #rrggbb, or {', '.join(COLORS)}")
