"""Form of a layout, from the one declaration of its keys: kind, default, choices and limits of each."""

from __future__ import annotations

from dataclasses import MISSING, fields, is_dataclass
from typing import Any, get_args, get_origin

from geomosaic.options.check import parse_color
from geomosaic.options.declaration import INFINITE, Option, field_kind
from geomosaic.sheets.layout import ELEMENTS, LayerPart, Layout
from geomosaic.sheets.style import BUILT_IN

_KINDS = {str: "text", float: "number", int: "integer", bool: "boolean"}


def layout_form() -> list[dict[str, Any]]:
    """Tables of a layout with their keys.

    Returns
    -------
    list of dict
        `table` and `keys`; of each key its `key`, `kind` ('text', 'number', 'integer', 'boolean', 'choice', 'colour',
        'list'), `default`, and where it has them `choices`, `least`, `most`, `count` (of a list), `position` (name of
        the element that it moves) and `suggested` (texts to choose from, others being possible).
    """
    whole = Layout()
    return [
        {"table": item.name, "keys": _keys(LayerPart if item.name == "layer" else type(getattr(whole, item.name)))}
        for item in fields(whole)
    ]


def _keys(part: Any) -> list[dict[str, Any]]:
    table = next((item.name for item in fields(Layout) if isinstance(getattr(Layout(), item.name), part)), "layer")
    moved = {(one.table, one.key): name for name, one in ELEMENTS.items()}
    found = []
    for item in fields(part):
        option: Option = item.metadata.get("option", Option())
        kind, _ = field_kind(part, item)
        entry: dict[str, Any] = {"key": item.name, "default": None if item.default is MISSING else item.default}
        if get_origin(kind) is tuple:
            inner = get_args(kind)
            entry |= {"kind": "list", "of": _KINDS[inner[0]], "count": None if inner[-1] is Ellipsis else len(inner)}
        elif option.choices:
            entry |= {"kind": "choice", "choices": list(option.choices)}
        elif option.parse is parse_color:
            entry["kind"] = "colour"
        else:
            entry["kind"] = _KINDS[kind]
        limits = {"least": max(option.least, option.above), "most": option.most}
        entry |= {name: value for name, value in limits.items() if abs(value) < INFINITE}
        if (table, item.name) in moved:
            entry["position"] = moved[table, item.name]
        if (table, item.name) == ("layer", "style"):
            entry["suggested"] = list(BUILT_IN)
        if (table, item.name) == ("sheet", "paper"):
            entry["suggested"] = ["A0", "A1", "A2", "A3", "A4"]
        found.append(entry)
    return [entry for entry in found if not is_dataclass(entry["default"])]
