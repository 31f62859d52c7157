"""Single pixels picked out of an image are those of the whole image, and so is what is known of them."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st

from geomosaic.geo.grid import Window
from geomosaic.raster.cog.tiles import filled
from geomosaic.raster.source import Source
from geomosaic.raster.validity import missing_by_value

ROWS, COLS = 211, 333


@pytest.fixture(scope="module")
def image(tmp_path_factory):
    """An image whose every pixel is another, with corners of nodata."""
    values = np.arange(ROWS * COLS * 2, dtype=np.uint32).reshape(2, ROWS, COLS).astype(np.uint16) + 1
    values[:, :60, :50] = 0
    values[0, 100:150, 100:150] = 0  # one band alone is no nodata
    path = tmp_path_factory.mktemp("picked") / "i.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=COLS, height=ROWS, count=2, dtype="uint16", nodata=0, tiled=True,
        blockxsize=64, blockysize=64, interleave="pixel", transform=Affine(1.0, 0.0, 0.0, 0.0, -1.0, 0.0),
    ) as dataset:  # fmt: skip
        dataset.write(values)
    with Source(path) as source:
        assert source.decimates
        yield source


@given(step=st.integers(2, 70), col=st.integers(0, COLS - 1), row=st.integers(0, ROWS - 1), less=st.booleans())
def test_decimated_pixels_are_those_of_the_whole(image, step, col, row, less):
    count = -(-(COLS - col) // step), -(-(ROWS - row) // step)
    count = tuple(max(1, n - less) for n in count)
    whole, valid = image.read(Window(0, 0, COLS, ROWS))
    here = slice(row, row + step * count[1], step), slice(col, col + step * count[0], step)
    values, seen = image.read_decimated((col, row), count, step)
    np.testing.assert_array_equal(values, whole[here])
    np.testing.assert_array_equal(np.ones(values.shape[:2]) if seen is None else seen, valid[here])


SHAPES = st.tuples(st.integers(1, 9), st.integers(1, 9), st.sampled_from([1, 2, 3, 4, 5, 8, 13]))
KINDS = st.sampled_from(["uint8", "uint16", "uint32", "int16", "float32"])


def pixels_of(shape, kind, seed, values, planar):
    """Few different values, NaN among those of floats; pixel by pixel in memory, or band by band."""
    rng = np.random.default_rng(seed)
    pixels = rng.integers(0, values, shape).astype(kind)
    if kind == "float32":
        pixels[rng.random(shape) < 0.1] = np.nan
    return np.moveaxis(np.ascontiguousarray(np.moveaxis(pixels, -1, 0)), 0, -1) if planar else pixels


@given(
    shape=SHAPES, one=st.sampled_from([0, 1, 3]), kind=KINDS, seed=st.integers(0, 99), values=st.integers(1, 4),
    planar=st.booleans(), bare=st.booleans(),
)  # fmt: skip
def test_unsigned_pixels_are_missing_where_every_band_says_so_and_others_where_any_does(
    shape, one, kind, seed, values, planar, bare
):
    pixels = pixels_of(shape, kind, seed, values, planar)
    nodata = [float(one)] * shape[2]
    if bare:  # a band without nodata
        nodata[-1] = None
    marked = [pixels[..., band] == value for band, value in enumerate(nodata) if value is not None]
    marked += [np.zeros(shape[:2], dtype=bool)] * bare
    expected = (np.logical_and if kind.startswith("u") else np.logical_or).reduce(marked)
    expected |= np.isnan(pixels).any(axis=2)
    found = missing_by_value(pixels, nodata)
    np.testing.assert_array_equal(np.zeros(shape[:2], dtype=bool) if found is None else found, expected)


@given(
    shape=SHAPES, nodata=st.sampled_from([None, 0, 1, 255]), kind=KINDS, seed=st.integers(0, 99),
    values=st.integers(1, 4), planar=st.booleans(), masked=st.booleans(),
)  # fmt: skip
def test_what_is_written_as_valid_is_read_as_valid(shape, nodata, kind, seed, values, planar, masked):
    pixels = np.nan_to_num(pixels_of(shape, kind, seed, values, planar))
    valid = np.random.default_rng(seed).integers(0, 2, shape[:2], dtype=np.uint8) if masked else None
    seen = np.ones(shape[:2], dtype=bool) if valid is None else valid > 0
    out = filled(pixels, valid, nodata)
    assert out.dtype == pixels.dtype
    assert (out[~seen] == (nodata or 0)).all()
    missing = missing_by_value(out, (nodata,) * shape[2])
    if nodata is not None:
        np.testing.assert_array_equal(seen, ~missing if missing is not None else np.ones_like(seen))
    kept = out[seen] == pixels[seen]
    near = np.abs(out[seen].astype(float) - pixels[seen].astype(float)) <= 1
    assert (kept | (near & (pixels[seen] == nodata))).all()
