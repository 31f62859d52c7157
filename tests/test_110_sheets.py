"""The page on map sheets has every key of a layout, every style and shape, and its layout can be drawn."""

from __future__ import annotations

import re
import sys
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest

from geomosaic.sheets.inputs import read_layout
from geomosaic.sheets.layout import Layout
from geomosaic.sheets.style import BUILT_IN, MARKERS, parse_style

DOCS = Path(__file__).resolve().parent.parent / "docs"
PAGE = (DOCS / "sheets.md").read_text(encoding="utf-8")


def test_every_key_is_documented() -> None:
    """The keys of the tables below each heading are those of the tables the heading names, no more and no fewer."""
    seen = set()
    for head, text in re.findall(r"^### (.*?)\n(.*?)(?=^##)", PAGE, re.MULTILINE | re.DOTALL):
        names = re.findall(r"\[+(\w+)\]+", head)
        written = {
            key for row in re.findall(r"^\| (`.*?) \|", text, re.MULTILINE) for key in re.findall(r"`(\w+)`", row)
        }
        known = set()
        for name in names:
            part = {item.name: item for item in fields(Layout)}[name]
            kind = type(getattr(Layout(), name)) if name != "layer" else None
            from geomosaic.sheets.layout import LayerPart

            known |= {item.name for item in fields(kind or LayerPart)}
            seen.add(part.name)
        assert written == known, head
    assert seen == {item.name for item in fields(Layout)}


def test_styles_and_shapes_are_documented() -> None:
    assert all(re.search(rf"\b{name}\b", PAGE) for name in (*BUILT_IN, *MARKERS))
    example = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    style = parse_style(tomllib.loads(example[0]), "page")
    assert [rule.name for rule in style.rules] == ["Main road", "track"]


def test_the_files_of_the_sheet_on_the_page_are_whole(
    tmp_path: Path, sample: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Layout and styles are read; the vectors of the sample are made, and have what the styles name."""
    from geomosaic.raster.vector import read_layer

    layout = read_layout(DOCS / "sheet" / "layout.toml")
    monkeypatch.syspath_prepend(str(DOCS / "sheet"))
    from make_map import make

    make(sample / "gcps.csv", tmp_path / "map.gpkg")
    sys.modules.pop("make_map")
    for part in layout.layer:
        style = parse_style(tomllib.loads((DOCS / "sheet" / part.style).read_text()), part.style)
        columns = set(read_layer(tmp_path / part.file, part.layer).columns)
        assert {style.label.column if style.label else "", style.column} - {""} <= columns
