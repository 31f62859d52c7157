"""Tables of tie points: the same whether they are read at once or line by line, and longer than any other table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from geomosaic import whole_files
from geomosaic.errors import InputError
from geomosaic.inputs import tables, tie_points
from geomosaic.inputs.tie_points import TiePoints, read_ties

PLAIN = """# measured by hand

id,image,col,row,sigma_px
7,a.tif,1200.125,0.1,0.3
 p 8 ,b.tif, 17.5 ,4.000000000000001e3,

# halfway
7,b.tif,-3,5e-1,0.25
"""


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_a_plain_table_reads_as_it_does_line_by_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "ties.csv", PLAIN)
    at_once = read_ties(path)
    assert isinstance(at_once.origins, tables.Origins)
    monkeypatch.setattr(tie_points, "read_columns", lambda *a: None)
    slowly = read_ties(path)
    assert (at_once.points, at_once.images) == (slowly.points, slowly.images)
    assert list(at_once.origins) == list(slowly.origins)
    np.testing.assert_array_equal(at_once.colrow, slowly.colrow)
    np.testing.assert_array_equal(np.asarray(at_once.sigma), np.asarray(slowly.sigma))


def test_covariances_of_positions_survive_a_table_either_way_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    covariance = np.array([[[0.04, 0.03], [0.03, 0.09]], np.full((2, 2), np.nan), [[0.01, 0.0], [0.0, 4.0]]])
    ties = TiePoints(["1", "1", "2"], ["a", "b", "a"], np.ones((3, 2)), np.array([1.0, 0.7, np.nan]), (), covariance)
    np.testing.assert_allclose(np.asarray(ties.sigma), [np.sqrt(0.065), 0.7, np.sqrt(2.005)])
    path = ties.write(tmp_path / "ties.csv")
    for at_once in (True, False):
        if not at_once:
            monkeypatch.setattr(tie_points, "read_columns", lambda *a: None)
        found = read_ties(path)
        np.testing.assert_allclose(np.asarray(found.covariance), covariance, atol=1e-4)
        np.testing.assert_allclose(np.asarray(found.sigma), np.asarray(ties.sigma), atol=1e-4)


def test_a_covariance_that_cannot_be_is_named_with_its_line(tmp_path: Path) -> None:
    table = "id,image,col,row,sigma_col,sigma_row,correlation\n7,a.tif,1,2,0.1,0.2,0\n8,a.tif,1,2,0.1,0.2,1.5\n"
    with pytest.raises(InputError, match="no covariance") as caught:
        read_ties(written(tmp_path / "ties.csv", table))
    assert "line 3" in str(caught.value.where)
    with pytest.raises(InputError, match="sigma_row is 0") as caught:
        read_ties(written(tmp_path / "ties.csv", table.replace("0.2,0", "0,0")))
    assert "line 2" in str(caught.value.where)


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("9,a.tif,1", "3 values for 4 columns"),
        ("9,a.tif,1,2,3", "5 values for 4 columns"),
        ("9,a.tif,x,2", "column 'col' has 'x'"),
        ("9,a.tif,inf,2", "column 'col' has 'inf'"),
        ("9,a.tif,,2", "column 'col' has ''"),
        (",a.tif,1,2", "column 'id' is empty"),
    ],
)
def test_a_mistake_is_named_with_its_line(line: str, told: str, tmp_path: Path) -> None:
    path = written(tmp_path / "ties.csv", f"id,image,col,row\n7,a.tif,1,2\n{line}\n")
    with pytest.raises(InputError, match=told) as caught:
        read_ties(path)
    assert "line 3" in str(caught.value.where)


def test_names_in_quotes_hold_commas(tmp_path: Path) -> None:
    found = read_ties(written(tmp_path / "ties.csv", 'id,image,col,row\n"7, left",a.tif,1,2\n'))
    assert list(found.points) == ["7, left"]


def test_tie_points_may_have_more_rows_than_other_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "ties.csv", PLAIN)
    monkeypatch.setattr(whole_files, "MOST_ROWS", 2)
    assert len(read_ties(path)) == 3
    monkeypatch.setattr(whole_files, "MOST_TIES", 3)
    with pytest.raises(InputError, match="more than 3 rows"):
        read_ties(path)
