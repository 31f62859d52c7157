"""Orthos and mosaics of photos of an analytic ground, where every pixel's truth is known."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import shapely
from affine import Affine

from geomosaic.block.block import Block
from geomosaic.block.footprint import Footprint
from geomosaic.block.scene import Scene
from geomosaic.errors import GeomosaicError, InputError, OutputExistsError, RasterReadError
from geomosaic.geo.crs import horizontal, parse_crs, with_heights
from geomosaic.geo.grid import Grid
from geomosaic.product.extent import footprints, output_grid
from geomosaic.product.mosaic import beside, mosaic
from geomosaic.product.mosaic_options import MosaicOptions
from geomosaic.product.mosaic_result import MosaicResult
from geomosaic.product.options import RenderOptions
from geomosaic.product.ortho import OrthoResult, ortho
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.registry import build
from geomosaic.surface.dem import Dem
from geomosaic.surface.model import Surface
from geomosaic.testing.synthetic import CAMERA, AnalyticGround, SyntheticPhoto, coordinates, render, synthetic_block

CRS3 = with_heights(parse_crs("EPSG:32633"), "egm96")
MAP = horizontal(CRS3)
GROUND = AnalyticGround(CRS3, origin=(400_000.0, 5_500_000.0), wavelength=8.0, spacing=1.0)
SIZE, GSD = (400, 300), 2.0
SMALL = {**CAMERA, "size": list(SIZE)}


def model_of(photo: SyntheticPhoto, camera: dict[str, Any]) -> Any:
    """The photo's model by the public door."""
    omega, phi, kappa = photo.angles
    options = {
        "camera": camera,
        "position": list(photo.position),
        "orientation": {"system": "opk", "omega": omega, "phi": phi, "kappa": kappa},
        "ground_height": GROUND.base,
    }
    return build("frame", SensorRequest(photo.name, tuple(camera["size"]), options, CRS3))


def write(path: Path, values: np.ndarray, **more: Any) -> Path:
    """Write an image (rows, cols, bands) that knows nothing of its place."""
    rows, cols, bands = values.shape
    with rasterio.open(
        path, "w", driver="GTiff", width=cols, height=rows, count=bands, dtype=values.dtype, tiled=True,
        blockxsize=128, blockysize=128, **more,
    ) as file:  # fmt: skip
        file.write(values.transpose(2, 0, 1))
    return path


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Values (rows, cols, bands) and whether they are valid (rows, cols)."""
    with rasterio.open(path) as file:
        return file.read().transpose(1, 2, 0), file.dataset_mask() > 0


def sha(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@dataclass(frozen=True)
class Job:
    """Photos of one block, ready for a product."""

    block: Block
    grid: Grid
    outlines: list[Footprint]

    def ortho(self, path: Path, index: int = 0, **options: Any) -> OrthoResult:
        scene, outline = self.block.scenes[index], self.outlines[index]
        return ortho(scene, self.block.surface, self.grid, outline, path, RenderOptions(overwrite=True, **options))

    def mosaic(self, path: Path, feather: float | None = None, balance: bool = True, **options: Any) -> MosaicResult:
        render_options = RenderOptions(overwrite=True, **options)
        return mosaic(
            self.block, self.grid, self.outlines, path, MosaicOptions(render_options, feather, balance, stac=False)
        )


def job(
    surface: Surface,
    files: Sequence[Path],
    photos: Sequence[SyntheticPhoto],
    resolution: float,
    camera: dict[str, Any] | None = None,
    nodata: float | None = None,
) -> Job:
    scenes = tuple(
        Scene(photo.name, str(file), "frame", model_of(photo, camera or SMALL), nodata)
        for file, photo in zip(files, photos, strict=True)
    )
    outlines = footprints(scenes, surface, MAP)
    return Job(Block(scenes, surface), output_grid(MAP, outlines, resolution), outlines)


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
    [("cubic", 0.02, 0.01, 0.05), ("bilinear", 0.02, 0.01, 0.05), ("cubic", 0.002, 0.002, 0.01)],
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


@dataclass(frozen=True)
class Strip:
    """Four photos that overlap, their radiance as rendered, and the DEM."""

    folder: Path
    photos: list[SyntheticPhoto]
    radiance: list[np.ndarray]
    files: list[Path]
    dem: Dem

    def exposed(self, folder: Path, effect: Callable[[int, np.ndarray], np.ndarray], **more: Any) -> list[Path]:
        """The photos with an effect each."""
        folder.mkdir(exist_ok=True)
        return [
            write(folder / f"{photo.name}.tif", effect(i, values), **more)
            for i, (photo, values) in enumerate(zip(self.photos, self.radiance, strict=True))
        ]


def bytes_of(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(20 + 200 * values), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def strip(tmp_path_factory: pytest.TempPathFactory) -> Strip:
    folder = tmp_path_factory.mktemp("strip")
    photos = synthetic_block(GROUND, SMALL, 2, 2, 0.6, 0.35, seed=5, gsd=GSD)
    radiance = [render(photo.camera(SMALL, GROUND), GROUND, dtype=np.float32) for photo in photos]
    files = [write(folder / f"{p.name}.tif", bytes_of(values)) for p, values in zip(photos, radiance, strict=True)]
    nodes = np.arange(-1000.0, 1000.0, 2.0) + 1.0
    x, y = np.meshgrid(nodes + GROUND.origin[0], nodes[::-1] + GROUND.origin[1])
    heights = GROUND.height(np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape).astype(np.float32)
    path = folder / "dem.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=1000, height=1000, count=1, dtype="float32", crs="EPSG:32633+5773",
        transform=Affine(2, 0, GROUND.origin[0] - 1000, 0, -2, GROUND.origin[1] + 1000), tiled=True,
    ) as file:  # fmt: skip
        file.write(heights, 1)
    return Strip(folder, photos, radiance, files, Dem.open(path))


RUNS = [(1, 1024), (2, 2048), (4, 1024), (4, 2048)]


@pytest.mark.parametrize("driver", ["GTiff", "COG"])
def test_bytes_of_an_ortho_depend_on_neither_threads_nor_tiles(strip: Strip, tmp_path: Path, driver: str) -> None:
    made = job(strip.dem, strip.files[:1], strip.photos[:1], 0.35)
    assert made.grid.width > 2 * 1024  # several blocks both ways
    assert made.grid.height > 3 * 512
    runs = RUNS if driver == "GTiff" else RUNS[::3]
    sums = {
        sha(made.ortho(tmp_path / "ortho.tif", threads=threads, tile=tile, driver=driver, resampling="cubic").path)
        for threads, tile in runs
    }
    assert len(sums) == 1


@pytest.mark.parametrize("driver", ["GTiff", "COG"])
def test_bytes_of_a_mosaic_depend_on_neither_threads_nor_tiles(strip: Strip, tmp_path: Path, driver: str) -> None:
    effect = strip.exposed(tmp_path / "photos", lambda i, v: bytes_of((0.8 + 0.1 * i) * v))
    made = job(strip.dem, effect, strip.photos, 0.5)
    assert made.grid.width > 2 * 1024
    assert made.grid.height > 3 * 512
    runs = RUNS if driver == "GTiff" else RUNS[::3]
    sums, gains = set(), set()
    for threads, tile in runs:
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
    labels, _ = read(beside(result.path, "-labels", ".tif"))
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
    made, feather = twice(strip, files, 0.35), 80.0
    assert made.grid.width > 2 * 1024
    result = made.mosaic(tmp_path / "mosaic.tif", feather=feather, balance=False)
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
    labels, _ = read(beside(result.path, "-labels", ".tif"))
    clear = np.abs(values[rows, cols, 0] - 0.5) > 1e-3
    assert (labels[rows, cols, 0][clear] == 1 + (values[rows, cols, 0] > 0.5)[clear]).all()


@pytest.mark.parametrize("feather", [0.0, 10.0, 200.0])
def test_weights_sum_to_one_everywhere(strip: Strip, tmp_path: Path, feather: float) -> None:
    files = strip.exposed(tmp_path / "photos", lambda i, v: np.full((*v.shape[:2], 1), 77, dtype=np.uint8))
    result = job(strip.dem, files, strip.photos, GSD).mosaic(tmp_path / "mosaic.tif", balance=False, feather=feather)
    values, valid = read(result.path)
    assert (values[valid] == 77).all()
    assert (values[~valid] == 0).all()


@pytest.mark.parametrize(("feather", "resolution"), [(0.0, GSD), (60.0, GSD), (20.0, 0.4)])
def test_labels_cover_exactly_what_is_valid(strip: Strip, tmp_path: Path, feather: float, resolution: float) -> None:
    made = job(strip.dem, strip.files, strip.photos, resolution)
    result = made.mosaic(tmp_path / "mosaic.tif", feather=feather)
    _, valid = read(result.path)
    labels, _ = read(beside(result.path, "-labels", ".tif"))
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
    labels, _ = read(beside(result.path, "-labels", ".tif"))
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
    labels, _ = read(beside(whole.path, "-labels", ".tif"))
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


# --- What goes wrong is said, and leaves nothing behind -----------------------------------------------------------


def refused(call: Callable[[], object], folder: Path, kind: type[GeomosaicError] = InputError) -> GeomosaicError:
    """Call what must fail; nothing may be left of the output, whole or partial."""
    before = {path.name for path in folder.iterdir()}
    with pytest.raises(kind) as caught:
        call()
    assert {path.name for path in folder.iterdir()} == before
    assert caught.value.what
    assert caught.value.mend
    return caught.value


def test_an_image_outside_the_dem(strip: Strip, tmp_path: Path) -> None:
    x, y, z = strip.photos[0].position
    away = replace(strip.photos[0], position=(x + 9000.0, y, z))
    error = refused(lambda: job(strip.dem, strip.files[:1], [away], GSD), tmp_path)
    assert error.where == away.name
    assert "DEM" in error.what


def test_an_image_of_the_sky(strip: Strip, tmp_path: Path) -> None:
    up = replace(strip.photos[0], angles=(180.0, 0.0, 0.0))
    error = refused(lambda: job(strip.dem, strip.files[:1], [up], GSD), tmp_path)
    assert "sky" in error.what
    assert "angle" in str(error.mend)


def test_an_image_that_is_not_the_models(strip: Strip, tmp_path: Path) -> None:
    other = write(tmp_path / "other.tif", np.zeros((30, 40, 3), dtype=np.uint8))
    made = job(strip.dem, [other, *strip.files[1:]], strip.photos, GSD)
    for call in (made.ortho, made.mosaic):
        error = refused(lambda call=call: call(tmp_path / "out.tif"), tmp_path)
        assert error.where == str(other)
        assert "40 x 30" in error.what
        assert "400 x 300" in error.what


@pytest.mark.parametrize(("values", "word"), [((300, 400, 1), "1 bands"), ((300, 400, 3), "uint16")])
def test_images_that_do_not_go_together(strip: Strip, tmp_path: Path, values: tuple[int, ...], word: str) -> None:
    other = write(tmp_path / "other.tif", np.ones(values, dtype="uint16" if word == "uint16" else "uint8"))
    made = job(strip.dem, [*strip.files[:3], other], strip.photos, GSD)
    error = refused(lambda: made.mosaic(tmp_path / "out.tif"), tmp_path)
    assert error.where == str(other)
    assert word in error.what


def test_a_missing_image(strip: Strip, tmp_path: Path) -> None:
    made = job(strip.dem, [tmp_path / "none.tif", *strip.files[1:]], strip.photos, GSD)
    for call in (made.ortho, made.mosaic):
        error = refused(lambda call=call: call(tmp_path / "out.tif"), tmp_path)
        assert "none.tif" in str(error.where)


def test_bounds_that_miss(strip: Strip, tmp_path: Path) -> None:
    made = job(strip.dem, strip.files, strip.photos, GSD)
    error = refused(lambda: output_grid(MAP, made.outlines, GSD, (0.0, 0.0, 1000.0, 1000.0)), tmp_path)
    assert "bounds" in error.what
    # Bounds within the outlines' box, where nevertheless no photo is: a corner of the grid.
    left, _, _, top = made.grid.bounds
    corner = replace(made, grid=output_grid(MAP, made.outlines, 0.1, (left, top - 2.0, left + 2.0, top)))
    for call in (corner.ortho, corner.mosaic):
        refused(lambda call=call: call(tmp_path / "out.tif"), tmp_path)


def test_an_output_that_exists_stays(strip: Strip, tmp_path: Path) -> None:
    made = job(strip.dem, strip.files, strip.photos, GSD)
    old = tmp_path / "out.tif"
    old.write_bytes(b"precious")
    for call in (
        lambda: ortho(made.block.scenes[0], made.block.surface, made.grid, made.outlines[0], old),
        lambda: mosaic(made.block, made.grid, made.outlines, old),
    ):
        refused(call, tmp_path, OutputExistsError)
        assert old.read_bytes() == b"precious"


@pytest.mark.parametrize("kind", ["jpg", "tif"])
def test_a_truncated_image(strip: Strip, sample: Path, tmp_path: Path, kind: str) -> None:
    if kind == "jpg":
        whole = sample / "photos" / "strip1_01.jpg"
        camera, photo = CAMERA, SyntheticPhoto("cut", (400_010.0, 5_500_020.0, GROUND.base + 1000.0), (0.0, 0.0, 0.0))
    else:
        whole, camera, photo = strip.files[0], SMALL, strip.photos[0]
    cut = tmp_path / f"cut.{kind}"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])

    def run(product: str) -> None:
        made = job(strip.dem, [cut], [photo], GSD, camera)
        getattr(made, product)(tmp_path / "out.tif")

    for product in ("ortho", "mosaic"):
        error = refused(lambda product=product: run(product), tmp_path, RasterReadError)
        assert "cut" in str(error.where)


FULL_DISK = """
import resource, sys
from pathlib import Path
import geomosaic.resample.kernels.place
resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))
from geomosaic.cli.main import main
main(sys.argv[1:])
"""


@pytest.mark.parametrize("command", ["ortho", "mosaic"])
@pytest.mark.parametrize("driver", ["GTiff", "COG"])
def test_a_full_disk(sample: Path, tmp_path: Path, command: str, driver: str) -> None:
    """A limit on the size of files stands in for the disk: writing fails halfway through."""
    images = sorted((sample / "photos").glob("strip1_0[12].jpg"))
    words = [
        command, *map(str, images[: 1 if command == "ortho" else 2]), "--sensor", "frame", "--camera", "camera.toml",
        "--exterior", "exterior.csv", "--crs", "EPSG:32633", "--heights", "egm96", "--dem", "dem.tif", "--res", "1",
        "-f", driver, "--co", "COMPRESS=NONE", "-o", str(tmp_path / "out.tif"),
    ]  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, *words], cwd=sample, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 1, done.stderr
    assert "out" in done.stderr
    assert "mend" in done.stderr
    assert "fault of geomosaic" not in done.stderr
    assert not list(tmp_path.iterdir())


# --- Memory -------------------------------------------------------------------------------------------------------

# Not ru_maxrss: on Linux a child starts with the peak of the process that it was forked from.
PEAK = """
import sys
from pathlib import Path
from geomosaic.cli.main import run
code = run(sys.argv[1:])
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
print(int(status["VmHWM"].split()[0]) / 1024)
sys.exit(code)
"""


def peak(sample: Path, out: Path, command: str, resolution: float, limit: int, *more: str) -> tuple[float, int]:
    """Peak resident megabytes of a run of its own, and its output's pixels."""
    images = sorted((sample / "photos").glob("*.jpg"))
    words = [
        command, *map(str, images[: 1 if command == "ortho" else 12]), "--sensor", "frame", "--camera", "camera.toml",
        "--exterior", "exterior.csv", "--crs", "EPSG:32633", "--heights", "egm96", "--dem", "dem.tif",
        "--res", str(resolution), "--mem-limit", f"{limit}M", "--overwrite", "-o", str(out), *more,
    ]  # fmt: skip
    done = subprocess.run([sys.executable, "-c", PEAK, *words], cwd=sample, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr
    with rasterio.open(out) as file:
        return float(done.stdout.split()[-1]), file.width * file.height


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="peak memory is read from /proc")
@pytest.mark.parametrize("command", ["ortho", pytest.param("mosaic", marks=pytest.mark.slow)])
def test_memory_does_not_grow_with_the_output(sample: Path, tmp_path: Path, command: str) -> None:
    limit, fine = 512, 0.14 if command == "ortho" else 0.4
    compiled = "--resampling", "cubic"  # the small one too has work enough for the compiled kernels
    small, few = peak(sample, tmp_path / "out.tif", command, fine * 10**0.5, limit, *compiled)
    large, many = peak(sample, tmp_path / "out.tif", command, fine, limit, *compiled)
    assert many > 9.5 * few
    assert large <= 1.2 * limit, f"{large:.0f} MB ({small:.0f} MB for a tenth of the output)"
    assert large - small < 150, f"{small:.0f} MB to {large:.0f} MB"  # the ten times larger output has up to 270 MB


@pytest.mark.slow
@pytest.mark.parametrize("command", ["ortho", "mosaic"])
def test_memory_of_a_large_output(sample: Path, tmp_path: Path, command: str) -> None:
    limit, fine = 512, 0.07 if command == "ortho" else 0.12
    small, few = peak(sample, tmp_path / "out.tif", command, fine * 10**0.5, limit)
    large, many = peak(sample, tmp_path / "out.tif", command, fine, limit)
    assert many > 9.5 * few
    assert many * 3 > 0.35e9  # three bands of it would not fit beside the program
    assert large <= 1.2 * limit, f"{large:.0f} MB ({small:.0f} MB for a tenth of the output)"
