"""Orthos of radar: held against an exact orbit over ground that is a formula; amplitudes averaged in power."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import Transformer
from sar_rig import Scene

import geomosaic as gm
from geomosaic.cli.main import run
from geomosaic.errors import GeomosaicError, InputError

SCENE = Scene()
CRS, PIXEL = "EPSG:32602", 12.0


def _heights(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Gentle hills without layover or shadow, metres."""
    return 300.0 + 120.0 * np.sin(x / 900.0) * np.cos(y / 700.0)


def _place(scene: Scene = SCENE) -> tuple[float, float]:
    return Transformer.from_crs(4326, CRS, always_xy=True).transform(*scene.middle(300.0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """DEM of the hills, and the scene as a raster of its own columns and rows, and as one of speckle."""
    folder = tmp_path_factory.mktemp("sar")
    x, y = _place()
    left, top = np.round((x - 6000.0) / 20) * 20, np.round((y + 7000.0) / 20) * 20
    cols, rows = np.meshgrid(left + 20 * (np.arange(600) + 0.5), top - 20 * (np.arange(700) + 0.5))
    with rasterio.open(
        folder / "dem.tif", "w", width=600, height=700, count=1, dtype="float32", crs=CRS,
        transform=Affine(20, 0, left, 0, -20, top),
    ) as file:  # fmt: skip
        file.write(_heights(cols, rows).astype(np.float32), 1)
    width, height = SCENE.size
    places = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)).astype(np.float32)
    amplitude = np.random.default_rng(5).rayleigh(200.0, (1, height, width)).astype(np.uint16)
    for name, values in (("places", places), ("speckle", amplitude)):
        with rasterio.open(
            folder / f"{name}.tif", "w", width=width, height=height, count=len(values), dtype=values.dtype
        ) as file:
            file.write(values)
        SCENE.write(folder, name)
    return folder


def _ortho(folder, name, **options):
    scene = gm.Scene(folder / f"{name}.tif", "sar")
    out = folder / f"{name}-ortho.tif"
    options = {"resolution": PIXEL, "dem": folder / "dem.tif", "dem_heights": "ellipsoidal", **options}
    return gm.ortho(scene, out, dst_crs=CRS, overwrite=True, **options)


def test_ortho_shows_each_place_at_the_pixel_of_the_exact_orbit(folder):
    result = _ortho(folder, "places")
    with rasterio.open(result.path) as file:
        values, seen, transform = file.read(), file.dataset_mask() > 0, file.transform
    rows, cols = np.nonzero(seen)
    chosen = np.random.default_rng(1).choice(len(rows), 400, replace=False)
    rows, cols = rows[chosen], cols[chosen]
    x, y = transform.c + transform.a * (cols + 0.5), transform.f + transform.e * (rows + 0.5)
    with rasterio.open(folder / "dem.tif") as file:
        dem, t = file.read(1).astype(float), file.transform
    c, r = (x - t.c) / t.a - 0.5, (y - t.f) / t.e - 0.5
    i, j = np.floor(r).astype(int), np.floor(c).astype(int)
    u, v = c - j, r - i
    z = (1 - v) * ((1 - u) * dem[i, j] + u * dem[i, j + 1]) + v * ((1 - u) * dem[i + 1, j] + u * dem[i + 1, j + 1])
    xyz = np.array(Transformer.from_crs(CRS, 4978, always_xy=True).transform(x, y, z)).T
    # PROJ takes heights of a 2-D CRS for ellipsoidal ones.
    exact = SCENE.image(xyz)
    inside = ((exact > 1.0) & (exact < np.array(SCENE.size) - 1.0)).all(axis=1)
    off = values[:, rows, cols].T - exact
    assert inside.sum() > 300
    assert np.sqrt(np.mean(np.sum(off[inside] ** 2, axis=1))) < 0.01
    assert np.abs(off[inside]).max() < 0.03


def test_amplitudes_of_speckle_are_averaged_in_power(folder):
    power = _ortho(folder, "speckle", resampling="rms", resolution=60.0).read()
    plain = _ortho(folder, "speckle", resampling="average", resolution=60.0).read()
    middle = np.s_[40:80, 40:80]
    # Of a Rayleigh distribution of scale s the mean is s·√(π/2), the root of the mean square s·√2.
    assert power[0].filled(0).astype(float)[middle].mean() == pytest.approx(200 * np.sqrt(2), rel=0.01)
    assert plain[0].filled(0).astype(float)[middle].mean() == pytest.approx(200 * np.sqrt(np.pi / 2), rel=0.01)


def test_a_dem_without_a_datum_is_refused_with_the_shift_it_could_cause(folder):
    with pytest.raises(GeomosaicError, match="datum"):
        _ortho(folder, "places", dem_heights=None)


def test_a_dem_of_another_place_is_refused(folder):
    x, y = _place()
    with pytest.raises(GeomosaicError):
        _ortho(folder, "places", bounds=(x + 90_000.0, y, x + 91_000.0, y + 1000.0))


def test_a_scene_of_another_place_is_refused_with_where_it_lies_and_where_the_dem_lies(folder):
    """As one that looks to the other side; ground without heights under its middle is a hole."""
    (folder / "away.tif").write_bytes((folder / "speckle.tif").read_bytes())
    SCENE.left().write(folder, "away")
    lon, lat = SCENE.left().middle(300.0)
    x, y = Transformer.from_crs(4326, CRS, always_xy=True).transform(lon, lat)
    with pytest.raises(InputError, match="outside the DEM") as caught:
        _ortho(folder, "away")
    told = [float(word) for word in re.findall(r"shows x (\S+), y (\S+) \(", caught.value.what)[0]]
    assert told == pytest.approx([x, y], abs=500.0)
    assert "the DEM reaches over x" in caught.value.what
    assert "side it looks to" in caught.value.hint
    with rasterio.open(folder / "dem.tif") as file:
        heights, profile = file.read(1), file.profile
    heights[:, 5:] = -9999
    with rasterio.open(folder / "hole.tif", "w", **{**profile, "nodata": -9999}) as file:
        file.write(heights, 1)
    with pytest.raises(InputError, match="shows a hole of the DEM"):
        _ortho(folder, "places", dem=folder / "hole.tif")


def test_a_project_corrects_the_scene_by_control_and_names_the_blunder(folder):
    x, y = _place()
    to_ecef = Transformer.from_crs(CRS, 4978, always_xy=True)
    rng = np.random.default_rng(9)
    points = np.array([x, y]) + rng.uniform(-1500, 1500, (9, 2))
    z = _heights(*points.T)
    image = SCENE.image(np.array(to_ecef.transform(*points.T, z)).T) + rng.normal(0, 0.1, (9, 2)) + np.array([20, 12])
    image[4] += [40.0, 0.0]
    rows = zip(range(9), points, z, image, strict=True)
    table = [f"p{k},{q[0]},{q[1]},{h},speckle.tif,{c[0]},{c[1]}" for k, q, h, c in rows]
    (folder / "gcps.csv").write_text("\n".join(["id,x,y,z,image,col,row", *table]))
    (folder / "project.toml").write_text(
        f"""format = 1
project = {{ name = "radar", images = ["speckle.tif"] }}
sensor = {{ name = "sar" }}
control = {{ file = "gcps.csv" }}
exterior = {{ crs = "{CRS}", heights = "ellipsoidal" }}
dem = {{ file = "dem.tif", heights = "ellipsoidal" }}
output = {{ folder = "output", resampling = "rms", resolution = 60.0 }}
"""
    )
    with pytest.warns(gm.errors.GeomosaicWarning, match="point 'p4' is off by 40"):
        gm.run_project(folder / "project.toml", steps=("orient",))
    state = json.loads((folder / "output" / "models" / "speckle.tif.json").read_text())
    found = state["state"]["values"]
    assert found[0] == pytest.approx(20 * SCENE.spacing, abs=0.1 * SCENE.spacing)
    assert found[1] == pytest.approx(12 * SCENE.row_interval, abs=0.1 * SCENE.row_interval)


def test_overviews_of_amplitudes_are_averaged_in_power_and_the_file_says_so(folder):
    """Whatever the resampling, in orthos, mosaics and the overview of tiled mosaics; calibrated powers by the mean."""
    area = {"resolution": 6.0, "dst_crs": CRS, "dem": folder / "dem.tif", "dem_heights": "ellipsoidal"}
    scene = gm.Scene(folder / "speckle.tif", "sar")
    block = gm.Scene(folder / "speckle.tif", "sar", dem=folder / "dem.tif", dem_heights="ellipsoidal")
    for made in (
        gm.ortho(scene, folder / "o.tif", resampling="nearest", **area),
        gm.mosaic(block, folder / "m.tif", resampling="nearest", balance=False, resolution=6.0, dst_crs=CRS),
    ):
        with rasterio.open(made.path) as file:
            values, seen = file.read(1).astype(float), file.dataset_mask() > 0
            assert file.tags()["OVERVIEW_RESAMPLING"] == "RMS"
            small = file.read(1, out_shape=(-(-file.height // 2), -(-file.width // 2)))
        rows, cols = 2 * (values.shape[0] // 2), 2 * (values.shape[1] // 2)
        four = np.stack([values[i:rows:2, j:cols:2] for i in (0, 1) for j in (0, 1)])
        whole = np.stack([seen[i:rows:2, j:cols:2] for i in (0, 1) for j in (0, 1)]).all(axis=0)
        assert whole.sum() > 100_000
        assert np.abs(small[: rows // 2, : cols // 2] - np.sqrt((four**2).mean(axis=0)))[whole].max() <= 0.51
    plain = gm.ortho(scene, folder / "p.tif", creation={"OVERVIEW_RESAMPLING": "average"}, **area)
    with rasterio.open(plain.path) as file:
        assert "OVERVIEW_RESAMPLING" not in file.tags()


def test_the_overview_of_a_tiled_mosaic_is_averaged_in_power_too(folder):
    block = gm.Scene(folder / "speckle.tif", "sar", dem=folder / "dem.tif", dem_heights="ellipsoidal")
    gm.mosaic(
        block, folder / "t.vrt", tiling="1024px", resampling="nearest", balance=False, resolution=4.0, dst_crs=CRS
    )
    (small,) = folder.glob("t*/t-overview.tif")
    with rasterio.open(small) as file:
        shown = file.read(1).astype(float)
    middle = shown[shown.shape[0] // 3 : -shown.shape[0] // 3, shown.shape[1] // 3 : -shown.shape[1] // 3]
    assert np.sqrt((middle**2).mean()) == pytest.approx(200 * np.sqrt(2), rel=0.02)


def test_rpcs_of_a_scene_meet_its_geometry(folder, capsys):
    words = ["rpc", folder / "speckle.tif", "--sensor", "sar", "--dem", folder / "dem.tif", "--dem-heights"]
    assert run([*map(str, words), "ellipsoidal", "--text", "--overwrite", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [one["fit_worst_px"] < 1e-3 for one in told["images"]] == [True]
