"""The studio shows a project as its files are, and saves edits whole or not at all."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="the extra `studio` is not installed")
pytest.importorskip("httpx2", reason="httpx2 is not installed")

from studio_rig import PROJECT, owner, write_project

from geomosaic import whole_files
from geomosaic.errors import InputError, OutputError
from geomosaic.studio.changes import Changes
from geomosaic.studio.history import History, text_of
from geomosaic.studio.workspace import Workspace


def test_a_project_is_told_with_its_images(tmp_path: Path) -> None:
    with owner(write_project(tmp_path)) as client:
        told = client.get("/api/project").json()
        assert told["name"] == "scan"
        assert [(one["name"], one["width"], one["height"], one["oriented"]) for one in told["images"]] == [
            ("one.tif", 400, 300, False)
        ]
        assert told["messages"] == []
        image = told["images"][0]["id"]
        facts = client.get(f"/api/raster/{image}").json()
        assert (facts["width"], facts["levels"], facts["ready"]) == (400, 2, 1.0)
        tile = client.get(f"/tiles/{image}/0/0/0.webp", params={"v": facts["version"]})
        assert tile.headers["content-type"] == "image/webp"
        assert "immutable" in tile.headers["cache-control"]
        assert {step["name"]: step["reason"] for step in client.get("/api/steps").json()} == {
            "orient": "never run", "mosaic": "never run", "check": "never run", "report": "never run",
        }  # fmt: skip


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("format = 1\n[project\n", "not valid TOML"),
        (PROJECT.replace("images", "imagse"), "line 4: [project] imagse: unknown key; did you mean 'images'?"),
        (PROJECT.replace("*.tif", "*.jpg"), "no file"),
        ("", "no project file"),
    ],
)
def test_a_project_with_errors_is_opened_and_tells_them(tmp_path: Path, text: str, words: str) -> None:
    with owner(write_project(tmp_path, text)) as client:
        told = client.get("/api/project").json()
        assert told["images"] == []
        (message,) = told["messages"]
        assert message["kind"] == "error"
        assert words in f"{message['what']} {message['hint']}"
        assert client.get("/api/steps").json() == []
        (tmp_path / "project.toml").write_text(PROJECT)  # mended in an editor
        assert client.get("/api/project").json()["messages"] == []


def test_an_image_that_is_gone_is_told(tmp_path: Path) -> None:
    with owner(write_project(tmp_path)) as client:
        image = client.get("/api/project").json()["images"][0]["id"]
        (tmp_path / "one.tif").write_text("no raster")
        assert "not a raster" in client.get("/api/project").json()["images"][0]["error"]
        answer = client.get(f"/api/raster/{image}")
        assert answer.status_code == 422
        assert answer.json()["hint"]


def test_edits_are_undone_and_done_again_in_their_order(tmp_path: Path) -> None:
    file, other, history = tmp_path / "gcps.csv", tmp_path / "new.csv", History()
    file.write_text("a\n")
    history.save("first", {file: "a\n"}, {file: "b\n"})
    history.save("second", {file: "b\n", other: None}, {file: "c\n", other: "x\n"})
    assert history.titles == {"undo": "second", "redo": None}
    assert history.undo() == "second"
    assert (file.read_text(), other.exists()) == ("b\n", False)
    assert history.undo() == "first"
    assert file.read_text() == "a\n"
    with pytest.raises(InputError, match="nothing to undo"):
        history.undo()
    assert history.redo() == "first"
    assert history.redo() == "second"
    assert (file.read_text(), other.read_text()) == ("c\n", "x\n")
    history.undo()
    history.save("third", {file: "b\n"}, {file: "d\n"})
    with pytest.raises(InputError, match="nothing to do again"):
        history.redo()


def test_nothing_is_written_over_what_another_program_has_saved(tmp_path: Path) -> None:
    file, history = tmp_path / "gcps.csv", History()
    file.write_text("a\n")
    history.save("first", {file: "a\n"}, {file: "b\n"})
    file.write_text("edited in QGIS\n")
    for act in (history.undo, lambda: history.save("second", {file: "b\n"}, {file: "c\n"})):
        with pytest.raises(InputError, match="another program"):
            act()
        assert file.read_text() == "edited in QGIS\n"


def test_a_full_disk_leaves_all_files_as_they_were(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one, two, history = tmp_path / "a.csv", tmp_path / "b.csv", History()
    one.write_text("1\n")
    two.write_text("2\n")
    sync = whole_files.sync

    def full(path: Path) -> None:
        if "b.csv" in path.name:
            raise OSError(28, "No space left on device")
        sync(path)

    monkeypatch.setattr(whole_files, "sync", full)
    with pytest.raises(OutputError, match="No space left"):
        history.save("both", {one: "1\n", two: "2\n"}, {one: "11\n", two: "22\n"})
    assert (text_of(one), text_of(two)) == ("1\n", "2\n")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv", "b.csv"]
    assert history.titles["undo"] is None


def test_undo_by_the_page_answers_what_was_taken_back(tmp_path: Path) -> None:
    project = write_project(tmp_path)
    with owner(project) as client:
        assert client.post("/api/undo").status_code == 422
        assert client.post("/api/redo").json()["what"].startswith("there is nothing")


def test_a_change_by_another_program_is_told_within_a_second(tmp_path: Path) -> None:
    async def listen() -> tuple[dict, float]:
        changes = Changes(Workspace(write_project(tmp_path)))
        stream = changes.events()
        await anext(stream)
        watching = asyncio.create_task(changes.watch())
        await asyncio.sleep(0.1)
        loop = asyncio.get_running_loop()
        started = loop.time()
        (tmp_path / "project.toml").write_text(PROJECT.replace("scan", "map"))
        event = await asyncio.wait_for(anext(stream), 5)
        spent = loop.time() - started
        watching.cancel()
        changes.end()
        return json.loads(event.removeprefix("data: ")), spent

    event, spent = asyncio.run(listen())
    assert event == {"kind": "changed", "files": ["project.toml"]}
    assert spent < 1.0
