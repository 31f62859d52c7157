"""Layouts of a project as TOML files, and their edits: comments and order of all that is not edited stay."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT

from geomosaic.digests import digest_of
from geomosaic.errors import GeomosaicError, InputError
from geomosaic.sheets.inputs import layout_of
from geomosaic.sheets.layout import check_layout
from geomosaic.studio.history import text_of
from geomosaic.studio.toml_edit import set_key

# Bytes above which a TOML file is no layout, and layouts of a project that are listed.
_LARGEST, _MOST = 1 << 20, 200
_MARK = re.compile(r"^\s*\[\s*(sheet|map)\s*\]", re.MULTILINE)
_PROJECT = re.compile(r"^\s*\[\s*project\s*\]", re.MULTILINE)
_NAME = re.compile(r"\w[\w -]{0,59}")

TEMPLATE = """\
# Layout of a map sheet: `geomosaic sheet RASTER --layout {file} -o sheet.pdf` prints it.
# Every key has a default; lengths are millimetres on paper, sizes of text points.
[sheet]
title = {title}
paper = "A3"

[map]
# scale = "1:10000"         # the largest round one at which the raster fits

[grid]
style = "lines"

[legend]
title = "Legend"
"""


@dataclass(frozen=True)
class LayoutFile:
    """Layout of a project.

    Attributes
    ----------
    id : str
        Name in addresses: a digest of the path, so that no request can name a file.
    path : Path
    """

    id: str
    path: Path

    @classmethod
    def of(cls, path: Path) -> LayoutFile:
        """Layout at a path."""
        return cls(digest_of("layout", str(path))[:16], path)


def layout_files(folder: Path) -> list[LayoutFile]:
    """Layouts in a folder: TOML files with a table `[sheet]` or `[map]`, or with 'layout' in their name.

    Parameters
    ----------
    folder : Path
    """
    return [LayoutFile.of(path) for path in sorted(folder.glob("*.toml"))[:_MOST] if _is_layout(path)]


def _is_layout(path: Path) -> bool:
    try:
        text = path.read_text(encoding="utf-8") if path.stat().st_size <= _LARGEST else ""
    except (OSError, UnicodeDecodeError):
        return False
    return not _PROJECT.search(text) and bool(_MARK.search(text) or "layout" in path.stem.lower())


def new_layout(folder: Path, name: str, title: str) -> tuple[Path, str]:
    """Path and text of a layout that is begun.

    Parameters
    ----------
    folder : Path
    name : str
        Of the file, without its ending.
    title : str

    Raises
    ------
    InputError
        The name is none, or there is such a file.
    """
    if not _NAME.fullmatch(name):
        raise InputError(
            f"'{name}' is no name for a layout", where="name", hint="give letters, figures, spaces and hyphens"
        )
    path = folder / f"{name.strip().replace(' ', '-')}.toml"
    if path.exists():
        raise InputError(f"there is a file {path.name} already", where="name", hint="give another name")
    return path, TEMPLATE.format(file=path.name, title=tomlkit.string(title).as_string())


def values_of(text: str, name: str) -> dict[str, Any]:
    """Tables of a layout as they are written, valid or not.

    Parameters
    ----------
    text : str
    name : str
        Of the file, for errors.

    Raises
    ------
    InputError
        It is no TOML.
    """
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"the layout is not valid TOML: {error}", where=name, hint="correct that line") from None


def problem(text: str, name: str) -> GeomosaicError | None:
    """What is wrong with a layout, without looking at the files that it names; None where nothing is.

    Parameters
    ----------
    text : str
    name : str
        Of the file, for errors.
    """
    try:
        check_layout(layout_of(values_of(text, name), name))
    except GeomosaicError as error:
        return error
    return None


def edited(text: str, edit: Mapping[str, Any]) -> str:
    """Text of a layout after one edit.

    Parameters
    ----------
    text : str
        Valid TOML.
    edit : mapping
        `table` and `key` with a `value`, None for the default; for the list of layers `table = "layer"` and its
        `index`; or `layer` = 'add' with a `file`, 'remove' or 'move' with `index` (and `to`). With `of`, `file` and
        `layer` of the layer as it was told, another one at that index is not touched.

    Raises
    ------
    InputError
        There is no such layer, or the text is written in a way that cannot be edited.
    """
    try:
        document = tomlkit.parse(text)
        if "layer" in edit:
            _edit_layers(document, edit)
        else:
            _set(document, edit)
        return tomlkit.dumps(document)
    except (TOMLKitError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"the layout cannot be changed as it is written: {error}", hint="change it in an editor"
        ) from None


def _set(document: Any, edit: Mapping[str, Any]) -> None:
    table, key, value = str(edit.get("table", "")), str(edit.get("key", "")), edit.get("value")
    if table == "layer":
        set_key(_layer(document, edit), (), key, value)
    else:
        set_key(document, (table,), key, value)


def _edit_layers(document: Any, edit: Mapping[str, Any]) -> None:
    act, layers = edit["layer"], document.get("layer")
    if act == "add":
        entry = tomlkit.table()
        entry["file"] = str(edit.get("file", ""))
        if isinstance(layers, AoT):
            layers.append(entry)
        else:
            new = tomlkit.aot()
            new.append(entry)
            document.append("layer", new)
        return
    _layer(document, edit)
    place = int(edit["index"])
    if act == "remove":
        del layers[place]
        if not len(layers):
            del document["layer"]
    elif act == "move":
        target = max(0, min(len(layers) - 1, int(edit.get("to", place))))
        entries = list(layers.body)
        entries.insert(target, entries.pop(place))
        new = tomlkit.aot()
        for entry in entries:
            new.append(entry)
        document["layer"] = new
    else:
        raise InputError(f"'{act}' is no edit of layers", hint="add, remove or move")


def _layer(document: Any, edit: Mapping[str, Any]) -> Any:
    layers, index = document.get("layer") or (), edit.get("index")
    if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < len(layers):
        raise InputError("the layout has no such layer", hint="load the page again")
    found = layers[index]
    if "of" in edit and edit["of"] != [found.get("file"), found.get("layer")]:
        raise InputError("the layers have changed meanwhile", hint="look at them, and repeat the edit")
    return found


def read(path: Path) -> str:
    """Text of a layout.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        It is gone, or cannot be read.
    """
    text = text_of(path)
    if text is None:
        raise InputError("the layout is gone", where=path.name, hint="choose another one")
    return text
