"""Tiles for the page show the pixels of rasters of any depth, with overviews and without."""

from __future__ import annotations

import time
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import rasterio
from PIL import Image

from geomosaic.errors import InputError, RasterReadError
from geomosaic.geo.grid import Window
from geomosaic.raster import display
from geomosaic.raster.display import DisplayRaster, eight_bits
from geomosaic.raster.environment import environment, opening
from geomosaic.studio.raster_tiles import SIZE, RasterTiles, level_count

pytest.importorskip("httpx2", reason="httpx2 is not installed")

from studio_rig import write_image


def texture(rows: int, cols: int, bands: int = 1, dtype: type = np.uint16) -> np.ndarray:
    """Smooth values with some noise, within 12 bits or 8."""
    y, x = np.mgrid[:rows, :cols]
    waves = np.sin(x / 37.0) + np.cos(y / 53.0) + 0.2 * np.random.default_rng(1).standard_normal((rows, cols))
    top = 250 if dtype is np.uint8 else 4000
    return np.repeat(np.clip((waves + 3) / 6 * top, 1, top).astype(dtype)[..., None], bands, axis=2)


def decoded(encoded: bytes) -> np.ndarray:
    return np.asarray(Image.open(BytesIO(encoded)).convert("RGBA"))


def wait_until_ready(raster: DisplayRaster) -> None:
    until = time.monotonic() + 30
    while raster.ready < 1.0:
        assert time.monotonic() < until
        time.sleep(0.01)


@pytest.mark.parametrize(
    ("size", "levels"), [((1, 1), 1), ((256, 256), 1), ((257, 10), 2), ((512, 100), 2), ((30000, 30000), 8)]
)
def test_level_0_holds_the_whole_raster_and_the_last_level_its_pixels(size: tuple[int, int], levels: int) -> None:
    assert level_count(*size) == levels
    assert max(size) <= SIZE * 2 ** (levels - 1)


def test_the_finest_tiles_show_every_pixel_at_its_place(tmp_path: Path) -> None:
    values = texture(600, 700, 3, np.uint8)
    tiles = RasterTiles({"a": write_image(tmp_path / "a.tif", values)}.get)
    shown = np.zeros((768, 768, 4), np.uint8)
    for x in range(3):
        for y in range(3):
            encoded, final = tiles.tile("a", 2, x, y)
            assert final
            shown[y * 256 : y * 256 + 256, x * 256 : x * 256 + 256] = decoded(encoded)
    difference = shown[:600, :700, :3].astype(int) - values
    assert np.sqrt(np.mean(difference**2)) < 4.0  # WebP of quality 85 over noise of 8 grey values
    assert (shown[:600, :700, 3] == 255).all()
    assert (shown[600:, :, 3] == 0).all()
    assert (shown[:, 700:, 3] == 0).all()
    tiles.close()


@pytest.mark.parametrize("overviews", [True, False])
@pytest.mark.parametrize("shrink", [1, 4, 8, 32])
def test_reduced_windows_are_means_of_the_pixels(
    tmp_path: Path, overviews: bool, shrink: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(display, "_SMALL", 500)  # as if the raster were large
    values = texture(1024, 1280)
    path = write_image(tmp_path / "a.tif", values, tiled=True, blockxsize=256, blockysize=256)
    if overviews:
        with environment(), opening(), rasterio.open(path, "r+") as file:
            file.build_overviews([2, 4, 8, 16, 32], rasterio.enums.Resampling.average)
    raster = DisplayRaster(path)
    wait_until_ready(raster)
    window = Window(256, 512, 512, 256)
    found, valid = raster.read(window, shrink)
    part = values[512:768, 256:768, 0].astype(float)
    means = part.reshape(256 // shrink, shrink, 512 // shrink, shrink).mean(axis=(1, 3))
    assert valid is None or valid.all()
    assert np.abs(found[..., 0] - means).max() <= 3.0  # each of up to five levels of overviews is rounded
    raster.close()


def test_sixteen_bits_are_stretched_between_their_percentiles(tmp_path: Path) -> None:
    values = texture(900, 900)
    raster = DisplayRaster(write_image(tmp_path / "a.tif", values))
    low, high = np.percentile(values, (2.0, 98.0))
    assert raster.limits() == pytest.approx((low, high), rel=0.06)  # of means of four pixels
    grey = eight_bits(np.array([[[low], [(low + high) / 2], [high], [high + 999]]]), (low, high))
    assert grey.ravel().tolist() == [0, pytest.approx(127.5, abs=1), 255, 255]
    raster.close()


def test_a_coarse_view_is_there_before_the_whole_raster_was_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(display, "_SMALL", 500)
    monkeypatch.setattr(DisplayRaster, "_reduce", lambda self, reduced: None)  # as far as it gets in no time
    values = texture(1024, 1024)
    tiles = RasterTiles({"a": write_image(tmp_path / "a.tif", values, tiled=True, blockxsize=256, blockysize=256)}.get)
    encoded, final = tiles.tile("a", 0, 0, 0)
    assert not final
    assert tiles.facts("a")["ready"] == 0.0
    shown = decoded(encoded)
    assert (shown[..., 3] == 255).all()
    truth = eight_bits(values.reshape(256, 4, 256, 4, 1).mean(axis=(1, 3)), tiles.facts("a")["stretch"])[..., 0]
    assert np.corrcoef(shown[..., 0].ravel(), truth.ravel())[0, 1] > 0.8
    tiles.close()


def test_pixels_without_data_are_transparent_and_do_not_enter_means(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(display, "_SMALL", 500)
    values = np.full((640, 640, 1), 100, np.int16)
    values[:, :320] = -9999
    raster = DisplayRaster(write_image(tmp_path / "a.tif", values, nodata=-9999))
    wait_until_ready(raster)
    found, valid = raster.read(Window(0, 0, 640, 640), 16)
    assert valid is not None
    assert (valid[:, :20] == 0).all()
    assert (valid[:, 20:] == 1).all()
    assert (found[:, 20:] == 100).all()
    raster.close()


def test_a_palette_is_shown_in_its_colours(tmp_path: Path) -> None:
    path = write_image(
        tmp_path / "map.tif", np.repeat(np.arange(4, dtype=np.uint8), 75).reshape(1, 300, 1).repeat(300, axis=0)
    )
    with environment(), opening(), rasterio.open(path, "r+") as file:
        file.write_colormap(1, {0: (255, 0, 0, 255), 1: (0, 255, 0, 255), 2: (0, 0, 255, 255), 3: (9, 9, 9, 255)})
    raster = DisplayRaster(path)
    found, _ = raster.read(Window(0, 0, 300, 300), 1)
    assert found[0, ::75].tolist() == [[255, 0, 0], [0, 255, 0], [0, 0, 255], [9, 9, 9]]
    raster.close()


def test_a_file_that_is_replaced_is_shown_as_it_is_now(tmp_path: Path) -> None:
    path = write_image(tmp_path / "a.tif", np.full((100, 100, 1), 40, np.uint8))
    tiles = RasterTiles({"a": path}.get)
    first = tiles.facts("a")["version"]
    assert decoded(tiles.tile("a", 0, 0, 0)[0])[5, 5, 0] == pytest.approx(40, abs=2)
    write_image(tmp_path / "new.tif", np.full((100, 101, 1), 200, np.uint8)).replace(path)
    assert tiles.facts("a")["version"] != first
    assert decoded(tiles.tile("a", 0, 0, 0)[0])[5, 5, 0] == pytest.approx(200, abs=2)
    path.unlink()
    with pytest.raises(RasterReadError, match="gone"):
        tiles.tile("a", 0, 0, 0)
    tiles.close()


@pytest.mark.parametrize(
    "place", [(0, 0, 0, "b"), (0, 1, 0, "a"), (0, 0, 1, "a"), (1, 0, 0, "a"), (-1, 0, 0, "a"), (9**9, 0, 0, "a")]
)
def test_a_tile_that_there_is_not_is_an_error_in_words(tmp_path: Path, place: tuple[int, int, int, str]) -> None:
    tiles = RasterTiles({"a": write_image(tmp_path / "a.tif", np.zeros((100, 100, 1), np.uint8))}.get)
    *where, layer = place
    with pytest.raises(InputError, match=r"no such layer|has no tile"):
        tiles.tile(layer, *where)
    tiles.close()


def test_a_truncated_file_is_told_and_shows_what_it_has(tmp_path: Path) -> None:
    path = write_image(tmp_path / "a.tif", texture(1024, 1024), tiled=True, blockxsize=256, blockysize=256)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    tiles = RasterTiles({"a": path}.get)
    with pytest.raises(RasterReadError, match="damaged"):
        tiles.tile("a", 2, 3, 3)
    tiles.close()
