"""Block adjustment of a project on the command line, and the mosaic that is made of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from adjust_project_rig import PROJECT, Block, grid_block, write_project

import geomosaic as gm
from geomosaic.cli.main import run
from geomosaic.orientation.block.poses import pose_of
from geomosaic.sensor.corrected import model_from_dict


def truth() -> Block:
    return grid_block(2, 4, 30, seed=3)


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    text = PROJECT.replace("sigma_px", 'exports = ["colmap", "metashape", "pix4d", "ori"]\nsigma_px')
    return write_project(tmp_path_factory.mktemp("project"), truth(), text)


def test_a_project_is_adjusted_and_its_mosaic_takes_the_adjusted_models(project: Path, capsys: Any) -> None:
    assert run(["adjust", str(project)]) == 0
    told = capsys.readouterr().out
    assert "sigma0" in told
    assert "check points: 2, RMS" in told
    assert len(told.splitlines()) < 25
    block = truth()
    for name, model in zip(block.names, block.models, strict=True):
        state = json.loads((project.parent / "output" / "models" / f"{name}.tif.json").read_text())
        off = pose_of(model_from_dict(state), block.frame).centre - pose_of(model, block.frame).centre
        sigmas = np.sqrt(np.diag(state["covariance"])[:3])
        assert (np.abs(off) < 4.5 * sigmas).all()
        assert state["known_by"].startswith("orientation: block adjustment, sigma0 ")
    assert run(["run", str(project), "mosaic", "--json"]) == 0
    out = json.loads(capsys.readouterr().out)
    assert [step["fresh"] for step in out["steps"]] == [True, False]
    with rasterio.open(project.parent / "output" / "block.tif") as mosaic:
        assert mosaic.width > 300


def test_the_answer_for_programs_has_all_facts(project: Path, capsys: Any) -> None:
    assert run(["adjust", str(project), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["orient"]["adjusted"]["block"]
    adjustment = json.loads(Path(facts["outputs"]["adjustment"]).read_text())
    assert adjustment["sigma0_as_expected"]
    page = Path(facts["outputs"]["adjustment_report"]).read_text()
    assert all(f"<td>{image['name']}</td>" in page for image in adjustment["images"])
    assert {each["name"] for each in adjustment["observations"]} >= {"image positions", "control", "attitudes"}
    exports = facts["orient"]["adjusted"]["exports"]
    assert list(exports) == ["colmap", "metashape", "pix4d", "ori"]
    for format, folder in exports.items():
        home = Path(folder)
        (path,) = {"metashape": [*home.glob("*.xml")], "pix4d": [*home.glob("*_parameters.txt")]}.get(format, [home])
        assert len(gm.read_reconstruction(path).images) == len(truth().names)


def test_a_project_takes_cameras_and_ties_from_folders_of_another_program(project: Path, capsys: Any) -> None:
    text = project.read_text().replace("ties.csv", "output/exports/colmap").replace('"output"', '"again"')
    text = text.replace("exports = ", 'fixed = ["*"]\nexports = ').replace("exterior.csv", "output/block-exterior.csv")
    file = project.with_name("again.toml")
    file.write_text(text)
    assert run(["adjust", str(file), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["steps"][0]["name"] == "orient"
    adjustment = json.loads(Path(facts["outputs"]["adjustment"]).read_text())
    assert 0.8 < adjustment["sigma0"] < 1.2


def test_a_limit_that_fails_ends_with_its_code_and_control_that_is_left_out_is_in_no_residual(
    tmp_path: Path, capsys: Any
) -> None:
    """One control point is 40 m too high. Everything is written; the table of residuals still has the point."""
    project = write_project(tmp_path, truth(), PROJECT + "[quality]\nmax_check_rms_px = 0.01\n")
    file = tmp_path / "control.csv"
    rows = [line.split(",") for line in file.read_text().splitlines()]
    rows = [[*row[:3], str(float(row[3]) + 40.0), *row[4:]] if row[0] == "c1" else row for row in rows]
    file.write_text("\n".join(map(",".join, rows)) + "\n")
    assert run(["adjust", str(project)]) == 3
    assert "check points, RMS" in capsys.readouterr().err
    assert (tmp_path / "output" / "adjustment.json").is_file()
    facts = json.loads((tmp_path / ".geomosaic" / "block" / "facts" / "orient.json").read_text())
    assert max(np.hypot(each["col"], each["row"]) for each in facts["control"] if each["id"] == "c1") > 10.0
    assert facts["rms_control_px"] < 1.0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text.partition("[adjust]")[0] + "[output]\nresolution = 4.0\n", "no section [adjust]"),
        (lambda text: text + '[planar]\nkind = "grown"\n', "[planar] places the photos in the plane"),
        (lambda text: text.replace("sigma_px = 0.3", "sigma_pixels = 0.3"), "[adjust] sigma_pixels: unknown key"),
        (lambda text: text.replace("sigma_px = 0.3", 'strips = "strips.csv"'), "[adjust] strips"),
        (lambda text: text.replace("sigma_px = 0.3", 'interior = ["focus"]'), "[adjust] interior"),
        (lambda text: text.replace('"ori"', '"bingo"'), "[adjust] exports.3"),
        (lambda text: text.replace("position_sigma = 20.0", "position_sigma = 0"), "[adjust] position_sigma"),
        (lambda text: text.replace("ties.csv", "missing.csv"), "missing.csv"),
        (
            lambda text: text.replace("sigma_px", "lever_arm = [0, 0, 1]\nsigma_px").replace(
                "position_sigma = 20.0", ""
            ),
            "[adjust] lever_arm",
        ),
    ],
)
def test_a_project_that_contradicts_itself_writes_nothing(project: Path, change: Any, said: str, capsys: Any) -> None:
    file = project.with_name("wrong.toml")
    file.write_text(change(project.read_text()).replace('folder = "output"', 'folder = "wrong"'))
    assert run(["adjust", str(file)]) == 1
    assert said in capsys.readouterr().err
    assert not list((project.parent / "wrong").rglob("*.json"))
