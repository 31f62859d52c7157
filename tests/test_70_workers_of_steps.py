"""Steps on workers: each computes its units in other processes, to the bytes and facts of one thread."""

from __future__ import annotations

import os
import pickle
import platform
import re
import traceback
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_rig import PHOTOS

import geomosaic as gm
from geomosaic.execution.run_report import RunReport
from geomosaic.execution.units import workers_for
from geomosaic.jobs.project import run_project
from geomosaic.options.render import RenderOptions
from geomosaic.project.sample_block import copy_sample
from geomosaic.raster.cloud_mask import CloudMask
from geomosaic.raster.source import Source

pytestmark = pytest.mark.ci

SAMPLE = Path(__file__).parents[1] / "data" / "sample"
FILES = {"camera": SAMPLE / "camera.toml", "exterior": SAMPLE / "exterior.csv", "crs": "EPSG:32633", "heights": "egm96"}
BLOCK = gm.Block([SAMPLE / "photos" / name for name in PHOTOS[::2]], "frame", dem=SAMPLE / "dem.tif", **FILES)
# Across both photos.
PLACE = {"resolution": 1.0, "bounds": (400000.0, 5499700.0, 400140.0, 5500300.0), "tile": 1024}


WORKERS = 2


@pytest.fixture(scope="module")
def run() -> Iterator[RunReport]:
    """Report of a run on two processes, which takes in all tests of this file."""
    with workers_for(RenderOptions(workers=WORKERS)) as report:
        assert report is not None
        yield report


def units(run: RunReport) -> Counter[str]:
    """Units that workers have computed so far, by the name of their function."""
    assert f"{platform.node()}:{os.getpid()}" not in run.workers
    return sum((worker.units for worker in run.workers.values()), Counter())


@pytest.fixture(autouse=True)
def fixed_time(monkeypatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


# Functions that read a few photos at the client, however many the block has: 48 places, and 10.
FEW = ("_difference_noise", "worst_places")


@pytest.fixture
def read_here(monkeypatch) -> list[str]:
    """Photos that this process reads from now on, but for those of `FEW`."""
    found: list[str] = []
    read = Source.read

    def noted(self: Source, *args: Any, **options: Any) -> Any:
        frames = {frame.name for frame in traceback.extract_stack()}
        if self.info.path.endswith(".jpg") and not frames.intersection(FEW):
            found.append(self.info.path)
        return read(self, *args, **options)

    monkeypatch.setattr(Source, "read", noted)
    return found


MOSAICS = {
    "matched histograms, graph cuts, multiband blending, all rasters beside": (
        {
            "histogram": "overlap", "stretch": "2,98", "seams": "graph-cut", "blend": "multiband",
            "views": True, "displacement": 100.0, "accuracy": True, "sigma_dem": 1.0, "sigma_px": 0.3,
        },
        {
            "footprint": 2, "ThumbnailOfImage": 4, "image_terms": 2, "RenderedUnits": 2, "facts_of_image": 2,
            "LabelledUnits": 4, "AccuracyUnits": 1,
        },
    ),
    "balance, outlines of valid pixels, seam quality": (
        {"src_nodata": 0.0, "seam_quality": True, "colour": "gain,vignetting"},
        {
            "footprint": 2, "SamplesOfImage": 2, "correction_field": 2, "valid_outline": 2, "RenderedUnits": 2,
            "facts_of_image": 2, "measured": 1,
        },
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", MOSAICS)
def test_every_step_of_a_mosaic_has_workers_compute_its_units(what, run, tmp_path, read_here) -> None:
    """The client reads no photo."""
    options, expected = MOSAICS[what]
    options = dict(options)
    block = replace(BLOCK, src_nodata=options.pop("src_nodata", None))
    for name in ("one", "many"):
        (tmp_path / name).mkdir()
    gm.mosaic(block, tmp_path / "one" / "m.tif", **PLACE, **options, threads=1)
    before = units(run)
    read_here.clear()
    gm.mosaic(block, tmp_path / "many" / "m.tif", **PLACE, **options, threads=1, workers=WORKERS)
    assert files(tmp_path / "many") == files(tmp_path / "one")
    assert dict(units(run) - before) == expected
    assert not read_here


def test_tie_points_are_those_of_threads_and_the_client_reads_no_photo(run, tmp_path, read_here) -> None:
    few = {"features": 400, "match_size": 1000}
    strip = replace(BLOCK, images=[SAMPLE / "photos" / name for name in PHOTOS[:2]])
    here = gm.match(strip, threads=1, **few)
    before = units(run)
    read_here.clear()
    there = gm.match(strip, cache=tmp_path / "cache", workers=WORKERS, **few)
    assert len(here.ties) > 50
    assert there.ties.points == here.ties.points
    np.testing.assert_array_equal(there.ties.colrow, here.ties.colrow)
    np.testing.assert_array_equal(there.ties.covariance, here.ties.covariance)
    assert dict(units(run) - before) == {"content": 2, "features": 2, "pair": 1, "patches": 2}
    assert not read_here
    # What they made is kept by the client, whatever workers see of its disk.
    assert gm.match(strip, cache=tmp_path / "cache", threads=1, **few).ties.points == here.ties.points


def test_maps_of_one_image_tell_the_run_they_were_made_in(run, tmp_path) -> None:
    for name, how in (("one", {"threads": 1}), ("many", {"workers": WORKERS})):
        made = gm.reproject(SAMPLE / "dem.tif", tmp_path / f"{name}.tif", dst_crs="EPSG:3857", **how)
        assert made.run is (run if name == "many" else None)
    assert (tmp_path / "one.tif").read_bytes() == (tmp_path / "many.tif").read_bytes()
    given = {"crs": "EPSG:32633", "model": "conformal", "resolution": 4.0, "report": False, "insist": True}
    photo = SAMPLE / "photos" / PHOTOS[0]
    placed = gm.georeference(photo, tmp_path / "placed.tif", SAMPLE / "gcps.csv", workers=WORKERS, **given)
    assert placed.product.run is run


def test_a_project_with_orthos_and_a_check_has_the_bytes_of_one_thread(run, tmp_path, read_here) -> None:
    made, checks = {}, {}
    for name, how in (("one", {"threads": 1}), ("many", {"threads": 1, "workers": WORKERS})):
        file = copy_sample(tmp_path / name)
        text = re.sub(r"(?s)\[control\].*?\[output\]", "[output]\northos = true", file.read_text())
        text = text.replace("*.jpg", "strip1_0[12].jpg").replace("resolution = 1.0", "resolution = 4.0")
        file.write_text(text.partition("max_control")[0] + "max_registration_px = 1.0\n")
        before = units(run)
        read_here.clear()
        done = run_project(file, **how)
        assert done.failure is None
        checks[name] = done.facts["check"]
        made[name] = {path.name: path.read_bytes() for path in (tmp_path / name / "output").rglob("*.tif")}
    assert len(made["one"]) == 4  # the mosaic, its labels, two orthos
    assert made["many"] == made["one"]
    assert checks["many"] == checks["one"]
    found = units(run) - before
    assert (found["RectifiedUnits"], found["Strips"]) == (2, 6)
    assert not read_here


def test_a_process_makes_the_ortho_of_files_under_relative_names(run, tmp_path, monkeypatch) -> None:
    """Relative to the client's folder, not to that of the process."""
    monkeypatch.chdir(SAMPLE)
    assert pickle.loads(pickle.dumps(CloudMask("dem.tif"))) == CloudMask(str(SAMPLE / "dem.tif"))
    one = gm.Scene(Path("photos") / PHOTOS[0], "frame", dem="dem.tif", **FILES)
    for name, how in (("plain", {"threads": 1}), ("sent", {"workers": WORKERS})):
        gm.ortho(one, tmp_path / f"{name}.tif", **PLACE, **how)
    assert (tmp_path / "plain.tif").read_bytes() == (tmp_path / "sent.tif").read_bytes()


# Modules with threads of their own, and why these do not go to workers.
OWN_THREADS = {
    "execution/units.py": "the one loop",
    "inputs/orientation_plausibility.py": "looks at eight photos of any block",
    "kernels/threads.py": "parts of one array",
    "mosaicking/mosaic.py": "one thread for checksum and drivers while the mosaic is finished",
    "project/folders.py": "headers of files for a draft",
    "raster/cog/writer.py": "overviews of the file that the client writes",
    "stores/objects.py": "ranges of one file that are read at the same time",
    "studio/app.py": "pictures for a browser",
    "testing/conformance.py": "a test of threads",
    "testing/synthetic/photo.py": "photos for tests",
}


def test_no_step_has_threads_or_processes_of_its_own() -> None:
    root = Path(gm.__file__).parent
    own = re.compile(r"\b(map_in_order|ThreadPoolExecutor|ProcessPoolExecutor)\(")
    found = {path.relative_to(root).as_posix() for path in root.rglob("*.py") if own.search(path.read_text("utf-8"))}
    assert found == set(OWN_THREADS)
