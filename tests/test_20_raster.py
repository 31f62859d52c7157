"""Rasters in and out: what is read, what is valid, what stands in the file, and what happens when it goes wrong."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS

from geomosaic.errors import InputError, OutputExistsError, RasterReadError
from geomosaic.geo.grid import Grid, Window
from geomosaic.raster import source as source_module
from geomosaic.raster import tiff
from geomosaic.raster.checksum import sha256
from geomosaic.raster.option_values import METHODS
from geomosaic.raster.preview import png_bytes, preview
from geomosaic.raster.pyramid import halve
from geomosaic.raster.shrink import block_mean
from geomosaic.raster.sink import RasterSink
from geomosaic.raster.source import Source, inspect

UTM = CRS.from_epsg(32633)
NORTH_UP = Affine(2.0, 0.0, 500_000.0, 0.0, -2.0, 5_300_000.0)


def picture(rows=700, cols=900, bands=3, dtype="uint8", seed=0):
    """Smooth picture with some noise, in the lower half of the type's range."""
    rng = np.random.default_rng(seed)
    c, r = np.meshgrid(np.arange(cols), np.arange(rows))
    base = 60 + 40 * np.sin(c / 37.0)[:, :, None] * np.cos(r / 23.0)[:, :, None] + 10 * np.arange(bands)
    return (base + rng.normal(0, 3, (rows, cols, bands))).astype(dtype)


def holes(rows=700, cols=900):
    c, r = np.meshgrid(np.arange(cols), np.arange(rows))
    return (((c - 300) ** 2 + (r - 400) ** 2 > 90**2) & (c < cols - 5)).astype(np.uint8)


def write_file(path: Path, values, **profile) -> Path:
    rows, cols, bands = values.shape
    profile = {"driver": "GTiff", "transform": NORTH_UP, "crs": "EPSG:32633", **profile}
    mask, alpha = profile.pop("mask", None), profile.pop("alpha", None)
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
        rasterio.open(
            path, "w", width=cols, height=rows, count=bands + (alpha is not None), dtype=values.dtype, **profile
        ) as dataset,
    ):
        dataset.write(np.moveaxis(values, -1, 0), list(range(1, bands + 1)))
        if alpha is not None:
            dataset.write(alpha, bands + 1)
            dataset.colorinterp = [*dataset.colorinterp[:bands], rasterio.enums.ColorInterp.alpha]
        if mask is not None:
            dataset.write_mask(mask * np.uint8(255))
    return path


def whole(info) -> Window:
    return Window(0, 0, info.width, info.height)


# --- reading -------------------------------------------------------------------------------------------------------

STORED = {
    "tiled": {"tiled": True, "blockxsize": 256, "blockysize": 256},
    "tiled-band": {"tiled": True, "blockxsize": 128, "blockysize": 128, "interleave": "band"},
    "tiled-deflate": {"tiled": True, "blockxsize": 256, "blockysize": 256, "compress": "deflate"},
    "strips": {},
    "strips-deflate": {"compress": "deflate", "blockysize": 64},
    "one-strip": {"compress": "lzw", "blockysize": 700},
    "png": {"driver": "PNG"},
    "bmp": {"driver": "BMP"},
}


@pytest.mark.parametrize("kind", STORED)
@pytest.mark.parametrize("memory", [512 << 20, 0])
def test_windows_of_every_format(tmp_path, kind, memory):
    values = picture()
    path = write_file(tmp_path / "image", values, **STORED[kind])
    rng = np.random.default_rng(1)
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    before = sorted(tmp_path.iterdir())
    with Source(path, memory_limit=memory, scratch=scratch) as image:
        assert image.info.size == (900, 700)
        assert image.info.windowed == (kind not in ("strips-deflate", "png"))
        for _ in range(10):
            col, row = int(rng.integers(0, 899)), int(rng.integers(0, 699))
            window = Window(col, row, int(rng.integers(1, 901 - col)), int(rng.integers(1, 701 - row)))
            got, valid = image.read(window)
            assert got.flags.c_contiguous
            assert valid is None
            np.testing.assert_array_equal(got, values[row : window.stop_row, col : window.stop_col])
        assert bool(list(scratch.iterdir())) == (memory == 0 and not image.info.windowed)
    assert not list(scratch.iterdir())
    assert sorted(tmp_path.iterdir()) == before  # reading leaves nothing beside the image


@pytest.mark.parametrize("limit", [512 << 20, 0])
def test_jpeg_is_decoded_once(tmp_path, monkeypatch, limit):
    path = write_file(tmp_path / "p.jpg", picture(), driver="JPEG")
    with rasterio.open(path) as dataset:
        truth = np.moveaxis(dataset.read(), 0, -1)
    rows = []
    decode = Source._decode
    monkeypatch.setattr(Source, "_decode", lambda self, window: rows.append(window.height) or decode(self, window))
    with Source(path, memory_limit=limit, scratch=tmp_path) as image, ThreadPoolExecutor(4) as pool:
        windows = Window(0, 0, 900, 700).split(200, 150)
        for window, (got, _) in zip(windows, pool.map(image.read, windows), strict=True):
            np.testing.assert_array_equal(got, truth[window.row : window.stop_row, window.col : window.stop_col])
    assert sum(rows) == 700


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int16", "int32", "float32", "float64"])
def test_sample_types_and_band_choice(tmp_path, dtype):
    values = picture(bands=4, dtype=dtype)
    path = write_file(tmp_path / "i.tif", values, tiled=True, photometric="minisblack")
    with Source(path, bands=[4, 2]) as image:
        assert image.info.bands == len(image.info.units) == 2
        got, _ = image.read(whole(image.info))
        assert got.dtype == np.dtype(dtype)
        np.testing.assert_array_equal(got, values[:, :, [3, 1]])
    for bands, said in (([5], "no band 5: the file has bands 1 to 4"), ([1, 0], "no band 0"), ([], "no band is")):
        with pytest.raises(InputError, match=said) as caught:
            Source(path, bands=bands)
        assert caught.value.where == str(path)


def test_what_is_said_of_bands_is_said_of_those_chosen(tmp_path):
    path = tmp_path / "i.tif"
    with rasterio.open(path, "w", driver="GTiff", width=8, height=6, count=3, dtype="int16") as file:
        file.descriptions, file.units, file.scales = ("red", "near", "heat"), ("a", "b", "c"), (1.0, 2.0, 3.0)
    info = inspect(path, [3, 1])
    assert (info.bands, info.descriptions, info.units, info.scales) == (2, ("heat", "red"), ("c", "a"), (3.0, 1.0))


def test_threads_have_handles_of_their_own(tmp_path):
    values = picture()
    image = Source(write_file(tmp_path / "i.tif", values, tiled=True, compress="deflate"))
    windows = Window(0, 0, 900, 700).split(64, 64)
    ready = threading.Barrier(3)
    with ThreadPoolExecutor(3, initializer=ready.wait) as pool:
        for window, (got, _) in zip(windows, pool.map(image.read, windows), strict=True):
            np.testing.assert_array_equal(got, values[window.row : window.stop_row, window.col : window.stop_col])
    assert len(image._handles) == 3
    handles = list(image._handles)
    image.close()
    assert all(handle.closed for handle in handles)


# --- validity ------------------------------------------------------------------------------------------------------


def test_black_is_valid_without_a_mark(tmp_path):
    values = np.zeros((50, 50, 3), np.uint8)
    with Source(write_file(tmp_path / "i.tif", values)) as image:
        assert not image.info.masked
        assert image.read(whole(image.info))[1] is None


def test_unsigned_nodata_needs_every_band(tmp_path):
    values = picture(50, 50)
    values[10, 10] = 0
    values[20, 20, 1] = 0  # dark green, not a hole
    with Source(write_file(tmp_path / "i.tif", values, nodata=0)) as image:
        _, valid = image.read(whole(image.info))
        assert (valid == 0).nonzero() == (np.array([10]), np.array([10]))
        assert image.read(Window(20, 20, 5, 5))[1] is None
    with Source(tmp_path / "i.tif", nodata=255) as image:
        assert image.read(whole(image.info))[1] is None
    with Source(tmp_path / "i.tif", nodata=-9999) as image:
        assert image.read(whole(image.info))[1] is None


@pytest.mark.parametrize(("dtype", "mark"), [("int16", -9999), ("float32", -9999), ("float32", np.nan)])
def test_signed_nodata_needs_one_band(tmp_path, dtype, mark):
    values = picture(50, 50, dtype=dtype)
    values[20, 20, 1] = mark
    with Source(write_file(tmp_path / "i.tif", values, nodata=mark)) as image:
        _, valid = image.read(whole(image.info))
        assert valid.dtype == np.uint8
        assert (valid == 0).sum() == 1
        assert valid[20, 20] == 0


def test_nan_and_infinity_are_never_valid(tmp_path):
    values = picture(50, 50, 1, "float32")
    values[3, 4], values[5, 6] = np.nan, np.inf
    with Source(write_file(tmp_path / "i.tif", values, nodata=-1)) as image:
        _, valid = image.read(whole(image.info))
    assert sorted(zip(*np.nonzero(valid == 0), strict=True)) == [(3, 4), (5, 6)]


@pytest.mark.parametrize("how", ["mask", "alpha"])
def test_mask_and_alpha(tmp_path, how):
    valid = holes()
    extra = {"mask": valid} if how == "mask" else {"alpha": valid * np.uint8(255)}
    with Source(write_file(tmp_path / "i.tif", picture(), tiled=True, **extra)) as image:
        assert image.info.bands == 3
        assert image.info.masked
        values, got = image.read(whole(image.info))
        assert values.shape == (700, 900, 3)
        np.testing.assert_array_equal(got, valid)
        assert image.read(Window(0, 0, 50, 50))[1] is None


# --- reduced reading -----------------------------------------------------------------------------------------------


def naive_mean(values, valid, s):
    rows, cols, bands = values.shape
    means = np.zeros((-(-rows // s), -(-cols // s), bands))
    known = np.zeros(means.shape[:2], np.uint8)
    for r in range(means.shape[0]):
        for c in range(means.shape[1]):
            block = values[r * s : r * s + s, c * s : c * s + s].astype(np.float64)
            use = valid[r * s : r * s + s, c * s : c * s + s] != 0
            if use.any():
                known[r, c] = 1
                means[r, c] = block[use].mean(axis=0)
    return means, known


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 23), st.integers(1, 23), st.integers(2, 9),
    st.sampled_from(["uint8", "uint16", "int16", "float32"]), st.integers(0, 5),
)  # fmt: skip
def test_block_mean_is_the_mean(rows, cols, size, dtype, seed):
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 120, (rows, cols, 2)).astype(dtype)
    valid = (rng.random((rows, cols)) > 0.4).astype(np.uint8)
    for mask in (valid, None):
        got, known = block_mean(values, mask, size)
        means, expected = naive_mean(values, np.ones_like(valid) if mask is None else mask, size)
        np.testing.assert_allclose(got, means, rtol=1e-6)
        np.testing.assert_array_equal(np.ones_like(expected) if known is None else known, expected)


@pytest.mark.parametrize("kind", ["tiled-deflate", "png"])
def test_shrink_reads_by_strips(tmp_path, monkeypatch, kind):
    values = picture()
    values[100:150, 200:300] = 0
    path = write_file(tmp_path / "i", values, nodata=0, **STORED[kind])
    monkeypatch.setattr(source_module, "_STRIP_BYTES", 60_000)
    with Source(path) as image:
        got, known = image.read(Window(100, 50, 800, 650), shrink=5)
        part, _ = image.read(Window(200, 300, 303, 400), shrink=5)
        with pytest.raises(ValueError, match="multiple"):
            image.read(Window(101, 50, 10, 10), shrink=5)
        with pytest.raises(ValueError, match="inside"):
            image.read(Window(890, 0, 20, 10))
    means, expected = naive_mean(values[50:, 100:], (values[50:, 100:] != 0).any(axis=2), 5)
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, means, rtol=1e-6)
    np.testing.assert_array_equal(known, expected)
    np.testing.assert_array_equal(part[:, :60], got[50:130, 20:80])


def test_white_noise_keeps_the_block_means_deviation(tmp_path):
    values = np.random.default_rng(1).normal(1000, 100, (1000, 1000, 1)).astype("uint16")
    with Source(write_file(tmp_path / "i.tif", values, tiled=True)) as image:
        got, _ = image.read(whole(image.info), shrink=10)
    assert got.std() == pytest.approx(10.0, rel=0.03)


# --- bad files -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["tiled", "tiled-deflate", "strips", "strips-deflate", "png", "jpeg"])
def test_truncated_files_say_so(tmp_path, kind):
    profile = {"driver": "JPEG"} if kind == "jpeg" else STORED[kind]
    path = write_file(tmp_path / "cut", picture(), **profile)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 3 // 4])
    with pytest.raises(RasterReadError) as caught, Source(path) as image:
        image.read(Window(0, 600, 900, 100))
    text = str(caught.value)
    assert str(path) in text
    assert "mend" in text
    assert "truncated" in text
    assert "columns" in text


def test_what_is_no_raster(tmp_path):
    with pytest.raises(RasterReadError, match="does not exist"):
        inspect(tmp_path / "none.tif")
    with pytest.raises(RasterReadError, match="folder"):
        inspect(tmp_path)
    (tmp_path / "text.tif").write_text("no raster at all")
    with pytest.raises(RasterReadError, match="not a raster"):
        inspect(tmp_path / "text.tif")
    (tmp_path / "list.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": []}))
    with pytest.raises(RasterReadError, match="not a raster"):
        inspect(tmp_path / "list.geojson")
    write_file(tmp_path / "radar.tif", np.ones((10, 10, 1), np.complex64))
    with pytest.raises(RasterReadError, match="complex64"):
        inspect(tmp_path / "radar.tif")


def test_inspect(tmp_path):
    info = inspect(write_file(tmp_path / "i.tif", picture(dtype="uint16"), tiled=True, nodata=0, crs="EPSG:32633+5773"))
    assert (info.size, info.bands, info.dtype, info.nodata) == ((900, 700), 3, "uint16", 0.0)
    assert info.transform == NORTH_UP
    assert info.crs.sub_crs_list[1].name == "EGM96 height"
    assert info.tiled
    assert info.masked
    assert info.direct
    plain = inspect(write_file(tmp_path / "p.png", picture(), driver="PNG", crs=None, transform=Affine.identity()))
    assert plain.transform is None
    assert plain.crs is None
    assert plain.colors == ("red", "green", "blue")


def test_fixtures(real_data):
    folder = real_data("rasterio-fixtures")
    with Source(folder / "RGB.byte.tif") as image:
        _, valid = image.read(whole(image.info))
        with rasterio.open(folder / "RGB.byte.tif") as dataset:
            np.testing.assert_array_equal(valid * np.uint8(255), dataset.dataset_mask())
    with Source(folder / "white-gemini-iv.vrt") as image:
        assert not image.info.windowed


# --- writing -------------------------------------------------------------------------------------------------------


def grid_of(rows, cols):
    return Grid(UTM, NORTH_UP, cols, rows)


def write_raster(path, values, valid=None, width=1024, height=512, **options):
    rows, cols, bands = values.shape
    with RasterSink(path, grid_of(rows, cols), bands, values.dtype.name, **options) as sink:
        for window in Window(0, 0, cols, rows).split(width, height):
            part = np.s_[window.row : window.stop_row, window.col : window.stop_col]
            sink.write(window, values[part], None if valid is None else valid[part])
        return sink.finish()


def digest(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize("driver", ["GTiff", "COG"])
@pytest.mark.parametrize("compress", ["NONE", "DEFLATE", "ZSTD"])
def test_same_bytes_for_any_windows_and_threads(tmp_path, driver, compress):
    values, valid = picture(1100, 1600), holes(1100, 1600)
    valid[500:, 900:] = 0
    found = set()
    for i, (width, height, threads) in enumerate([(512, 512, 1), (1024, 512, 3), (1536, 1024, 2), (2048, 1536, 4)]):
        path = write_raster(
            tmp_path / f"{i}.tif", values, valid, width, height, driver=driver, creation={"COMPRESS": compress},
            threads=threads,
        )  # fmt: skip
        found.add(digest(path))
    # What stands in invalid pixels does not reach the file.
    noise = np.where(valid[:, :, None] != 0, values, 77).astype(np.uint8)
    found.add(digest(write_raster(tmp_path / "n.tif", noise, valid, driver=driver, creation={"COMPRESS": compress})))
    assert len(found) == 1
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


@pytest.mark.parametrize("driver", ["GTiff", "COG"])
@pytest.mark.parametrize(
    ("compress", "dtype", "bands"),
    [
        ("NONE", "uint8", 3), ("NONE", "float32", 2), ("DEFLATE", "uint8", 3), ("DEFLATE", "uint16", 4),
        ("DEFLATE", "float32", 1), ("ZSTD", "int16", 1), ("LZW", "uint8", 4), ("LERC", "float32", 2),
        ("PACKBITS", "int32", 1),
    ],
)  # fmt: skip
def test_written_is_read(tmp_path, driver, compress, dtype, bands):
    values, valid = picture(bands=bands, dtype=dtype), holes()
    path = write_raster(
        tmp_path / "o.tif", values, valid, driver=driver, creation={"compress": compress},
        descriptions=[f"band {i}" for i in range(bands)], tags={"GEOMOSAIC_TEST": "é <&>"},
    )  # fmt: skip
    expected = np.where(valid[:, :, None] != 0, values, 0)
    with rasterio.open(path) as dataset:
        np.testing.assert_array_equal(np.moveaxis(dataset.read(), 0, -1), expected)
        for band in range(1, bands + 1):
            np.testing.assert_array_equal(dataset.read_masks(band), valid * np.uint8(255))
        assert dataset.transform == NORTH_UP
        assert dataset.crs.to_epsg() == 32633
        assert dataset.descriptions == tuple(f"band {i}" for i in range(bands))
        assert dataset.tags()["GEOMOSAIC_TEST"] == "é <&>"
        assert dataset.block_shapes[0] == (512, 512)
        assert "alpha" not in [color.name for color in dataset.colorinterp]
        assert (dataset.colorinterp[0].name == "red") == (bands == 3)
        structure = dataset.tags(ns="IMAGE_STRUCTURE")
        assert structure.get("COMPRESSION", "NONE") == compress
        assert structure.get("LAYOUT") == ("COG" if driver == "COG" else None)
    with Source(path) as image:
        got, got_valid = image.read(whole(image.info))
        np.testing.assert_array_equal(got, expected)
        np.testing.assert_array_equal(got_valid, valid)


@pytest.mark.parametrize("driver", ["GTiff", "COG"])
@pytest.mark.parametrize("big", ["YES", "NO"])
def test_big_tiff_and_no_mask_where_all_is_valid(tmp_path, driver, big):
    values = picture(600, 530)
    path = write_raster(
        tmp_path / "o.tif", values, np.ones((600, 530), np.uint8), driver=driver, creation={"BIGTIFF": big}
    )
    assert path.read_bytes()[:4] == (b"II+\0" if big == "YES" else b"II*\0")
    with path.open("rb") as file:
        assert len(tiff.read_directories(file)) == (1 if driver == "GTiff" else 2)
    with rasterio.open(path) as dataset:
        np.testing.assert_array_equal(np.moveaxis(dataset.read(), 0, -1), values)
    assert not inspect(path).masked


def test_jpeg_compression(tmp_path):
    values, valid = picture(), holes()
    for driver in ("GTiff", "COG"):
        path = write_raster(
            tmp_path / "o.tif", values, valid, driver=driver, creation={"COMPRESS": "JPEG", "QUALITY": "95"},
            overwrite=True,
        )  # fmt: skip
        with Source(path) as image:
            got, got_valid = image.read(whole(image.info))
        np.testing.assert_array_equal(got_valid, valid)
        assert np.abs(got.astype(int) - values)[valid != 0].mean() < 3
        with rasterio.open(path) as dataset:
            assert dataset.tags(ns="IMAGE_STRUCTURE")["COMPRESSION"] == "YCbCr JPEG"


@pytest.mark.parametrize("compress", ["NONE", "DEFLATE"])
@pytest.mark.parametrize("nodata", [None, 255])
def test_cog_is_valid_and_its_overviews_are_means(tmp_path, compress, nodata):
    from rio_cogeo import cog_validate

    values, valid = picture(1100, 2100), holes(1100, 2100)
    path = write_raster(tmp_path / "o.tif", values, valid, creation={"COMPRESS": compress}, nodata=nodata, threads=2)
    good, errors, warnings = cog_validate(path, strict=True)
    assert good, (errors, warnings)
    with rasterio.open(path) as dataset:
        assert dataset.overviews(1) == [2, 4, 8]
    expected, known = values, valid
    for level in range(3):
        rows, cols = -(-expected.shape[0] // 2), -(-expected.shape[1] // 2)
        means, known = naive_mean_fast(expected, known)
        expected = np.rint(means).astype(np.uint8)
        with rasterio.open(path, overview_level=level) as dataset:
            assert dataset.shape == (rows, cols)
            np.testing.assert_array_equal(dataset.dataset_mask() != 0, known != 0)
            got = np.moveaxis(dataset.read(), 0, -1)
            np.testing.assert_array_equal(got[known != 0], expected[known != 0])
            assert (got[known == 0] == (nodata or 0)).all()


def naive_mean_fast(values, valid):
    rows, cols = (n + n % 2 for n in valid.shape)
    v = np.zeros((rows, cols, values.shape[2]))
    w = np.zeros((rows, cols))
    v[: values.shape[0], : values.shape[1]], w[: valid.shape[0], : valid.shape[1]] = values, valid
    total = (v * w[:, :, None]).reshape(rows // 2, 2, cols // 2, 2, -1).sum(axis=(1, 3))
    count = w.reshape(rows // 2, 2, cols // 2, 2).sum(axis=(1, 3))
    return total / np.maximum(count, 1)[:, :, None], (count > 0).astype(np.uint8)


def test_halving_adds_no_brightness():
    values = np.random.default_rng(0).integers(0, 255, (512, 512, 1)).astype(np.uint8)
    exact = values.reshape(256, 2, 256, 2).mean(axis=(1, 3))
    got, _ = halve(values, None, "average")
    assert abs((got[:, :, 0] - exact).mean()) < 0.01
    negative, _ = halve(values.astype(np.int16) - 500, None, "average")
    np.testing.assert_array_equal(negative[:, :, 0], np.rint(exact - 500))


def test_label_overviews_hold_labels_only(tmp_path):
    labels = np.random.default_rng(0).integers(1, 4, (700, 900, 1)).astype(np.uint16) * 100
    path = write_raster(tmp_path / "o.tif", labels, nodata=0, classes=True)
    with rasterio.open(path, overview_level=0) as dataset:
        np.testing.assert_array_equal(dataset.read(1), labels[::2, ::2, 0])


@pytest.mark.parametrize("driver", ["GTiff", "COG"])
def test_nodata_instead_of_a_mask(tmp_path, driver):
    values, valid = picture(), holes()
    values[5, 5] = 0  # true black must stay valid
    path = write_raster(tmp_path / "o.tif", values, valid, nodata=0, driver=driver)
    with rasterio.open(path) as dataset:
        assert dataset.nodata == 0
        np.testing.assert_array_equal(dataset.dataset_mask() != 0, valid != 0)
        assert dataset.read()[:, 5, 5].tolist() == [1, 1, 1]
    floats = picture(dtype="float32")
    path = write_raster(tmp_path / "f.tif", floats, valid, nodata=float("nan"), driver=driver)
    with rasterio.open(path) as dataset:
        np.testing.assert_array_equal(np.isnan(dataset.read(1)), valid == 0)


def test_what_cannot_be_written(tmp_path):
    grid = grid_of(10, 10)
    for nodata, dtype in ((-1, "uint8"), (300, "uint8"), (0.5, "int16"), (float("nan"), "uint16"), (1e300, "float32")):
        with pytest.raises(InputError, match="nodata"):
            RasterSink(tmp_path / "o.tif", grid, 1, dtype, nodata=nodata)
    for options in ({"TILED": "NO"}, {"BLOCKXSIZE": "256"}, {"INTERLEAVE": "BAND"}, {"COMRPESS": "LZW"}):
        with pytest.raises(InputError, match=next(iter(options))):
            RasterSink(tmp_path / "o.tif", grid, 1, "uint8", creation=options)
    with pytest.raises(InputError, match="COG or GTiff"):
        RasterSink(tmp_path / "o.tif", grid, 1, "uint8", driver="PNG")
    with pytest.raises(InputError, match="folder"):
        RasterSink(tmp_path / "none" / "o.tif", grid, 1, "uint8")
    with pytest.raises(InputError, match="WEBP"):
        RasterSink(tmp_path / "o.tif", grid, 1, "float32", creation={"COMPRESS": "WEBP"})
    assert not list(tmp_path.iterdir())


def test_existing_outputs(tmp_path):
    path = tmp_path / "o.tif"
    path.write_bytes(b"precious")
    (tmp_path / "o.tif.aux.xml").write_text("<stale/>")
    with pytest.raises(OutputExistsError, match="--overwrite"):
        RasterSink(path, grid_of(10, 10), 1, "uint8")
    values = picture(600, 600)

    def fails():
        with RasterSink(path, grid_of(600, 600), 3, "uint8", overwrite=True, threads=2) as sink:
            sink.write(Window(0, 0, 600, 512), values[:512])
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        fails()
    assert path.read_bytes() == b"precious"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["o.tif", "o.tif.aux.xml"]
    write_raster(path, values, overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["o.tif"]


def test_windows_must_fit_blocks_and_be_all_there(tmp_path):
    with RasterSink(tmp_path / "o.tif", grid_of(600, 600), 1, "uint8") as sink:
        for window in (Window(0, 0, 100, 512), Window(1, 0, 512, 512), Window(512, 0, 512, 512)):
            with pytest.raises(ValueError, match=r"o\.tif|block"):
                sink.write(window, np.zeros((window.height, window.width, 1), np.uint8))
        with pytest.raises(ValueError, match="fill"):
            sink.write(Window(0, 0, 512, 512), np.zeros((512, 512, 1), np.uint16))
        sink.write(Window(0, 0, 600, 512), np.zeros((512, 600, 1), np.uint8))
        with pytest.raises(ValueError, match="not every window"):
            sink.finish()
    assert not list(tmp_path.iterdir())


FULL_DISK = """
import resource, signal, sys
import numpy as np
from affine import Affine
from pyproj import CRS
from geomosaic.errors import OutputError
from geomosaic.geo.grid import Grid, Window
from geomosaic.raster.sink import RasterSink

path, driver, compress, limit, threads = sys.argv[1], sys.argv[2], sys.argv[3], int(sys.argv[4]), int(sys.argv[5])
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
values = np.random.default_rng(0).integers(0, 255, (512, 1500, 3)).astype(np.uint8)
grid = Grid(CRS.from_epsg(32633), Affine(1, 0, 0, 0, -1, 0), 1500, 1500)
with RasterSink(path, grid, 3, "uint8", driver=driver, creation={"COMPRESS": compress}, threads=threads) as warm:
    pass
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
try:
    with RasterSink(path, grid, 3, "uint8", driver=driver, creation={"COMPRESS": compress}, threads=threads) as sink:
        for window in grid.window.split(1500, 512):
            sink.write(window, values[: window.height])
        sink.finish()
except OutputError as error:
    print(error)
    sys.exit(1)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs RLIMIT_FSIZE")
@pytest.mark.parametrize(
    ("driver", "compress", "share"),
    [
        ("GTiff", "NONE", 0.02), ("GTiff", "NONE", 0.99999), ("GTiff", "DEFLATE", 0.5), ("GTiff", "DEFLATE", 0.99999),
        ("COG", "NONE", 0.5), ("COG", "DEFLATE", 0.02), ("COG", "DEFLATE", 0.8), ("COG", "DEFLATE", 0.99999),
    ],
)  # fmt: skip
def test_full_disk(tmp_path, driver, compress, share):
    """A limit on file size stands in for a full disk, at the first tile, midway, and at the last bytes."""
    values = np.random.default_rng(0).integers(0, 255, (512, 1500, 3)).astype(np.uint8)
    path = write_raster(
        tmp_path / "o.tif", np.concatenate([values, values, values[:476]]), width=1500, driver=driver,
        creation={"COMPRESS": compress},
    )  # fmt: skip
    limit = int(path.stat().st_size * share)
    path.unlink()
    command = [sys.executable, "-c", FULL_DISK, str(path), driver, compress, str(limit), "2"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert run.returncode == 1, run.stderr
    assert "writing failed" in run.stdout
    assert str(path) in run.stdout
    assert "free" in run.stdout
    assert not list(tmp_path.iterdir())


def test_a_folder_that_may_not_be_written_to(tmp_path, monkeypatch):
    from geomosaic.errors import OutputError

    def refused(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refused)
    with pytest.raises(OutputError, match="Permission denied") as caught:
        RasterSink(tmp_path / "o.tif", grid_of(100, 100), 3, "uint8")
    assert "rights" in str(caught.value.mend)
    assert "space" not in str(caught.value.mend)


def test_full_disk_is_foreseen(tmp_path, monkeypatch):
    from geomosaic.errors import OutputError
    from geomosaic.raster import sink as sink_module

    usage = type("Usage", (), {"free": 1_000_000})
    monkeypatch.setattr(sink_module.shutil, "disk_usage", lambda path: usage)
    with pytest.raises(OutputError, match=r"needs 3.0 MB, 1.0 MB are free"):
        RasterSink(tmp_path / "o.tif", grid_of(1000, 1000), 3, "uint8", creation={"COMPRESS": "NONE"})
    with RasterSink(tmp_path / "o.tif", grid_of(1000, 1000), 3, "uint8"):
        pass
    assert not list(tmp_path.iterdir())


# --- the rest ------------------------------------------------------------------------------------------------------


def test_checksum(tmp_path):
    (tmp_path / "f").write_bytes(b"abc")
    assert sha256(tmp_path / "f") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    with pytest.raises(InputError, match="cannot be read"):
        sha256(tmp_path / "none")


def test_preview(tmp_path):
    from io import BytesIO

    from PIL import Image

    values, valid = picture(dtype="uint16"), holes()
    values[valid == 0] = 60_000
    path = write_raster(tmp_path / "o.tif", values, valid)
    rgb, seen = preview(path, 300)
    assert rgb.shape == (233, 300, 3)
    assert rgb.dtype == np.uint8
    assert 0.9 < seen.mean() < 0.97
    assert rgb[seen != 0].std() > 40  # the stretch knows nothing of the holes
    with Image.open(BytesIO(png_bytes(rgb, seen))) as image:
        assert image.mode == "RGBA"
        np.testing.assert_array_equal(np.asarray(image)[:, :, 3] != 0, seen != 0)
    grey, _ = preview(write_raster(tmp_path / "g.tif", picture(bands=1)), 5000)
    assert grey.shape == (700, 900, 3)
    assert (grey[:, :, 0] == grey[:, :, 2]).all()


def test_vector_layers(tmp_path, monkeypatch):
    import shapely

    from geomosaic.raster.vector import Layer, read_layer, write_layers

    box, crs = shapely.box(0, 0, 1, 1), CRS.from_epsg(32633)
    columns = {"name": ["é", "b"], "number": [1, 2], "size": [0.5, np.nan], "whole": [True, False]}
    layers = {
        "first": Layer(crs, "Polygon", [box, box], columns),
        "second": Layer(crs, "MultiPolygon", [box], {"name": ["é"]}),
        "none": Layer(crs, "MultiLineString", [], {"name": []}),
    }
    one = write_layers(tmp_path / "one.gpkg", layers)
    two = write_layers(tmp_path / "two.gpkg", layers)
    assert digest(one) == digest(two)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["one.gpkg", "two.gpkg"]
    frame = read_layer(one)
    assert len(frame) == 2
    assert frame["name"].tolist() == ["é", "b"]
    assert frame["number"].tolist() == [1, 2]
    assert frame["whole"].tolist() == [True, False]
    assert frame.geometry[0].equals(box)
    assert read_layer(one, "second").crs.to_epsg() == 32633
    assert read_layer(one, "second").geom_type[0] == "MultiPolygon"
    assert len(read_layer(one, "none")) == 0
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    assert digest(write_layers(two, layers, overwrite=True)) != digest(one)
    with pytest.raises(OutputExistsError):
        write_layers(one, layers)
    with pytest.raises(InputError, match="first, second, none"):
        read_layer(one, "third")
    with pytest.raises(InputError, match="does not exist"):
        read_layer(tmp_path / "none.gpkg")
    (tmp_path / "bad.gpkg").write_text("nothing")
    with pytest.raises(InputError, match="not a vector file"):
        read_layer(tmp_path / "bad.gpkg")


@pytest.mark.parametrize(
    ("creation", "bands", "dtype", "mend"),
    [
        ({"COMPRESS": "foo"}, 1, "uint8", "DEFLATE, ZSTD, LZW"),
        ({"COMPRESS": "JXL"}, 3, "uint8", "DEFLATE, ZSTD, LZW"),
        ({"COMPRESS": ""}, 1, "uint8", "NONE"),
        ({"PREDICTOR": "4"}, 1, "uint8", "STANDARD"),
        ({"PREDICTOR": "3"}, 1, "uint16", "use 2"),
        ({"ZLEVEL": "13"}, 1, "uint8", "1 to 12"),
        ({"ZLEVEL": "-1"}, 1, "uint8", "1 to 12"),
        ({"LEVEL": "six"}, 1, "uint8", "1 to 12"),
        ({"LEVEL": "23", "COMPRESS": "zstd"}, 1, "uint8", "1 to 22"),
        ({"ZSTD_LEVEL": "0", "COMPRESS": "ZSTD"}, 1, "uint8", "1 to 22"),
        ({"LZMA_PRESET": "10", "COMPRESS": "LZMA"}, 1, "uint8", "0 to 9"),
        ({"QUALITY": "101", "COMPRESS": "JPEG"}, 3, "uint8", "1 to 100"),
        ({"BIGTIFF": "MAYBE"}, 1, "uint8", "IF_SAFER"),
        ({"PHOTOMETRIC": "PALETTE"}, 1, "uint8", "MINISBLACK"),
        ({"PHOTOMETRIC": "RGB"}, 1, "uint8", "one band"),
        ({"PHOTOMETRIC": "YCBCR"}, 3, "uint8", "COMPRESS=JPEG"),
        ({"ALPHA": "PERHAPS"}, 4, "uint8", "PREMULTIPLIED"),
        ({"WEBP_LOSSLESS": "MAYBE", "COMPRESS": "WEBP"}, 3, "uint8", "YES"),
        ({"MAX_Z_ERROR": "x", "COMPRESS": "LERC"}, 1, "float32", "not negative"),
        ({"DISCARD_LSB": "9"}, 1, "uint8", "0 to 7"),
        ({"GEOTIFF_VERSION": "2"}, 1, "uint8", "1.1"),
    ],
)
def test_values_that_gdal_would_ignore_are_refused(tmp_path, creation, bands, dtype, mend):
    name, value = next(iter(creation.items()))
    with pytest.raises(InputError, match=f"{name}={value} cannot be had") as caught:
        RasterSink(tmp_path / "a.tif", grid_of(10, 10), bands, dtype, creation=creation)
    assert mend in str(caught.value.mend)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("method", METHODS)
def test_every_compression_that_is_offered_is_written(tmp_path, method):
    values = picture(60, 70)
    path = write_raster(tmp_path / "o.tif", values, np.ones((60, 70), np.uint8), creation={"compress": method.lower()})
    with rasterio.open(path) as dataset:
        assert method in dataset.tags(ns="IMAGE_STRUCTURE").get("COMPRESSION", "NONE")
        assert np.abs(dataset.read().transpose(1, 2, 0).astype(int) - values).mean() < 5


def test_words_of_options_may_be_small(tmp_path):
    words = {"bigtiff": "yes", "predictor": "no", "level": "9", "photometric": "minisblack"}
    path = write_raster(tmp_path / "o.tif", picture(60, 70), np.ones((60, 70), np.uint8), creation=words)
    assert path.read_bytes()[:4] == b"II+\0"
    with rasterio.open(path) as dataset:
        assert "PREDICTOR" not in dataset.tags(ns="IMAGE_STRUCTURE")
        assert dataset.colorinterp[0].name == "gray"
