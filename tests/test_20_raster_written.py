"""Rasters written: what stands in the file, which options there are, and what happens when it goes wrong."""

from __future__ import annotations

import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import rasterio
from raster_rig import NORTH_UP, digest, grid_of, holes, picture, whole, write_raster

from geomosaic.errors import InputError, OutputError, OutputExistsError
from geomosaic.geo.grid import Window
from geomosaic.raster.cog import codec, tiff
from geomosaic.raster.cog.codec import RasterMetadata, Samples
from geomosaic.raster.cog.overviews import halve
from geomosaic.raster.creation_options import METHODS
from geomosaic.raster.sink import RasterSink
from geomosaic.raster.source import Source, inspect


@pytest.mark.parametrize("driver", ["GTiff", "COG"])
@pytest.mark.parametrize("compress", ["NONE", "DEFLATE", pytest.param("ZSTD", marks=pytest.mark.slow)])
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
        metadata=RasterMetadata([f"band {i}" for i in range(bands)], tags={"GEOMOSAIC_TEST": "é <&>"}),
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


def test_jpeg_compression_is_close_to_the_pixels(tmp_path):
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


@pytest.mark.parametrize("dtype", ["uint8", "int8", "uint16", "int16", "int32", "float32"])
@pytest.mark.parametrize("masked", [False, True])
def test_halving_takes_the_mean_of_the_valid_pixels_rounded_to_even(dtype, masked):
    rng, whole = np.random.default_rng(5), np.dtype(dtype).kind != "f"
    low, high = (np.iinfo(dtype).min, np.iinfo(dtype).max) if whole else (-1000, 1000)
    # Few values, so that ties are many, and those at the ends of the range.
    pick = np.array([low, low + 1, 0, 1, 2, 3, high - 1, high], dtype=dtype)
    values = rng.choice(pick, (64, 96, 3))
    valid = rng.integers(0, 2, (64, 96)).astype(np.uint8)
    half, seen = halve(values, valid if masked else None, "average")
    assert half.dtype == values.dtype
    assert (seen is not None) == masked
    for row, col in np.ndindex(32, 48):
        four = np.s_[2 * row : 2 * row + 2, 2 * col : 2 * col + 2]
        known = valid[four] > 0 if masked else np.ones((2, 2), dtype=bool)
        assert seen is None or seen[row, col] == known.any()
        for band in range(3):
            one = [Fraction(float(value)) for value in values[four][..., band][known]]
            if one:
                mean = sum(one) / len(one)
                assert half[row, col, band] == (round(mean) if whole else np.float32(float(mean)))


@pytest.mark.parametrize("dtype", ["uint8", "int16", "uint16", "float32"])
@pytest.mark.parametrize("bands", [1, 3])
@pytest.mark.parametrize(
    "options",
    [
        {"COMPRESS": "DEFLATE", "ZLEVEL": "1", "PREDICTOR": "2"},
        {"COMPRESS": "DEFLATE", "ZLEVEL": "6", "PREDICTOR": "1"},
        {"COMPRESS": "ZSTD", "ZSTD_LEVEL": "1", "PREDICTOR": "2"},
        {"COMPRESS": "LZW", "PREDICTOR": "2"},
    ],
)
def test_a_tile_has_the_bytes_that_gdal_gives_it(tmp_path, dtype, bands, options):
    rng, side = np.random.default_rng(6), codec.BLOCK
    steps = rng.integers(-3, 4, (side, side, bands)).cumsum(axis=1) + 1000
    values = (steps % 200 if dtype == "uint8" else steps).astype(dtype)
    profile = codec.tile_profile(bands, dtype, options)
    path = tmp_path / "one.tif"
    with rasterio.open(path, "w", crs="EPSG:32631", transform=NORTH_UP, **profile) as file:
        file.write(np.moveaxis(values, -1, 0))
    with path.open("rb") as file:
        directory = tiff.read_directories(file)[0]
    (offset,), (count,) = (directory[tag].integers for tag in (tiff.TILE_OFFSETS, tiff.TILE_COUNTS))
    assert codec.encode_tile(values, profile) == path.read_bytes()[offset : offset + count]


def test_label_overviews_hold_labels_only(tmp_path):
    labels = np.random.default_rng(0).integers(1, 4, (700, 900, 1)).astype(np.uint16) * 100
    path = write_raster(tmp_path / "o.tif", labels, nodata=0, metadata=RasterMetadata(categorical=True))
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
            RasterSink(tmp_path / "o.tif", grid, Samples(1, dtype, nodata=nodata))
    for options in ({"TILED": "NO"}, {"BLOCKXSIZE": "256"}, {"INTERLEAVE": "BAND"}, {"COMRPESS": "LZW"}):
        with pytest.raises(InputError, match=next(iter(options))):
            RasterSink(tmp_path / "o.tif", grid, Samples(1, "uint8"), creation=options)
    with pytest.raises(InputError, match="COG or GTiff"):
        RasterSink(tmp_path / "o.tif", grid, Samples(1, "uint8"), driver="PNG")
    with pytest.raises(InputError, match="folder"):
        RasterSink(tmp_path / "none" / "o.tif", grid, Samples(1, "uint8"))
    with pytest.raises(InputError, match="WEBP"):
        RasterSink(tmp_path / "o.tif", grid, Samples(1, "float32"), creation={"COMPRESS": "WEBP"})
    assert not list(tmp_path.iterdir())


def test_existing_outputs_are_kept_unless_overwritten(tmp_path):
    path = tmp_path / "o.tif"
    path.write_bytes(b"precious")
    (tmp_path / "o.tif.aux.xml").write_text("<stale/>")
    with pytest.raises(OutputExistsError, match="`overwrite`"):
        RasterSink(path, grid_of(10, 10), Samples(1, "uint8"))
    values = picture(600, 600)

    def fails():
        with RasterSink(path, grid_of(600, 600), Samples(3, "uint8"), overwrite=True, threads=2) as sink:
            sink.write(Window(0, 0, 600, 512), values[:512])
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        fails()
    assert path.read_bytes() == b"precious"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["o.tif", "o.tif.aux.xml"]
    write_raster(path, values, overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["o.tif"]


def test_windows_must_fit_blocks_and_be_all_there(tmp_path):
    with RasterSink(tmp_path / "o.tif", grid_of(600, 600), Samples(1, "uint8")) as sink:
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
from geomosaic.raster.cog.codec import Samples
from geomosaic.raster.sink import RasterSink

path, driver, compress, limit, threads = sys.argv[1], sys.argv[2], sys.argv[3], int(sys.argv[4]), int(sys.argv[5])
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
values = np.random.default_rng(0).integers(0, 255, (512, 1500, 3)).astype(np.uint8)
grid, samples = Grid(CRS.from_epsg(32633), Affine(1, 0, 0, 0, -1, 0), 1500, 1500), Samples(3, "uint8")
with RasterSink(path, grid, samples, driver=driver, creation={"COMPRESS": compress}, threads=threads) as warm:
    pass
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
try:
    with RasterSink(path, grid, samples, driver=driver, creation={"COMPRESS": compress}, threads=threads) as sink:
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
        ("GTiff", "NONE", 0.02), ("GTiff", "DEFLATE", 0.99999), ("COG", "NONE", 0.5), ("COG", "DEFLATE", 0.8),
        ("COG", "DEFLATE", 0.99999),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (("GTiff", "NONE", 0.99999), ("GTiff", "DEFLATE", 0.5), ("COG", "DEFLATE", 0.02))
        ),
    ],
)  # fmt: skip
def test_a_full_disk_leaves_no_file_behind(tmp_path, driver, compress, share):
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

    def refused(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refused)
    with pytest.raises(OutputError, match="Permission denied") as caught:
        RasterSink(tmp_path / "o.tif", grid_of(100, 100), Samples(3, "uint8"))
    assert "rights" in str(caught.value.hint)
    assert "space" not in str(caught.value.hint)


def test_full_disk_is_foreseen(tmp_path, monkeypatch):
    from geomosaic.raster import sink as sink_module

    usage = type("Usage", (), {"free": 1_000_000})
    monkeypatch.setattr(sink_module.shutil, "disk_usage", lambda path: usage)
    with pytest.raises(OutputError, match=r"needs 3.0 MB, 1.0 MB are free"):
        RasterSink(tmp_path / "o.tif", grid_of(1000, 1000), Samples(3, "uint8"), creation={"COMPRESS": "NONE"})
    with RasterSink(tmp_path / "o.tif", grid_of(1000, 1000), Samples(3, "uint8")):
        pass
    assert not list(tmp_path.iterdir())


# --- options -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("creation", "bands", "dtype", "hint"),
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
def test_values_that_gdal_would_ignore_are_refused(tmp_path, creation, bands, dtype, hint):
    name, value = next(iter(creation.items()))
    with pytest.raises(InputError, match=f"creation={name}={value}` is not possible") as caught:
        RasterSink(tmp_path / "a.tif", grid_of(10, 10), Samples(bands, dtype), creation=creation)
    assert hint in str(caught.value.hint)
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
