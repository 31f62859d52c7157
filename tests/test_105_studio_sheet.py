"""Sheets in the studio: edits of layouts, previews, prints."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pytest
import rasterio

pytest.importorskip("starlette", reason="the extra `studio` is not installed")
pytest.importorskip("tomlkit", reason="the extra `studio` is not installed")
pytest.importorskip("httpx2", reason="httpx2 is not installed")

from PIL import Image
from sheet_project_rig import LAYOUT, sheet_project
from sheet_reading import SheetPdf
from studio_rig import owner

import geomosaic as gm
from geomosaic.studio.sheets.layout_files import edited


@pytest.fixture
def project(tmp_path: Path) -> Path:
    return sheet_project(tmp_path)


@pytest.fixture
def client(project: Path) -> Iterator[Any]:
    with owner(project) as client:
        yield client


def first(client: Any) -> tuple[str, str]:
    """Ids of the layout and of the mosaic."""
    found = client.get("/api/sheets").json()
    assert [one["name"] for one in found["layouts"]] == ["wall.toml"]
    return found["layouts"][0]["id"], found["rasters"][0]["id"]


def test_edits_keep_comments_and_order_and_are_undone(client: Any, project: Path) -> None:
    layout, _ = first(client)
    file = project.parent / "wall.toml"

    def change(*edits: dict[str, Any]) -> Any:
        return client.patch(f"/api/sheets/{layout}", json={"edits": list(edits), "title": "tried"})

    answer = change({"table": "sheet", "key": "title", "value": 'New "title"'})
    assert answer.status_code == 200
    assert answer.json()["values"]["sheet"]["title"] == 'New "title"'
    assert file.read_text() == LAYOUT.replace('"Old title"', '"New \\"title\\""')
    moved = change({"table": "legend", "key": "position", "value": [20.5, 30]})
    assert "[legend]\nposition = [20.5, 30]" in file.read_text()
    assert moved.json()["history"]["undo"] == "tried"
    change({"table": "layer", "index": 0, "key": "color", "value": "#0000ff"})
    change({"layer": "add", "file": "roads.gpkg"}, {"layer": "move", "index": 1, "to": 0})
    assert [set(one) for one in client.get(f"/api/sheets/{layout}").json()["values"]["layer"]] == [
        {"file"}, {"file", "style", "color"},
    ]  # fmt: skip
    for comment in ("# made by hand", "# what stands above the map", "# roads last"):
        assert comment in file.read_text()
    # What was meant for a layer that is elsewhere by now is not done to another one.
    for edit in ({"layer": "remove"}, {"table": "layer", "key": "title", "value": "Roads"}):
        assert change({**edit, "index": 0, "of": ["rivers.gpkg", None]}).status_code == 422
    assert change({"layer": "remove", "index": 0, "of": ["roads.gpkg", None]}).status_code == 200
    for _ in range(5):
        assert client.post("/api/undo").status_code == 200
    assert file.read_text() == LAYOUT


@pytest.mark.parametrize(
    ("edit", "what", "where"),
    [
        ({"table": "sheet", "key": "titel", "value": "x"}, "unknown key 'titel'", "wall.toml, [sheet]"),
        ({"table": "grid", "key": "width", "value": -1}, "-1 is out of range", "wall.toml, [grid] width"),
        ({"table": "sheet", "key": "dpi", "value": "many"}, "'many' is not a whole number", "wall.toml, [sheet] dpi"),
        ({"table": "sheet", "key": "logo", "value": "../../logo.png"}, "outside the project", "[sheet] logo"),
        ({"layer": "add", "file": "/etc/passwd"}, "outside the project", "[layer] file"),
        ({"table": "layer", "index": 7, "key": "color", "value": "red"}, "no such layer", None),
        ({"table": "legend", "key": "width", "value": 40}, "would do nothing without", "[legend]"),
    ],
)
def test_an_edit_that_makes_the_layout_wrong_is_refused_with_its_place(
    client: Any, project: Path, edit: dict[str, Any], what: str, where: str | None
) -> None:
    layout, _ = first(client)
    answer = client.patch(f"/api/sheets/{layout}", json={"edits": [edit]})
    assert answer.status_code == 422
    assert what in answer.json()["what"]
    assert answer.json()["hint"]
    assert answer.json()["where"] == where
    assert (project.parent / "wall.toml").read_text() == LAYOUT


def test_a_layout_spoilt_by_hand_is_shown_with_its_error_and_mended_by_an_edit(client: Any, project: Path) -> None:
    layout, raster = first(client)
    file = project.parent / "wall.toml"
    file.write_text(LAYOUT.replace("interval = 200.0", 'interval = "wide"'))
    state = client.get(f"/api/sheets/{layout}").json()
    assert state["error"]["where"] == "wall.toml, [grid] interval"
    other = {"edits": [{"table": "sheet", "key": "number", "value": "3"}]}
    assert client.patch(f"/api/sheets/{layout}", json=other).json()["error"] == state["error"]
    mend = {"edits": [{"table": "grid", "key": "interval", "value": 100}]}
    assert client.patch(f"/api/sheets/{layout}", json=mend).json()["error"] is None
    file.write_text("[sheet\n")
    answer = client.get(f"/api/sheets/{layout}")
    assert answer.status_code == 422  # no table by which it would be a layout
    assert client.get(f"/api/sheets/{layout}/preview?raster={raster}").status_code == 422


def test_two_layouts_one_of_them_from_the_template(client: Any, project: Path) -> None:
    first(client)
    made = client.post("/api/sheets", json={"name": "for the office"}).json()
    assert made["name"] == "for-the-office.toml"
    assert made["values"]["sheet"]["title"] == "scan"
    assert made["error"] is None
    assert len(client.get("/api/sheets").json()["layouts"]) == 2
    for name in ("for the office", "../other", "", "project"):
        assert client.post("/api/sheets", json={"name": name}).status_code == 422
    client.post("/api/undo")
    assert not (project.parent / "for-the-office.toml").exists()


@pytest.mark.ci
def test_the_preview_is_what_the_command_prints_at_that_resolution_and_the_print_too(
    client: Any, project: Path
) -> None:
    layout, raster = first(client)
    folder = project.parent
    address = f"/api/sheets/{layout}/preview?raster={raster}&dpi=80"
    found = client.get(address).json()
    assert found["error"] is None
    assert {"title", "legend", "scalebar", "north", "notes"} <= set(found["sheet"]["elements"])
    picture = client.get(f"/api/sheets/pictures/{found['key']}.png")
    assert picture.headers["content-type"] == "image/png"
    gm.sheet(folder / "output" / "scan.tif", folder / "own.png", layout=folder / "wall.toml", dpi=80)
    shown, own = (np.asarray(Image.open(one)) for one in (io.BytesIO(picture.content), folder / "own.png"))
    np.testing.assert_array_equal(shown, own)
    started = time.perf_counter()
    assert client.get(address).json()["key"] == found["key"]
    assert time.perf_counter() - started < 0.3  # kept
    client.patch(f"/api/sheets/{layout}", json={"edits": [{"table": "sheet", "key": "title", "value": "Ours"}]})
    changed = client.get(address).json()
    assert changed["key"] != found["key"]
    assert changed["seconds"] < 3.0  # one on a quiet machine
    edit = {"table": "legend", "key": "position", "value": [20.0, 500.0]}
    client.patch(f"/api/sheets/{layout}", json={"edits": [edit]})
    wrong = client.get(address).json()["error"]
    assert wrong["where"] == "[legend] position"
    assert "beyond the paper" in wrong["what"]
    client.post("/api/undo")
    assert client.post(f"/api/sheets/{layout}/print", json={"raster": raster, "format": "png"}).status_code == 200
    assert client.post("/api/sheets/print/stop").json()["state"] == "stopped"
    order = {"raster": raster, "format": "pdf"}
    assert client.post(f"/api/sheets/{layout}/print", json=order).json()["state"] == "running"
    done = ended_print(client)
    assert Path(done["output"]) == folder / "output" / "wall-sheet.pdf"
    assert [one.name for one in (folder / "output").iterdir() if "wall" in one.name] == ["wall-sheet.pdf"]
    assert "Ours" in SheetPdf(Path(done["output"])).text
    assert client.post(f"/api/sheets/{layout}/print", json=order).status_code == 422  # there is one already
    assert client.post(f"/api/sheets/{layout}/print", json={**order, "format": "exe"}).status_code == 422


def test_a_printed_map_sheet_is_a_picture_to_draw_on(client: Any, project: Path) -> None:
    layout, raster = first(client)
    assert not [one for one in client.get("/api/project").json()["layers"] if one["role"] == "sheet"]
    client.post(f"/api/sheets/{layout}/print", json={"raster": raster, "format": "tif"})
    assert ended_print(client)["output"] == str(project.parent / "output" / "wall-sheet.tif")
    (layer,) = [one for one in client.get("/api/project").json()["layers"] if one["role"] == "sheet"]
    assert layer["name"] == "wall-sheet"
    assert [one["name"] for one in client.get("/api/sheets").json()["rasters"]] == ["scan"]  # no sheet of a sheet
    values = {"name": "paths", "kind": "Point", "fields": [], "map_layer": raster}
    paths = client.post("/api/features/layers", json=values).json()["id"]
    pixel = [0.4 * layer["width"], 0.6 * layer["height"]]
    with rasterio.open(project.parent / "output" / "wall-sheet.tif") as file:
        place = list(file.transform @ pixel)
    # On the map that the sheet is, and on the sheet in its own pixels.
    for side, coordinates in (("map_layer", place), ("image", pixel)):
        point = {"id": None, "geometry": {"type": "Point", "coordinates": coordinates}}
        body = {"changes": [point], side: layer["id"]}
        assert client.post(f"/api/features/layers/{paths}/edits", json=body).status_code == 200
    drawn = geopandas.read_file(project.parent / "paths.gpkg")
    np.testing.assert_allclose(np.column_stack([drawn.geometry.x, drawn.geometry.y]), [place, place], atol=1e-3)


def ended_print(client: Any) -> dict[str, Any]:
    """The print when it has ended well."""
    until = time.monotonic() + 30
    while (done := client.get("/api/sheets").json()["print"])["state"] == "running":
        assert time.monotonic() < until
        time.sleep(0.05)
    assert done["state"] == "done", done
    return done


def test_the_form_has_every_key_of_a_layout(client: Any) -> None:
    form = {one["table"]: {key["key"]: key for key in one["keys"]} for one in client.get("/api/sheets").json()["form"]}
    assert form["grid"]["style"]["choices"] == ["lines", "crosses", "ticks", "none"]
    assert form["grid"]["color"]["kind"] == "colour"
    assert form["map"]["bounds"]["count"] == 4
    assert form["sheet"]["title_position"]["position"] == "title"
    assert form["layer"]["file"]["default"] is None
    assert form["contours"]["dem"]["kind"] == "text"


def test_the_last_layer_taken_off_takes_its_list_with_it() -> None:
    assert "[[layer]]" not in edited(LAYOUT, {"layer": "remove", "index": 0})
