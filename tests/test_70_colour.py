"""Colour in the mosaic itself: against true radiance, the same for any tiles and threads, and as in NumPy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import geopandas
import numpy as np
import numpy_kernels as plain
import pytest
import rasterio
import shapely
from affine import Affine

import geomosaic
from geomosaic.errors import InputError
from geomosaic.inputs.declarations import Block
from geomosaic.kernels.blend import shade
from geomosaic.mosaicking.colour.stretch import parse_stretch
from geomosaic.mosaicking.records import MosaicResult
from geomosaic.options.inputs import Area
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.products.mosaics import make_mosaic
from geomosaic.resample.warp import value_range

SIZE = (240, 180)
STEP = (96, 120)
COLS, ROWS = 4, 3
LEFT, TOP = 500_000.0, 5_600_000.0


def radiance(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Ground (rows, cols, 2) of 40 to 130, x and y in metres from the upper left."""
    wave = np.sin(x / 17 + 2 * np.sin(y / 31)) + np.sin(y / 13 - x / 41) + np.sin(x / 5) * np.sin(y / 6)
    return np.asarray(85 + 14 * wave)[..., None] * np.array([1.0, 0.9])


def camera(index: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(index)
    return np.exp(rng.normal(0, 0.1, 2)), rng.uniform(-5, 5, 2)


def photograph(path: Path, index: int, falloff: float, dtype: str = "uint8") -> Path:
    col, row = index % COLS * STEP[0], index // COLS * STEP[1]
    x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    rho2 = ((x - SIZE[0] / 2) ** 2 + (y - SIZE[1] / 2) ** 2) / (np.hypot(*SIZE) / 2) ** 2
    gain, offset = camera(index)
    values = gain * (1 - falloff * rho2)[..., None] * radiance(x + col, y + row) + offset
    scale = 1 if dtype == "uint8" else 40
    noise = np.random.default_rng(100 + index).normal(0, 0.5, values.shape)
    with rasterio.open(
        path, "w", driver="GTiff", width=SIZE[0], height=SIZE[1], count=2, dtype=dtype, crs="EPSG:32633",
        transform=Affine(1, 0, LEFT + col, 0, -1, TOP - row),
    ) as file:  # fmt: skip
        file.write(
            np.clip(np.rint(scale * (values + noise)), 0, 65535 if scale > 1 else 255).astype(dtype).transpose(2, 0, 1)
        )
    return path


@pytest.fixture(scope="module")
def shots(tmp_path_factory: pytest.TempPathFactory) -> Callable[[float, str], tuple[Path, ...]]:
    known: dict[tuple[float, str], tuple[Path, ...]] = {}

    def shoot(falloff: float, dtype: str = "uint8") -> tuple[Path, ...]:
        key = falloff, dtype
        if key not in known:
            folder = tmp_path_factory.mktemp("shots")
            known[key] = tuple(photograph(folder / f"p{i:02d}.tif", i, *key) for i in range(COLS * ROWS))
        return known[key]

    return shoot


def make(shots: tuple[Path, ...], output: Path, threads: int = 2, tile: int = 1024, **more) -> MosaicResult:
    options = MosaicOptions.of(threads=threads, tile=tile, feather=8.0, labels=False, vectors=False, **more)
    return make_mosaic(Block(shots, "planar"), Area(None, 1.0), output, options)


def off_truth(path: Path) -> float:
    """RMS of the mosaic about true radiance in parts of its mean, but for one scale and offset per band."""
    with rasterio.open(path) as file:
        shown, valid = file.read().astype(float), file.dataset_mask() > 0
    y, x = np.mgrid[: shown.shape[1], : shown.shape[2]] + 0.5
    truth, found = radiance(x, y), []
    for band in range(2):
        a, b = shown[band][valid], truth[..., band][valid]
        line = np.polynomial.Polynomial.fit(a, b, 1)
        found.append(np.sqrt(np.mean((line(a) - b) ** 2)) / b.mean())
    return float(np.max(found))


def test_the_mosaic_is_as_bright_as_the_ground(shots, tmp_path):
    images = shots(0.35)
    made = {
        name: make(images, tmp_path / f"{name}.tif", **more)
        for name, more in {
            "raw": {"balance": False},
            "gain": {"colour": ("gain",)},
            "auto": {},
        }.items()
    }
    raw, gain, auto = (off_truth(result.path) for result in made.values())
    assert raw > 0.07
    assert auto < 0.012, f"{raw:.3f} raw, {gain:.3f} gain and offset, {auto:.3f} all"
    assert auto < 0.35 * gain
    fields = made["auto"].balance.fields
    assert fields is not None
    assert "vignetting" in fields.setting.terms
    assert (made["auto"].balance.after < 0.5 * made["gain"].balance.after).all()


def test_nothing_more_than_gain_and_offset_where_nothing_more_is_there(shots, tmp_path):
    images = shots(0.0)
    auto, gain = make(images, tmp_path / "auto.tif"), make(images, tmp_path / "gain.tif", colour=("gain",))
    assert auto.balance.fields is None
    assert len(auto.balance.trials) > 2
    with rasterio.open(auto.path) as one, rasterio.open(gain.path) as other:
        assert np.array_equal(one.read(), other.read())


def test_tiles_and_threads_make_no_difference(shots, tmp_path):
    images = shots(0.35)
    terms = ("vignetting", "gamma", "dodging")
    first = make(images, tmp_path / "a.tif", threads=1, tile=1024, colour=terms)
    second = make(images, tmp_path / "b.tif", threads=3, tile=2048, colour=terms)
    with rasterio.open(first.path) as one, rasterio.open(second.path) as other:
        assert np.array_equal(one.read(), other.read())


def test_sixteen_bits_come_out_as_eight_do(shots, tmp_path):
    wide = make(shots(0.35, "uint16"), tmp_path / "wide.tif")
    assert off_truth(wide.path) < 0.012
    with rasterio.open(wide.path) as file:
        assert file.dtypes[0] == "uint16"


@pytest.mark.parametrize(("bent", "hazy"), [(False, False), (True, False), (True, True), (False, True)])
@pytest.mark.parametrize(("bands", "planar"), [(1, False), (2, False), (3, False), (3, True), (4, False), (7, True)])
def test_shades_are_those_of_numpy(bent, hazy, bands, planar):
    def in_form(array):
        return np.ascontiguousarray(np.moveaxis(array, -1, 0)).transpose(1, 2, 0) if planar else array

    rng, shape = np.random.default_rng(1), (20, 290)
    seen = (rng.random(shape) < 0.8).astype(np.uint8)
    seen[3:9], seen[9, :100] = 1, 0
    values = rng.uniform(-50, 300, (*shape, bands))
    values[seen == 0] = np.nan
    net, dark, offset = rng.uniform(0.5, 2, (5, 7, bands)), rng.normal(0, 3, bands), rng.normal(0, 3, bands)
    gammas = np.linspace(0.7, 1.6, bands)[:, None]
    curve = 255.0 * (np.arange(4097) / 4096)[None] ** gammas if bent else np.zeros((bands, 0))
    path, haze = (rng.uniform(0, 1, (5, 7)), rng.uniform(3, 20, bands)) if hazy else (np.zeros((0, 0)), np.zeros(0))
    place = (-0.4, 0.7, 0.025, 0.16)  # beyond the net on all sides but one
    for dtype in ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float32", "float64"):
        made, given = [], in_form(values.astype(np.result_type(dtype, np.float32)))
        for kernel in (shade, plain.shade):
            out, valid = in_form(np.full((*shape, bands), 5, dtype=dtype)), np.zeros(shape, dtype=np.uint8)
            ends = value_range(dtype)
            kernel(given, seen, net, path, haze, place, dark, curve, 255.0, offset, *ends, out, valid)
            made.append(out)
            assert np.array_equal(valid, seen)
        assert made[0].tobytes() == made[1].tobytes()
        assert (made[0][seen == 0] == 5).all()


def test_a_master_keeps_its_own_values(shots, tmp_path):
    made = make(shots(0.0), tmp_path / "m.tif", colour=("gain",), master="p05")
    assert made.balance.gain[5] == pytest.approx(1.0, abs=1e-12)
    assert made.balance.offset[5] == pytest.approx(0.0, abs=1e-9)
    expected = camera(5)[0] / camera(0)[0]
    assert made.balance.gain[0] == pytest.approx(expected, rel=0.02)


def reference(path: Path) -> Path:
    """True radiance in pixels of 12 m and another CRS, as reflectances in 16 bits."""
    from pyproj import Transformer
    from rasterio.warp import Resampling, reproject

    y, x = np.mgrid[-60:480, -60:620] + 0.5
    source = np.clip(30 * radiance(x, y), 0, 65535).astype(np.uint16).transpose(2, 0, 1)
    here = Affine(1, 0, LEFT - 60, 0, -1, TOP + 60)
    x, top = Transformer.from_crs("EPSG:32633", "EPSG:3035", always_xy=True).transform(LEFT - 60, TOP + 60)
    to, width, height = Affine(12, 0, x - 60, 0, -12, top + 60), 70, 60
    with rasterio.open(
        path, "w", driver="GTiff", width=width, height=height, count=2, dtype="uint16", crs="EPSG:3035", transform=to,
        nodata=0,
    ) as file:  # fmt: skip
        for band in range(2):
            values = np.zeros((height, width), dtype=np.uint16)
            reproject(
                source[band], values, src_transform=here, src_crs="EPSG:32633", dst_transform=to, dst_crs="EPSG:3035",
                resampling=Resampling.average,
            )  # fmt: skip
            file.write(values, band + 1)
    return path


def test_a_satellite_image_of_another_crs_and_unit_gives_the_level(shots, tmp_path):
    """Its units are scaled by one number; relative to it every photo's gain is known."""
    like = reference(tmp_path / "satellite.tif")
    made = make(shots(0.0), tmp_path / "m.tif", colour=("gain",), reference=like)
    assert "times" in made.balance.notes[0]
    true = 1 / np.array([camera(i)[0] for i in range(COLS * ROWS)])
    ratio = made.balance.gain / true
    assert ratio.std() / ratio.mean() < 0.02, ratio
    assert off_truth(made.path) < 0.02


def test_masked_areas_say_nothing(shots, tmp_path):
    """A lake of glint fills most of an overlap, brighter in every photo than in the one before."""
    folder = tmp_path / "glint"
    folder.mkdir()
    images = []
    for i, path in enumerate(shots(0.0)):
        with rasterio.open(path) as file:
            values, profile, here = file.read(), file.profile, file.transform
        col, row = round(here.c - LEFT), round(TOP - here.f)
        y, x = np.mgrid[row : row + SIZE[1], col : col + SIZE[0]]
        lake = (x > 100) & (x < 430) & (y > 20) & (y < 400)
        values[:, lake] = np.clip(values[:, lake] * (0.6 + 0.08 * i), 0, 250)
        images.append(folder / path.name)
        with rasterio.open(images[-1], "w", **profile) as file:
            file.write(values)
    areas = geopandas.GeoDataFrame(geometry=[shapely.box(LEFT + 98, TOP - 402, LEFT + 432, TOP - 18)], crs="EPSG:32633")
    areas.to_crs("EPSG:4326").to_file(tmp_path / "lake.gpkg")
    true = 1 / np.array([camera(i)[0] for i in range(COLS * ROWS)])

    def spread(**more) -> float:
        made = make(tuple(images), tmp_path / f"{len(more)}.tif", colour=("gain",), **more)
        return float((made.balance.gain / true).std())

    seen, masked = spread(), spread(mask=tmp_path / "lake.gpkg")
    assert seen > 0.1
    assert masked < 0.06, f"{masked:.3f}, {seen:.3f} without mask"


def test_the_last_stretch_goes_to_eight_bits_and_is_reported(shots, tmp_path):
    made = make(shots(0.35, "uint16"), tmp_path / "s.tif", colour=("gain",), stretch="2,98")
    assert made.stretch is not None
    with rasterio.open(made.path) as file:
        values, valid = file.read(), file.dataset_mask() > 0
        assert file.dtypes[0] == "uint8"
    low, high = np.mean(values[:, valid] <= 2), np.mean(values[:, valid] >= 254)
    assert 0.005 < low < 0.05, low
    assert 0.005 < high < 0.05, high
    fixed = make(shots(0.35, "uint16"), tmp_path / "v.tif", balance=False, stretch="v0,v6000")
    assert (fixed.stretch.low, fixed.stretch.high) == (0.0, 6000.0)


@pytest.mark.parametrize("text", ["", "2", "98,2", "-1,50", "v5", "2,v50", "a,b", "2,nan"])
def test_what_is_no_stretch(text):
    with pytest.raises(InputError):
        parse_stretch(text)


def test_histograms_over_a_region_and_in_sequence(shots, tmp_path):
    region = geopandas.GeoDataFrame(geometry=[shapely.box(LEFT, TOP - 300, LEFT + 528, TOP)], crs="EPSG:32633")
    region.to_file(tmp_path / "region.gpkg")
    images = shots(0.0, "uint16")
    before = off_truth(make(images, tmp_path / "raw.tif", balance=False).path)
    for method, more in (("sequence", {}), ("overlap", {"region": tmp_path / "region.gpkg"})):
        made = make(images, tmp_path / f"{method}.tif", histogram=method, **more)
        assert off_truth(made.path) < 0.6 * before, method
    with pytest.raises(InputError, match="region"):
        MosaicOptions.of(region=tmp_path / "region.gpkg")


def test_crops_of_one_scene_with_different_offsets_are_joined_though_their_ground_differs(tmp_path):
    """Offsets that make whole crops less alike are right where they explain all that the crops share."""
    column = np.arange(240)
    rng = np.random.default_rng(4)
    scene = np.round(600 + 8.0 * column + rng.normal(0, 60, (120, 240))).astype(np.uint16)
    files = []
    for number, (first, offset) in enumerate(((0, 300), (60, 0), (120, 0))):
        files.append(tmp_path / f"{number}.tif")
        place = Affine(2, 0, LEFT + 2 * first, 0, -2, TOP)
        crop = scene[None, :, first : first + 120] + np.uint16(offset)
        with rasterio.open(
            files[-1], "w", driver="GTiff", width=120, height=120, count=1, dtype="uint16", crs="EPSG:32633",
            transform=place,
        ) as file:  # fmt: skip
            file.write(crop)
    made = geomosaic.mosaic(files, tmp_path / "out.tif")
    assert made.balance.gain == pytest.approx(1.0, abs=1e-3)
    assert np.ptp(made.balance.offset + np.array([[300.0], [0.0], [0.0]])) < 3.0, made.balance.offset


def test_terms_that_are_none(tmp_path):
    with pytest.raises(InputError, match="vignetting"):
        MosaicOptions.of(colour=("vignettting",))
