"""A raster of the whole globe on maps of many kinds, without --bounds: what is shown, where it ends, and how well."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS, Transformer

from geomosaic.cli.main import run
from geomosaic.geo.projection_domain import domain, limits

STEP = 0.5


@pytest.fixture(scope="module")
def globe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sine and cosine of longitude, and latitude, at the middle of pixels of half a degree."""
    path = tmp_path_factory.mktemp("globe") / "globe.tif"
    lon, lat = np.meshgrid(np.arange(-180, 180, STEP) + STEP / 2, 90 - STEP / 2 - np.arange(0, 180, STEP))
    bands = np.stack([np.sin(np.radians(lon)), np.cos(np.radians(lon)), lat]).astype(np.float32)
    with rasterio.open(
        path, "w", driver="GTiff", width=720, height=360, count=3, dtype="float32", crs="EPSG:4326",
        transform=Affine(STEP, 0, -180, 0, -STEP, 90),
    ) as out:  # fmt: skip
        out.write(bands)
    return path


MAPS = {
    "EPSG:3857": ((-20037508, -20048966, 20037508, 20048966), 0.0),
    "EPSG:4087": ((-20037508, -10018754, 20037508, 10018754), 0.0),
    "EPSG:3832": ((-20037508, -20048966, 20037508, 20048966), 0.003),  # the seam of the raster lies within
    "EPSG:3031": ((-45.87e6, -45.87e6, 45.87e6, 45.87e6), 0.003),
    "ESRI:54030": ((-17005833, -8625155, 17005833, 8625155), 0.010),
    "EPSG:8857": ((-17243959, -8392928, 17243959, 8392928), 0.010),
    "ESRI:54009": ((-18040096, -9020048, 18040096, 9020048), 0.012),
    "EPSG:3035": ((-8.42e6, -9.53e6, 17.07e6, 15.95e6), 0.012),
}


# Cut by the seam, seen from a pole, folding rim.
SHARE = ("EPSG:3832", "EPSG:3031", "EPSG:8857")


@pytest.mark.parametrize(
    "code", [code if code in SHARE else pytest.param(code, marks=pytest.mark.slow) for code in MAPS]
)
def test_the_whole_globe(code: str, globe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The output reaches from end to end of the map, shows each place once, and each where PROJ says."""
    bounds, lost = MAPS[code]
    size = 200_000 if code == "EPSG:3031" else 40_000  # a polar map of the globe is more than twice as wide
    out = tmp_path / "out.tif"
    assert run(["reproject", str(globe), "--dst-crs", code, "--res", str(size), "-o", str(out), "--json"]) == 0
    json.loads(capsys.readouterr().out)
    with rasterio.open(out) as file:
        values, seen, crs = file.read(), file.read_masks(1) > 0, file.crs
        assert np.abs(np.array(file.bounds) - bounds).max() < 2.75 * size
        row, col = np.mgrid[0 : file.height, 0 : file.width]
        x, y = file.transform @ (col + 0.5, row + 0.5)
    there = Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    lon, lat = there.transform(x, y)
    with np.errstate(invalid="ignore"):
        again = np.array(there.transform(lon, lat, direction="INVERSE"))
        exists = np.isfinite(lon) & (np.hypot(*(again - (x, y))) < 10.0)
        sides = np.abs(lon) > 180.0 - STEP  # the raster's own seam, where nothing lies beyond
    assert not (seen & ~exists & (np.abs(x) < bounds[2])).any()
    assert (exists & ~seen).sum() <= lost * exists.sum()
    sure = seen & exists & ~sides & (np.abs(lat) < 89.0)
    assert sure.sum() > 0.9 * exists.sum()
    # Where a pixel shows many pixels of the raster it is their mean: only maps that are not squeezed are held tight.
    with np.errstate(invalid="ignore"):
        scale = np.hypot(np.gradient(lat, axis=0), np.gradient(lat, axis=1)) / STEP
        tight = sure & (scale < 1.0) & (np.abs(np.gradient(lon, axis=1)) < STEP)
    assert tight.sum() > 0.05 * exists.sum()
    assert np.abs(values[2] - lat)[tight].max() < 0.04 * STEP
    turned = np.degrees(np.angle((values[1] + 1j * values[0])[tight] * np.exp(-1j * np.radians(lon[tight]))))
    assert np.abs(turned).max() < 0.04 * STEP


def test_the_end_of_the_map_is_reported(globe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A note says where the output ends; with --bounds it goes on."""
    words = ["reproject", str(globe), "--dst-crs", "EPSG:3857", "--res", "100000", "-o", str(tmp_path / "a.tif")]
    assert run(words) == 0
    told = capsys.readouterr()
    assert "latitudes -85.06 to 85.06" in told.err + told.out
    far = ["--bounds", "-1000000", "20000000", "1000000", "24000000", "--overwrite"]
    assert run([*words, *far]) == 0
    told = capsys.readouterr()
    assert "85.06" not in told.err + told.out
    with rasterio.open(tmp_path / "a.tif") as file:
        assert file.bounds.top == 24_000_000
        assert (file.read_masks(1) > 0).all()


def test_limits_of_maps() -> None:
    """Held against closed formulas: half the Earth's circumference, and an equal-area cylinder."""
    assert limits(CRS("EPSG:3857")) == pytest.approx((-20037508.34, -20048966.1, 20037508.34, 20048966.1), rel=1e-6)
    left, bottom, right, top = limits(CRS("EPSG:6933"))
    assert right == pytest.approx(17367530.45, abs=1.0)
    assert top == pytest.approx(7342230.14, abs=1.0)
    assert (left, bottom) == pytest.approx((-right, -top), abs=1.0)
    assert domain(CRS("EPSG:3857")).torn
    assert not domain(CRS("EPSG:3857")).folds
    assert domain(CRS("EPSG:8857")).folds
    assert not domain(CRS("EPSG:32633")).torn


@pytest.mark.parametrize(
    ("code", "place", "step"),
    [("EPSG:26791", (-93.62, 49.28), "80"), ("EPSG:5513", (14.4, 50.1), "30"), ("EPSG:2964", (-150.0, 64.0), "80")],
)
def test_what_two_operations_join_is_whole(
    code: str, place: tuple[float, float], step: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """PROJ may go to another datum and back by two operations that differ by metres: no place is lost by that."""
    path, out = tmp_path / "small.tif", tmp_path / "out.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=100, height=100, count=1, dtype="uint8", crs="EPSG:4326",
        transform=Affine(0.001, 0, place[0], 0, -0.001, place[1]),
    ) as file:  # fmt: skip
        file.write(np.full((1, 100, 100), 7, np.uint8))
    assert run(["reproject", str(path), "--dst-crs", code, "--res", step, "-o", str(out), "--json"]) == 0
    capsys.readouterr()
    with rasterio.open(out) as file:
        row, col = np.mgrid[0 : file.height, 0 : file.width]
        x, y = file.transform @ (col + 0.5, row + 0.5)
        lon, lat = Transformer.from_crs(file.crs, "EPSG:4326", always_xy=True).transform(x, y)
        inside = (np.abs(lon - place[0] - 0.05) < 0.049) & (np.abs(lat - place[1] + 0.05) < 0.049)
        assert inside.sum() > 1000
        assert (file.read_masks(1)[inside] > 0).all()


def test_a_small_sheet_of_two_datums_is_no_globe() -> None:
    """Its graticule on another datum has lines of its own size."""
    from geomosaic.sheets.grid_lines import map_grid

    bounds = (1889390.67 - 150, 994393.7 - 150, 1889390.67 + 150, 994393.7 + 150)
    grid = map_grid(CRS("EPSG:4326"), CRS("EPSG:26791"), bounds, 60.0)
    assert grid.interval < 0.01
    assert {line.axis for line in grid.lines} == {0, 1}


def test_axes_that_go_west(globe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A cylinder whose x grows westwards shows each place once, too."""
    crs, out = "+proj=eqc +axis=wnu +datum=WGS84 +type=crs", tmp_path / "west.tif"
    assert run(["reproject", str(globe), "--dst-crs", crs, "--res", "100000", "-o", str(out), "--json"]) == 0
    capsys.readouterr()
    with rasterio.open(out) as file:
        assert (file.read_masks(1) > 0).mean() > 0.98


def test_cones_of_the_south() -> None:
    """The hemisphere of a cone is that of its standard parallels, wherever its coordinates begin."""
    assert domain(CRS("EPSG:3577")).south == -90.0
    assert domain(CRS("EPSG:2154")).north == 90.0
