"""Edits of TOML that people write: one key set or taken out, comments, order and layout of all else as they are."""

from __future__ import annotations

import tomllib
from collections.abc import MutableMapping, Sequence
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import Table

from geomosaic.errors import InputError

# Characters of a list that is written on one line.
_LINE = 100

Value = str | float | Sequence[str]


def with_value(text: str, table: Sequence[str], key: str, value: Value | None) -> str:
    """Text of a TOML file with one key set, or taken out.

    Parameters
    ----------
    text : str
        Valid TOML.
    table : sequence of str
        Names down to the table, such as ('mosaic', 'retouch', 'photo.tif'); it is added where there is none.
    key : str
    value : str, float, sequence of str or None
        None takes the key out, and its table with it where that is empty then and more than a section.

    Raises
    ------
    InputError
        The key is written in a way that cannot be changed.
    """
    plain: Any = value
    if not isinstance(value, str | None):
        plain = float(value) if isinstance(value, int | float) else list(value)
    expected = tomllib.loads(text)
    try:
        document = tomlkit.parse(text.replace("\r\n", "\n"))
        set_key(document, table, key, _array(plain) if isinstance(plain, list) else plain)
        changed = tomlkit.dumps(document)
        set_key(expected, table, key, plain)
        same = tomllib.loads(changed) == expected
    except (TOMLKitError, tomllib.TOMLDecodeError, TypeError, AttributeError):
        same = False
    if not same:
        name = f"[{'.'.join(table)}] {key}"
        raise InputError(f"the key '{key}' could not be changed as it is written", where=name, hint="change it by hand")
    return changed.replace("\n", "\r\n") if "\r\n" in text else changed


def with_list(text: str, section: str, key: str, values: Sequence[str]) -> str:
    """Text of a TOML file with a list of texts set, or taken out where it is empty.

    Parameters
    ----------
    text : str
        Valid TOML.
    section, key : str
        Such as 'project' and 'set_aside'.
    values : sequence of str

    Returns
    -------
    str
        As from `with_value`.
    """
    return with_value(text, (section,), key, list(values) or None)


def set_key(document: MutableMapping[str, Any], table: Sequence[str], key: str, value: Any) -> None:
    """Set a key of a table, in place.

    Parameters
    ----------
    document : mapping
        Of tomlkit, or plain.
    table : sequence of str
        Names down to the table.
    key : str
    value : object
        None takes the key out.
    """
    tables: list[Any] = [document]
    for name in table:
        if name not in tables[-1]:
            if value is None:
                return
            tables[-1][name] = tomlkit.table() if isinstance(document, tomlkit.TOMLDocument) else {}
        tables.append(tables[-1][name])
    if value is not None:
        _put(tables[-1], key, value)
        return
    tables[-1].pop(key, None)
    # Sections stay where they are empty: their comments may say what belongs there.
    for depth in range(len(table) - 1, 0, -1):
        if not tables[depth + 1]:
            del tables[depth][table[depth]]


def _put(table: Any, key: str, value: Any) -> None:
    """Set a key; a new one before the comments at the end of its table, which may be about the next table."""
    new = isinstance(table, Table) and key not in table
    table[key] = value
    if new:
        # tomlkit finds entries by their places: the document is written now, and not asked for this key again.
        body = table.value.body
        place = first = next(i for i, (name, _) in enumerate(body) if name == key)
        while first > 0 and body[first - 1][0] is None:
            first -= 1
        body.insert(first, body.pop(place))


def _array(values: Sequence[str]) -> Any:
    array = tomlkit.array()
    array.extend(values)
    return array.multiline(len(array.as_string()) > _LINE)
