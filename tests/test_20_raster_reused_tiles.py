"""A raster that takes tiles of an earlier one has the same bytes as if all had been written."""

from __future__ import annotations

import hashlib
from functools import lru_cache

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

from geomosaic.geo.grid import Grid, Window
from geomosaic.raster.cog.codec import RasterMetadata, Samples
from geomosaic.raster.cog.tiles import EarlierTiles
from geomosaic.raster.sink import RasterSink

WIDTH, HEIGHT = 2100, 1100
LABELS = RasterMetadata(categorical=True)
GRID = Grid(CRS.from_epsg(32633), Affine(1, 0, 0, 0, -1, 0), WIDTH, HEIGHT)
UNIT = 1024


@lru_cache
def picture(bands, dtype, seed=0):
    rng = np.random.default_rng(seed)
    rows, cols = np.mgrid[:HEIGHT, :WIDTH]
    wave = 90 + 60 * np.sin(rows / 150)[..., None] * np.cos(cols / 90)[..., None] + rng.normal(0, 3, bands)
    return (wave + rng.normal(0, 2, (HEIGHT, WIDTH, bands))).astype(dtype)


def write(path, values, valid, earlier=None, kept=(), **options):
    options = {"driver": "COG", **options}
    samples = Samples(values.shape[2], values.dtype.name, options.pop("nodata", None), options.pop("mask", True))
    with RasterSink(path, GRID, samples, overwrite=True, **options) as sink:
        if earlier is not None:
            assert sink.reuse_tiles_of(earlier)
        for window in GRID.window.split(UNIT, 512):
            rows, cols = slice(window.row, window.stop_row), slice(window.col, window.stop_col)
            if window in kept:
                sink.keep(window)
            else:
                sink.write(window, values[rows, cols], None if valid is None else valid[rows, cols])
        sink.finish()
    return hashlib.sha256(path.read_bytes()).hexdigest()


CASES = [
    ({}, "uint8", 3, True),
    pytest.param({"threads": 3}, "uint8", 3, True, marks=pytest.mark.slow),
    ({"threads": 2}, "uint16", 4, False),
    ({"nodata": 7.0}, "uint8", 3, True),
    ({"nodata": float("nan")}, "float32", 2, True),
    ({"nodata": -9999.0, "creation": {"COMPRESS": "ZSTD"}}, "int16", 1, True),
    ({"creation": {"COMPRESS": "NONE"}}, "uint8", 1, True),
    ({"driver": "GTiff", "creation": {"COMPRESS": "LZW", "BIGTIFF": "YES"}}, "uint8", 3, True),
    ({"metadata": LABELS, "nodata": 0.0}, "uint8", 1, True),
]


@pytest.mark.parametrize(("options", "dtype", "bands", "holes"), CASES)
def test_kept_and_written_are_the_same(tmp_path, options, dtype, bands, holes):
    before = picture(bands, dtype)
    valid = None
    if holes:
        valid = np.ones((HEIGHT, WIDTH), dtype=np.uint8)
        valid[300:700, 900:1500] = 0  # part of several tiles, and of some all
        valid[512:1024, 1024:1536] = 0
    write(tmp_path / "old.tif", before, valid, **options)
    changed = {Window(1024, 512, 1024, 512)}
    after, seen = before.copy(), None if valid is None else valid.copy()
    after[600:650, 1500:1540] += 40
    if seen is not None:
        seen[800:900, 1600:1700] = 0
    kept = set(GRID.window.split(UNIT, 512)) - changed
    assert len(kept) == 8
    whole = write(tmp_path / "whole.tif", after, seen, **options)
    earlier = tmp_path / "old.tif"
    assert write(tmp_path / "some.tif", after, seen, earlier, kept, **options) == whole
    assert write(tmp_path / "all.tif", before, valid, earlier, set(GRID.window.split(UNIT, 512)), **options)
    assert (tmp_path / "all.tif").read_bytes() == (tmp_path / "old.tif").read_bytes()
    assert (tmp_path / "some.tif").read_bytes() != (tmp_path / "old.tif").read_bytes()


@pytest.mark.parametrize(("old_holes", "new_holes"), [(True, False), (False, True)])
def test_a_mask_comes_and_goes_with_the_pixels(tmp_path, old_holes, new_holes):
    values = picture(3, "uint8")
    holes, none = np.ones((HEIGHT, WIDTH), dtype=np.uint8), None
    holes[100:140, 100:140] = 0
    first = next(iter(GRID.window.split(UNIT, 512)))
    write(tmp_path / "old.tif", values, holes if old_holes else none)
    whole = write(tmp_path / "whole.tif", values, holes if new_holes else none)
    kept = set(GRID.window.split(UNIT, 512)) - {first}
    assert write(tmp_path / "some.tif", values, holes if new_holes else none, tmp_path / "old.tif", kept) == whole
    # In its own place, too.
    assert write(tmp_path / "old.tif", values, holes if new_holes else none, tmp_path / "old.tif", kept) == whole


def test_a_file_of_another_form_is_not_taken(tmp_path):
    values = picture(1, "uint8")
    write(tmp_path / "old.tif", values, None)
    for options in ({"creation": {"COMPRESS": "ZSTD"}}, {"creation": {"PREDICTOR": "NO"}}, {"driver": "GTiff"}):
        with RasterSink(tmp_path / "new.tif", GRID, Samples(1, "uint8"), **options) as sink:
            assert not sink.reuse_tiles_of(tmp_path / "old.tif")
    with RasterSink(tmp_path / "new.tif", GRID, Samples(2, "uint8")) as sink:
        assert not sink.reuse_tiles_of(tmp_path / "old.tif")
        assert not sink.reuse_tiles_of(tmp_path / "nothing.tif")
    (tmp_path / "text.tif").write_text("II*\0 and nothing else")
    with pytest.raises(ValueError, match="no file of tiles"):
        EarlierTiles(tmp_path / "text.tif")
