"""Tiles that show nothing cost nothing, and the file has the bytes it would have without the short cut."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

from geomosaic.geo.grid import Grid, Window
from geomosaic.raster.cog import codec
from geomosaic.raster.cog.codec import RasterMetadata, Samples
from geomosaic.raster.cog.overviews import Tile, levels
from geomosaic.raster.cog.tiles import TileMaker
from geomosaic.raster.sink import RasterSink
from geomosaic.raster.source import Source

WIDTH, HEIGHT = 2600, 1500
LABELS = RasterMetadata(categorical=True)
GRID = Grid(CRS.from_epsg(32633), Affine(1, 0, 0, 0, -1, 0), WIDTH, HEIGHT)


def scene(dtype, bands):
    """Two pictures far apart, one small and one that crosses tiles, and nothing between them."""
    rng = np.random.default_rng(5)
    valid, values = np.zeros((HEIGHT, WIDTH), dtype=np.uint8), np.zeros((HEIGHT, WIDTH, bands), dtype=dtype)
    for place in (np.s_[30:200, 40:170], np.s_[900:1100, 2200:2590]):
        valid[place] = 1
        values[place] = rng.integers(1, 250, values[place].shape)
    return values, valid


def write(path, values, valid, *, leave=True, kept_from=None, **options):
    """Digest of the file; windows without a valid pixel are left where that is wanted."""
    samples = Samples(values.shape[2], values.dtype.name, options.pop("nodata", None), options.pop("mask", True))
    with RasterSink(path, GRID, samples, **{"driver": "COG", **options}) as sink:
        assert kept_from is None or sink.reuse_tiles_of(kept_from)
        for window in GRID.window.split(2048, 512):
            here = slice(window.row, window.stop_row), slice(window.col, window.stop_col)
            if kept_from is not None and window.col == 0:
                sink.keep(window)
            elif leave and not valid[here].any():
                sink.add(sink.empty(window))
            else:
                sink.write(window, values[here], valid[here])
        sink.finish()
    return hashlib.sha256(path.read_bytes()).hexdigest()


CASES = [
    ({}, "uint8", 3),
    ({"threads": 3}, "uint8", 3),
    ({"nodata": 7.0}, "uint16", 3),
    ({"nodata": float("nan"), "threads": 2}, "float32", 2),
    ({"nodata": -9999.0, "creation": {"COMPRESS": "ZSTD"}}, "int16", 1),
    ({"creation": {"COMPRESS": "NONE"}, "threads": 2}, "uint8", 3),
    ({"creation": {"COMPRESS": "NONE"}, "nodata": 9.0}, "uint8", 1),
    ({"driver": "GTiff", "creation": {"COMPRESS": "LZW"}}, "uint8", 3),
    ({"metadata": LABELS, "nodata": 0.0}, "uint8", 1),
    ({"metadata": LABELS, "nodata": 3.0}, "uint8", 1),
    ({"mask": False}, "uint8", 3),
]


@pytest.mark.parametrize(("options", "dtype", "bands"), CASES)
def test_the_bytes_are_those_of_tiles_that_went_the_whole_way(tmp_path, monkeypatch, options, dtype, bands):
    values, valid = scene(dtype, bands)
    left = write(tmp_path / "left.tif", values, valid, **options)
    written = write(tmp_path / "written.tif", values, valid, leave=False, **options)
    again = left
    if options.get("mask", True):  # without, a file does not tell what its overviews are the means of
        again = write(tmp_path / "again.tif", values, valid, kept_from=tmp_path / "left.tif", **options)

    def the_whole_way(self, level, index):
        zeros = np.zeros((codec.BLOCK, codec.BLOCK), dtype=np.uint8)
        return self.pieces(Tile(level, index, np.zeros((*zeros.shape, bands), dtype=dtype), zeros), False)

    monkeypatch.setattr(TileMaker, "nothing", the_whole_way)
    assert write(tmp_path / "whole.tif", values, valid, leave=False, **options) == left == written == again
    with Source(tmp_path / "left.tif") as source:
        found, seen = source.read(GRID.window)
    np.testing.assert_array_equal(found[valid > 0], np.where(values == options.get("nodata"), found, values)[valid > 0])
    if options.get("mask", True):
        np.testing.assert_array_equal(seen, valid)


def test_what_shows_nothing_is_compressed_once(tmp_path, monkeypatch):
    values, valid = scene("uint8", 3)
    calls = []
    encode = codec.encode_tile
    monkeypatch.setattr(codec, "encode_tile", lambda *a, **k: calls.append(1) or encode(*a, **k))
    write(tmp_path / "left.tif", values, valid)
    tiles = sum(level.across * level.down for level in levels(WIDTH, HEIGHT))
    assert tiles == 6 * 3 + 3 * 2 + 2 + 1
    # Level by level what the small and the large picture touch, and once what shows nothing.
    assert len(calls) == (1 + 2 * 2) + (1 + 2) + (1 + 1) + 1 + 1


def test_windows_that_are_left_must_fit_too(tmp_path):
    with RasterSink(tmp_path / "out.tif", GRID, Samples(1, "uint8")) as sink:
        for window in (Window(3, 0, 512, 512), Window(0, 0, 500, 512), Window(0, 0, 512, 4096)):
            with pytest.raises(ValueError, match="block of 512"):
                sink.empty(window)
