"""Workers that die, hang, need too much memory or go away altogether: what is made has the bytes of one thread."""

from __future__ import annotations

import multiprocessing
import os
import platform
import re
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import worker_rig
from worker_rig import cluster, small_block

import geomosaic as gm
from geomosaic.errors import GeomosaicWarning, RasterReadError, WorkerError, WorkersUnreachableError, warn
from geomosaic.execution import run_report
from geomosaic.execution.unit_times import LEAST_PATIENCE, PATIENCE, UnitTimes
from geomosaic.execution.units import map_units, workers_for
from geomosaic.options.render import RenderOptions

pytestmark = pytest.mark.ci

# Places and units that are small, so that there are many of them.
PLACE: dict[str, Any] = {"resolution": 0.05, "tile": 1024, "vectors": False, "creation": {"COMPRESS": "JPEG"}}
# A strip across six photos, in seventeen units or tiles.
STRIP: dict[str, Any] = {**PLACE, "resolution": 0.0065, "bounds": (399943.0, 5500002.0, 400050.0, 5500002.8)}


def mosaic(block: gm.Block, folder: Path, **options: Any) -> tuple[dict[str, bytes], gm.MosaicResult]:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    made = gm.mosaic(block, folder / "m.tif", **{**PLACE, **options})
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.tif"))}, made


@pytest.fixture(scope="module")
def few(tmp_path_factory) -> tuple[gm.Block, dict[str, bytes]]:
    """Block of 6 photos, and a strip of its mosaic by one thread."""
    block = small_block(tmp_path_factory.mktemp("photos"), 2, 3)
    return block, mosaic(block, tmp_path_factory.mktemp("few") / "one", **STRIP, threads=1)[0]


class Killer:
    """Progress that ends a worker by SIGKILL every so many units."""

    def __init__(self, pids: Callable[[], list[int]], kills: int, every: int) -> None:
        self.pids, self.left, self.every, self.seen = pids, kills, every, 0

    def __call__(self, done: int, total: int, stage: str) -> None:
        self.seen += stage == "mosaic"
        if self.left and stage == "mosaic" and self.seen % self.every == 1:
            alive = self.pids()
            if alive:
                os.kill(alive[self.left % len(alive)], signal.SIGKILL)
                self.left -= 1


def processes() -> list[int]:
    return [one.pid for one in multiprocessing.active_children() if one.name == "geomosaic worker" and one.pid]


def test_processes_that_are_killed_on_the_way_are_replaced_and_change_no_byte(few, tmp_path) -> None:
    """The report tells what each did, what was lost, and what a rerun would cost."""
    block, expected = few
    killer = Killer(processes, 2, 4)
    found, made = mosaic(block, tmp_path / "killed", **STRIP, workers=2, progress=killer)
    assert found == expected
    assert killer.left == 0
    assert not processes()
    run = made.run
    assert run is not None
    assert run_report.current.get() is None
    assert (run.slots, run.kind) == (2, "2 processes")
    assert len(run.workers) >= 3  # those that came after the killed ones
    assert 1 <= run.lost["died"] == run.lost.total()
    grid, facts = made.grid, run.facts
    units = -(-grid.width // 1024) * -(-grid.height // 512)
    assert sum(one.units["RenderedUnits"] for one in run.workers.values()) == units
    assert facts["lost_units"] == {"died": run.lost["died"]}
    # Every photo is read by someone, and results come back by pipes, not by files.
    if facts["rerun"]["bytes_read"] is not None:  # Linux counts them
        assert facts["rerun"]["bytes_read"] >= sum(Path(path).stat().st_size for path in block.images)
    assert sum(one["bytes_returned"] for one in facts["workers"]) > 0
    assert facts["core_hours"] == pytest.approx(sum(one["seconds"] for one in facts["workers"]) / 3600.0, rel=1e-2)
    assert facts["rerun"]["seconds"] == pytest.approx(facts["core_hours"] * 1800.0)
    assert 0.0 < facts["rerun"]["seconds"] <= facts["seconds"]


def test_workers_are_opened_once_for_all_that_a_run_does() -> None:
    options = RenderOptions(workers=2)
    with workers_for(options) as run:
        assert run is not None
        assert list(map_units(float, range(5), options)) == [(k, float(k)) for k in range(5)]
        first = set(processes())
        with workers_for(options) as same:
            squares = dict(map_units(worker_rig.slow_square, range(300), options))
        assert same is run
        assert squares == {k: k * k for k in range(300)}
        assert set(processes()) >= first
        # A map that is left on the way hurts no other.
        with closing(map_units(worker_rig.slow_square, range(300), options)) as left:
            next(left)
        assert [value for _, value in map_units(float, range(100), options)] == list(range(100))
        with pytest.warns(GeomosaicWarning, match="of a unit"):
            list(map_units(warn, ["of a unit"], options))
        assert run.units >= 5 + 300 + 1 + 100
        assert len(run.workers) <= 2
    assert not processes()


@pytest.mark.parametrize(
    ("seconds", "size", "units"),
    [(1e-4, 100, 64), (0.01, 1000, 25), (0.01, 1 << 20, 4), (3.0, 100, 1), (0.0, 0, 64), (0.01, 1 << 30, 1)],
)
def test_tasks_have_as_many_units_as_a_quarter_of_a_second_and_four_megabytes_hold(seconds, size, units) -> None:
    times = UnitTimes()
    assert times.units_of_task() == 1  # until it is known
    assert times.patience(1) == LEAST_PATIENCE
    times.add(10, 10 * seconds, seconds, 10 * size)
    assert times.units_of_task() == units
    times.add(1, 100.0, 100.0, size)
    assert times.patience(3) == PATIENCE * 100.0 * 3


def test_units_that_grow_on_the_way_end_their_task_early(monkeypatch) -> None:
    """What is left of it goes out again, and the order is kept."""
    monkeypatch.setattr("geomosaic.execution.task.LONGEST", 0.1)
    with ThreadPoolExecutor(2) as executor:
        found = list(map_units(worker_rig.grows, range(90), RenderOptions(workers=executor)))
    assert found == [(k, k) for k in range(90)]


def test_a_process_that_hangs_or_is_over_its_memory_is_replaced(monkeypatch, tmp_path) -> None:
    """In the middle of a unit it is ended, and the unit is begun again."""
    monkeypatch.setattr("geomosaic.execution.unit_times.LEAST_PATIENCE", 4.0)
    options = RenderOptions(workers=1, memory_limit=256 << 20)
    with workers_for(options) as run:
        for unit in (worker_rig.hangs_once, worker_rig.hungry_once):
            assert [value for _, value in map_units(unit, [str(tmp_path / unit.__name__)], options)] == ["done"]
    assert run is not None
    assert run.lost == {"hung": 1, "memory": 1}


@pytest.mark.slow
def test_a_unit_that_always_hangs_is_named(monkeypatch) -> None:
    monkeypatch.setattr("geomosaic.execution.unit_times.LEAST_PATIENCE", 3.0)
    monkeypatch.setattr("geomosaic.execution.units_on_workers.RETRIES", 1)
    with pytest.raises(WorkerError, match=r"lost every time \(no answer in \d+ s\)") as caught:
        list(map_units(worker_rig.hangs, [0, 1], RenderOptions(workers=1)))
    assert caught.value.where == "1"


@pytest.mark.slow
def test_a_unit_that_always_needs_too_much_memory_is_named_with_the_limit() -> None:
    with pytest.raises(WorkerError, match=r"it held \d+ MB of memory, the limit is 400 MB") as caught:
        list(map_units(worker_rig.hungry, [0, 1], RenderOptions(workers=1, memory_limit=256 << 20)))
    assert caught.value.where == "1"


@pytest.mark.slow
def test_what_a_process_keeps_between_units_does_not_grow_beyond_its_memory() -> None:
    options = RenderOptions(workers=1, memory_limit=400 << 20)
    with workers_for(options) as run:
        kept = [most for _, most in map_units(worker_rig.keeps, range(6), options)]
    assert run is not None
    assert max(kept) <= 3
    assert (kept.count(1) >= 2, len(run.workers) >= 2, run.lost.total()) == (True, True, 0)


@pytest.fixture(scope="module")
def pair(tmp_path_factory) -> Iterator[tuple[Any, list[subprocess.Popen[bytes]]]]:
    """Cluster of two workers without nannies, which its last test here kills."""
    pytest.importorskip("distributed", reason="Dask is not here: pip install 'geomosaic[cluster]'")
    import dask

    with (
        dask.config.set({"distributed.comm.timeouts.connect": "2s"}),
        cluster(tmp_path_factory.mktemp("dask"), nannies=False) as started,
    ):
        yield started


def test_a_worker_that_cannot_do_the_work_is_named(pair, few, tmp_path, monkeypatch) -> None:
    """It sees other files than the client, which names them by way of its own folder; or it has too little memory."""
    client, _ = pair
    block, _ = few
    monkeypatch.chdir(block.images[0].parent)
    unseen = replace(block, images=tuple(Path("/proc/self/cwd") / path.name for path in block.images))
    if unseen.images[0].exists():  # on Linux
        with pytest.raises(RasterReadError) as caught:
            mosaic(unseen, tmp_path / "made", workers=client, balance=False)
        pids = "|".join(map(str, client.run(os.getpid).values()))
        assert re.search(rf"worker {platform.node()}:({pids}) must see the file under this path$", caught.value.hint)
        assert list((tmp_path / "made").iterdir()) == []
    with pytest.raises(WorkerError, match="has 4096 MB of memory, and units may need 8192 MB") as refused:
        list(map_units(float, [1], RenderOptions(workers=client, memory_limit=8 << 30)))
    assert str(refused.value.where).startswith("tcp://127.0.0.1:")
    assert list(map_units(float, [1], RenderOptions(workers=client))) == [(1, 1.0)]


def test_tiles_that_a_cluster_made_are_kept_when_a_worker_and_then_the_scheduler_are_killed(
    pair, few, tmp_path
) -> None:
    """Nothing half-written is left, and the same command renders what is missing, to the bytes of one thread."""
    block, _ = few
    # When the third tile is there, some have not been given to anyone.
    place = {**STRIP, "tiling": "1024px", "seam_quality": False}
    for name in ("one", "made"):
        (tmp_path / name).mkdir()
    gm.mosaic(block, tmp_path / "one" / "m.vrt", threads=1, **place)
    client, started = pair
    output = tmp_path / "made" / "m.vrt"
    killed: list[int] = []

    def kill(done: int, total: int, stage: str) -> None:
        if stage == "mosaic" and not killed:
            killed.append(next(iter(client.run(os.getpid).values())))
            os.kill(killed[0], signal.SIGKILL)
        if stage == "mosaic" and done == 3:
            started[0].kill()

    with pytest.raises(WorkersUnreachableError) as caught:
        gm.mosaic(block, output, workers=client, progress=kill, **place)
    assert caught.value.exit_code == 4
    for process in started:  # whatever they were at
        process.kill()
        process.wait()
    assert not output.exists()
    records = list((tmp_path / "made" / "m-tiles" / ".geomosaic").glob("m-r*.json"))
    made = gm.mosaic(block, output, threads=1, **place)
    assert made.units == 17
    assert 3 <= made.reused == len(records) < 17
    one, two = (
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.*") if path.suffix in (".tif", ".vrt")}
        for folder in (tmp_path / "one", tmp_path / "made")
    )
    assert two == one
    assert not list((tmp_path / "made").rglob("*partial*"))


@pytest.mark.slow
@pytest.mark.parametrize("nannies", [True, False])
def test_a_worker_of_a_cluster_that_hangs_is_done_without(nannies, tmp_path, monkeypatch) -> None:
    """With a nanny it is started anew; without one the other does its work."""
    monkeypatch.setattr("geomosaic.execution.unit_times.LEAST_PATIENCE", 10.0)
    with cluster(tmp_path, nannies=nannies) as (client, _):
        options = RenderOptions(workers=client)
        with workers_for(options) as run:
            assert [value for _, value in map_units(worker_rig.hangs_once, [str(tmp_path / "marker")], options)] == [
                "done"
            ]
        assert run is not None
        assert run.lost == {"hung": 1}


@pytest.mark.slow
def test_four_hundred_photos_on_a_cluster_whose_workers_are_killed_twenty_times(tmp_path) -> None:
    """Every two seconds one of the two gets SIGKILL; the mosaic is made until twenty were."""
    block = small_block(tmp_path / "photos", 20, 20)
    expected, _ = mosaic(block, tmp_path / "one", threads=1)
    (tmp_path / "dask").mkdir()
    with cluster(tmp_path / "dask") as (client, _):
        undisturbed, made = mosaic(block, tmp_path / "two", workers=client)
        assert undisturbed == expected
        assert not made.run.lost
        killed, over = [], threading.Event()

        def kill() -> None:
            while len(killed) < 20 and not over.wait(2.0):
                with suppress(Exception):
                    pids = [its["pid"] for its in client.run(_identity).values()]
                    os.kill(pids[len(killed) % len(pids)], signal.SIGKILL)
                    killed.append(time.monotonic())

        killer = threading.Thread(target=kill)
        killer.start()
        try:
            while len(killed) < 20:
                assert mosaic(block, tmp_path / "killed", workers=client)[0] == expected
        finally:
            over.set()
            killer.join()
    assert len(killed) == 20


def _identity() -> dict[str, int]:
    return {"pid": os.getpid()}
