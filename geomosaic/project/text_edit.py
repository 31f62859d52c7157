"""Edits of a project file as text: one key set or taken out, all else left as its writer has it."""

from __future__ import annotations

import copy
import json
import re
import tomllib
from collections.abc import Sequence
from typing import Any

from geomosaic.errors import InputError

# Characters of a list that is written on one line.
_LINE = 100

Value = str | float | Sequence[str]


def with_value(text: str, table: Sequence[str], key: str, value: Value | None) -> str:
    """Text of a project file with one key set, or taken out.

    Parameters
    ----------
    text : str
        Valid TOML.
    table : sequence of str
        Names down to the table, such as ('mosaic', 'retouch', 'photo.tif'); it is added where there is none.
    key : str
    value : str, float, sequence of str or None
        None takes the key out, and its table with it where that is empty then and more than a section.

    Returns
    -------
    str
        Comments, order and layout of all else stay.

    Raises
    ------
    InputError
        The key is written in a way that is not understood.
    """
    if value is None and not _has(tomllib.loads(text), table, key):
        return text
    lines = text.splitlines()
    written = [] if value is None else _written(key, value)
    header = next((i for i, line in enumerate(lines) if _header(line) == list(table)), None)
    if header is None:
        lines += ["", f"[{'.'.join(map(_key, table))}]", *written]
    else:
        end = next((i for i in range(header + 1, len(lines)) if re.match(r"\s*\[+\s*[\w\"']", lines[i])), len(lines))
        own = _place(lines, header + 1, end, key)
        last = max(i for i in range(header, end) if lines[i].strip() and not lines[i].lstrip().startswith("#"))
        start, stop = own or (last + 1, last + 1)
        lines[start:stop] = written
        end += len(written) - (stop - start)
        if value is None and len(table) > 1 and not any(line.strip() for line in lines[header + 1 : end]):
            del lines[header - (header > 0 and not lines[header - 1].strip()) : end]
    changed = "\n".join(lines) + "\n"
    if _pruned(_values(changed), table) != _pruned(_expected(text, table, key, value), table):
        name = f"[{'.'.join(table)}] {key}"
        raise InputError(f"the key '{key}' could not be changed as it is written", where=name, hint="change it by hand")
    return changed.replace("\n", "\r\n") if "\r\n" in text else changed


def with_list(text: str, section: str, key: str, values: Sequence[str]) -> str:
    """Text of a project file with a list of texts set, or taken out where it is empty.

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


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)


def _header(line: str) -> list[str] | None:
    """Names of a line that begins a table; None for other lines."""
    found = _values(line) if line.lstrip().startswith("[") and not line.lstrip().startswith("[[") else None
    names = []
    while found:
        ((name, found),) = found.items()
        names.append(name)
    return names or None


def _written(key: str, value: Value) -> list[str]:
    """Lines of a key."""
    if isinstance(value, str):
        return [f"{key} = {json.dumps(value, ensure_ascii=False)}"]
    if isinstance(value, int | float):
        return [f"{key} = {float(value)!r}"]
    quoted = [json.dumps(one, ensure_ascii=False) for one in value]
    line = f"{key} = [{', '.join(quoted)}]"
    return [line] if len(line) <= _LINE else [f"{key} = [", *(f"    {one}," for one in quoted), "]"]


def _place(lines: Sequence[str], start: int, end: int, key: str) -> tuple[int, int] | None:
    """First line of a key and the line after its value; None where it is not there."""
    first = next((i for i in range(start, end) if re.match(rf"\s*{re.escape(key)}\s*=", lines[i])), None)
    if first is None:
        return None
    for last in range(first + 1, len(lines) + 1):
        if _values("\n".join(lines[first:last])) is not None:
            return first, last
    return None


def _values(text: str) -> dict[str, Any] | None:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return None


def _has(values: Any, table: Sequence[str], key: str) -> bool:
    for name in table:
        values = values.get(name) if isinstance(values, dict) else None
    return isinstance(values, dict) and key in values


def _expected(text: str, table: Sequence[str], key: str, value: Value | None) -> dict[str, Any] | None:
    found = copy.deepcopy(tomllib.loads(text))
    inner: Any = found
    for name in table:
        if not isinstance(inner.setdefault(name, {}), dict):
            return None
        inner = inner[name]
    if value is None:
        inner.pop(key, None)
    else:
        inner[key] = value if isinstance(value, str | int | float) else list(value)
    return found


def _pruned(values: dict[str, Any] | None, table: Sequence[str]) -> Any:
    """Values without the empty tables on the way to one."""
    if values is None or not table:
        return values
    inner = _pruned(values[table[0]], table[1:]) if isinstance(values.get(table[0]), dict) else values.get(table[0])
    rest = {name: one for name, one in values.items() if name != table[0]}
    return rest if inner in ({}, None) else {**rest, table[0]: inner}
