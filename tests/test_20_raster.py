"""Rasters read: values, what is valid, fractions of the size, and what happens when it goes wrong."""

from __future__ import annotations

import json
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from helpers import examples
from hypothesis import given
from hypothesis import strategies as st
from raster_rig import NORTH_UP, holes, picture, whole

from geomosaic.errors import InputError, RasterReadError
from geomosaic.geo.grid import Window
from geomosaic.raster import source as source_module
from geomosaic.raster.source import Source, inspect
from geomosaic.raster.validity import block_mean


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


@examples(40)
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
    assert "hint" in text
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


def test_inspection_gives_what_the_file_declares(tmp_path):
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


def test_files_of_rasterio_are_read(real_data):
    folder = real_data("rasterio-fixtures")
    with Source(folder / "RGB.byte.tif") as image:
        _, valid = image.read(whole(image.info))
        with rasterio.open(folder / "RGB.byte.tif") as dataset:
            np.testing.assert_array_equal(valid * np.uint8(255), dataset.dataset_mask())
    with Source(folder / "white-gemini-iv.vrt") as image:
        assert not image.info.windowed
