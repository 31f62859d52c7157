"""Checks of options: type, limits and choices of each value, options that would do nothing, tables of TOML."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar, get_args, get_origin

from geomosaic.errors import InputError, counted, did_you_mean
from geomosaic.limits import LARGEST
from geomosaic.options.declaration import (
    Declared,
    Option,
    compose,
    declared,
    field_kind,
    flat_values,
    is_part,
)
from geomosaic.stores.addresses import accept, is_address
from geomosaic.stores.path import given_path

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


NAMES: dict[Any, str] = {str: "text", float: "a number", int: "a whole number", bool: "true or false", Path: "a path"}


class CheckedOptions:
    """Base of frozen options whose values are brought to their types and checked as they are made.

    What is declared with a class, such as `group="input"`, holds for each option in its body that says nothing else.
    """

    def __init_subclass__(cls, **shared: Any) -> None:
        for item in vars(cls).values():
            if isinstance(item, Field) and "option" in item.metadata:
                added = {name: value for name, value in shared.items() if name not in item.metadata["declared"]}
                option = replace(item.metadata["option"], **added)
                item.metadata = MappingProxyType({**item.metadata, "option": option})

    def __post_init__(self) -> None:
        for one in declared(type(self)):
            if one.owner is type(self) or one.name in self.__dict__:
                found = getattr(self, one.name)
                if not one.typed and not isinstance(found, str | int | float):
                    continue  # a value of the library's own, in place of a file
                settled = _checked(found, one.kind, one.option, f"`{one.name}`", optional=one.optional)
                if settled is not found:
                    object.__setattr__(self, one.name, settled)  # frozen, but still being made


class SelfContainedOptions(CheckedOptions):
    """Base of options which do not depend on others: also those that would do nothing beside each other are refused."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_idle(self)


def _checked(value: Any, kind: Any, option: Option, where: str, *, optional: bool = False) -> Any:
    """Value of an option in its type and within its limits."""
    if value is None and optional:
        return None
    origin = get_origin(kind)
    # A value that is read already, as when options are replaced one by one, is not read again; a text may still be one
    # of several spellings.
    if option.parse is not None and not (isinstance(kind, type) and isinstance(value, kind) and kind is not str):
        try:
            return option.parse(value)
        except InputError as error:
            raise InputError(error.what, where=where, hint=error.hint) from None
    if origin is tuple:
        return _sequence(value, get_args(kind), option, where)
    if isinstance(origin or kind, type) and issubclass(origin or kind, Mapping):
        if not isinstance(value, Mapping):
            raise InputError(f"'{value}' is no table of names and values", where=where, hint="give names with values")
        inner = get_args(kind)[-1:]
        if inner and is_part(inner[0]):
            return {name: _checked(part, inner[0], option, f"{where} {name}") for name, part in value.items()}
        return value
    if is_part(kind) and isinstance(value, Mapping):
        try:
            return compose(kind, value)
        except InputError as error:
            part = (error.where or "").strip("`")
            what = f"{part}: {error.what}" if part else error.what
            raise InputError(what, where=where, hint=error.hint) from None
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value) if abs(value) < LARGEST else math.inf
    if kind is str and isinstance(value, str) and is_address(value):  # of files that go with images, for example
        value = accept(value)
    if kind is Path and isinstance(value, str):
        value = given_path(value)
    if hasattr(value, "item") and kind in (int, float, bool):  # a NumPy scalar
        value = kind(value.item())
    # To Python true is the number 1; to a user it is not.
    if not isinstance(value, kind) or (kind is not bool and isinstance(value, bool)):
        name = NAMES.get(kind, f"a {kind.__name__}")
        raise InputError(f"'{value}' is not {name}", where=where, hint=f"give {name}")
    check_limits(value, option, where)
    return value


def _sequence(value: Any, kinds: tuple[Any, ...], option: Option, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise InputError(f"'{value}' is not a list", where=where, hint="give values in brackets: [...]")
    if kinds[-1] is Ellipsis:
        kinds = (kinds[0],) * len(value)
    if len(value) != len(kinds):
        what = f"{counted(len(value), 'value')} where {len(kinds)} belong"
        raise InputError(what, where=where, hint=f"give {len(kinds)}")
    return tuple(_checked(part, kind, option, where) for part, kind in zip(value, kinds, strict=True))


def check_limits(value: Any, option: Option, where: str) -> None:
    """Check of a value against the choices and limits of its option.

    Parameters
    ----------
    value : object
    option : Option
    where : str
        Named by errors.

    Raises
    ------
    InputError
    """
    if option.choices and value not in option.choices:
        known = ", ".join(option.choices)
        hint = did_you_mean(str(value), option.choices)
        raise InputError(f"'{value}' is not known here", where=where, hint=f"{hint} one of {known}".strip())
    if isinstance(value, float | int) and not isinstance(value, bool):
        option.limits.check(value, where)


def check_idle(value: Any, effective: Mapping[str, Any] | None = None) -> None:
    """Check that no option is given that would do nothing beside the others.

    Parameters
    ----------
    value : options value
    effective : mapping, optional
        What counts in conditions in place of a value that was left open, by name.

    Raises
    ------
    InputError
        Names both options in backticks.
    """
    # Of options that this set does not have, such as the labels of an ortho, conditions say nothing.
    values = list(flat_values(value))
    state = {one.name: found for one, found in values} | dict(effective or {})
    for one, found in values:
        # An option whose default follows from others may be switched off beside any of them.
        if not is_given(one, found) or (found is False and one.name in (effective or {})):
            continue
        own = f"`{one.name}`"
        for condition in one.option.idle_with:
            if _holds(condition, state):
                other = _shown(condition, state)
                hint = f"leave out {own} or `{condition.partition('=')[0]}`"
                raise InputError(f"{own} would do nothing with {other}", hint=hint)
        # Switched off, an option asks for nothing that another would have to give.
        needs = [condition for condition in one.option.needs if condition.partition("=")[0] in state]
        if found is not False and needs and not any(_holds(condition, state) for condition in needs):
            wanted = " or ".join(f"`{condition}`" for condition in needs)
            give = wanted if len(needs) == 1 else "one of them"
            raise InputError(f"{own} would do nothing without {wanted}", hint=f"give {give}, or leave out {own}")


def is_given(one: Declared, value: Any) -> bool:
    """Whether an option is set to something else than its default.

    Parameters
    ----------
    one : Declared
    value : object

    Returns
    -------
    bool
        True for any value of an option without a default.
    """
    return one.default is MISSING or bool(value != one.default)


def _holds(condition: str, state: Mapping[str, Any]) -> bool:
    """Whether an option is in effect ('name'), or has a value ('name=value')."""
    name, equals, wanted = condition.partition("=")
    if name not in state:
        return False
    found = state[name]
    if equals:
        return str(found) == wanted
    return bool(found)


def _shown(condition: str, state: Mapping[str, Any]) -> str:
    """Condition with the value that the option has."""
    name, equals, _ = condition.partition("=")
    found = state[name]
    return f"`{condition}`" if equals or not isinstance(found, str | int | float) else f"`{name}={found}`"


def finite_numbers(values: Any) -> tuple[float, ...]:
    """Finite numbers of a list, which may be written as texts; none where it is no list of them.

    Parameters
    ----------
    values : object
    """
    try:
        found = () if isinstance(values, str) else tuple(map(float, values))
    except (TypeError, ValueError, OverflowError):
        return ()
    return found if all(map(math.isfinite, found)) else ()


def as_written(value: Any) -> str:
    """Value as a user wrote it: what is in a list with blanks between.

    Parameters
    ----------
    value : object
    """
    return " ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


T = TypeVar("T", bound="DataclassInstance")

# Colours that have names here; any other is written #rrggbb.
COLORS = {
    "black": "#000000", "white": "#ffffff", "red": "#d7191c", "green": "#1a9641", "blue": "#2c6fbb",
    "yellow": "#ffe119", "orange": "#f58231", "brown": "#8c4a16", "grey": "#808080", "gray": "#808080",
    "purple": "#7b3294", "cyan": "#00a6c8", "magenta": "#c51b8a",
}  # fmt: skip


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
    return _checked(value, kind, item.metadata.get("option", Option()), place)


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
