"""Edits of control tables: what is edited reads back, all else stays as it was written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from geomosaic.control.edit import BEGUN, ControlText
from geomosaic.control.read import read_control_file
from geomosaic.errors import InputError

OWN = """# measured on Monday
name;x;y;col;row;surveyor
a;500000,5;5400000;10,5;20;Meyer

# doubtful
b;500100;5400000;200;21;"Smith; J."
"""
QGIS = """#CRS: EPSG:32633
mapX,mapY,sourceX,sourceY,enable,dX,dY,residual
500000,5400000,10.5,-20,1,0,0,0
500100,5400000,200,-21.25,0,0,0,0
"""


def read(tmp_path: Path, text: str, name: str = "points.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return read_control_file(path, crs=None if "#CRS" in text else "EPSG:32633").control


def test_one_row_changes_and_nothing_else(tmp_path: Path) -> None:
    table = ControlText.of(OWN)
    row = next(row for row in table.rows if row.values["id"] == "b")
    changed = table.with_row(row.line, {"col": "201,25"})
    lines, before = changed.text.splitlines(), OWN.splitlines()
    assert [i for i, (a, b) in enumerate(zip(lines, before, strict=True)) if a != b] == [5]
    control = read(tmp_path, changed.text)
    np.testing.assert_array_equal(control.colrow, [[10.5, 20.0], [201.25, 21.0]])
    assert changed.rows[1].values["surveyor"] == "Smith; J."
    assert changed.with_row(row.line, {"col": "200"}).text == OWN


def test_rows_are_added_and_taken_out(tmp_path: Path) -> None:
    table = ControlText.of(None).with_row(
        None, {"id": "1", "x": "5", "y": "6", "image": "a.tif", "col": "1", "row": "2"}
    )
    table = table.with_row(
        None, {"id": "2", "x": "7", "y": "8", "image": "a.tif", "col": "3", "row": "4", "role": "check"}
    )
    control = read(tmp_path, table.text)
    assert control.names == ("1", "2")
    assert control.roles == ("control", "check")
    assert ControlText.of(table.text).without_row(table.rows[0].line).rows[0].values["id"] == "2"
    assert ControlText.of(table.text).rows == table.rows


def test_a_column_comes_when_it_is_needed(tmp_path: Path) -> None:
    table = ControlText.of("id,x,y,col,row\na,1,2,3,4\nb,5,6,7,8\n")
    assert table.with_row(2, {"enabled": "1", "role": "control"}).columns == table.columns
    changed = table.with_row(3, {"enabled": "0"})
    assert changed.columns[-1] == "enabled"
    assert read(tmp_path, changed.text).enabled.tolist() == [True, False]


def test_points_of_qgis_keep_their_sign_and_switch(tmp_path: Path) -> None:
    table = ControlText.of(QGIS)
    assert [row.values["row"] for row in table.rows] == ["20", "21.25"]
    changed = table.with_row(4, {"row": "22.5", "enabled": "1"}).with_row(
        None, {"id": "2", "image": "scan.tif", "x": "500200", "y": "5400100", "col": "300", "row": "40"}
    )
    control = read(tmp_path, changed.text, "scan.points")
    np.testing.assert_array_equal(control.colrow, [[10.5, 20.0], [200.0, 22.5], [300.0, 40.0]])
    assert control.enabled.all()
    assert changed.text.splitlines()[:3] == QGIS.splitlines()[:3]
    with pytest.raises(InputError, match="no column"):
        table.with_row(3, {"role": "check"})


def test_what_is_no_table_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="names no columns") as caught:
        ControlText.of("hello\nworld\n")
    assert BEGUN in str(caught.value.hint)
