"""Edits that are saved elsewhere: seen while the other program still holds the file, and run as soon as they are."""

from __future__ import annotations

import json
import queue
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from project_rig import edit_south, make_project

from geomosaic.cli.main import run
from geomosaic.digests import sha256
from geomosaic.jobs.project import status_of
from geomosaic.jobs.run_control import file_states, wait_for_change
from geomosaic.project.load import load_project
from geomosaic.raster.files import Hashes
from geomosaic.raster.vector import read_layer

pytestmark = pytest.mark.ci


@pytest.fixture(scope="module")
def made(sample, tmp_path_factory) -> Path:
    file = make_project(tmp_path_factory.mktemp("watch") / "one", sample)
    assert run(["run", str(file), "mosaic"]) == 0
    edit_south(file)
    assert run(["run", str(file), "mosaic"]) == 0
    return file


@pytest.fixture
def own(made, tmp_path) -> Path:
    shutil.copytree(made.parent, tmp_path / "own")
    return tmp_path / "own" / made.name


QGIS = """
import sqlite3, sys
import shapely
database = sqlite3.connect(sys.argv[1], isolation_level=None)
for (name,) in database.execute("select name from sqlite_master where type = 'trigger'").fetchall():
    database.execute(f'drop trigger "{name}"')  # they call functions of GDAL's
database.execute("pragma journal_mode = wal")
database.execute("pragma wal_checkpoint(truncate)")
print("open", flush=True)
for by in map(float, sys.stdin):
    number, blob = database.execute("select fid, geom from seams").fetchone()
    head = 8 + (0, 32, 48, 48, 64)[(blob[3] >> 1) & 7]
    shape = shapely.from_wkb(blob[head:]).buffer(-by)
    database.execute("update seams set geom = ? where fid = ?", (blob[:head] + shapely.to_wkb(shape), number))
    print("saved", flush=True)
database.close()
"""


@contextmanager
def held_open(file: Path) -> Iterator[Callable[[float], None]]:
    """Hold a GeoPackage as QGIS does while a layer is edited; gives a function that draws in the first area's border.

    What is saved stands in a journal beside the file.
    """
    words = [sys.executable, "-c", QGIS, str(file)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdin is not None
        assert other.stdout is not None
        assert other.stdout.readline() == "open\n"

        def shrink(by: float) -> None:
            other.stdin.write(f"{by}\n")
            other.stdin.flush()
            assert other.stdout.readline() == "saved\n"

        yield shrink
    assert other.returncode == 0


def mosaic_of(project: Path) -> str:
    return next(state.reason for state in status_of(load_project(project)) if state.name == "mosaic")


def test_an_edit_in_the_journal_is_an_edit(own, tell):
    assert mosaic_of(own) == "fresh"
    mine = own.parent / "mine.gpkg"
    with held_open(mine) as shrink:
        assert tell("run", own, "mosaic")[0] == 0  # the file says now that there is a journal
        before, area = sha256(mine), read_layer(mine, "seams").geometry[0].area
        assert mosaic_of(own) == "fresh"
        shrink(8.0)
        assert sha256(mine) == before
        assert read_layer(mine, "seams").geometry[0].area < area
        assert mosaic_of(own) == "mine.gpkg changed"
        code, out, _ = tell("run", own, "mosaic")
        assert code == 0
        assert "units computed, the rest kept" in out
        assert mosaic_of(own) == "fresh"
    assert not mine.with_name("mine.gpkg-wal").exists()


def test_a_file_without_a_journal_counts_as_it_is(tmp_path):
    file = tmp_path / "a.gpkg"
    file.write_bytes(b"one")
    (tmp_path / "a.gpkg-wal").touch()
    assert Hashes().of(file) == sha256(file)
    (tmp_path / "a.gpkg-wal").write_bytes(b"two")
    assert Hashes().of(file) != sha256(file)


def test_an_output_with_changes_beside_it_is_not_replaced(own, tell):
    """SQLite would put the old file's journal into the new one."""
    own.write_text(own.read_text().replace('cutlines = "mine.gpkg"\n', ""))
    output = own.parent / "output" / "trial.gpkg"
    with held_open(output) as shrink:
        shrink(8.0)
        before = sha256(output), sha256(output.with_suffix(".tif"))
        code, _, err = tell("run", own, "mosaic")
        assert code == 1
        assert "changes to the output stand beside it" in err
        assert "trial.gpkg-wal" in err
        assert (sha256(output), sha256(output.with_suffix(".tif"))) == before
    assert tell("run", own, "mosaic")[0] == 0


def test_a_change_is_waited_for_until_it_is_whole(tmp_path):
    file, other = tmp_path / "a", tmp_path / "b"
    file.write_text("one")
    before = file_states([file, other])

    def write() -> None:
        for number in range(8):
            time.sleep(0.05)
            with file.open("a") as stream:
                stream.write(f" {number}")
        other.touch()

    writer = threading.Thread(target=write)
    writer.start()
    now = wait_for_change(before, pause=0.6)
    assert not writer.is_alive()
    assert file.read_text().endswith("7")
    assert now == file_states([file, other])
    assert [path for path in now if now[path] != before[path]] == [file, other]


def test_a_journal_without_its_file_is_not_put_into_a_new_one(own, tell):
    """QGIS ended badly, and only the GeoPackage was removed."""
    output = own.parent / "output" / "trial.gpkg"
    output.unlink()
    left = output.with_name("trial.gpkg-wal")
    left.write_bytes(b"pages of another file")
    code, _, err = tell("run", own, "mosaic")
    assert code == 1
    assert "remove both files" in err
    left.unlink()
    assert tell("run", own, "mosaic")[0] == 0


def test_a_journal_that_has_just_gone_is_none(tmp_path, monkeypatch):
    file = tmp_path / "a.gpkg"
    file.write_bytes(b"one")
    monkeypatch.setattr("geomosaic.raster.files._filled_journal", lambda path: path.with_name("a.gpkg-wal"))
    assert Hashes().of(file) == sha256(file)


@contextmanager
def watcher(project: Path) -> Iterator[tuple[subprocess.Popen[str], Callable[[], dict[str, Any]]]]:
    """A run that watches, and a function that gives its next answer, within two minutes."""
    start = "from geomosaic.cli.main import main; main()"
    words = [sys.executable, "-c", start, "run", str(project), "mosaic", "--watch", "--json"]
    answers: queue.Queue[str] = queue.Queue()
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as watching:

        def listen() -> None:
            assert watching.stdout is not None
            for line in watching.stdout:
                answers.put(line)

        threading.Thread(target=listen, daemon=True).start()
        try:
            yield watching, lambda: json.loads(answers.get(timeout=120))
        finally:
            watching.kill()


def fresh(answer: dict[str, Any]) -> list[bool]:
    return [state["fresh"] for state in answer["steps"]]


def test_an_edit_is_run_by_the_process_that_watches(own):
    """A wrong setting is told and waited out; an edit is run by the process that is there; Ctrl-C ends it."""
    with watcher(own) as (watching, said):
        assert fresh(said()) == [True, True]
        good = own.read_text()
        own.write_text(good.replace("[mosaic]", "[mosaics]"))
        assert "mosaics" in said()["error"]["what"]
        own.write_text(good.replace('cutlines = "mine.gpkg"\n', ""))
        again = said()
        assert fresh(again) == [True, False]
        assert 0 < again["mosaic"]["reused"] < again["mosaic"]["units"]
        watching.send_signal(signal.SIGINT)
        assert said()["error"]["what"] == "stopped by Ctrl-C"
        assert watching.wait(timeout=60) == 130


def test_a_photo_that_goes_and_comes_back_is_seen(own):
    photo = next((own.parent / "photos").iterdir())
    with watcher(own) as (watching, said):
        assert fresh(said()) == [True, True]
        photo.rename(own.parent / "away.jpg")
        assert photo.name in json.dumps(said()["error"])
        (own.parent / "away.jpg").rename(photo)
        assert fresh(said())[-1]  # the mosaic is still that of all photos
        watching.send_signal(signal.SIGTERM)
        assert watching.wait(timeout=60) == 4


@pytest.mark.slow  # one that comes back is seen by default
def test_a_photo_that_comes_is_seen(own):
    photo = next((own.parent / "photos").iterdir())
    head, tail = own.read_text().split("[sensor]", 1)
    own.write_text(head.split("images =")[0] + 'images = ["photos/*.jpg"]\n[sensor]' + tail)
    photo.rename(own.parent / "away.jpg")
    with watcher(own) as (_, said):
        without = said()
        (own.parent / "away.jpg").rename(photo)
        assert said() != without


def test_an_output_that_is_closed_elsewhere_is_made(own):
    with watcher(own) as (_, said):
        assert fresh(said()) == [True, True]
        with held_open(own.parent / "output" / "trial.gpkg") as shrink:
            shrink(8.0)
            assert "changes to the output" in said()["error"]["what"]
        assert fresh(said()) == [True, False]
