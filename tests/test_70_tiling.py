"""Mosaics in many files: tiles that are windows of the single mosaic, to the bit, and what joins them."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pystac
import pytest
import rasterio
from cli_rig import PHOTOS
from pyproj import CRS
from rasterio.windows import from_bounds

import geomosaic as gm
from geomosaic.errors import GeomosaicWarning, InputError, OutputExistsError
from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.outputs import MosaicFiles
from geomosaic.options.mosaic import MosaicOptions, TileSize
from geomosaic.options.render import RenderOptions

SAMPLE = Path(__file__).parents[1] / "data" / "sample"
FILES = {"camera": SAMPLE / "camera.toml", "exterior": SAMPLE / "exterior.csv", "crs": "EPSG:32633", "heights": "egm96"}
BLOCK = gm.Block([SAMPLE / "photos" / name for name in PHOTOS[::2]], "frame", dem=SAMPLE / "dem.tif", **FILES)
# Wider than what the photos show: a column of tiles stays empty.
PLACE = {"resolution": 0.8, "bounds": (399700.0, 5499900.0, 401700.0, 5500760.0)}


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> tuple[gm.mosaic, gm.mosaic]:
    """One file, and tiles of 1024 pixels."""
    folder = tmp_path_factory.mktemp("tiling")
    return (
        gm.mosaic(BLOCK, folder / "one.tif", **PLACE),
        gm.mosaic(BLOCK, folder / "grid.vrt", **PLACE, tiling="800m"),
    )


def bands_and_mask(path: Path, window=None) -> np.ndarray:
    with rasterio.open(path) as dataset:
        return np.concatenate([dataset.read(window=window), dataset.dataset_mask(window=window)[None]])


def test_tiles_are_windows_of_the_single_mosaic_to_the_bit(made) -> None:
    one, tiled = made
    assert len(tiled.tiles) == 4  # of six
    assert (tiled.pixels, tiled.valid_pixels) == (one.pixels, one.valid_pixels)
    for path in tiled.tiles:
        with rasterio.open(path) as tile, rasterio.open(one.path) as whole:
            window = from_bounds(*tile.bounds, whole.transform).round_offsets().round_lengths()
            assert tile.profile["tiled"]
            assert (window.width, window.height) == (tile.width, tile.height)
        assert (bands_and_mask(path) == bands_and_mask(one.path, window)).all()
        labels = path.with_name(f"{path.stem}-labels.tif")
        assert (bands_and_mask(labels) == bands_and_mask(one.labels, window)).all()


def test_virtual_raster_and_tile_index_show_the_single_mosaic(made) -> None:
    one, tiled = made
    whole = bands_and_mask(one.path)
    assert (bands_and_mask(tiled.path) == whole).all()
    assert (bands_and_mask(tiled.labels) == bands_and_mask(one.labels)).all()
    assert (tiled.read() == one.read()).all()
    with rasterio.open(tiled.path) as virtual, rasterio.open(one.path) as single:
        assert (virtual.transform, virtual.crs, virtual.colorinterp) == (
            single.transform, single.crs, single.colorinterp,
        )  # fmt: skip
    with rasterio.open(tiled.path.with_name("grid.gti.gpkg")) as index:
        # The index ends where its tiles do.
        with rasterio.open(one.path) as single:
            window = from_bounds(*index.bounds, single.transform).round_offsets().round_lengths()
        assert (index.read() == bands_and_mask(one.path, window)[:-1]).all()


def test_the_whole_has_an_overview_of_its_own_as_its_tiles_have(made) -> None:
    """A program that shows all of it opens one small file; its pixels are those of the tiles' overviews."""
    _, tiled = made
    for path, name in ((tiled.path, "grid"), (tiled.labels, "grid-labels")):
        small = tiled.path.parent / "grid-tiles" / f"{name}-overview.tif"
        with rasterio.open(path) as virtual, rasterio.open(small) as overview:
            assert virtual.overviews(1)[0] == 2
            shape = (overview.height, overview.width)
            assert shape == (-(-virtual.height // 2), -(-virtual.width // 2))
            bands = virtual.count
            shown = virtual.read(out_shape=(bands, *shape))
            assert (shown == overview.read(list(range(1, bands + 1)))).all()
            assert ((virtual.dataset_mask(out_shape=shape) > 0) == (overview.dataset_mask() > 0)).all()
        for tile in tiled.tiles:
            tile = tile if name == "grid" else tile.with_name(f"{tile.stem}-labels.tif")
            with rasterio.open(tile, overview_level=0) as one, rasterio.open(small) as overview:
                place = from_bounds(*one.bounds, overview.transform).round_offsets().round_lengths()
                part = overview.read(list(range(1, bands + 1)), window=place)
                assert (part == one.read()[:, : part.shape[1], : part.shape[2]]).all()
                assert 0 < (overview.dataset_mask(window=place) > 0).mean() <= 1


def test_the_collection_names_each_tile_with_its_checksum(made) -> None:
    _, tiled = made
    collection = pystac.Collection.from_file(str(tiled.item))
    collection.stac_extensions = []  # their schemas are on the net
    assert collection.validate()
    items = list(collection.get_items())
    assert len(items) == len(tiled.tiles)
    for item in items:
        assert item.properties["proj:code"] == "EPSG:32633"
        assert item.get_collection().id == "grid"
        item.stac_extensions = []
        assert item.validate()
        assert Path(item.assets["mosaic"].get_absolute_href()).is_file()
    assert {"mosaic", "index", "labels", "seams"} <= set(collection.assets)


def test_an_empty_tile_has_no_file_and_a_rerun_with_larger_tiles_leaves_none_of_the_smaller(tmp_path) -> None:
    output = tmp_path / "grid.vrt"
    place = {"resolution": 1.0, "bounds": (399500.0, 5499900.0, 401700.0, 5500200.0), "vectors": False}
    first = gm.mosaic(BLOCK, output, **place, tiling="1024px")
    folder = tmp_path / "grid-tiles"
    beside = {folder / "grid-overview.tif", folder / "grid-labels-overview.tif"}
    assert {*folder.glob("[!.]*")} - beside == {
        path for tile in first.tiles for path in (tile, tile.with_name(f"{tile.stem}-labels.tif"))
    }
    with pytest.raises(OutputExistsError, match="exists"):
        gm.mosaic(BLOCK, output, **place, tiling="2048px")
    second = gm.mosaic(BLOCK, output, **place, tiling="2048px", overwrite=True)
    assert len(second.tiles) == 1 < len(first.tiles)
    assert len({*folder.glob("[!.]*")} - beside) == 2


@pytest.mark.parametrize("text", ["0px", "0km", "10", "-3km", "10 miles", "", "nanpx"])
def test_sizes_that_are_none_are_refused(text) -> None:
    with pytest.raises(InputError, match="is not a size of tiles") as caught:
        MosaicOptions.of(tiling=text)
    assert caught.value.where == "`tiling`"


@pytest.mark.parametrize(("text", "said"), [("1px", "1024 x 1024"), ("1500px", "1024 x 1024"), ("10m", "1024 x 1024")])
def test_a_size_that_is_no_multiple_of_a_block_is_told(text, said) -> None:
    grid = Grid.from_bounds(CRS("EPSG:32633"), (399500.0, 5499900.0, 401700.0, 5500200.0), 1.0)
    files = MosaicFiles.of(Path("grid.vrt"), MosaicOptions.of(tiling=text), grid)
    with pytest.warns(GeomosaicWarning, match=f"tiles have {said} pixels: their sides are multiples of 1024"):
        files.rasters(grid, TileSize.parse(text))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for silent in ("2048px", "1km", "1.2km"):
            files.rasters(grid, TileSize.parse(silent))


def test_sizes_and_names() -> None:
    with pytest.raises(InputError, match="0 is out of range"):
        RenderOptions(tile=0)
    assert MosaicOptions.of(tiling="10km").records.tiling == TileSize(10000.0, "m")
    assert MosaicOptions.of(tiling="16384px").records.tiling == TileSize(16384.0, "px")
    with pytest.raises(InputError, match="virtual raster") as caught:
        gm.mosaic(BLOCK, "grid.tif", **PLACE, tiling="1024px")
    assert "grid.vrt" in str(caught.value.hint)
    assert json.dumps(caught.value.where) == '"grid.tif"'


@pytest.mark.parametrize(
    "creation",
    [
        {"COMPRESS": "JPEG", "QUALITY": "80"},
        pytest.param({"COMPRESS": "WEBP"}, marks=pytest.mark.slow),
        pytest.param({"COMPRESS": "ZSTD"}, marks=pytest.mark.slow),
        pytest.param({"COMPRESS": "NONE"}, marks=pytest.mark.slow),
    ],
)
def test_tiles_of_any_compression_are_valid_and_have_the_pixels_of_the_single_file(creation, tmp_path) -> None:
    from rio_cogeo import cog_validate

    place = {**PLACE, "bounds": (399700.0, 5500300.0, 400720.0, 5500500.0), "vectors": False, "creation": creation}
    one = gm.mosaic(BLOCK, tmp_path / "one.tif", **place)
    tiled = gm.mosaic(BLOCK, tmp_path / "grid.vrt", **place, tiling="1024px")
    for path in tiled.tiles:
        for file in (path, path.with_name(f"{path.stem}-labels.tif")):
            assert cog_validate(file, strict=True, quiet=True) == (True, [], [])
    with rasterio.open(tiled.tiles[0]) as tile:
        compression = "none" if tile.compression is None else tile.compression.name.lower()
        assert compression == creation["COMPRESS"].lower()
    whole, joined = bands_and_mask(one.path), bands_and_mask(tiled.path)
    seen = whole[-1] > 0
    assert 0.0 < seen.mean() < 1.0
    assert (joined[-1] == whole[-1]).all()
    assert (joined[:, seen] == whole[:, seen]).all()  # what a codec leaves below the mask is its own affair
