"""Block in the studio's application: residuals as the adjustment told them, rays, images set aside and taken back."""

from __future__ import annotations

import json
import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the extra `studio` is not installed")
pytest.importorskip("httpx2", reason="httpx2 is not installed")

from adjust_project_rig import grid_block, write_project
from block_rig import Block
from planar_rig import flight
from starlette.testclient import TestClient
from studio_rig import owner, write_image

import geomosaic as gm
from geomosaic.cli.main import run
from geomosaic.geo.transform import Transform
from geomosaic.orientation.single.next_point import ground_of
from geomosaic.sensor.corrected import model_from_dict


@pytest.fixture(scope="module")
def truth() -> Block:
    return grid_block(2, 4, 40, seed=3)


@pytest.fixture(scope="module")
def adjusted(truth: Block, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A block of two strips that step orient has adjusted; one tie point is 30 px wrong in one photo."""
    path = write_project(tmp_path_factory.mktemp("block"), truth)
    ties = path.parent / "ties.csv"
    lines = ties.read_text().splitlines()
    rays = [line.split(",")[0] for line in lines]
    row = next(row for row in range(1, len(lines)) if rays.count(rays[row]) >= 4)
    point, image, col, place = lines[row].split(",")
    lines[row] = f"{point},{image},{float(col) + 30.0},{place}"
    ties.write_text("\n".join(lines) + "\n")
    assert run(["run", str(path), "orient"]) == 0
    return path


@pytest.fixture
def client(adjusted: Path) -> Iterator[TestClient]:
    text = adjusted.read_text()
    with owner(adjusted) as found:
        yield found
    adjusted.write_text(text)


def test_residuals_from_the_files_are_those_that_the_adjustment_told(client: TestClient, adjusted: Path) -> None:
    told = json.loads((adjusted.parent / "output" / "adjustment.json").read_text())
    block = client.get("/api/block").json()
    assert block["state"] == "adjusted"
    assert block["sigma0"] == told["sigma0"]
    by_name = {image["name"]: image for image in block["images"]}
    for image in told["images"]:
        own = by_name[image["name"]]
        assert own["rms"] == pytest.approx(image["rms_px"], rel=1e-4)
        assert (own["points"], own["left_out"]) == (image["points"], image["rejected"])
    (wrong,) = [one for one in told["blunders"] if one["image"]]
    ties = client.get(f"/api/block/{by_name[wrong['image']]['id']}/ties").json()
    (out,) = [one for one in ties["points"] if one["left_out"]]
    assert out["id"] == wrong["point"]
    np.testing.assert_allclose(out["residual"], wrong["size"], atol=1e-3)
    assert out["residual"][0] == pytest.approx(30.0, abs=1.5)


def test_a_point_lies_on_the_map_where_it_is_and_names_all_images_that_show_it(
    client: TestClient, adjusted: Path, truth: Block
) -> None:
    block = client.get("/api/block").json()
    image = block["images"][1]
    point = max(client.get(f"/api/block/{image['id']}/ties").json()["points"], key=lambda one: one["rays"])
    rays = client.get("/api/block/rays", params={"point": point["id"]}).json()
    number = int(point["id"][1:])
    shown = {f"{truth.names[index]}.tif" for index in truth.image[truth.point == number]}
    assert {ray["name"] for ray in rays["rays"]} == shown
    # As well as its sigma says: some centimetres in plan.
    np.testing.assert_allclose(rays["on_map"], truth.frame.to_ground(truth.points)[number][:2], atol=0.5)
    assert [one["line"] for one in block["images"]] == [0] * 4 + [1] * 4
    ring = np.array(image["footprint"])
    assert (ring.min(axis=0) < rays["on_map"]).all()
    assert (ring.max(axis=0) > rays["on_map"]).all()


def test_an_image_is_set_aside_in_the_project_file_taken_back_and_undone(client: TestClient, adjusted: Path) -> None:
    text = adjusted.read_text()
    images = client.get("/api/block").json()["images"]
    first = images[0]
    answer = client.post(f"/api/block/{first['id']}/aside", json={"aside": True})
    assert answer.status_code == 200, answer.text
    changed = adjusted.read_text()
    assert tomllib.loads(changed)["project"]["set_aside"] == [first["name"]]
    assert [line for line in changed.splitlines() if "set_aside" not in line] == text.splitlines()
    block = client.get("/api/block").json()
    assert [one["by"] for one in block["images"]] == [None] * 7 + ["project"]
    assert [one["name"] for one in client.get("/api/project").json()["images"] if one["set_aside"]] == [first["name"]]
    stale = {step["name"]: step["fresh"] for step in client.get("/api/steps").json()}
    assert not stale["orient"]
    assert client.post("/api/undo").json()["title"] == f"{first['name']} set aside"
    assert adjusted.read_text() == text
    client.post("/api/redo")
    again = client.post(f"/api/block/{first['id']}/aside", json={"aside": False})
    assert again.status_code == 200, again.text
    assert adjusted.read_text() == text
    for one in images[:-1]:
        assert client.post(f"/api/block/{one['id']}/aside", json={"aside": True}).status_code == 200
    refused = client.post(f"/api/block/{images[-1]['id']}/aside", json={"aside": True})
    assert (refused.status_code, refused.json()["what"]) == (422, "the last image cannot be set aside")


def test_images_that_the_project_file_has_as_comments_are_told_with_the_reason_and_taken_back(
    client: TestClient, adjusted: Path
) -> None:
    text = adjusted.read_text()
    names = sorted(f"photos/{path.name}" for path in (adjusted.parent / "photos").glob("*.tif"))
    own = adjusted.parent / names[0]
    shutil.copy(own, own.with_name("again [1].tif"))
    quoted, reason = '"photos/again [[]1].tif"', f"the same file as {own.name}"
    start = text.index("images = [")
    rest = text[text.index("]", start) + 1 :]
    listed = "".join(f"    {json.dumps(name)},\n" for name in names)
    commented = f"{text[:start]}images = [\n{listed}    # {quoted},    # {reason}\n]{rest}"
    adjusted.write_text(commented)
    try:
        assert client.get("/api/block").json()["commented"] == {json.loads(quoted): reason}
        for wrong in ("../../etc/passwd", own.name, ""):
            assert client.post("/api/block/commented", json={"name": wrong}).status_code == 422
        assert adjusted.read_text() == commented
        answer = client.post("/api/block/commented", json={"name": json.loads(quoted)})
        assert answer.status_code == 200, answer.text
        assert adjusted.read_text() == commented.replace(f"# {quoted}", quoted)
        assert "again [1].tif" in [one["name"] for one in client.get("/api/project").json()["images"]]
        assert client.get("/api/block").json()["commented"] == {}
        client.post("/api/undo")
        assert adjusted.read_text() == commented
    finally:
        own.with_name("again [1].tif").unlink()


def test_a_step_runs_without_the_image_that_is_set_aside(adjusted: Path, tmp_path: Path) -> None:
    own = tmp_path / "block.toml"
    for file in adjusted.parent.iterdir():
        if file.name not in ("output", "block.toml"):
            (tmp_path / file.name).symlink_to(file)
    own.write_text(adjusted.read_text().replace("[sensor]", 'set_aside = ["s1p1.tif"]\n[sensor]', 1))
    assert run(["run", str(own), "orient"]) == 0
    with owner(own) as client:
        block = client.get("/api/block").json()
    assert [one["name"] for one in block["images"] if one["footprint"]] == [
        f"s{s}p{p}.tif" for s in (1, 2) for p in range(1, 5) if (s, p) != (1, 1)
    ]


def test_advice_of_a_photo_starts_from_its_block_and_comes_true_when_the_block_is_adjusted_again(
    adjusted: Path, truth: Block, tmp_path: Path
) -> None:
    """A control point is added where advice asks for one: the error told for then is that of the new adjustment."""
    own = tmp_path / "block.toml"
    for file in adjusted.parent.iterdir():
        if file.name == "output" or file.name == ".geomosaic":
            shutil.copytree(file, tmp_path / file.name)
        elif file.is_file():
            shutil.copy(file, tmp_path)
        else:
            (tmp_path / file.name).symlink_to(file)
    facts = tmp_path / ".geomosaic" / "block" / "facts"
    assert facts.is_dir()
    with owner(own) as client:
        image = client.get("/api/project").json()["images"][0]
        now = client.get(f"/api/control/{image['id']}/next").json()
        assert now["of_block"]
        assert now["rms"] < 2.0
        best = now["order"][0]
        state = json.loads((tmp_path / "output" / "models" / f"{image['name']}.json").read_text())
        model = model_from_dict(state)
        surface = gm.Dem.open(tmp_path / "dem.tif", heights="ellipsoidal")
        ground = ground_of(model, np.array([[best["col"], best["row"]]]), surface)
        x, y, z = Transform(model.crs, truth.frame.ground)(ground)[0]
        table = tmp_path / "control.csv"
        row = f"new,{x:.4f},{y:.4f},{z:.4f},{image['name']},{best['col']:.4f},{best['row']:.4f},0.001,0.001,control"
        table.write_text(table.read_text() + row + "\n")
        since = client.get(f"/api/control/{image['id']}/next").json()
    assert since["rms"] == pytest.approx(best["rms"], rel=0.02)
    assert run(["run", str(own), "orient"]) == 0
    with owner(own) as client:
        again = client.get(f"/api/control/{image['id']}/next").json()
    assert again["rms"] == pytest.approx(best["rms"], rel=0.1)
    assert again["rms"] < 0.97 * now["rms"]


PLANAR = """\
format = 1
[project]
name = "flat"
images = ["strip*.tif"]
[sensor]
name = "planar"
[exterior]
crs = "EPSG:32633"
[control]
file = "gcps.csv"
[planar]
kind = "controlled"
rectify = "together"
ties = "ties.csv"
[quality]
max_corner_sigma_px = 50
"""


def test_advice_of_a_photo_of_a_planar_block_starts_from_the_block_and_comes_true(tmp_path: Path) -> None:
    """Control in two photos of eight: the error told for another is that of the next adjustment with its point."""
    taken = flight(noise=0.3)
    for name, camera in taken.cameras.items():
        write_image(tmp_path / f"{name}.tif", np.full((camera.size[1], camera.size[0], 1), 7, np.uint8))
    first, *_, last = sorted(taken.cameras)
    rows = [f"{point},{photo},{col:.5f},{row:.5f},0.3" for point, photo, col, row in taken.ties]
    (tmp_path / "ties.csv").write_text("\n".join(["id,image,col,row,sigma_px", *rows]) + "\n")
    known = [one for one in taken.control if one[3] in (first, last)]
    rows = [f"{name},{x:.4f},{y:.4f},{photo},{col:.5f},{row:.5f},0.3" for name, x, y, photo, col, row in known]
    table, path = tmp_path / "gcps.csv", tmp_path / "flat.toml"
    table.write_text("\n".join(["id,x,y,image,col,row,sigma_px", *rows]) + "\n")
    path.write_text(PLANAR)
    assert run(["run", str(path), "orient"]) == 0
    with owner(path) as client:
        images = {one["name"]: one["id"] for one in client.get("/api/project").json()["images"]}
        name = sorted(taken.cameras)[3]  # at a corner without control
        address = f"/api/control/{images[f'{name}.tif']}/next"
        now = client.get(address).json()
        assert (now["of_block"], now["unit"]) == (True, "m")
        assert not client.get(f"{address}?model=affine").json()["of_block"]  # tried on this photo's own points
        best = now["order"][0]
        model = model_from_dict(json.loads((tmp_path / "output" / "models" / f"{name}.tif.json").read_text()))
        x, y, _ = ground_of(model, np.array([[best["col"], best["row"]]]), None)[0]
        table.write_text(f"{table.read_text()}new,{x:.4f},{y:.4f},{name},{best['col']:.4f},{best['row']:.4f},\n")
        since = client.get(address).json()
    assert since["rms"] == pytest.approx(best["rms"], rel=0.02)
    assert run(["run", str(path), "orient"]) == 0
    with owner(path) as client:
        again = client.get(address).json()
    assert again["rms"] == pytest.approx(best["rms"], rel=0.1)
    assert again["rms"] < 0.97 * now["rms"]
