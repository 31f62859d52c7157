"""Mosaics by rule against rasterio.merge and NumPy, to the bit; order, base, and many files."""

from __future__ import annotations

import hashlib
import os
import warnings
from pathlib import Path

import mosaic_rig as rig
import numpy as np
import pytest
from rasterio.merge import merge

from geomosaic.errors import InputError
from geomosaic.options.inputs import Area

PLACES = [(0, 0), (350, 45), (150, 215), (160, 100)]
SIZE = (310, 450)


def images(folder: Path, dtype: str = "uint8", bands: int = 3, nodata: float = 0) -> list[Path]:
    """Four images of noise with holes, on one grid that starts at no round number, larger than a block together."""
    rng = np.random.default_rng(5)
    files = []
    for i, (col, row) in enumerate(PLACES):
        values = (rng.uniform(1, 250, (*SIZE, bands)) * (1 if dtype == "uint8" else 17.3)).astype(dtype)
        values[rng.random(SIZE) < 0.1] = nodata
        values[50:90, 100:210] = nodata
        files.append(rig.write(folder / f"{i}.tif", values, col, row, nodata=nodata))
    return files


def stacked(files: list[Path], shape: tuple[int, int]) -> np.ma.MaskedArray:
    """All images on the mosaic's grid (images, rows, cols, bands), masked where they show nothing."""
    layers = []
    for file, (col, row) in zip(files, PLACES, strict=True):
        values, valid = rig.read(file)
        layer = np.ma.masked_all((*shape, values.shape[2]), dtype=np.float64)
        layer[row : row + SIZE[0], col : col + SIZE[1]] = np.ma.array(values, mask=np.repeat(~valid[..., None], 3, 2))
        layers.append(layer)
    return np.ma.stack(layers)


@pytest.mark.parametrize("rule", ["first", "last", "min", "max"])
@pytest.mark.parametrize(("dtype", "nodata"), [("uint8", 0), ("float32", -9999.0)])
def test_a_rule_gives_what_rasterio_gives(tmp_path: Path, rule: str, dtype: str, nodata: float) -> None:
    files = images(tmp_path, dtype, nodata=nodata)
    result = rig.run(files, tmp_path / "out.tif", rule=rule)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # rasterio multiplies transforms
        expected, transform = merge([str(file) for file in files], method=rule, nodata=nodata)
    values, valid = rig.read(tmp_path / "out.tif")
    assert tuple(result.grid.transform) == pytest.approx(tuple(transform), abs=1e-9)
    assert values.shape == expected.transpose(1, 2, 0).shape
    seen = (expected != nodata).all(axis=0)
    assert np.array_equal(valid, seen)
    assert np.array_equal(values[valid], expected.transpose(1, 2, 0)[valid])
    assert result.valid_pixels == seen.sum()
    assert result.lattice_error == 0.0


def test_means_medians_sums_and_counts_are_numpys(tmp_path: Path) -> None:
    files = images(tmp_path)
    out = tmp_path / "out.tif"
    shape = rig.run(files, out, rule="count").grid.shape
    stack = stacked(files, shape)
    expected = {
        "count": stack.count(axis=0)[..., :1],
        "mean": np.floor(stack.mean(axis=0) + 0.5),
        "median": np.floor(np.ma.median(stack, axis=0) + 0.5),
        "sum": stack.sum(axis=0),
    }
    for rule, wanted in expected.items():
        if rule != "count":  # which is there
            rig.run(files, out, rule=rule)
        values, valid = rig.read(out)
        assert np.array_equal(valid, stack.count(axis=0)[..., 0] > 0), rule
        assert np.array_equal(values[valid], np.ma.getdata(wanted)[valid]), rule
        assert values.dtype == {"sum": "uint32", "count": "uint16"}.get(rule, "uint8")


@pytest.mark.parametrize("rule", ["first", "median"])
def test_tiles_and_threads_do_not_matter(tmp_path: Path, rule: str) -> None:
    files = images(tmp_path)
    made = []
    for threads, tile in ((1, 2048), (3, 1024)):
        rig.run(files, tmp_path / "out.tif", rule=rule, threads=threads, tile=tile)
        made.append(hashlib.sha256((tmp_path / "out.tif").read_bytes()).hexdigest())
    assert made[0] == made[1]


def test_seams_copy_pixels_too(tmp_path: Path) -> None:
    """With hard seams every pixel of a mosaic is one that an image holds, however odd its values."""
    files = images(tmp_path, "float32", nodata=-9999.0)
    result = rig.run(files, tmp_path / "out.tif", feather=0)
    values, valid = rig.read(tmp_path / "out.tif")
    stack = np.ma.getdata(stacked(files, result.grid.shape))
    assert (values[None] == stack).all(axis=-1).any(axis=0)[valid].all()
    labels, _ = rig.read(tmp_path / "out-labels.tif")
    assert set(np.unique(labels)) == {0, 1, 2, 3, 4} - ({0} if valid.all() else set())


def test_degrees_keep_their_pixels(tmp_path: Path) -> None:
    """A pixel of a third of an arc second is no round number of degrees."""
    values = np.random.default_rng(1).integers(1, 255, (90, 120, 1)).astype(np.uint8)
    pixel, corner = 1 / 10800, (14.123456789, 49.6)
    files = [
        rig.write(tmp_path / f"{i}.tif", values[:, 50 * i : 50 * i + 70], 50 * i, 0, pixel, "EPSG:4326", corner=corner)
        for i in range(2)
    ]
    result = rig.run(files, tmp_path / "out.tif", rule="first")
    made, valid = rig.read(tmp_path / "out.tif")
    assert valid.all()
    assert np.array_equal(made, values)
    assert tuple(result.grid.transform)[:6] == pytest.approx((pixel, 0, corner[0], 0, -pixel, corner[1]), rel=1e-12)


def test_order_and_base(tmp_path: Path) -> None:
    flat = np.ones((40, 60, 1), dtype=np.uint8)
    stamp = "TIFFTAG_DATETIME"
    files = [
        rig.write(tmp_path / "b.tif", flat * 10, 0, 0, tags={stamp: "2021:05:01 10:00:00"}),
        rig.write(tmp_path / "c.tif", np.kron(flat, np.ones((2, 2, 1), np.uint8)) * 20, 0, 0, 0.5,
                  tags={stamp: "2019:05:01 10:00:00"}),
        rig.write(tmp_path / "a.tif", flat * 30, 0, 0, tags={stamp: "2023:05:01 10:00:00"}),
    ]  # fmt: skip

    def middle(**options: str) -> int:
        rig.run(files, tmp_path / "out.tif", **options)
        return int(rig.read(tmp_path / "out.tif")[0][20, 30, 0])

    assert middle(rule="first") == 10
    assert middle(rule="last") == 30
    assert middle(rule="first", order="name") == 30
    assert middle(rule="first", order="resolution") == 20
    assert middle(rule="first", order="date") == 30
    assert middle(rule="last", order="date") == 20
    assert middle(rule="first", base="b.tif") == 20
    assert middle(rule="last", base="a") == 20
    with pytest.raises(InputError, match=r"no image is called 'd\.tif'"):
        middle(rule="first", base="d.tif")
    rig.write(tmp_path / "b.tif", flat * 10)
    with pytest.raises(InputError, match="does not say when it was taken"):
        middle(rule="first", order="date")


def test_another_crs_and_pixel_size(tmp_path: Path) -> None:
    """An image of the neighbouring zone, coarser by half: where only it shows the ground, it does."""
    ground = rig.scene(200, 200)
    values = ground.astype(np.uint8)
    one = rig.write(tmp_path / "one.tif", values[:, :120])
    from pyproj import Transformer

    to = Transformer.from_crs("EPSG:32633", "EPSG:32632", always_xy=True)
    x, y = to.transform(rig.LEFT, rig.TOP)
    flat = np.full((200, 300, 3), 77, dtype=np.uint8)
    other = rig.write(tmp_path / "other.tif", flat, 0, 0, 1.5, "EPSG:32632", corner=(x, y + 60))
    result = rig.run([one, other], tmp_path / "out.tif", rule="first")
    made, valid = rig.read(tmp_path / "out.tif")
    c, r = (round(v) for v in result.grid.colrow(np.array([[rig.LEFT, rig.TOP]]))[0])
    assert np.array_equal(made[r : r + 200, c : c + 120], values[:, :120])
    assert (made[r + 50 : r + 150, c + 121 : c + 250] == 77).all()
    assert valid[r + 50 : r + 150, c : c + 250].all()


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="no /proc to count open files in")
def test_many_files_are_not_open_at_once(tmp_path: Path) -> None:
    values = np.random.default_rng(2).integers(1, 255, (16, 110 * 8, 1)).astype(np.uint8)
    files = [rig.write(tmp_path / f"{i:03}.tif", values[:, 8 * i : 8 * i + 8], 8 * i) for i in range(110)]
    most = 0

    def count(*_: object) -> None:
        nonlocal most
        most = max(most, len(os.listdir("/proc/self/fd")))  # noqa: PTH208

    from geomosaic.inputs.declarations import Block
    from geomosaic.options.mosaic import MosaicOptions
    from geomosaic.products.mosaics import make_mosaic

    before = len(os.listdir("/proc/self/fd"))  # noqa: PTH208
    options = MosaicOptions.of(threads=1, progress=count, balance=False, stac=False, rule="first")
    make_mosaic(Block(tuple(files), "planar"), Area(), tmp_path / "out.tif", options)
    assert np.array_equal(rig.read(tmp_path / "out.tif")[0], values)
    assert most - before < 90
