"""Correction grids in files, and in projects: a camera with systematic image errors is put right by its grid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_42_corrected_models import smooth
from test_80_build import inputs

from geomosaic.errors import InputError, OutputExistsError
from geomosaic.inputs.build import build_block
from geomosaic.inputs.correction_grids import read_corrections, write_corrections
from geomosaic.project.load import load_project
from geomosaic.sensor.corrected import Corrected, CorrectionGrid


@pytest.mark.parametrize("name", ["grid.csv", "grid.tif"])
def test_corrections_come_back_as_written(tmp_path: Path, name: str) -> None:
    nodes = np.random.default_rng(1).uniform(-3.0, 3.0, (7, 5, 2))
    for method, beyond in (("bicubic", "zero"), ("bilinear", "held")):
        grid = CorrectionGrid([-10.25, 3.5], [80.0, 33.3], nodes, method, beyond)
        write_corrections(tmp_path / name, grid, overwrite=True)
        back = read_corrections(tmp_path / name)
        np.testing.assert_allclose(back.nodes, nodes, atol=1e-6)
        np.testing.assert_allclose([back.origin, back.spacing], [grid.origin, grid.spacing], rtol=1e-12)
        assert (back.method, back.beyond) == (method, beyond)
    with pytest.raises(OutputExistsError):
        write_corrections(tmp_path / name, grid)


def test_a_table_written_by_hand(tmp_path: Path) -> None:
    """Any order of nodes, any delimiter; bicubic and held unless said."""
    (tmp_path / "grid.txt").write_text("row col d_row d_col\n100 0 4 3\n0 50 -1 1\n0 0 0 0.5\n100 50 2 2\n")
    grid = read_corrections(tmp_path / "grid.txt")
    np.testing.assert_allclose(
        grid.at(np.array([[0.0, 100.0], [50.0, 0.0], [999.0, 999.0]])), [[3, 4], [1, -1], [2, 2]]
    )
    assert (grid.method, grid.beyond) == ("bicubic", "held")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("col,row,d_col\n0,0,1\n", "d_row"),
        ("col,row,d_col,d_row\n0,0,1,1\n9,0,1,1\n0,9,1,1\n", "the node at col 9, row 9 0 times"),
        ("col,row,d_col,d_row\n0,0,1,1\n0,0,1,1\n", "row 0 2 times"),
        ("col,row,d_col,d_row\n0,0,1,1\n9,0,1,1\n30,0,1,1\n", "9 to 21 pixels apart"),
        ("# method = spline\ncol,row,d_col,d_row\n0,0,1,1\n", "no method 'spline'"),
        ("col,row,d_col,d_row\n0,0,1,1\n9,0,8,1\n", "fold"),
    ],
)
def test_wrong_tables_are_reported(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "grid.csv").write_text(text)
    with pytest.raises(InputError, match=words) as told:
        read_corrections(tmp_path / "grid.csv")
    assert "grid.csv" in str(told.value)


def test_another_raster_is_refused(tmp_path: Path) -> None:
    import rasterio

    with rasterio.open(tmp_path / "a.tif", "w", driver="GTiff", width=4, height=4, count=2, dtype="float32") as file:
        file.write(np.zeros((2, 4, 4), dtype=np.float32))
    with pytest.raises(InputError, match="no correction grid"):
        read_corrections(tmp_path / "a.tif")


def test_a_block_takes_the_grid(tmp_path: Path, sample: Path) -> None:
    """One grid for all images, or one for each; the block's models are the plain ones with it behind them."""
    plain = build_block(inputs(sample)).scenes[0].model
    grid = smooth(plain.size)
    for name, pattern in (("all.csv", "all.csv"), ("strip1_02.tif", "{image}.tif")):
        write_corrections(tmp_path / name, grid)
        given = inputs(sample, corrections=str(tmp_path / pattern))
        assert tmp_path / name in given.tables
        model = build_block(given).scenes[0].model
        assert isinstance(model, Corrected)
        seeds = np.array([plain.seed])
        ideal = plain.ground_to_image(seeds)
        np.testing.assert_allclose(model.ground_to_image(seeds), ideal + grid.at(ideal), atol=1e-5)
    with pytest.raises(InputError, match="does not exist"):
        build_block(inputs(sample, corrections=str(tmp_path / "{image}-none.csv")))


def test_a_project_file_names_its_corrections(tmp_path: Path, sample: Path) -> None:
    (tmp_path / "p.toml").write_text(
        f'format = 1\n[project]\nimages = ["{sample / "photos" / "strip1_02.jpg"}"]\n'
        '[sensor]\nname = "frame"\ncorrections = "grids/{image}.csv"\n'
    )
    project = load_project(tmp_path / "p.toml")
    assert project.inputs.corrections == str(tmp_path / "grids" / "{image}.csv")
    assert project.inputs.tables == (tmp_path / "grids" / "strip1_02.csv",)
