"""More of real scenes: places other programs publish, grids of physical models, GDAL, and RPCs of real SPOT scenes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
from pyproj import CRS
from rpc_rig import gdal

from geomosaic.cli.main import run
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import metres_per_unit
from geomosaic.inputs.orientation_covariance import orientation
from geomosaic.monoplotting.line_drawing import VISIBLE, View
from geomosaic.monoplotting.places import locate
from geomosaic.sensor import registry
from geomosaic.sensor.error_propagation import InputUncertainty, ellipses
from geomosaic.sensor.plugin import SensorModel, SensorRequest
from geomosaic.sensor.solve import image_to_height
from geomosaic.surface.dem import Dem
from geomosaic_pushbroom.metadata import read_metadata
from geomosaic_rpc import RpcModel, fit_rpc, read_rpc, write_tags
from geomosaic_rpc.model import WGS84

RealData = Callable[[str], Path]
ECEF = CRS.from_epsg(4978)


def scene(file: Path) -> SensorModel:
    request = SensorRequest(file.name, read_metadata(file).size, {"metadata": file.name}, None, str(file.parent))
    return registry.build("pushbroom", request)


PUBLISHED = {
    "PHR1B_P_201709281038393_SEN_PRG_FC_178609-001": ([7.048662660737769592, 43.72774839443545858, 0], [100.5, 200.5]),
    "PHR1B_P_201709281038045_SEN_PRG_FC_178608-001": (
        [7.11526088296757386331, 43.684281179313565, 850],
        [10121.5657, 10236.4310],
    ),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_shareloc_places_pixels_alike(real_data: RealData, name: str) -> None:
    """The same from OSSIM's list, from the vendor's XML and from tags; published to 0.01 px."""
    folder = real_data("shareloc-phr-grids") / "rpc"
    ground, image = (np.array([each], dtype=float) for each in PUBLISHED[name])
    found = [read_rpc(folder / file).rpc(file).image(ground) for file in (f"{name}.geom", f"RPC_{name}.XML")]
    if (folder / f"{name}.tif").exists():
        with rasterio.open(folder / f"{name}.tif") as file:
            size = file.width, file.height
        request = SensorRequest(name, size, {"rpc": "image", "offset": [0, 0]}, None, ".", str(folder / f"{name}.tif"))
        found.append(registry.build("rpc", request).ground_to_image(ground))
    assert np.abs(np.array(found) - image).max() < 1e-2
    assert np.abs(np.array(found) - found[0]).max() < 1e-6


def nodes(path: Path) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Height, ground (N, 3) and image (N, 2) of each level of a grid of direct locations."""
    with rasterio.open(path) as file:
        bands, t, tags = file.read(), file.transform, file.tags()
    row, col = np.mgrid[0 : bands.shape[1], 0 : bands.shape[2]]
    image = np.column_stack([(t.c + t.a * col).ravel(), (t.f + t.e * row).ravel()])
    heights = [float(tags[f"ALTITUDE_B{2 * k}"]) for k in range(len(bands) // 2)]
    return [
        (h, np.column_stack([bands[2 * k].ravel(), bands[2 * k + 1].ravel(), np.full(len(image), h)]), image)
        for k, h in enumerate(heights)
    ]


def test_pleiades_physical_model_against_its_producers_grid(real_data: RealData) -> None:
    """Orbit and attitude of DIMAP 1 against 65 × 65 places on each of nine heights, by another program."""
    base = real_data("shareloc-phr-grids")
    model = scene(next((base / "rpc").glob("PHRDIMAP_*.XML")))
    levels = nodes(next((base / "ellipsoide").glob("*2018122638935449CP/GRID_*.tif")))
    assert len(levels) == 9
    for _, ground, image in levels:
        assert np.abs(model.ground_to_image(Transform(WGS84, ECEF)(ground)) - image).max() < 1e-3


def test_pleiades_rpc_within_its_physical_model_agrees_with_it(real_data: RealData) -> None:
    """F_COL and F_ROW of the same DIMAP against the producer's grid, within the heights they are made for."""
    base = real_data("shareloc-phr-grids")
    file = next((base / "rpc").glob("PHRDIMAP_*.XML"))
    fields = read_rpc(file)
    rpc = fields.rpc(str(file))
    compared = 0
    for height, ground, image in nodes(next((base / "ellipsoide").glob("*2018122638935449CP/GRID_*.tif"))):
        if abs(height - fields.numbers["HEIGHT_OFF"]) <= fields.numbers["HEIGHT_SCALE"]:
            assert np.abs(rpc.image(ground) - image).max() < 0.01
            compared += 1
    assert compared


def test_pleiades_rpc_against_the_grid_of_its_physical_model(real_data: RealData) -> None:
    """Below 0.01 px where the RPC is made for; it says less of 3000 m above."""
    base = real_data("shareloc-phr-grids")
    name = "2017092838284574CP"
    rpc = read_rpc(base / "rpc" / f"RPC_P1BP--{name}.XML").rpc(name)
    for height, ground, image in nodes(next((base / "ellipsoide").glob(f"*{name}/GRID_*.tif"))):
        assert np.abs(rpc.image(ground) - image).max() < (0.01 if height < 1500.0 else 0.1)


GDAL = (
    "shareloc-phr-grids/rpc/wv3_20.NTF",
    "shareloc-phr-grids/rpc/PHR1B_P_201709281038393_SEN_PRG_FC_178609-001.tif",
    "s2p-pair/input_pair/img_02.tif",
)


@pytest.mark.parametrize("name", GDAL)
def test_gdal_places_pixels_alike(real_data: RealData, name: str) -> None:
    folder, _, rest = name.partition("/")
    path = real_data(folder) / rest
    with rasterio.open(path) as file:
        size = file.width, file.height
    model = registry.build(
        "rpc", SensorRequest(path.name, size, {"rpc": "image", "offset": [0, 0]}, None, ".", str(path))
    )
    assert isinstance(model, RpcModel)
    ground = model.rpc.ground_offset + np.random.default_rng(3).uniform(-0.9, 0.9, (300, 3)) * model.rpc.ground_scale
    assert np.abs(gdal(path, ground) - model.ground_to_image(ground)).max() < 1e-6


@pytest.mark.parametrize("name", ["QB/qb-1", "ikonos/ikonos-1", "wv2/wv2-1", "pleiades/pleiades-1"])
def test_gdal_shows_ossims_points(real_data: RealData, tmp_path: Path, name: str) -> None:
    """A keyword list written as tags: GDAL gives the columns and rows that OTB computed."""
    base = real_data("otb-sensor-geoms")
    rpc = read_rpc(base / f"{name}.geom").rpc(name)
    width, height = (int(v) for v in rpc.image_offset + np.abs(rpc.image_scale))
    model = RpcModel.of(rpc, (width, height))
    profile = {"driver": "GTiff", "dtype": "uint8", "count": 1, "width": width, "height": height}
    with rasterio.open(tmp_path / "scene.tif", "w", sparse_ok=True, tiled=True, bigtiff="yes", **profile):
        pass
    write_tags(model, tmp_path / "scene.tif")
    points = np.loadtxt(base / f"{name}.gcp")
    found = gdal(tmp_path / "scene.tif", points[:, [5, 6, 4]])
    assert np.abs(found - rpc.image(points[:, [5, 6, 4]])).max() < 1e-6
    assert np.abs(found - points[:, :2]).max() < 1e-3


SPOT = {
    "otb-sensor-geoms/spot5/spot5-1.geom": (0.12, 0.01),
    "cosicorr-spot-dimap/SPOT4.DIM": (0.15, 0.02),
    "cosicorr-spot-dimap/SPOT5.DIM": (0.2, 0.01),
    "cosicorr-spot-dimap/SPOT1.DIM": (0.3, 0.02),
    "cosicorr-spot-dimap/SP-2.DIM": (0.45, 0.01),
}


def fit_of_a_spot_scene(path: Path, most: float, rest: float) -> None:
    """What the satellite trembles by, no cubic follows: a function of the row. Nor bends of the detector line.

    So it is split up: residual = f(row) + g(column) + rest. The rest is what the fit loses; the first two are told.
    """
    model = scene(path)
    fit = fit_rpc(model, (0.0, 1000.0))
    assert fit.worst < most
    cols, rows = (np.linspace(0.5, side - 0.5, 13) for side in model.size)
    image = np.stack(np.meshgrid(cols, rows), axis=-1)
    found = []
    for height in (100.0, 900.0):
        ground = image_to_height(model, image.reshape(-1, 2), height, WGS84)
        found.append((fit.model.ground_to_image(ground) - image.reshape(-1, 2)).reshape(image.shape))
    off = np.array(found)  # height, row, column, (col, row)
    assert np.abs(off).max() < 1.1 * fit.worst
    trembling, bends = off.mean(axis=(0, 2), keepdims=True), off.mean(axis=(0, 1), keepdims=True)
    left = off - trembling - bends + off.mean(axis=(0, 1, 2), keepdims=True)
    assert np.abs(left).max() < rest
    assert np.abs(left).max() < 0.3 * np.abs(off).max()


def test_an_rpc_of_a_real_spot_scene(real_data: RealData) -> None:
    name = next(iter(SPOT))
    folder, _, rest = name.partition("/")
    fit_of_a_spot_scene(real_data(folder) / rest, *SPOT[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", list(SPOT)[1:])
def test_an_rpc_of_each_real_spot_scene(real_data: RealData, name: str) -> None:
    folder, _, rest = name.partition("/")
    fit_of_a_spot_scene(real_data(folder) / rest, *SPOT[name])


def test_quickbird_refined_by_the_command(
    real_data: RealData, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The five surveyed points: from 3.6 px to a tenth, and GDAL sees the refined RPC."""
    base = real_data("orthority-qb2")
    image = tmp_path / "qb2.tif"
    image.write_bytes((base / "qb2_basic1b.tif").read_bytes())
    features = json.loads((base / "gcps.geojson").read_text())["features"]
    rows = [[*each["geometry"]["coordinates"], *(np.array(each["properties"]["ji"]) + 0.5)] for each in features]
    lines = [f"g{k},{x!r},{y!r},{z!r},qb2.tif,{float(c)!r},{float(r)!r}" for k, (x, y, z, c, r) in enumerate(rows)]
    (tmp_path / "gcps.csv").write_text("id,x,y,z,image,col,row\n" + "\n".join(lines) + "\n")
    words = ["rpc", str(image), "--refine", "shift", "--gcps", str(tmp_path / "gcps.csv")]
    crs = ["--crs", "EPSG:4326", "--heights", "ellipsoidal"]
    assert run([*words, *crs, "--tags", "--overwrite", "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)["images"]
    assert told["rms_before_px"] == pytest.approx(3.64, abs=0.01)
    assert told["rms_after_px"] < 0.15
    table = np.array(rows)
    off = gdal(image, table[:, :3]) - table[:, 3:]
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.15


def test_places_on_a_real_surface_model_both_ways(real_data: RealData) -> None:
    """Pixels of the stereo pair's first image to its surface model and back; every place found is one that is seen."""
    base = real_data("s2p-pair")
    path = base / "input_pair" / "img_01.tif"
    model = registry.build("rpc", SensorRequest(path.name, (1024, 1024), {}, None, ".", str(path)))
    surface = Dem.open(base / "expected_output" / "pair" / "dsm.tif", heights="ellipsoidal")
    image = np.random.default_rng(2).uniform(350, 750, (300, 2))
    found = locate(model, surface, image, surface.crs, InputUncertainty(pixel=0.5, height=1.0))
    seen = found.seen
    assert seen.sum() > 150
    back, state = View.of(model, surface, surface.crs).drape_to_image(found.xyz[seen, :2])
    surface.close()
    assert (state == VISIBLE).all()
    assert np.abs(back - image[seen]).max() < 1e-5
    axes = found.ellipses.semi_axes[seen]
    assert np.nanmedian(axes[:, 1]) > 0.2  # 0.5 px of 0.5 m, and more on slopes
    assert 0.2 < np.nanmedian(axes[:, 0]) < 2.0


def test_surveyed_points_lie_within_the_errors_that_a_quickbird_scene_states(real_data: RealData) -> None:
    """12.15 m of bias and 0.3 m along each axis; the points of one scene share one error, here 1 to 2 of it."""
    base = real_data("orthority-qb2")
    features = json.loads((base / "gcps.geojson").read_text())["features"]
    ground = np.array([each["geometry"]["coordinates"] for each in features])
    image = np.array([each["properties"]["ji"] for each in features]) + 0.5
    path = base / "qb2_basic1b.tif"
    model = registry.build("rpc", SensorRequest(path.name, (850, 1450), {}, None, ".", str(path)))
    _, covariance, note = orientation(model, {})
    assert "states" in note
    told = ellipses(model, None, model.crs, ground, InputUncertainty(orientation=covariance)).covariance[:, :2, :2]
    assert np.allclose(np.sqrt(told[:, [0, 1], [0, 1]]), np.hypot(12.15, 0.3), rtol=0.02)
    found = image_to_height(model, image, ground[:, 2], model.crs)
    off = (found[:, :2] - ground[:, :2]) * metres_per_unit(model.crs, ground[:, :2])
    assert (np.abs(off).max(axis=0) < 2.0 * 12.2).all()
    assert np.hypot(*off.T).min() > 12.0
