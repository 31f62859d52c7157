"""Single pixels picked out of an image are those of the whole image, and so is what is known of them."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st

from geomosaic.geo.grid import Window
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


@given(
    shape=st.tuples(st.integers(1, 9), st.integers(1, 9), st.integers(1, 5)), one=st.sampled_from([0, 1, 3]),
    kind=st.sampled_from(["uint8", "uint16"]), seed=st.integers(0, 99), values=st.integers(1, 4),
)  # fmt: skip
def test_missing_where_every_band_has_the_value(shape, one, kind, seed, values):
    """Against the definition."""
    pixels = np.random.default_rng(seed).integers(0, values, shape).astype(kind)
    expected = (pixels == one).all(axis=2)
    found = missing_by_value(pixels, (float(one),) * shape[2])
    np.testing.assert_array_equal(np.zeros(shape[:2], dtype=bool) if found is None else found, expected)
