"""Units of work on processes and on a Dask cluster: the bytes that threads make, whatever happens to workers."""

from __future__ import annotations

import pickle
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from cli_rig import PHOTOS

import geomosaic as gm
from geomosaic.errors import GeomosaicWarning, InputError, SensorInputError, WorkerError, warn
from geomosaic.execution import packing
from geomosaic.execution.units import map_units
from geomosaic.execution.units_on_workers import RETRIES
from geomosaic.options.render import RenderOptions
from geomosaic.render import regions
from geomosaic.render.photos import Photos
from geomosaic.stores.failures import StoreError

SAMPLE = Path(__file__).parents[1] / "data" / "sample"
FILES = {"camera": SAMPLE / "camera.toml", "exterior": SAMPLE / "exterior.csv", "crs": "EPSG:32633", "heights": "egm96"}
BLOCK = gm.Block([SAMPLE / "photos" / name for name in PHOTOS[::2]], "frame", dem=SAMPLE / "dem.tif", **FILES)
# A strip of three units of 512 rows, across both photos.
PLACE = {"resolution": 0.7, "bounds": (400000.0, 5499700.0, 400140.0, 5500700.0), "tile": 1024}
WAYS = [
    {"blend": "multiband", "creation": {"COMPRESS": "NONE"}, "nodata": 0.0, "colour": "gain,vignetting"},
    pytest.param({"true_ortho": True, "balance": False}, marks=pytest.mark.slow),
    pytest.param({"rule": "median"}, marks=pytest.mark.slow),
    pytest.param({"histogram": "overlap", "stretch": "2,98"}, marks=pytest.mark.slow),
]


def rasters(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.rglob("*.tif"))}


def mosaic(folder: Path, **options: Any) -> dict[str, bytes]:
    folder.mkdir()
    gm.mosaic(BLOCK, folder / "m.tif", vectors=False, **PLACE, **options)
    return rasters(folder)


@pytest.fixture(scope="module")
def client(tmp_path_factory) -> Iterator[Any]:
    """Client of a Dask cluster of two processes on this machine."""
    distributed = pytest.importorskip("distributed", reason="Dask is not here: pip install 'geomosaic[cluster]'")
    import dask

    with (
        dask.config.set(temporary_directory=str(tmp_path_factory.mktemp("dask"))),
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield client


def test_workers_of_another_version_are_refused_by_name(client, monkeypatch, tmp_path) -> None:
    """Workers tell their versions when they are asked, and each looks at those of what it gets."""
    same = dict(packing.versions())
    work = packing.packed(len)
    monkeypatch.setitem(packing.versions(), "geomosaic", "0.0.9")
    monkeypatch.setitem(packing.versions(), "kernels", "0123456789ab")
    apart = f"geomosaic {same['geomosaic']} there, 0.0.9 here; kernels {same['kernels']} there, 0123456789ab here"
    with pytest.raises(WorkerError, match=apart) as caught:
        mosaic(tmp_path / "other", workers=client)
    assert str(caught.value.where).startswith("tcp://127.0.0.1:")
    assert list((tmp_path / "other").iterdir()) == []
    with pytest.raises(WorkerError, match=f"geomosaic {same['geomosaic']} there, 0.0.9 here"):
        packing.unpacked(work)


def test_a_cluster_makes_the_sample_of_one_thread(client, tmp_path) -> None:
    """All twelve photos, on two processes."""
    sample = replace(BLOCK, images=sorted((SAMPLE / "photos").glob("*.jpg")))
    assert len(sample.images) == 12
    place = {"resolution": 3.0, "tile": 1024, "vectors": False, "colour": "gain"}  # two units
    for name, how in (("one", {"threads": 1}), ("two", {"workers": client})):
        (tmp_path / name).mkdir()
        made = gm.mosaic(sample, tmp_path / name / "m.tif", **place, **how)
    assert rasters(tmp_path / "two") == rasters(tmp_path / "one")
    assert len(made.run.workers) == 2


@pytest.mark.parametrize("way", WAYS)
def test_what_is_sent_renders_the_same_bytes(way, tmp_path) -> None:
    """In an executor of this process everything is packed and opened again as in another."""
    plain = mosaic(tmp_path / "threads", threads=1, **way)
    with ThreadPoolExecutor(1) as executor:
        assert mosaic(tmp_path / "sent", workers=executor, **way) == plain


# What pixels depend on beside one image: transitions, gaps, the order of images. A tile of a mosaic is a unit, too.
REGIONS = [
    pytest.param({"blend": "multiband", "colour": "gain"}, marks=pytest.mark.ci),
    pytest.param({"tiling": "1024px", "colour": "gain"}, marks=pytest.mark.ci),
    *(
        pytest.param(way, marks=pytest.mark.slow)
        for way in (
            {"blend": "edge", "seams": "order", "colour": "gain"}, {"blend": "cutline"}, {"blend": "overlap"},
            {"rule": "median"}, {"rule": "first"}, {"true_ortho": True},
            {"seams": "graph-cut", "colour": "gain,vignetting"},
        )
    ),
]  # fmt: skip


@pytest.mark.parametrize("way", REGIONS)
def test_what_is_sent_by_regions_renders_the_same_bytes(way, monkeypatch, tmp_path) -> None:
    """Units get the images that their region depends on, and no others."""
    monkeypatch.setattr(regions, "MOST_IMAGES", 5)
    sample = replace(BLOCK, images=sorted((SAMPLE / "photos").glob("*.jpg")))
    sent, only = [], Photos.only

    def noted(photos, near):
        if near is not None:
            sent.append({*near})
        return only(photos, near)

    monkeypatch.setattr(Photos, "only", noted)
    place = {"resolution": 1.5, "tile": 1024, "vectors": False, **way}
    name = "m.vrt" if "tiling" in way else "m.tif"
    made = {}
    for which in ("threads", "sent"):
        with ThreadPoolExecutor(1) as executor:
            how = {"threads": 1} if which == "threads" else {"workers": executor}
            (tmp_path / which).mkdir()
            gm.mosaic(sample, tmp_path / which / name, **place, **how)
        made[which] = rasters(tmp_path / which)
        assert bool(sent) == (which == "sent")
    assert made["sent"] == made["threads"]
    assert len(sent) > 1
    assert min(map(len, sent)) < len(sample.images)


# Signals that a unit sends to the process it runs in: none, and one that nothing survives. What sends them is not of
# this file, which workers then need not load.
HARMLESS, DEADLY = 0, int(signal.SIGKILL)


@pytest.mark.parametrize("retries", [1, pytest.param(RETRIES, marks=pytest.mark.slow)])
def test_a_unit_that_kills_every_process_is_named_after_its_trials(retries, monkeypatch) -> None:
    monkeypatch.setattr("geomosaic.execution.units_on_workers.RETRIES", retries)
    items, done = [HARMLESS, HARMLESS, DEADLY, HARMLESS], []
    with pytest.raises(WorkerError, match=f"begun {retries + 1} times and lost every time") as caught:
        done.extend(item for item, _ in map_units(signal.raise_signal, items, RenderOptions(workers=1)))
    assert (caught.value.where, done) == (str(DEADLY), [HARMLESS, HARMLESS])


@pytest.mark.slow
def test_a_unit_that_kills_every_worker_of_a_cluster_is_named(client) -> None:
    with pytest.raises(WorkerError, match="lost every time"):
        list(map_units(signal.raise_signal, [HARMLESS, DEADLY], RenderOptions(workers=client)))


def test_warnings_of_units_are_given_here_once_each(client) -> None:
    with ThreadPoolExecutor(1) as executor:
        for workers in (client, executor):
            with pytest.warns(GeomosaicWarning) as caught:
                list(map_units(warn, ["one", "two", "one"], RenderOptions(workers=workers)))
            assert [str(each.message) for each in caught] == ["one", "two"]


class Counting(Executor):
    """Executor that knows how many results nobody has taken."""

    _max_workers = 2
    begun = most = 0

    def submit(self, function: Any, *args: Any) -> Any:
        self.begun += 1
        self.most = max(self.most, self.begun)
        counting, future = self, Future[Any]()
        future.set_result(function(*args))

        class Taken:
            def result(self) -> Any:
                counting.begun -= 1
                return future.result()

            def cancel(self) -> None: ...

        return Taken()


def test_units_go_out_in_bounded_waves() -> None:
    executor = Counting()
    found = list(map_units(float, range(1000), RenderOptions(workers=executor)))
    assert found == [(k, float(k)) for k in range(1000)]
    assert executor.most == 6


def misses(item: int) -> int:
    raise SensorInputError("no such thing", name="camera", where="a.tif", hint="give one")


def refused(item: int) -> int:
    raise StoreError("the store does not let this be read (403)", where="s3://a/b.tif", hint="check the key")


def fails_twice(path: str) -> str:
    with Path(path).open("a") as file:
        file.write("x")
    if Path(path).stat().st_size < 3:
        raise OSError("a passing fault")
    return Path(path).read_text()


def test_errors_of_the_user_come_back_as_they_are_and_others_are_tried_again(tmp_path) -> None:
    with ThreadPoolExecutor(1) as executor:
        options = RenderOptions(workers=executor)
        with pytest.raises(SensorInputError, match="no such thing"):
            list(map_units(misses, [1], options))
        with pytest.raises(StoreError, match=r"check the key; worker \S+:\d+ asks the store by its own environment"):
            list(map_units(refused, [1], options))
        assert next(map_units(fails_twice, [str(tmp_path / "tries")], options))[1] == "xxx"
        with pytest.raises(WorkerError, match="cannot be sent to other processes"):
            list(map_units(lambda item: item, [1], options))
    error = pickle.loads(pickle.dumps(SensorInputError("what", name="camera", where="a", hint="b")))
    assert (str(error), error.name) == ("a: what\n  hint: b", "camera")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("0", "0 workers do nothing"),
        (0, "0 is"),
        ("tcp://192.168.1.4:8786", "anyone on the network"),
        ("tcp://scheduler:8786", "anyone on the network"),
        ("http://127.0.0.1:8786", "neither a number"),
        ("tcp://127.0.0.1:65536", "neither a number"),
        ("two", "neither a number"),
        (True, "not a whole number"),
        ([2], "cannot be of type list"),
    ],
)
def test_workers_that_cannot_be_are_refused_at_once(given, words) -> None:
    with pytest.raises(InputError, match=words) as caught:
        RenderOptions(workers=given)
    assert caught.value.where == "`workers`"
    assert caught.value.hint


def test_a_script_whose_processes_would_start_it_again_is_told_how_to_call(tmp_path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "from geomosaic.execution.units import map_units\n"
        "from geomosaic.options.render import RunningOptions\n"
        "print(list(map_units(abs, range(3), RunningOptions(workers=1))))\n"
    )
    ended = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 1
    assert ended.stderr.splitlines()[-1].startswith("  hint: a script must make the call under if __name__")


def test_addresses_of_this_machine_and_encrypted_ones_are_taken() -> None:
    for text in ("tls://scheduler.example:8786", "tcp://127.0.0.1:8786", "tcp://localhost:1", "tcp://[::1]:8786"):
        assert RenderOptions(workers=text).workers == text
    assert RenderOptions(workers="3").workers == 3


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch) -> None:
    pytest.importorskip("distributed", reason="Dask is not here: pip install 'geomosaic[cluster]'")
    monkeypatch.setattr("geomosaic.execution.cluster.SCHEDULER_TIMEOUT", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as mute:
        for port, why in ((9, "Timed out"), (mute.getsockname()[1], "what listens there says nothing")):
            with pytest.raises(WorkerError, match=rf"no Dask scheduler answers \({why}") as caught:
                list(map_units(float, [1], RenderOptions(workers=f"tcp://127.0.0.1:{port}")))
            assert caught.value.where == f"tcp://127.0.0.1:{port}"


def test_an_encrypted_scheduler_without_certificates_is_not_tried() -> None:
    pytest.importorskip("distributed", reason="Dask is not here: pip install 'geomosaic[cluster]'")
    with pytest.raises(WorkerError, match="tls:// needs certificates in Dask's configuration"):
        list(map_units(float, [1], RenderOptions(workers="tls://127.0.0.1:9")))
