"""`geomosaic deskew`: a rendered strip becomes flat, with nothing but nominal numbers; sweeps become orthos."""

from __future__ import annotations

import json
import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from pyproj import CRS, Geod
from rasterio.errors import NotGeoreferencedWarning

from geomosaic.block import OrientedImage, footprint
from geomosaic.cli.main import run
from geomosaic.errors import GeomosaicWarning
from geomosaic.inputs.declarations import Block
from geomosaic.options.inputs import Area
from geomosaic.options.render import RenderOptions
from geomosaic.products.orthos import deskew, make_ortho
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.solve import image_to_ground
from geomosaic.surface.model import Plane
from geomosaic.types import FloatArray

SIZE = (500, 400)
H, FIELD, ADVANCE = 3000.0, 90.0, 12.0


def write(path: Path, values: FloatArray) -> None:
    profile = {"driver": "GTiff", "width": values.shape[1], "height": values.shape[0], "count": 1, "dtype": "uint16"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", **profile) as dataset:
            dataset.write(np.round(values).astype(np.uint16), 1)


def texture(x: FloatArray, y: FloatArray) -> FloatArray:
    """Changes by up to 45 a metre."""
    return 30000 + 6000 * np.sin(x / 180.0) + 6000 * np.cos(y / 150.0 + 1.0)


def strip(drift: float) -> FloatArray:
    """A scanner's lines by their closed form: y is the way, x = H·tan θ; the nose `drift` right of the course."""
    c, r = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    x = H * np.tan(np.radians((c - SIZE[0] / 2) * FIELD / SIZE[0]))
    way = (r - SIZE[1] / 2) * ADVANCE
    return texture(x - way * math.sin(math.radians(drift)), way * math.cos(math.radians(drift)))


def read(path: Path) -> tuple[FloatArray, FloatArray, FloatArray]:
    with rasterio.open(path) as dataset:
        values, valid = dataset.read(1).astype(float), dataset.dataset_mask() > 0
        rows, cols = np.nonzero(valid)
        x, y = dataset.transform @ (cols + 0.5, rows + 0.5)
    return values[valid], np.asarray(x), np.asarray(y)


def test_a_strip_is_flattened_without_control(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "strip.tif", tmp_path / "flat.tif"
    write(path, strip(0.0))
    said = [f"kind=scanner field_of_view={FIELD} height_above_ground={H} v_over_h={ADVANCE / H}"]
    options = [word for pair in said[0].split() for word in ("--option", pair)]
    assert run(["deskew", str(path), *options, "--res", "10", "--resampling", "cubic", "-o", str(out), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert "relative metres" in facts["notes"][0]
    values, x, y = read(out)
    # gsw = 2·H·tan(θ/2), and the length is the way.
    assert np.ptp(x) == pytest.approx(2 * H * math.tan(math.radians(FIELD / 2)), abs=25)
    assert np.ptp(y) == pytest.approx(SIZE[1] * ADVANCE, abs=25)
    inner = (np.abs(x) < 2900) & (np.abs(y) < 2300)
    assert np.sqrt(((values - texture(x, y))[inner] ** 2).mean()) < 12  # a tenth of a pixel would be 40 and more
    with rasterio.open(out) as dataset:
        assert CRS.from_wkt(dataset.crs.to_wkt()).is_engineering
        assert "relative metres" in dataset.crs.to_wkt()


def test_skew_by_drift_goes(tmp_path: Path) -> None:
    """The nose 8° off the course skews the image; heading is 0 in the strip's own map, and course is the rest."""
    path, out = tmp_path / "strip.tif", tmp_path / "flat.tif"
    write(path, strip(8.0))
    options = {"kind": "scanner", "field_of_view": FIELD, "height_above_ground": H, "advance": ADVANCE}
    inputs = Block((path,), "panoramic", options=options | {"relative": True, "drift": 8.0})
    make_ortho(inputs, Area(None, 10.0), out, RenderOptions(resampling="cubic"))
    values, x, y = read(out)
    inner = (np.abs(x + y * math.tan(math.radians(8.0))) < 2900) & (np.abs(y) < 2200)
    assert inner.sum() > 100_000
    assert np.sqrt(((values - texture(x, y))[inner] ** 2).mean()) < 12


def test_an_orbit_is_deskewed_in_true_distances(tmp_path: Path) -> None:
    """Angles and distances of the relative map are those on the ellipsoid: the Earth's turning is out."""
    ellipsoid = CRS.from_epsg(4979)
    options: dict[str, Any] = {
        "kind": "sweeps", "orbit": {"inclination": 98.2, "pass": "descending"}, "period": 71.46e-3,
        "field_of_view": 14.9, "line_angle": math.degrees(42.5e-6),
    }  # fmt: skip
    size = (6320, 5984)
    placed = registry.build(
        "panoramic", SensorRequest("s", size, {**options, "position": [11.0, 48.0, 705_000.0]}, ellipsoid)
    )
    free = registry.build(
        "panoramic",
        SensorRequest("s", size, {**options, "relative": True, "height_above_ground": 705_000.0, "latitude": 48.0}),
    )
    pixels = np.array([[3160.0, 2984.0], [3160.0, 24.0], [200.0, 2984.0], [6000.0, 5656.0]])
    ground = image_to_ground(placed, pixels, Plane(ellipsoid, 0.0))
    flat = image_to_ground(free, pixels)[:, :2]
    geod = Geod(ellps="WGS84")
    for i in (1, 2, 3):
        _, _, length = geod.inv(*ground[0, :2], *ground[i, :2])
        assert np.hypot(*(flat[i] - flat[0])) == pytest.approx(length, rel=2e-6)
    # An image straight down the columns is no straight angle in the raw: 3° of skew at this latitude.
    along, across = flat[1] - flat[0], flat[2] - flat[0]
    angle = math.degrees(math.acos(along @ across / np.hypot(*along) / np.hypot(*across)))
    assert abs(angle - 90.0) > 2.0


def test_sweeps_become_an_ortho_that_shows_the_ground_where_it_is(tmp_path: Path) -> None:
    """Sweeps of 16 lines, both ways, with a corrector: rendered by their rays, rectified, compared with the ground.

    Where one sweep takes over from the next the rows jump, and that no lattice holds: it is told.
    """
    ellipsoid = CRS.from_epsg(4979)
    size = (320, 160)
    field = 14.9 / 20
    options: dict[str, Any] = {
        "kind": "sweeps", "position": [11.0, 48.0, 705_000.0], "orbit": {"inclination": 98.2, "pass": "descending"},
        "period": 71.46e-3, "field_of_view": field, "directions": "both", "active": 0.85, "image_motion": 13.7,
        "line_angle": math.degrees(42.5e-6), "columns": "left",
    }  # fmt: skip
    model = registry.build("panoramic", SensorRequest("scene", size, options, ellipsoid))
    c, r = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    ground = image_to_ground(model, np.column_stack([c.ravel(), r.ravel()]), Plane(ellipsoid, 0.0))

    def shade(lon: FloatArray, lat: FloatArray) -> FloatArray:
        return texture((lon - 11.0) * 74_600 / 4, (lat - 48.0) * 111_200 / 4)

    path, out = tmp_path / "scene.tif", tmp_path / "ortho.tif"
    write(path, shade(*ground[:, :2].T).reshape(size[1], size[0]))
    inputs = Block((path,), "panoramic", options=options, crs="EPSG:4979", heights="ellipsoidal", height=0.0)
    with pytest.warns(GeomosaicWarning, match="interpolated within"):
        made = make_ortho(inputs, Area("EPSG:32632", 30.0), out, RenderOptions(resampling="cubic"))
    assert 0.02 < made.lattice_error < 0.8
    with rasterio.open(out) as dataset:
        values, valid = dataset.read(1).astype(float), dataset.dataset_mask() > 0
        rows, cols = np.nonzero(valid)
        x, y = dataset.transform @ (cols + 0.5, rows + 0.5)
        from pyproj import Transformer

        lon, lat = Transformer.from_crs("EPSG:32632", 4326, always_xy=True).transform(x, y)
    miss = values[valid] - shade(np.asarray(lon), np.asarray(lat))
    inside = np.abs(miss) < 5000
    assert inside.mean() > 0.99
    # 11 a metre and 30 m pixels: an error of a tenth of a pixel is 34.
    assert np.sqrt((miss[inside] ** 2).mean()) < 40


@pytest.mark.parametrize("drift", [-3.03, -2.0, 0.0, 2.0, 3.03])
def test_sweeps_with_drift_keep_their_whole_extent(drift: float) -> None:
    """Between two sweeps, and so along the border and maybe in the middle, rows of the image see nothing."""
    options: dict[str, Any] = {
        "kind": "sweeps", "relative": True, "height_above_ground": 705_000.0, "advance": 240.0, "drift": drift,
        "field_of_view": math.degrees(800 * 15 / 705_000), "line_angle": math.degrees(15 / 705_000),
    }  # fmt: skip
    model = registry.build("panoramic", SensorRequest("sweeps", (800, 800), options))
    middles = np.stack(np.meshgrid(np.linspace(4, 796, 12), np.arange(50) * 16 + 8.0), axis=-1).reshape(-1, 2)
    seen = image_to_ground(model, middles)[:, :2]
    assert np.isfinite(seen).all()
    outline = footprint(OrientedImage("sweeps", "sweeps.tif", "panoramic", model), None, model.crs)
    bounds = np.array(outline.bounds)
    assert outline.sampling == pytest.approx(15.0, rel=0.01)
    # The last rows lie half a sweep beyond the middle of their sweep, and the outline may end three rows before them.
    assert (bounds[:2] < seen.min(axis=0)).all()
    assert (bounds[2:] > seen.max(axis=0)).all()
    assert (bounds[2:] - bounds[:2] < np.ptp(seen, axis=0) + 2 * 11 * 15.0).all()


@pytest.mark.parametrize("drift", [-3.03, -2.0, 2.0, 3.03])
def test_drifting_sweeps_are_drawn_as_a_whole(tmp_path: Path, drift: float) -> None:
    """The nose turned against the course shifts the sweeps aside, and leaves their number of rows as it is."""
    path, out, side, lines = tmp_path / "sweeps.tif", tmp_path / "flat.tif", 160, 4
    write(path, np.full((side, side), 500.0))
    options: dict[str, Any] = {
        "kind": "sweeps",
        "height_above_ground": 705_000,
        "lines_per_sweep": lines,
        "drift": drift,
    }
    options |= {
        "advance": lines * 60,
        "field_of_view": math.degrees(side * 60 / 705_000),
        "line_angle": math.degrees(60 / 705_000),
    }
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "the geometry is interpolated within", GeomosaicWarning)
        deskew(path, out, options, resolution=240)
    with rasterio.open(out) as dataset:
        seen = dataset.dataset_mask() > 0
    # Output pixels are four image pixels wide; a drifting strip is a parallelogram, and the scanner moves on by a sweep
    # while it sweeps.
    shift = side * math.sin(math.radians(abs(drift)))
    assert seen.any(axis=1).sum() == pytest.approx((side + lines) / 4, abs=2)
    assert seen.any(axis=0).sum() == pytest.approx((side + shift) / 4, abs=2)
    assert seen.sum() == pytest.approx(side * side / 16, rel=0.05)


def test_what_is_wrong_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "strip.tif"
    write(path, strip(0.0))
    words = ["deskew", str(path), "--option", "kind=scanner", "--option", "field_of_view=90"]
    assert run([*words, "-o", str(tmp_path / "a.tif")]) == 1
    assert "height_above_ground" in capsys.readouterr().err
    assert run([*words, "--dst-crs", "EPSG:32633", "-o", str(tmp_path / "a.tif")]) == 2  # it lies nowhere
    assert "No such option" in capsys.readouterr().err
