"""Rasters that tests write: a picture with some noise, holes in it, and where it lies."""

from __future__ import annotations

import hashlib

import numpy as np
from affine import Affine
from pyproj import CRS

from geomosaic.geo.grid import Grid, Window
from geomosaic.raster.cog.codec import Samples
from geomosaic.raster.sink import RasterSink

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


def grid_of(rows, cols):
    return Grid(UTM, NORTH_UP, cols, rows)


def write_raster(path, values, valid=None, width=1024, height=512, **options):
    rows, cols, bands = values.shape
    samples = Samples(bands, values.dtype.name, options.pop("nodata", None), options.pop("mask", True))
    with RasterSink(path, grid_of(rows, cols), samples, **options) as sink:
        for window in Window(0, 0, cols, rows).split(width, height):
            part = np.s_[window.row : window.stop_row, window.col : window.stop_col]
            sink.write(window, values[part], None if valid is None else valid[part])
        return sink.finish()


def digest(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


def whole(info) -> Window:
    return Window(0, 0, info.width, info.height)
