"""A key of a project file changed as text: all else stays as its writer has it."""

from __future__ import annotations

import tomllib

import pytest

pytest.importorskip("tomlkit", reason="the extra `studio` is not installed")
from geomosaic.errors import InputError
from geomosaic.studio.toml_edit import with_list, with_value

TEXT = """\
# by hand
format = 1
[project]
name = "a"   # [mosaic]
images = [
    "a.tif",  # first
]

[mosaic]
seams = "graph-cut"
# cutlines = "mine.gpkg"

[ mosaic . retouch . "a.tif" ]
gain = 1.5
"""


def test_keys_are_set_changed_and_taken_out_and_all_else_stays() -> None:
    named = with_value(TEXT, ("mosaic",), "cutlines", 'my "seams".gpkg')
    assert named == TEXT.replace('"graph-cut"\n', '"graph-cut"\ncutlines = "my \\"seams\\".gpkg"\n')
    assert with_value(named, ("mosaic",), "cutlines", None) == TEXT
    assert with_value(TEXT, ("mosaic",), "cutlines", None) == TEXT
    listed = with_list(TEXT, "project", "images", ["b.tif", "c.tif"])
    assert 'images = ["b.tif", "c.tif"]\n\n[mosaic]' in listed
    assert with_value(TEXT, ("mosaic", "retouch", "a.tif"), "gain", 2).count("gain = 2.0") == 1
    assert "retouch" not in with_value(TEXT, ("mosaic", "retouch", "a.tif"), "gain", None)
    text = TEXT.replace('[ mosaic . retouch . "a.tif" ]', '[mosaic.retouch."a.tif"]')
    other = with_value(text, ("mosaic", "retouch", "ü 1.tif"), "offset", -3.5)
    assert other == text + '\n[mosaic.retouch."ü 1.tif"]\noffset = -3.5\n'
    assert tomllib.loads(other)["mosaic"]["retouch"] == {"a.tif": {"gain": 1.5}, "ü 1.tif": {"offset": -3.5}}
    assert with_value(TEXT.replace("\n", "\r\n"), ("output",), "folder", "x").endswith('[output]\r\nfolder = "x"\r\n')


def test_inline_tables_dotted_keys_and_remarks_beside_values_are_kept_as_such() -> None:
    assert with_value('mosaic = {seams = "halve"}\n', ("mosaic",), "cutlines", "b.gpkg").startswith(
        "mosaic = {seams = "
    )
    text = 'mosaic.cutlines = "a.gpkg"  # mine\n[project]\n'
    assert with_value(text, ("mosaic",), "cutlines", "b.gpkg") == text.replace("a.gpkg", "b.gpkg")


def test_a_new_key_stands_before_the_remarks_about_the_next_section() -> None:
    text = "[project]\nname = 'a'\n\n# the ground\n[dem]\nheight = 1\n"
    assert with_list(text, "project", "set_aside", ["b.tif"]) == text.replace("'a'\n", "'a'\nset_aside = [\"b.tif\"]\n")


@pytest.mark.parametrize("text", ["mosaic = 3\n", "[[mosaic]]\nseams = 'halve'\n"])
def test_what_cannot_hold_the_key_is_left_for_the_editor(text: str) -> None:
    with pytest.raises(InputError, match="as it is written") as refused:
        with_value(text, ("mosaic",), "cutlines", "b.gpkg")
    assert refused.value.where == "[mosaic] cutlines"
