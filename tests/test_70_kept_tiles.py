"""Mosaics in tiles that were stopped: the same command renders what is missing or stale, to the same bytes."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import geomosaic as gm
from geomosaic.errors import InputError, Interrupted, OutputError, OutputExistsError
from geomosaic.mosaicking.kept_tiles import WrittenTile
from geomosaic.mosaicking.rendering import RenderedUnits, _WholeTiles

SAMPLE = Path(__file__).parents[1] / "data" / "sample"
FILES = {"camera": SAMPLE / "camera.toml", "exterior": SAMPLE / "exterior.csv", "crs": "EPSG:32633", "heights": "egm96"}
NAMES = ("strip1_02.jpg", "strip1_03.jpg", "strip1_04.jpg")
# Five tiles, the last of which shows nothing; one thread, so that it is known which come first.
BOUNDS = 399700.0, 5500340.0, 401700.0, 5500440.0
PLACE: dict[str, Any] = {"resolution": 0.4, "bounds": BOUNDS, "tiling": "1024px", "vectors": False}
ONE = {"threads": 1}


@pytest.fixture(scope="module")
def photos(tmp_path_factory) -> list[Path]:
    """Copies of three photos in a row, whose times of modification are this test's affair."""
    folder = tmp_path_factory.mktemp("photos")
    return [Path(shutil.copy2(SAMPLE / "photos" / name, folder)) for name in NAMES]


def block(photos: list[Path]) -> gm.Block:
    return gm.Block(photos, "frame", dem=SAMPLE / "dem.tif", **FILES)


def bytes_of(folder: Path) -> dict[str, bytes]:
    """What stands in a folder under final names; the GeoPackages have the time they were written."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.suffix != ".gpkg")
    return {str(path.relative_to(folder)): path.read_bytes() for path in files if ".geomosaic" not in path.parts}


@pytest.fixture(scope="module")
def whole(photos, tmp_path_factory) -> dict[str, bytes]:
    """What a run makes that nobody stops."""
    folder = tmp_path_factory.mktemp("whole")
    gm.mosaic(block(photos), folder / "m.vrt", **PLACE, **ONE)
    return bytes_of(folder)


@pytest.fixture
def rendered(monkeypatch) -> list[int]:
    """Left columns of the units that are rendered in this process."""
    found: list[int] = []
    once = RenderedUnits.__call__

    def counted(self: RenderedUnits, unit: Any) -> Any:
        found.append(unit.raster.col)
        return once(self, unit)

    monkeypatch.setattr(RenderedUnits, "__call__", counted)
    return found


def stop_after(units: int) -> Any:
    def report(done: int, total: int, stage: str) -> None:
        if stage == "mosaic" and done > units:
            raise Interrupted("stopped", hint="run it again")

    return report


def test_a_run_that_was_stopped_twice_goes_on_with_what_is_missing(photos, whole, rendered, tmp_path) -> None:
    output = tmp_path / "m.vrt"
    for place in range(2):
        with pytest.raises(Interrupted):
            gm.mosaic(block(photos), output, **PLACE, **ONE, progress=stop_after(place + 1))
        assert not output.exists()
        assert len(list((tmp_path / "m-tiles").glob("m-r*-labels.tif"))) == place + 1
        assert not list((tmp_path / "m-tiles").glob(".*partial*"))
    rendered.clear()
    made = gm.mosaic(block(photos), output, **PLACE, **ONE)
    assert set(rendered) == {2048, 3072, 4096}
    assert (made.reused, made.units, len(made.tiles)) == (2, 5, 4)
    assert bytes_of(tmp_path) == whole
    with pytest.raises(OutputExistsError, match="exists"):  # it is finished now
        gm.mosaic(block(photos), output, **PLACE, **ONE)


@pytest.mark.ci
def test_a_stale_tile_is_found_and_its_neighbours_are_kept(photos, whole, rendered, tmp_path) -> None:
    """A photo is touched, a tile edited, another one gone, an option changed."""
    output = tmp_path / "m.vrt"
    again = {**PLACE, **ONE, "overwrite": True, "balance": False, "seams": "nearest"}
    gm.mosaic(block(photos), output, **again)
    first = bytes_of(tmp_path)

    def columns() -> set[int]:
        rendered.clear()
        made = gm.mosaic(block(photos), output, **again)
        assert made.units - made.reused == len(set(rendered))
        assert bytes_of(tmp_path) == first
        return set(rendered)

    assert columns() == set()
    os.utime(photos[2], (1_700_000_000, 1_700_000_000))  # another photo, by name, size and time
    assert columns() == {1024, 2048, 3072}
    with (tmp_path / "m-tiles" / "m-r000-c001.tif").open("r+b") as file:
        file.seek(-9, os.SEEK_END)
        file.write(b"edited")
    (tmp_path / "m-tiles" / "m-r000-c002-labels.tif").unlink()
    assert columns() == {1024, 2048}
    (tmp_path / "m-tiles" / ".geomosaic" / "m-r000-c000.json").write_text("{}")
    assert columns() == {0}
    rendered.clear()
    assert gm.mosaic(block(photos), output, **again, resampling="cubic").reused == 0
    assert len(set(rendered)) == 5


@pytest.mark.parametrize("sees", [True, False])
def test_workers_write_whole_tiles_where_they_see_the_folder_and_send_pixels_where_not(
    photos, whole, rendered, tmp_path, monkeypatch, sees
) -> None:
    saved: list[str] = []
    once = WrittenTile.save

    def counted(self: WrittenTile, tile: Any) -> None:
        saved.append(threading.current_thread().name)
        once(self, tile)

    monkeypatch.setattr(WrittenTile, "save", counted)
    if not sees:  # a folder of the same name, on another disk
        own = _WholeTiles.__call__
        monkeypatch.setattr(_WholeTiles, "__call__", lambda self, tile: own(replace(self, token="another"), tile))
    with ThreadPoolExecutor(2, "worker") as executor:
        gm.mosaic(block(photos), tmp_path / "m.vrt", **PLACE, workers=executor)
    assert bytes_of(tmp_path) == whole
    assert len(saved) == 5
    assert {name.startswith("worker") for name in saved} == {sees}


KILLED = """
import json, os, signal, sys
import geomosaic as gm
from geomosaic.mosaicking.kept_tiles import WrittenTile

def dies(self, tile, once=WrittenTile.save):
    if tile.window.col == int(sys.argv[4]):  # its files are there, its record is not
        os.kill(os.getpid(), signal.SIGKILL)
    once(self, tile)

WrittenTile.save = dies
given = json.loads(sys.argv[1])
gm.mosaic(gm.Block(json.loads(sys.argv[2]), "frame", **given.pop("block")), sys.argv[3], **given)
"""


def test_a_run_killed_at_any_moment_goes_on(photos, whole, rendered, tmp_path) -> None:
    """Killed (SIGKILL) between a tile and its record; the partial file of another killed process lies about."""
    output = tmp_path / "m.vrt"
    files = {name: str(value) for name, value in {**FILES, "dem": SAMPLE / "dem.tif"}.items()}
    given, images = json.dumps({**PLACE, **ONE, "block": files}), json.dumps([str(path) for path in photos])
    killed = subprocess.run([sys.executable, "-c", KILLED, given, images, str(output), "2048"], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert not output.exists()
    assert (tmp_path / "m-tiles" / "m-r000-c002.tif").is_file()
    (tmp_path / "m-tiles" / ".m-r000-c003.tif.partial-elsewhere-17").write_bytes(b"half a tile")
    made = gm.mosaic(block(photos), output, **PLACE, **ONE)
    assert (set(rendered), made.reused) == ({2048, 3072, 4096}, 2)
    assert bytes_of(tmp_path) == whole


def test_folders_that_cannot_hold_tiles_are_refused_before_any_work(photos, rendered, tmp_path) -> None:
    (tmp_path / "m-tiles").write_text("no folder")
    with pytest.raises(InputError, match="is a file") as caught:
        gm.mosaic(block(photos), tmp_path / "m.vrt", **PLACE, **ONE)
    assert caught.value.hint
    foreign = tmp_path / "n-tiles"
    foreign.mkdir()
    (foreign / "holiday.jpg").write_bytes(b"")
    with pytest.raises(OutputExistsError, match="not empty"):
        gm.mosaic(block(photos), tmp_path / "n.vrt", **PLACE, **ONE)
    with pytest.raises(InputError, match="does not exist"):
        gm.mosaic(block(photos), tmp_path / "nowhere" / "m.vrt", **PLACE, **ONE)
    assert not rendered


def test_a_run_that_cannot_write_or_shows_nothing_leaves_nothing(photos, tmp_path) -> None:
    corner = {**PLACE, "bounds": (399410.0, 5500770.0, 399420.0, 5500780.0)}
    with pytest.raises(InputError, match="no image shows anything"):
        gm.mosaic(block(photos), tmp_path / "m.vrt", **corner, **ONE)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not Path("/sys/kernel").is_dir(), reason="needs a folder in which nobody may write")
def test_a_folder_without_rights_is_named(photos, rendered) -> None:
    with pytest.raises(OutputError) as caught:
        gm.mosaic(block(photos), "/sys/kernel/m.vrt", **PLACE, **ONE, max_output=1 << 30)
    assert "/sys/kernel/m-tiles" in str(caught.value.where)
    assert not rendered
