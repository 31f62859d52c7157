"""`geomosaic edges`: photos and tables in, a mosaic and the misfits out."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from edge_render import photographs, roads
from edge_rig import rig

import geomosaic as gm
from geomosaic.cli.main import run
from geomosaic.options.inputs import EdgeOptions
from geomosaic.products.edges import EdgeInputs, match_photos


@pytest.fixture
def files(tmp_path: Path) -> Path:
    r = rig(2, "affine", common_sigma=0.05)
    photographs(r, roads(8), tmp_path, 300)
    control = ["id,x,y,z,image,col,row"]
    control += [f"{p.id},{p.xyz[0]},{p.xyz[1]},0,{p.image},{p.colrow[0]},{p.colrow[1]}" for p in r.control]
    (tmp_path / "gcps.csv").write_text("\n".join(control))
    common = ["id,image,col,row,sigma_px"]
    common += [f"{p.id},{p.image}.tif,{p.colrow[0]},{p.colrow[1]},{p.sigma_px}" for p in r.common]
    (tmp_path / "common.csv").write_text("\n".join(common))
    return tmp_path


def words(folder: Path, *more: str) -> list[str]:
    photos = [str(folder / f"photo-{k}.tif") for k in (0, 1)]
    tables = ["--gcps", str(folder / "gcps.csv"), "--common", str(folder / "common.csv"), "--crs", "EPSG:32633"]
    return ["edges", *photos, *tables, "-o", str(folder / "out.tif"), "--res", "4", *more]


def test_mosaic_and_misfits(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(words(files, "--json")) == 0
    told = json.loads(capsys.readouterr().out)
    assert (files / "out.tif").is_file()
    edges = told["edges"]
    assert edges["before"]["rms_px"] > 2.0 > edges["joined"]["largest_px"] * 100.0
    assert edges["joined"]["largest_px"] <= 0.02
    assert len(edges["after"]["points"]) == 8
    assert run(words(files, "--overwrite", "--model", "projective")) == 0
    said = capsys.readouterr().out
    assert "joined exactly" in said
    assert "px at the corners of the mosaic" in said


def test_workers_make_the_mosaic_of_one_thread_in_one_run(files: Path) -> None:
    given = [files / f"photo-{k}.tif" for k in (0, 1)], files / "gcps.csv", files / "common.csv", "EPSG:32633"
    with ThreadPoolExecutor(1) as workers:
        here, there = (
            gm.match_edges(given[0], files / f"{name}.tif", *given[1:], resolution=4.0, **how).mosaic
            for name, how in (("here", {"threads": 1}), ("there", {"workers": workers}))
        )
    assert there.path.read_bytes() == here.path.read_bytes()
    assert here.run is None
    assert there.run is not None
    (worker,) = there.run.workers.values()
    assert {"SamplesOfImage", "RenderedUnits", "facts_of_image"} <= set(worker.units)


def test_control_needs_no_heights(files: Path) -> None:
    """Plane models have no heights: the same solution without a column z, or with an empty one."""
    lines = [line.split(",") for line in (files / "gcps.csv").read_text().splitlines()]
    empty = [lines[0], *([*line[:3], "", *line[4:]] for line in lines[1:])]
    photos = (files / "photo-0.tif", files / "photo-1.tif")
    inputs = EdgeInputs(photos, files / "gcps.csv", files / "common.csv", "EPSG:32633", EdgeOptions())
    found = []
    for table in (lines, [line[:3] + line[4:] for line in lines], empty):
        (files / "gcps.csv").write_text("\n".join(",".join(line) for line in table))
        found.append(match_photos(inputs))
    assert found[0].joined.largest <= 0.02
    assert np.array_equal(found[0].residuals, found[1].residuals)
    assert np.array_equal(found[0].residuals, found[2].residuals)


def test_a_photo_without_control_starts_from_its_neighbour(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = (files / "gcps.csv").read_text().splitlines()
    (files / "gcps.csv").write_text("\n".join(line for line in lines if "photo-1" not in line or "c11" in line))
    assert run(words(files, "--json")) == 0
    assert json.loads(capsys.readouterr().out)["edges"]["joined"]["largest_px"] <= 0.02


def test_wrong_input_is_reported(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (files / "common.csv").write_text("id,image,col,row\np,other.tif,1,1\n")
    assert run(words(files)) == 1
    assert "no point of these images" in capsys.readouterr().err
    (files / "common.csv").write_text("id,image,col,row\np,photo-0,1,1\n")
    assert run(words(files)) == 1
    said = capsys.readouterr().err
    assert "1 point in one of these photos only, left out: p" in said
    assert "the photos share no point: there is no edge to match" in said


def test_common_points_of_a_larger_block(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A table of more photos than these: what only one of them shows is left out, and counted."""
    assert run(words(files, "--json")) == 0
    before = json.loads(capsys.readouterr().out)["edges"]
    with (files / "common.csv").open("a") as file:
        file.write("\nx1,photo-0,50,60,0.3\nx1,photo-7,50,60,0.3\n")
    assert run(words(files, "--json", "--overwrite")) == 0
    captured = capsys.readouterr()
    assert "1 point in one of these photos only, left out: x1" in captured.err
    assert json.loads(captured.out)["edges"] == before


def test_an_output_that_is_one_of_the_photos_is_refused(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photo = files / "photo-1.tif"
    before = photo.read_bytes()
    assert run([*words(files), "-o", str(photo), "--overwrite"]) == 1
    assert "the output is one of the inputs" in capsys.readouterr().err
    assert photo.read_bytes() == before
