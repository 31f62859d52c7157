"""Control in the studio's application: each edit is a row of the table, its answer the solution that it makes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the extra `studio` is not installed")
pytest.importorskip("httpx2", reason="httpx2 is not installed")

from reference_rig import GROUND
from starlette.testclient import TestClient
from studio_control_rig import (
    SCAN,
    ScanProject,
    frame_project,
    rpc_project,
    scan_ground,
    scan_pixels,
    scan_project,
    spot_ground,
    spot_project,
)
from studio_rig import owner

import geomosaic as gm
from geomosaic.geo.transform import Transform

PLACES = np.array([[60, 50], [640, 70], [630, 540], [70, 560], [350, 300], [200, 420], [520, 180]], dtype=float)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> ScanProject:
    return scan_project(tmp_path_factory.mktemp("studio"))


@pytest.fixture
def scan(written: ScanProject) -> ScanProject:
    written.table.unlink(missing_ok=True)
    return written


@pytest.fixture
def client(scan: ScanProject) -> Iterator[TestClient]:
    with owner(scan.path) as found:
        yield found


def layers(client: TestClient) -> tuple[str, str]:
    """Ids of the scan and of the reference."""
    project = client.get("/api/project").json()
    return project["images"][0]["id"], next(one["id"] for one in project["layers"] if one["role"] == "reference")


def place(
    client: TestClient, scan: ScanProject, pixel: np.ndarray, error: float = 0.0, noise: float = 0.0
) -> dict[str, Any]:
    """One point measured in both panes."""
    image, other = layers(client)
    col, row = scan.on_reference(scan_ground(pixel[None]))[0]
    off = np.random.default_rng(int(pixel[0])).normal(0.0, noise, 2)
    body = {"col": pixel[0] + error + off[0], "row": pixel[1] + off[1], "layer": other, "map_col": col, "map_row": row}
    answer = client.post(f"/api/control/{image}/points", json=body)
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_points_make_a_table_that_the_library_reads(client: TestClient, scan: ScanProject) -> None:
    image, _ = layers(client)
    first = client.get(f"/api/control/{image}").json()
    assert (first["points"], first["solution"], first["reason"]) == ([], None, "no point is measured yet")
    for pixel in PLACES:
        state = place(client, scan, pixel)
    assert state["solution"]["rms"] < 0.01
    control = gm.read_control(scan.table)
    np.testing.assert_allclose(control.colrow, PLACES, atol=1e-3)
    np.testing.assert_allclose(control.xy, scan_ground(PLACES), atol=2e-3)
    assert control.crs.to_epsg() == 32633
    assert [point["id"] for point in state["points"]] == list(control.names)


def test_a_wrong_point_is_named_moved_and_undone(client: TestClient, scan: ScanProject) -> None:
    image, _ = layers(client)
    for number, pixel in enumerate(PLACES):
        state = place(client, scan, pixel, 20.0 * (number == 4), 0.1)
    (told,) = [one for one in state["messages"] if one["code"] == "blunder"]
    assert told["points"] == ["5"]
    wrong = state["points"][4]
    assert wrong["blamed"]
    assert wrong["toggled"]["rms"] == pytest.approx(state["solution"]["clean_rms"], rel=1e-6)
    off = client.patch(f"/api/control/{image}/points/5", json={"enabled": False}).json()
    assert off["points"][4]["state"] == "off"
    assert off["solution"]["rms"] == pytest.approx(wrong["toggled"]["rms"], rel=1e-6)
    assert not gm.read_control(scan.table).enabled[4]
    assert client.post("/api/undo").json()["title"] == "point 5 switched off"
    moved = client.patch(f"/api/control/{image}/points/5", json={"col": PLACES[4, 0], "row": PLACES[4, 1]}).json()
    assert not moved["messages"]
    assert moved["solution"]["rms"] < 0.5
    client.post("/api/undo")
    assert client.get(f"/api/control/{image}").json()["solution"]["rms"] > 5.0
    client.post("/api/redo")
    assert client.get(f"/api/control/{image}").json()["solution"]["rms"] < 0.5
    gone = client.delete(f"/api/control/{image}/points/5").json()
    assert [point["id"] for point in gone["points"]] == ["1", "2", "3", "4", "6", "7"]


def test_places_are_expected_from_two_points_on_and_both_ways(client: TestClient, scan: ScanProject) -> None:
    image, other = layers(client)
    place(client, scan, PLACES[0])
    ask = f"/api/control/{image}/expected?layer={other}"
    assert client.get(f"{ask}&col=5&row=5").json()["col"] is None
    place(client, scan, PLACES[2])
    place(client, scan, PLACES[3])
    wanted = np.array([[333.0, 222.0]])
    col, row = scan.on_reference(scan_ground(wanted))[0]
    there = client.get(f"{ask}&map_col={col}&map_row={row}").json()
    np.testing.assert_allclose([there["col"], there["row"]], wanted[0], atol=0.02)
    back = client.get(f"{ask}&col=333&row=222").json()
    np.testing.assert_allclose([back["col"], back["row"]], [col, row], atol=0.02)
    state = client.get(f"/api/control/{image}?layer={other}").json()
    np.testing.assert_allclose([one["on_map"] for one in state["points"]], scan_ground(PLACES[[0, 2, 3]]), atol=2e-3)


def test_the_reference_is_matched_to_a_fraction_of_a_pixel(client: TestClient, scan: ScanProject) -> None:
    image, other = layers(client)
    for pixel in PLACES[:4]:
        place(client, scan, pixel + np.array([1.5, -1.0]))
    errors = []
    for xy in scan_ground(np.random.default_rng(3).uniform(120.0, 480.0, (8, 2))):
        col, row = scan.on_reference(xy[None])[0]
        body = {"way": "match", "layer": other, "map_col": col, "map_row": row}
        answer = client.post(f"/api/control/{image}/measure", json=body)
        if answer.status_code == 200:
            found = answer.json()
            errors.append(np.hypot(*(np.array([found["col"], found["row"]]) - scan_pixels(xy[None])[0])))
    assert len(errors) >= 5
    assert max(errors) < 0.15
    flat = client.post(f"/api/control/{image}/measure", json={"way": "mark", "col": -50.0, "row": 3.0})
    assert flat.status_code == 422
    assert flat.json()["hint"]


def test_the_next_point_lowers_the_expected_error_as_it_says(client: TestClient, scan: ScanProject) -> None:
    image, _ = layers(client)
    start = client.get(f"/api/control/{image}/next").json()
    assert start["unit"] == "px"
    for first in start["order"][:3]:
        assert min(first["col"], SCAN[0] - first["col"], first["row"], SCAN[1] - first["row"]) < 30
    for pixel in PLACES[[0, 4, 5, 6]]:
        place(client, scan, pixel, 0.0, 0.1)
    advice = client.get(f"/api/control/{image}/next").json()
    best = advice["order"][0]
    assert np.shape(advice["sigma"]) == np.shape(advice["rms_with"])
    assert best["rms"] == pytest.approx(min(map(min, advice["rms_with"])), rel=1e-6)
    assert best["rms"] < 0.9 * advice["rms"]


def test_a_sub_scene_uses_its_own_points(client: TestClient, scan: ScanProject) -> None:
    image, _ = layers(client)
    for pixel in PLACES:
        place(client, scan, pixel)
    part = client.get(f"/api/control/{image}?area=0,0,600,600").json()
    assert [point["state"] for point in part["points"]].count("outside") == 2
    assert client.get(f"/api/control/{image}?area=0,0,600").status_code == 400
    # Advice is of that part too: its accuracy, and places in it; a part that reaches beyond the image ends with it.
    for area, extent in (("100,50,500,350", [100, 50, 500, 350]), ("-90,-50,600,300", [0, 0, 600, 300])):
        advice = client.get(f"/api/control/{image}/next?area={area}").json()
        assert advice["extent"] == extent
        assert all(extent[0] < one["col"] < extent[2] and extent[1] < one["row"] < extent[3] for one in advice["order"])
    assert client.get(f"/api/control/{image}/next?area=9000,0,9100,90").status_code == 422


def test_the_image_is_written_where_its_points_place_it_and_steps_still_run(
    client: TestClient, scan: ScanProject
) -> None:
    image, _ = layers(client)
    for pixel in PLACES:
        place(client, scan, pixel)
    made = client.post(f"/api/control/{image}/georeference", json={}).json()
    assert made["file"] == "georeferenced/scan.tif"
    output = scan.path.parent / "output"
    assert (output / "georeferenced" / "scan.tif").is_file()
    (shown,) = [layer for layer in client.get("/api/project").json()["layers"] if layer["role"] == "ortho"]
    assert shown["name"] == "scan, by its control"
    # A scan that its control has placed is a map, on which points are measured.
    assert shown["on_map"]
    a, _, c, _, e, f = shown["affine"]
    pixel = np.array([300.0, 200.0])
    x, y = scan_ground(pixel[None])[0]
    query = f"layer={shown['id']}&map_col={(x - c) / a}&map_row={(y - f) / e}"
    there = client.get(f"/api/control/{image}/expected?{query}").json()
    assert np.hypot(there["col"] - pixel[0], there["row"] - pixel[1]) < 0.05
    body = {"col": pixel[0], "row": pixel[1], "layer": shown["id"], "map_col": (x - c) / a, "map_row": (y - f) / e}
    measured = client.post(f"/api/control/{image}/points?layer={shown['id']}", json=body).json()
    np.testing.assert_allclose(measured["points"][-1]["on_map"], [x, y], atol=1e-3)
    assert client.post("/api/undo").status_code == 200
    # The ortho of the step is another file, which it may write.
    gm.run_project(scan.path, steps=["orthos"])
    assert (output / "orthos" / "scan.tif").is_file()
    refused = client.post(f"/api/control/{image}/georeference", json={})
    assert (refused.status_code, "is there already" in refused.json()["what"]) == (422, True)
    assert client.get(f"/api/control/{image}").json()["written"] == "georeferenced/scan.tif"
    assert client.post(f"/api/control/{image}/georeference", json={"overwrite": True}).status_code == 200
    assert all(state.fresh for state in gm.run_project(scan.path, steps=["orthos"]).states)


@pytest.mark.parametrize(
    "body",
    [
        {}, {"col": "5", "row": 3}, {"col": 5, "row": None, "x": 1, "y": 2}, {"col": float("inf"), "row": 2},
        {"col": 5, "row": 5, "layer": "../../etc/passwd", "map_col": 3, "map_row": 4},
        {"col": 5, "row": 5, "x": 1, "y": 2, "role": "<script>"}, {"col": True, "row": 5, "x": 1, "y": 2},
    ],
)  # fmt: skip
def test_what_is_no_point_is_refused_and_nothing_is_written(
    client: TestClient, scan: ScanProject, body: dict[str, Any]
) -> None:
    image, _ = layers(client)
    text = "Infinity" if body.get("col") == float("inf") else None
    content = '{"col": Infinity, "row": 2}' if text else None
    answer = (
        client.post(f"/api/control/{image}/points", content=content)
        if content
        else client.post(f"/api/control/{image}/points", json=body)
    )
    assert 400 <= answer.status_code < 500
    assert not scan.table.exists()


def test_edits_of_others_are_kept_and_seen(client: TestClient, scan: ScanProject) -> None:
    image, _ = layers(client)
    for pixel in PLACES[:4]:
        place(client, scan, pixel)
    lines = scan.table.read_text().splitlines()
    scan.table.write_text("\n".join([*lines[:-1], "# by hand", lines[-1].replace("4,", "four,", 1)]) + "\n")
    state = client.get(f"/api/control/{image}").json()
    assert [point["id"] for point in state["points"]] == ["1", "2", "3", "four"]
    assert client.post("/api/undo").status_code == 422
    first, second = (state["points"][index] for index in (0, 1))
    address, told = f"/api/control/{image}/points/1", {"was": [first["col"], first["row"]]}
    assert client.patch(address, json={"enabled": False, "was": [second["col"], second["row"]]}).status_code == 422
    assert client.patch(address, json={"col": first["col"] + 1.0, **told}).status_code == 200
    for answer in (
        client.patch(address, json={"enabled": False, **told}),
        client.request("DELETE", address, json=told),
    ):
        assert answer.status_code == 422
        assert "point '1' is not where it was" in answer.json()["what"]
    client.patch(f"/api/control/{image}/points/four", json={"role": "check"})
    assert "# by hand" in scan.table.read_text()
    assert client.get(f"/api/control/{image}").json()["points"][3]["state"] == "check"


def test_a_damaged_table_is_told_with_its_line(client: TestClient, scan: ScanProject) -> None:
    image, _ = layers(client)
    scan.table.write_text("id,x,y,image,col,row\na,1,2,scan.tif,3,four\n")
    answer = client.get(f"/api/control/{image}")
    assert answer.status_code == 422
    assert "line 2" in answer.json()["where"]
    scan.table.unlink()
    scan.table.with_suffix(".x").unlink(missing_ok=True)
    assert client.get(f"/api/control/{image}").status_code == 200


def test_a_photo_is_measured_through_its_camera(tmp_path: Path) -> None:
    """Orientation some pixels wrong: expected places, matches, and a camera that its points bring to the truth."""
    project, camera = frame_project(tmp_path)
    xy = np.stack(np.meshgrid([-170.0, 0.0, 170.0], [-120.0, 120.0]), axis=2).reshape(-1, 2)
    xy = xy + np.array([400_030.0, 5_499_960.0])
    xyz = np.column_stack([xy, GROUND.height(xy)])
    true = camera.ground_to_image(Transform(GROUND.crs, camera.crs)(xyz))
    places = project.on_reference(xy)
    with owner(project.path) as client:
        image, other = layers(client)
        ask = f"/api/control/{image}"
        start = client.get(ask).json()
        assert start["predicts"]
        assert start["model"] == "sensor"
        first = client.get(f"{ask}/next").json()
        assert first["unit"] == "m"
        off, chosen, by_hand = [], [], 0
        for place, pixel in zip(places, true, strict=True):
            at = {"layer": other, "map_col": place[0], "map_row": place[1]}
            query = "&".join(f"{name}={value}" for name, value in at.items())
            there = client.get(f"{ask}/expected?{query}").json()
            off.append(np.hypot(there["col"] - pixel[0], there["row"] - pixel[1]))
            found = client.post(f"{ask}/measure", json={"way": "match", **at})
            # Some places look like others near them: they are pointed at by hand.
            matched = found.json() if found.status_code == 200 else {"col": pixel[0] + 0.3, "row": pixel[1] - 0.2}
            measured = {"col": matched["col"], "row": matched["row"]}
            by_hand += found.status_code != 200
            chosen.append([measured["col"], measured["row"]])
            state = client.post(f"{ask}/points?layer={other}", json={**measured, **at}).json()
        back = client.get(f"{ask}/expected?layer={other}&col={true[1, 0]}&row={true[1, 1]}").json()
        after = client.get(f"{ask}/next").json()
    assert by_hand < 4
    assert max(off[:3]) > 1.2
    assert off[-1] < 0.7
    assert np.abs(np.array(chosen) - true).max() < 0.5
    assert state["solution"]["rms"] < 0.5
    assert state["solution"]["redundancy"] == 6
    assert after["order"][0]["rms"] < after["rms"] < 0.02 * first["rms"]
    np.testing.assert_allclose([one["on_map"] for one in state["points"]], xy, atol=0.01)
    np.testing.assert_allclose([back["col"], back["row"]], places[1], atol=0.5)
    # The table has heights of the surface, and the library reads it for the project's block.
    assert gm.read_control(tmp_path / "gcps.csv").ground.shape == (6, 3)


def many_points(count: int, width: int, height: int) -> np.ndarray:
    """Pixels (N, 2) spread over an image."""
    return np.random.default_rng(4).uniform(20.0, np.array([width, height]) - 20.0, (count, 2))


def scan_of_many_points(folder: Path) -> tuple[ScanProject, np.ndarray, np.ndarray]:
    """Scan with 200 points of 0.1 px, and the pixels and map places of ten more."""
    places = many_points(210, *SCAN)
    project, xy = scan_project(folder), scan_ground(places)
    measured = places + np.random.default_rng(5).normal(0.0, 0.1, places.shape)
    lines = [
        f"{k},{x:.4f},{y:.4f},scan.tif,{c:.3f},{r:.3f}"
        for k, ((x, y), (c, r)) in enumerate(zip(xy, measured, strict=True), 1)
    ]
    project.table.write_text("\n".join(["# crs: EPSG:32633", "id,x,y,image,col,row", *lines[:200]]) + "\n")
    return project, places[200:], xy[200:]


def spot_of_many_points(folder: Path) -> tuple[ScanProject, np.ndarray, np.ndarray]:
    """SPOT scene with 200 points of 0.4 px, and the pixels and map places of ten more."""
    places = many_points(210, 2900, 2900)
    return spot_project(folder, places[:200], 0.4), places[200:], spot_ground(places[200:])


def photo_of_many_points(folder: Path) -> tuple[ScanProject, np.ndarray, np.ndarray]:
    """Photo with 200 points of 0.3 px, and the pixels and map places of ten more."""
    project, camera = frame_project(folder)
    xy = np.random.default_rng(4).uniform((399_870.0, 5_499_850.0), (400_190.0, 5_500_070.0), (210, 2))
    xyz = np.column_stack([xy, GROUND.height(xy)])
    places = camera.ground_to_image(Transform(GROUND.crs, camera.crs)(xyz))
    measured = places + np.random.default_rng(5).normal(0.0, 0.3, places.shape)
    lines = [
        f"{k},{x:.4f},{y:.4f},{z:.4f},photo.tif,{c:.3f},{r:.3f}"
        for k, ((x, y, z), (c, r)) in enumerate(zip(xyz, measured, strict=True), 1)
    ]
    project.table.write_text("\n".join(["id,x,y,z,image,col,row", *lines[:200]]) + "\n")
    return project, places[200:], xy[200:]


def rpc_of_many_points(folder: Path) -> tuple[ScanProject, np.ndarray, np.ndarray]:
    """Scene with RPCs a few pixels off, 200 points of 0.3 px, and the pixels and map places of ten more."""
    return rpc_project(folder, 200, 0.3)


@pytest.mark.slow
@pytest.mark.parametrize("write", [scan_of_many_points, spot_of_many_points, photo_of_many_points, rpc_of_many_points])
def test_a_point_beside_200_others_is_solved_within_150_ms(
    tmp_path: Path, write: Callable[[Path], tuple[ScanProject, np.ndarray, np.ndarray]]
) -> None:
    project, places, xy = write(tmp_path)
    spent = []
    with owner(project.path) as client:
        image, other = layers(client)
        client.get(f"/api/control/{image}?layer={other}")  # as the page does when it opens
        for (col, row), (map_col, map_row) in zip(places, project.on_reference(xy), strict=True):
            body = {"col": col, "row": row, "layer": other, "map_col": map_col, "map_row": map_row}
            started = time.process_time()
            answer = client.post(f"/api/control/{image}/points?layer={other}", json=body)
            spent.append(time.process_time() - started)
            assert answer.status_code == 200, answer.text
    state = answer.json()
    assert len(state["points"]) == 210
    assert state["solution"]["redundancy"] > 390
    assert all(one["left_out"] is not None for one in state["points"])
    assert np.median(spent) <= 0.150, np.round(1e3 * np.array(spent))
    assert spent[0] <= 0.200, np.round(1e3 * np.array(spent))
