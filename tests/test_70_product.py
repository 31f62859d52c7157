"""Orthos and mosaics of photos of an analytic ground, where every pixel's truth is known."""

from __future__ import annotations

import gc
import logging
import os
import signal
import sys
import threading
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import shapely
from affine import Affine
from product_rig import GROUND, GSD, SIZE, SMALL, Job, Strip, bytes_of, job, make_strip, read, sha, write

from geomosaic.raster.files import companion
from geomosaic.raster.source import Source
from geomosaic.render.ortho import OrthoResult
from geomosaic.surface.dem import Dem
from geomosaic.testing.synthetic import CAMERA, AnalyticGround, SyntheticPhoto, coordinates, render


@pytest.fixture(scope="module")
def strip(tmp_path_factory: pytest.TempPathFactory) -> Strip:
    return make_strip(tmp_path_factory.mktemp("strip"))


def test_a_library_call_leaves_its_process_as_it_was(strip: Strip, tmp_path: Path) -> None:
    def state() -> list[object]:
        handlers = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
        streams = [sys.stdin, sys.stdout, sys.stderr, *logging.getLogger("rasterio").handlers]
        filters = [list(warnings.filters), warnings.showwarning]
        return [*handlers, *streams, *filters, dict(os.environ), gc.get_threshold(), gc.isenabled(), Path.cwd()]

    warnings.simplefilter("error", rasterio.errors.NotGeoreferencedWarning)  # nor does it need the caller's filters
    before, made = state(), job(strip.dem, strip.files[:2], strip.photos[:2], 4 * GSD)
    made.ortho(tmp_path / "ortho.tif", threads=2)
    made.mosaic(tmp_path / "mosaic.tif", threads=2)
    assert state() == before


# --- One photo against the ground it was taken of -----------------------------------------------------------------


def misses(
    tmp_path: Path, size: tuple[int, int], gsd: float, surface: AnalyticGround, **options: Any
) -> tuple[np.ndarray, OrthoResult]:
    """Distances in pixels between where output pixels lie and where the photo says what they show was."""
    camera = {**CAMERA, "size": list(size)}
    above = gsd * CAMERA["focal_length"] * size[0] / CAMERA["sensor_size"][0]
    photo = SyntheticPhoto("place", (400_010.0, 5_500_020.0, GROUND.base + above), (1.5, -2.0, 37.0))
    truth = photo.camera(camera, GROUND)
    file = write(tmp_path / "place.tif", render(truth, GROUND, texture=coordinates, dtype=np.float32))
    made = job(surface, [file], [photo], gsd, camera)
    result = made.ortho(tmp_path / "ortho.tif", **options)
    values, valid = read(result.path)
    rows, cols = np.nonzero(valid)
    xy = result.grid.xy(np.column_stack([cols + 0.5, rows + 0.5]))
    seen = truth.project(np.column_stack([xy, GROUND.height(xy)]))
    # The outermost pixels have no neighbours to interpolate from.
    inner = ((seen > 2) & (seen < np.array(size) - 2)).all(axis=1)
    assert inner.mean() > 0.95
    off = values[rows, cols, :2][inner] - (xy - GROUND.datum[:2])[inner]
    return np.hypot(*off.T) / gsd, result


@pytest.mark.parametrize(
    ("resampling", "tolerance", "rms", "worst"),
    [
        ("cubic", 0.02, 0.01, 0.05),
        ("bilinear", 0.02, 0.01, 0.05),
        # By default the lattice alone is held to so little, in test_60_resample.
        pytest.param("cubic", 0.002, 0.002, 0.01, marks=pytest.mark.slow),
    ],
)
def test_an_ortho_lies_where_the_ground_is(
    tmp_path: Path, resampling: str, tolerance: float, rms: float, worst: float
) -> None:
    miss, result = misses(tmp_path, SIZE, GSD, GROUND, resampling=resampling, tolerance=tolerance)
    found = float(np.sqrt((miss**2).mean()))
    assert found <= rms, f"RMS {found:.5f} px"
    assert miss.max() <= worst, f"worst {miss.max():.5f} px"
    assert result.lattice_error <= tolerance
    # What was measured on the lattice is what was left in the product: honest, neither hope nor fear.
    assert 0.2 * result.lattice_error < miss.max() < 2.0 * result.lattice_error + 0.001


@pytest.mark.slow
def test_a_full_size_ortho_lies_where_the_ground_is(tmp_path: Path) -> None:
    surface = replace(GROUND, spacing=0.5)
    miss, result = misses(tmp_path, (4000, 3000), 0.25, surface, resampling="cubic")
    found = float(np.sqrt((miss**2).mean()))
    assert found <= 0.01, f"RMS {found:.5f} px"
    assert miss.max() <= 0.05, f"worst {miss.max():.5f} px"
    assert result.lattice_error <= 0.02


def test_an_ortho_covers_what_the_photo_shows_and_nothing_else(strip: Strip, tmp_path: Path) -> None:
    made = job(strip.dem, strip.files[:1], strip.photos[:1], GSD)
    result = made.ortho(tmp_path / "ortho.tif")
    _, valid = read(result.path)
    rows, cols = np.indices(valid.shape).reshape(2, -1)
    xy = result.grid.xy(np.column_stack([cols + 0.5, rows + 0.5]))
    seen = strip.photos[0].camera(SMALL, GROUND).project(np.column_stack([xy, GROUND.height(xy)]))
    inside = ((seen >= 0) & (seen < SIZE)).all(axis=1)
    rim = np.minimum(seen, np.array(SIZE) - seen).min(axis=1)
    wrong = inside != valid.ravel()
    assert not (wrong & (np.abs(rim) > 0.02)).any()
    assert result.valid_pixels == valid.sum()
    assert result.scale == pytest.approx(1.0, abs=0.1)


# --- A block of photos --------------------------------------------------------------------------------------------


RUNS = [(1, 1024), (4, 1024), (4, 2048)]


def test_a_small_ortho_is_drawn_by_one_thread_and_a_larger_one_by_all(
    strip: Strip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second thread would open the image and make its transformations once more."""
    readers, read_window = set(), Source.read

    def noted(source: Source, *words: Any) -> Any:
        readers.add(threading.current_thread())
        return read_window(source, *words)

    monkeypatch.setattr(Source, "read", noted)
    made = job(strip.dem, strip.files[:1], strip.photos[:1], 4 * GSD)
    made.ortho(tmp_path / "small.tif", threads=2)
    assert readers == {threading.main_thread()}
    monkeypatch.setattr("geomosaic.render.ortho.ALONE", 0)
    readers.clear()
    made.ortho(tmp_path / "larger.tif", threads=2)
    assert readers
    assert threading.main_thread() not in readers


@pytest.mark.parametrize("driver", [pytest.param("GTiff", marks=pytest.mark.slow), "COG"])
def test_bytes_of_an_ortho_depend_on_neither_threads_nor_tiles(strip: Strip, tmp_path: Path, driver: str) -> None:
    made = job(strip.dem, strip.files[:1], strip.photos[:1], 0.35)
    assert made.grid.width > 2 * 1024  # several blocks both ways
    assert made.grid.height > 3 * 512
    runs = RUNS if driver == "GTiff" else RUNS[::2]
    sums = {
        sha(made.ortho(tmp_path / "ortho.tif", threads=threads, tile=tile, driver=driver, resampling="cubic").path)
        for threads, tile in runs
    }
    assert len(sums) == 1


@pytest.mark.parametrize("driver", ["GTiff", pytest.param("COG", marks=pytest.mark.slow)])
def test_bytes_of_a_mosaic_depend_on_neither_threads_nor_tiles(strip: Strip, tmp_path: Path, driver: str) -> None:
    effect = strip.exposed(tmp_path / "photos", lambda i, v: bytes_of((0.8 + 0.1 * i) * v))
    made = job(strip.dem, effect, strip.photos, 0.5)
    assert made.grid.width > 2 * 1024
    assert made.grid.height > 3 * 512
    sums, gains = set(), set()
    for threads, tile in RUNS[::2]:
        result = made.mosaic(tmp_path / "mosaic.tif", threads=threads, tile=tile, driver=driver, feather=40.0)
        assert result.labels is not None
        sums.add((sha(result.path), sha(result.labels)))
        gains.add(result.balance.gain.tobytes())
    assert len(sums) == 1
    assert len(gains) == 1


def test_known_gains_and_offsets_come_back(strip: Strip, tmp_path: Path) -> None:
    gain, offset = np.array([0.75, 1.0, 1.2, 0.9]), np.array([10.0, -4.0, 6.0, 0.0])
    files = strip.exposed(tmp_path / "photos", lambda i, v: (gain[i] * 200 * v + offset[i]).astype(np.float32))
    result = job(strip.dem, files, strip.photos, GSD).mosaic(tmp_path / "mosaic.tif")
    scale = np.exp(np.mean(np.log(gain)))
    shift = np.mean(scale * offset / gain)
    dg = np.abs(result.balance.gain / (scale / gain)[:, None] - 1).max()
    do = np.abs(result.balance.offset - (shift - scale * offset / gain)[:, None]).max()
    assert dg < 0.01, f"gain off by {100 * dg:.3f} %"
    assert do < 0.01 * 200, f"offset off by {do:.3f} of 200"
    assert (result.balance.before > 10).all()
    assert (result.balance.after < 0.05 * result.balance.before).all()
    # And the pixels have it: what comes out is one linear function of the ground's colour, all over the mosaic.
    values, valid = read(result.path)
    rows, cols = np.nonzero(valid)
    ground = GROUND.texture(result.grid.xy(np.column_stack([cols + 0.5, rows + 0.5])))
    miss = values[rows, cols] - (scale * 200 * ground + shift)
    assert np.abs(np.median(miss, axis=0)).max() < 1.0
    assert np.percentile(np.abs(miss), 90) < 6.0


def test_without_balance_values_stay(strip: Strip, tmp_path: Path) -> None:
    files = strip.exposed(tmp_path / "photos", lambda i, v: np.full((*v.shape[:2], 1), 50 + 40 * i, dtype=np.uint8))
    result = job(strip.dem, files, strip.photos, GSD).mosaic(tmp_path / "mosaic.tif", balance=False, feather=0.0)
    values, valid = read(result.path)
    labels, _ = read(companion(result.path, "-labels", ".tif"))
    assert set(np.unique(values[valid])) == {50, 90, 130, 170}
    assert (values[valid][:, 0] == 10 + 40 * labels[valid][:, 0]).all()


def test_a_mosaic_of_one_photo_is_its_ortho(strip: Strip, tmp_path: Path) -> None:
    made = job(strip.dem, strip.files[:1], strip.photos[:1], 1.0)
    single, whole = made.ortho(tmp_path / "ortho.tif"), made.mosaic(tmp_path / "mosaic.tif")
    (a, seen_a), (b, seen_b) = read(single.path), read(whole.path)
    assert np.array_equal(seen_a, seen_b)
    assert np.array_equal(a, b)
    assert whole.valid_pixels == single.valid_pixels
    assert whole.lattice_error == single.lattice_error


def twice(strip: Strip, files: Sequence[Path], resolution: float) -> Job:
    """One photo under two names, with a seam through its middle, straight down."""
    first = strip.photos[0]
    made = job(strip.dem, files, [first, replace(first, name="again")], resolution)
    x, y = made.outlines[0].centre
    left, right = (replace(o, centre=(x + s, y)) for o, s in zip(made.outlines, (-50.0, 50.0), strict=True))
    return replace(made, outlines=[left, right])


@pytest.mark.parametrize("feather", [0.0, 16.0, 120.0])
def test_blending_what_is_equal_leaves_no_trace(strip: Strip, tmp_path: Path, feather: float) -> None:
    made = twice(strip, [strip.files[0]] * 2, 1.0)
    single, whole = made.ortho(tmp_path / "ortho.tif"), made.mosaic(tmp_path / "mosaic.tif", feather=feather)
    assert min(whole.pixels) > 0.3 * whole.valid_pixels
    (a, seen_a), (b, seen_b) = read(single.path), read(whole.path)
    assert np.array_equal(seen_a, seen_b)
    assert np.abs(a[seen_a].astype(int) - b[seen_a]).max() <= 1
    assert (a[seen_a] != b[seen_a]).mean() < 0.01
    assert np.abs(whole.balance.gain - 1).max() < 1e-9


def test_weights_are_a_straight_ramp_across_all_blocks(strip: Strip, tmp_path: Path) -> None:
    """One photo is 0 and one is 1: the mosaic is the weight of the second, and the ramp is known in closed form."""
    shape = (*SIZE[::-1], 1)
    files = [write(tmp_path / f"{k}.tif", np.full(shape, float(k), dtype=np.float32)) for k in (0, 1)]
    made, feather = twice(strip, files, 0.5), 80.0
    assert made.grid.width > 1024
    result = made.mosaic(tmp_path / "mosaic.tif", feather=feather, balance=False, tile=1024)
    values, valid = read(result.path)
    rows, cols = np.nonzero(valid)
    xy = made.grid.xy(np.column_stack([cols + 0.5, rows + 0.5]))
    seam = (made.outlines[0].centre[0] + made.outlines[1].centre[0]) / 2
    expected = np.clip(0.5 + (xy[:, 0] - seam) / feather, 0, 1)
    off = np.abs(values[rows, cols, 0] - expected)
    deep = shapely.contains_xy(made.outlines[0].polygon.buffer(-feather / 2 - 10), xy)
    assert deep.mean() > 0.7
    # The seam is burnt into cells of a fourteenth of the ramp, so it may lie half of one aside.
    assert off[deep].max() < 0.04, f"worst {off[deep].max():.4f}"
    # Towards the border of the photos both weights fall to 0, not quite together.
    assert off.max() < 0.1
    assert np.sqrt((off**2).mean()) < 0.01
    labels, _ = read(companion(result.path, "-labels", ".tif"))
    clear = np.abs(values[rows, cols, 0] - 0.5) > 1e-3
    assert (labels[rows, cols, 0][clear] == 1 + (values[rows, cols, 0] > 0.5)[clear]).all()


@pytest.mark.parametrize("feather", [0.0, 10.0, 200.0])
def test_weights_sum_to_one_everywhere(strip: Strip, tmp_path: Path, feather: float) -> None:
    files = strip.exposed(tmp_path / "photos", lambda i, v: np.full((*v.shape[:2], 1), 77, dtype=np.uint8))
    result = job(strip.dem, files, strip.photos, GSD).mosaic(tmp_path / "mosaic.tif", balance=False, feather=feather)
    values, valid = read(result.path)
    assert (values[valid] == 77).all()
    assert (values[~valid] == 0).all()


@pytest.mark.parametrize(
    ("feather", "resolution"), [(0.0, GSD), (60.0, GSD), pytest.param(20.0, 0.7, marks=pytest.mark.slow)]
)
def test_labels_cover_exactly_what_is_valid(strip: Strip, tmp_path: Path, feather: float, resolution: float) -> None:
    made = job(strip.dem, strip.files, strip.photos, resolution)
    result = made.mosaic(tmp_path / "mosaic.tif", feather=feather, balance=False)
    _, valid = read(result.path)
    labels, _ = read(companion(result.path, "-labels", ".tif"))
    assert np.array_equal(labels[..., 0] > 0, valid)
    assert [int((labels == k + 1).sum()) for k in range(4)] == result.pixels
    assert min(result.pixels) > 1000
    # Whatever any photo shows is in the mosaic.
    shown = np.zeros_like(valid)
    for index in range(4):
        shown |= read(made.ortho(tmp_path / "ortho.tif", index).path)[1]
    assert np.array_equal(shown, valid)


def test_each_pixel_comes_from_the_photo_its_label_names(strip: Strip, tmp_path: Path) -> None:
    made = job(strip.dem, strip.files, strip.photos, GSD)
    result = made.mosaic(tmp_path / "mosaic.tif", feather=0.0, balance=False)
    values, _ = read(result.path)
    labels, _ = read(companion(result.path, "-labels", ".tif"))
    for index in range(4):
        own, seen = read(made.ortho(tmp_path / "ortho.tif", index).path)
        here = labels[..., 0] == index + 1
        assert seen[here].all()
        off = np.abs(values[here].astype(int) - own[here])  # float32 on the way may round a half the other way
        assert off.max() <= 1
        assert (off > 0).sum() < 10


def test_a_hole_is_filled_from_the_next_photo_and_true_black_stays(strip: Strip, tmp_path: Path) -> None:
    hole, black = np.s_[100:160, 150:230], np.s_[180:220, 150:230]

    def effect(i: int, values: np.ndarray) -> np.ndarray:
        out = np.full((*values.shape[:2], 1), 60 + 30 * i, dtype=np.uint8)
        if i == 0:
            out[hole], out[black] = 255, 0
        return out

    files = strip.exposed(tmp_path / "photos", effect)
    made = job(strip.dem, files, strip.photos, GSD, nodata=255)
    whole = made.mosaic(tmp_path / "whole.tif", feather=0.0, balance=False)
    values, valid = read(whole.path)
    labels, _ = read(companion(whole.path, "-labels", ".tif"))
    own, seen = read(made.ortho(tmp_path / "ortho.tif", 0).path)
    full = job(strip.dem, strip.files, strip.photos, GSD)
    _, shown = read(full.ortho(tmp_path / "full.tif", 0).path)
    missing = shown & ~seen
    assert missing.sum() > 3000  # the hole is in the photo's own ortho
    assert not (values[valid] == 255).any()  # and in no mosaic
    others = np.zeros_like(valid)
    for index in (1, 2, 3):
        others |= read(made.ortho(tmp_path / "other.tif", index).path)[1]
    assert np.array_equal(valid, seen | others)
    filled = missing & others
    assert filled.sum() > 1000
    assert (labels[filled] > 1).all()
    assert np.array_equal(values[filled][:, 0], 30 + 30 * labels[filled][:, 0])
    dark = (own[..., 0] == 0) & seen & (labels[..., 0] == 1)
    assert dark.sum() > 1000
    assert (values[dark] == 0).all()
    assert valid[dark].all()


def test_drone_over_towers_stays_within_the_tolerance(tmp_path: Path) -> None:
    """Height steps of an eighth of the flying height, and a lens that bends a lot."""
    rng = np.random.default_rng(1)
    nodes = np.where(rng.random((120, 120)) < 0.15, rng.uniform(3, 12, (120, 120)), 0.0).astype(np.float32)
    path = tmp_path / "dsm.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=120, height=120, count=1, dtype="float32", crs="EPSG:32633+5773",
        transform=Affine(2, 0, GROUND.origin[0] - 120, 0, -2, GROUND.origin[1] + 120),
    ) as file:  # fmt: skip
        file.write(nodes + np.float32(GROUND.base), 1)
    photo = SyntheticPhoto("drone", (*GROUND.origin, GROUND.base + 100.0), (25.0, 3.0, 30.0))
    camera = {**SMALL, "focal_length": 32.0, "distortion": {"model": "brown", "k1": -0.264, "k2": 0.102, "k3": -0.026}}
    c, r = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    file = write(tmp_path / "drone.tif", np.stack([c, r], axis=-1).astype(np.float32))
    dem = Dem.open(path)
    made = job(dem, [file], [photo], 0.4, camera)
    result = made.ortho(tmp_path / "ortho.tif", resampling="bilinear")
    values, valid = read(result.path)
    rows, cols = np.nonzero(valid)
    xy = made.grid.xy(np.column_stack([cols + 0.5, rows + 0.5]))
    exact = photo.camera(camera, GROUND).project(np.column_stack([xy, dem.height(xy)]))
    inner = ((exact > 1) & (exact < np.array(SIZE) - 1)).all(axis=1)
    miss = np.hypot(*(values[rows, cols] - exact)[inner].T)
    assert inner.sum() > 30_000
    assert result.lattice_error <= 0.02
    assert miss.max() <= 0.02, f"worst {miss.max():.4f} px, reported {result.lattice_error:.4f} px"
