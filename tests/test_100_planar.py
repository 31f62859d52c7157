"""`geomosaic mosaic --kind ...` and the project kind: what is printed, what is written, what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from planar_rig import FLAT, flight
from test_80_planar_mosaic import write_tables

from geomosaic.cli.main import run
from geomosaic.jobs.steps.orient import restore_block
from geomosaic.project.load import load_project
from geomosaic.testing.synthetic import render


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four photos of one strip in colour, with tables."""
    made = tmp_path_factory.mktemp("strip")
    taken = flight(1, 4, noise=0.2)
    for name, camera in taken.cameras.items():
        values = render(camera, FLAT)
        profile = {"driver": "GTiff", "width": camera.size[0], "height": camera.size[1], "count": 3, "dtype": "uint8"}
        with rasterio.open(made / f"{name}.tif", "w", **profile) as file:
            file.write(np.moveaxis(values, 2, 0))
    write_tables(made, taken, lambda number: "check" if number % 4 == 1 else "control")
    return made


def command(folder: Path, *words: str) -> list[str]:
    return ["mosaic", *(str(path) for path in sorted(folder.glob("strip*.tif"))), *words]


@pytest.mark.parametrize("kind", ["semicontrolled", "controlled", pytest.param("grown", marks=pytest.mark.slow)])
def test_kinds_with_control(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str) -> None:
    """One line of how the photos were placed, control and check points, and the mosaic; the same in JSON."""
    output = tmp_path / "m.tif"
    words = ["--kind", kind, "--ties", str(folder / "ties.csv"), "--gcps", str(folder / "gcps.csv")]
    words += ["--crs", "EPSG:32633", "--no-balance", "-o", str(output)]
    assert run(command(folder, *words)) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(kind)
    assert "check points: " in printed
    assert f"placement: {tmp_path / 'm-placement.json'}" in printed
    assert run([*command(folder, *words), "--overwrite", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)["placement"]
    assert facts == json.loads((tmp_path / "m-placement.json").read_text())
    assert facts["rms_check_px"] < 2.5
    assert len(facts["photos"]) == 4


def test_small_residuals_of_a_block_that_little_holds_do_not_pass_for_accuracy(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two control points at each end, fitted exactly: the mosaic is written, its expected errors end it with 3."""
    head, *rows = (folder / "gcps.csv").read_text().replace(",check", ",control").splitlines()
    ends = [[row for row in rows if photo in row] for photo in ("strip1_01", "strip1_04")]
    chosen = [row.partition(",")[0] for of_end in ends for row in (of_end[0], of_end[-1])]
    few = tmp_path / "few.csv"
    few.write_text("\n".join([head, *(row for row in rows if row.partition(",")[0] in chosen)]) + "\n")
    output, ties = tmp_path / "m.tif", str(folder / "ties.csv")
    words = ["--kind", "controlled", "--ties", ties, "--gcps", str(few), "--crs", "EPSG:32633", "--no-balance"]
    assert run(command(folder, *words, "-o", str(output))) == 3
    told = capsys.readouterr()
    assert output.is_file()
    assert "they were fitted, which is not the accuracy" in told.out
    assert "largest expected error at the corners" in told.err
    accuracy = json.loads((tmp_path / "m-placement.json").read_text())["accuracy"]
    assert accuracy["largest_sigma_px"] > 5.0


def test_a_block_without_control_is_joined_by_ties(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Tie points alone; says what the joins add up to."""
    output = tmp_path / "m.tif"
    words = ["--kind", "uncontrolled", "--ties", str(folder / "ties.csv"), "--scale", "0.8", "--azimuth", "30"]
    assert run(command(folder, *words, "-o", str(output))) == 0
    printed = capsys.readouterr().out
    assert "uncontrolled, conformal: 4 photos joined outwards from strip1_02.tif" in printed
    assert "accumulated error against all photos adjusted together on ties alone: " in printed


def test_flags_that_do_not_belong_together(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Ties without a kind, a rigorous sensor with one."""
    ties, output = str(folder / "ties.csv"), str(tmp_path / "m.tif")
    assert run(command(folder, "--ties", ties, "-o", output)) == 1
    assert "--ties is given without --kind" in capsys.readouterr().err
    assert run(command(folder, "--kind", "uncontrolled", "--sensor", "frame", "--ties", ties, "-o", output)) == 1
    assert "without a rigorous model, and --sensor frame names one" in capsys.readouterr().err
    assert run(command(folder, "--sensor", "frame", "--gcps", ties, "-o", output)) == 1  # which may orient
    assert "the control points have no CRS" in capsys.readouterr().err
    assert run(command(folder, "--sensor", "frame", "--ties", ties, "-o", output)) == 1
    assert "give --kind, or leave out --ties" in capsys.readouterr().err
    control = ["--gcps", str(folder / "gcps.csv"), "--crs", "EPSG:32633", "-o", output]
    for idle, kind in (("--scale=2", "grown"), ("--azimuth=9", "controlled"), ("--rectify=singly", "semicontrolled")):
        assert run(command(folder, "--kind", kind, idle, "--ties", ties, *control)) == 1
        assert f"{idle.partition('=')[0]} would do nothing without --kind" in capsys.readouterr().err
    assert run(command(folder, "--kind", "uncontrolled", "--azimuth", "nan", "--ties", ties, "-o", output)) == 2
    assert "finite" in capsys.readouterr().err


def test_tables_of_another_block(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rows of other images are named; a measurement far outside its image or made twice stops with its line."""
    lines = (folder / "ties.csv").read_text().splitlines()
    words = ["--kind", "uncontrolled", "--overwrite", "-o", str(tmp_path / "m.tif"), "--ties"]
    ties = tmp_path / "ties.csv"
    point, photo, _, *rest = lines[5].split(",")
    ties.write_text("\n".join([*lines, ",".join(["x1", "strip1_0.tif", "20", "30", *rest[1:]])]) + "\n")
    assert run([*command(folder, *words), str(ties)]) == 0
    assert "1 row of images that are not of the block: strip1_0.tif (did you mean 'strip1_0" in capsys.readouterr().err
    ties.write_text("\n".join([*lines[:5], ",".join([point, photo, "9000", *rest]), *lines[6:]]) + "\n")
    assert run([*command(folder, *words), str(ties)]) == 1
    said = capsys.readouterr().err
    assert "ties.csv, line 6: point" in said
    assert "lies outside" in said
    ties.write_text("\n".join([*lines, lines[5]]) + "\n")
    assert run([*command(folder, *words), str(ties)]) == 1
    assert f"ties.csv, line 6 and {ties}, line {len(lines) + 1})" in capsys.readouterr().err.replace("\n", "")


PROJECT = """
format = 1
[project]
name = "strip"
images = ["strip*.tif"]
[sensor]
name = "planar"
[exterior]
crs = "EPSG:32633"
[control]
file = "gcps.csv"
[planar]
kind = "{kind}"
ties = "ties.csv"
"""


@pytest.mark.parametrize("kind", ["semicontrolled", "uncontrolled"])
def test_a_project_runs_to_its_report(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    """A project of photos without a rigorous model runs to the report, and is fresh until a table changes."""
    for path in folder.glob("*.*"):
        if path.suffix in (".tif", ".csv"):
            (tmp_path / path.name).write_bytes(path.read_bytes())
    project = tmp_path / "project.toml"
    project.write_text(PROJECT.format(kind=kind))
    assert run(["run", str(project), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["orient"]["planar"]["kind"] == kind
    assert (found["orient"]["rms_check_px"] is None) == (kind == "uncontrolled")
    assert (tmp_path / "output" / "strip.tif").is_file()
    assert (tmp_path / "output" / "strip.stac.json").is_file() == (kind != "uncontrolled")
    model = json.loads((tmp_path / "output" / "models" / "strip1_01.tif.json").read_text())
    assert (model["sensor"], model["state"]["kind"]) == ("planar", "conformal")
    assert f"<p>{kind}, conformal: 4 photos" in (tmp_path / "output" / "report.html").read_text(encoding="utf-8")
    ties = (tmp_path / "ties.csv").read_text().splitlines()
    (tmp_path / "ties.csv").write_text("\n".join(ties[:-1]) + "\n")
    assert run(["status", str(project)]) == 0
    assert "ties.csv" in capsys.readouterr().out


def test_a_wrong_tie_stops_with_its_line_or_is_left_out(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Line 20 of the table, off by 40 px: exit code 1, file and line; --robust goes on without it, and says so."""
    lines = (folder / "ties.csv").read_text().splitlines()
    shown = [line.split(",")[0] for line in lines]
    number = next(k for k, name in enumerate(shown) if k and shown.count(name) > 2)
    point, photo, col, *rest = lines[number].split(",")
    lines[number] = ",".join([point, photo, str(float(col) + 40.0), *rest])
    (tmp_path / "bad.csv").write_text("\n".join(lines) + "\n")
    words = ["--kind", "semicontrolled", "--ties", str(tmp_path / "bad.csv"), "--gcps", str(folder / "gcps.csv")]
    words += ["--crs", "EPSG:32633", "-o", str(tmp_path / "m.tif")]
    assert run(command(folder, *words)) == 1
    said = capsys.readouterr().err
    assert f"tie point '{point}' in {photo}.tif (" in said
    assert f"bad.csv, line {number + 1})" in said
    assert not (tmp_path / "m.tif").exists()
    assert run(command(folder, *words, "--robust", "--json")) == 0
    captured = capsys.readouterr()
    assert "left out" in captured.err
    found = json.loads(captured.out)["placement"]["wrong_points"]
    assert [(one["point"], one["images"]) for one in found["found"]] == [(point, [f"{photo}.tif"])]
    assert found["left_out"]
    assert found["found"][0]["px"] == pytest.approx(40.0, abs=3.0)


@pytest.mark.parametrize("kind", ["semicontrolled", "uncontrolled"])
def test_pixels_of_a_project_of_photos_placed_together_are_located_where_its_mosaic_shows_them(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    photos = sorted(str(path) for path in folder.glob("strip*.tif"))
    words = ["--kind", kind, "--ties", str(folder / "ties.csv")]
    words += ["--gcps", str(folder / "gcps.csv"), "--crs", "EPSG:32633"] if kind == "semicontrolled" else []
    project = tmp_path / "p.toml"
    assert run(["new", str(project), *photos, *words]) == 0
    assert run(["run", str(project), "orient"]) == 0
    loaded = load_project(project)
    block = restore_block(loaded, loaded.options.render.dem_memory)
    capsys.readouterr()
    assert run(["locate", str(project), "--image", Path(photos[2]).name, "--pixel", "120", "80", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["points"][0]
    place = np.array([[found["x"], found["y"], 0.0]])
    np.testing.assert_allclose(block.scenes[2].model.ground_to_image(place), [[120, 80]], atol=1e-2)
    assert run(["locate", str(project), "--pixel", "120", "80"]) == 1
    assert "name one: --image" in capsys.readouterr().err
