"""Real scenes with RPC, against the programs and the surveys they come with, and against GDAL."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.fill import fillnodata
from rasterio.transform import RPCTransformer

from geomosaic.accuracy.product_check import against_reference
from geomosaic.errors import InputError
from geomosaic.geo.transform import Transform
from geomosaic.inputs.declarations import Block
from geomosaic.options.inputs import Area
from geomosaic.options.render import RenderOptions
from geomosaic.products.orthos import make_ortho
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.solve import image_to_ground
from geomosaic.surface.dem import Dem
from geomosaic_rpc import (
    Rpc,
    RpcModel,
    TieMeasurements,
    correct_by_ties,
    fit_rpc,
    read_rpc,
    refine,
    write_tags,
)
from geomosaic_rpc.model import WGS84

RealData = Callable[[str], Path]


def of_file(path: Path) -> Rpc:
    return read_rpc(path).rpc(path.name)


def of_image(path: Path, **options: Any) -> RpcModel:
    with rasterio.open(path) as file:
        size = file.width, file.height
    made = registry.build("rpc", SensorRequest(path.name, size, options, None, ".", str(path)))
    assert isinstance(made, RpcModel)
    return made


@pytest.mark.parametrize("name", ["QB/qb-1", "ikonos/ikonos-1", "wv2/wv2-1", "pleiades/pleiades-1"])
def test_ossims_own_points(real_data: RealData, name: str) -> None:
    """OTB counts from the outer corner, as we do: (0.5, 0.5) is the centre of the first pixel."""
    base = real_data("otb-sensor-geoms")
    rpc = of_file(base / f"{name}.geom")
    points = np.loadtxt(base / f"{name}.gcp")
    assert len(points) == 36
    off = rpc.image(points[:, [5, 6, 4]]) - points[:, :2]
    assert np.abs(off).max() < 1e-3
    assert off.std(axis=0).max() < 1e-4
    points = np.loadtxt(base / f"{name}.gcp2")
    off = rpc.image(points[:, 2:5]) - points[:, :2]
    # That file was made with the first pixel of Pleiades taken for 1, not 0.5.
    assert np.abs(off + (0.5 if "pleiades" in name else 0.0)).max() < 1e-6


def test_a_geom_without_rpc(real_data: RealData) -> None:
    with pytest.raises(InputError, match="ossimSpot5Model and has no RPC"):
        read_rpc(real_data("otb-sensor-geoms") / "spot5" / "spot5-1.geom")


def test_quickbird_against_an_ortho(real_data: RealData) -> None:
    """808 tie points with an ortho; the header of the file says row, col, but the columns come first."""
    base = real_data("otb-sensor-geoms")
    rpc = of_file(base / "QB_TOULOUSE_MUL_Extract_500_500.geom")
    ties = np.loadtxt(base / "QB_TOULOUSE_MUL_Extract_500_500_in_tie_points.txt", comments="#")
    assert len(ties) == 808
    ground = np.column_stack([ties[:, 2:4], np.full(808, 200.0)])  # Toulouse: 150 m above the sea, geoid 50 m
    off = ties[:, :2] - rpc.image(ground)
    middle = np.median(off, axis=0)
    assert np.abs(middle).max() < 2.0  # 5 m, with one height for all of them
    assert np.median(np.abs(off - middle)) < 0.05


FILES = {
    "20191015_073816_ssc1d3_0011_basic_l1a_panchromatic_dn_RPC.TXT": "RPC.TXT",
    "rpc_IKONOS.txt": "RPC.TXT",
    "rpc_PLANET_L1A.txt": "RPC.TXT",
    "rpc_PLANET_L1B.txt": "RPC.TXT",
    "rpc_PLEIADES.xml": "DIMAP PHR_SENSOR",
    "rpc_SPOT6.xml": "DIMAP S6_SENSOR",
    "rpc_WV1.xml": "DigitalGlobe XML",
    "rpc_WV2.xml": "DigitalGlobe XML",
    "rpc_WV3.xml": "DigitalGlobe XML",
}


def gdal(tags: rasterio.rpc.RPC, ground: np.ndarray) -> np.ndarray:
    with RPCTransformer(tags) as transformer:
        rows, cols = transformer.rowcol(*ground[:, :2].T, zs=ground[:, 2], op=lambda value: value)
    return np.column_stack([cols, rows])


def scattered(rpc: Rpc, share: float = 0.5) -> np.ndarray:
    lph = np.random.default_rng(3).uniform(-share, share, (300, 3))
    return rpc.ground_offset + lph * rpc.ground_scale


def shown(rpc: Rpc) -> RpcModel:
    """The scene, of the size its scales tell."""
    width, height = (int(v) for v in rpc.image_offset + np.abs(rpc.image_scale))
    return RpcModel.of(rpc, (width, height))


@pytest.mark.parametrize("name", FILES)
def test_one_file_of_each_family(real_data: RealData, name: str, tmp_path: Path) -> None:
    """Read, shown, written as tags, read by GDAL: GDAL's transformer gives our image coordinates."""
    path = real_data("rpcm-rpc-files") / "test_rpc_files" / name
    assert read_rpc(path).format == FILES[name]
    model = shown(of_file(path))
    image = tmp_path / "scene.tif"
    profile = {"driver": "GTiff", "dtype": "uint8", "count": 1, "width": model.size[0], "height": model.size[1]}
    with rasterio.open(image, "w", sparse_ok=True, tiled=True, bigtiff="yes", **profile):
        pass
    write_tags(model, image)
    # SkySat's scales of one degree are far larger than its scene.
    ground = np.array(model.seed) + np.random.default_rng(3).uniform(-1, 1, (300, 3)) * [0.005, 0.005, 50.0]
    with rasterio.open(image) as file:
        off = gdal(file.rpcs, ground) - model.ground_to_image(ground)
    assert np.abs(off).max() < 1e-6
    assert np.abs(of_image(image).ground_to_image(ground) - model.ground_to_image(ground)).max() < 1e-6


def test_what_is_no_rpc_file(real_data: RealData) -> None:
    with pytest.raises(InputError, match="starts with <VRTDataset>"):
        read_rpc(real_data("rpcm-rpc-files") / "test_rpc_files" / "rpc_unsupported.xml")


def test_gdal_counts_dimap_pixels_alike(real_data: RealData, tmp_path: Path) -> None:
    """GDAL's reader of Pleiades files beside an image of their name, and ours: nobody is half a pixel off."""
    for profile, name in (("PHR1A", "rpc_PLEIADES.xml"), ("SPOT6", "rpc_SPOT6.xml")):
        data = (real_data("rpcm-rpc-files") / "test_rpc_files" / name).read_bytes()
        (tmp_path / f"RPC_{profile}_1.XML").write_bytes(data)
        (tmp_path / f"DIM_{profile}_1.XML").write_bytes(
            b"<Dimap_Document><Metadata_Identification><METADATA_FORMAT version='2.0'>DIMAP</METADATA_FORMAT>"
            b"<METADATA_PROFILE>" + {"PHR1A": b"PHR_SENSOR", "SPOT6": b"S6_SENSOR"}[profile] + b"</METADATA_PROFILE>"
            b"</Metadata_Identification></Dimap_Document>"
        )
        image = tmp_path / f"IMG_{profile}_1_R1C1.TIF"
        with rasterio.open(
            image, "w", driver="GTiff", dtype="uint8", count=1, width=20000, height=20000, sparse_ok=True, tiled=True
        ):
            pass
        model = of_image(image, offset=[0, 0])
        ground = scattered(model.rpc)
        with rasterio.open(image) as file:
            assert file.rpcs is not None
            assert np.abs(gdal(file.rpcs, ground) - model.ground_to_image(ground)).max() < 1e-6


def test_pleiades_against_its_physical_model(real_data: RealData) -> None:
    """Direct location grids of the physical model, computed by its producer: columns and rows every 200 pixels."""
    base = real_data("shareloc-phr-ventoux")
    left = base / "rpc" / "phr_ventoux" / "RPC_PHR1B_P_201308051042194_SEN_690908101-001.XML"
    rpcs = {"042194": of_file(left), "042523": of_file(base / "rpc" / "phr_ventoux" / "right_image.geom")}
    for part, rpc in rpcs.items():
        path = next((base / "grid" / "phr_ventoux").glob(f"*{part}*.tif"))
        with rasterio.open(path) as file:
            bands = file.read()
        cols, rows = np.meshgrid(4000.5 + 200.0 * np.arange(20), 4000.5 + 200.0 * np.arange(15))
        for level, height in enumerate((-100.0, 485.0, 1000.0, 2000.0, 3000.0)):
            ground = np.column_stack([bands[2 * level].ravel(), bands[2 * level + 1].ravel(), np.full(300, height)])
            off = rpc.image(ground) - np.column_stack([cols.ravel(), rows.ravel()])
            # The RPC is made for 190 to 1960 m.
            assert np.abs(off).max() < (1e-3 if 0 < height < 1500 else 3e-3), (part, height)
    assert np.abs(of_file(left).image_offset - of_file(left.with_name("left_image.geom")).image_offset).max() < 1e-9


@pytest.mark.parametrize("half", [0.0, 0.5], ids=["SRTM as it is", "SRTM as upstream reads it"])
def test_pleiades_on_srtm(real_data: RealData, tmp_path: Path, half: float) -> None:
    """Shareloc's published point: (1999.5, 999.5) with pixel centres at integers is (2000, 1000) here.

    Its height is that of the DEM half a cell to the north-west: nodes are taken for corners. Read so, ours agrees.
    """
    base = real_data("shareloc-phr-ventoux")
    heights = np.fromfile(base / "dtm/srtm_ventoux/srtm90_non_void_filled/N44E005.hgt", dtype=">i2").reshape(1201, 1201)
    step = 1.0 / 1200.0
    profile = {"driver": "GTiff", "dtype": "int16", "count": 1, "width": 1201, "height": 1201, "crs": "EPSG:4326"}
    transform = rasterio.Affine(step, 0, 5 - (0.5 + half) * step, 0, -step, 45 + (0.5 + half) * step)
    with rasterio.open(tmp_path / "srtm.tif", "w", nodata=-32768, transform=transform, **profile) as file:
        file.write(heights.astype(np.int16), 1)
    published = np.array([[5.17388499778903, 44.2257233720898, 376.86]])
    model = shown(of_file(base / "rpc" / "phr_ventoux" / "left_image.geom"))
    assert np.abs(model.ground_to_image(published) - [[2000.0, 1000.0]]).max() < 2e-3
    dem = Dem.open(tmp_path / "srtm.tif", heights="egm96")
    found = Transform(dem.crs, WGS84)(image_to_ground(model, np.array([[2000.0, 1000.0]]), dem))[0]
    dem.close()
    apart = (found - published[0]) * [80_000.0, 111_000.0, 1.0]
    if half:
        assert np.abs(apart).max() < 0.02
    else:
        assert np.hypot(*apart[:2]) > 1.0
        assert apart[2] < -10.0


@pytest.fixture(scope="module")
def quickbird(real_data: RealData) -> tuple[Path, np.ndarray, np.ndarray]:
    """The scene, its surveyed points, and where they were measured, in pixels from the corner."""
    base = real_data("orthority-qb2")
    features = json.loads((base / "gcps.geojson").read_text())["features"]
    ground = np.array([each["geometry"]["coordinates"] for each in features])
    return base / "qb2_basic1b.tif", ground, np.array([each["properties"]["ji"] for each in features]) + 0.5


def test_quickbird_as_delivered_and_refined(quickbird: tuple[Path, np.ndarray, np.ndarray]) -> None:
    path, ground, image = quickbird
    model = of_image(path)
    off = image - model.ground_to_image(ground)
    assert np.allclose(off.mean(axis=0), [-2.98, -2.09], atol=0.05)
    found = refine(model, ground, image, "shift")
    assert found.rms_before == pytest.approx(3.64, abs=0.01)
    assert found.rms_after < 0.15
    assert found.sigmas[:2].max() < 0.05
    for one in range(len(ground)):  # each point checked by the others
        others = np.arange(len(ground)) != one
        alone = refine(model, ground[others], image[others], "shift").model
        assert np.linalg.norm(image[one] - alone.ground_to_image(ground[one : one + 1])) < 0.3
    spoilt = image.copy()
    spoilt[2] += [40.0, -7.0]
    assert np.flatnonzero(~refine(model, ground, spoilt, "shift").used).tolist() == [2]


@pytest.mark.parametrize("name", ["orthority-qb2/qb2_basic1b.tif", "s2p-pair/input_pair/img_01.tif"])
def test_gdal_places_pixels_alike(real_data: RealData, name: str) -> None:
    folder, _, rest = name.partition("/")
    path = real_data(folder) / rest
    model = of_image(path)
    ground = scattered(model.rpc, 0.9)
    with rasterio.open(path) as file:
        assert np.abs(gdal(file.rpcs, ground) - model.ground_to_image(ground)).max() < 1e-6


@pytest.mark.parametrize("name", ["rpc_PLEIADES.xml", "rpc_WV3.xml", "rpc_IKONOS.txt"])
def test_an_rpc_is_fitted_to_a_vendors(real_data: RealData, name: str) -> None:
    model = shown(of_file(real_data("rpcm-rpc-files") / "test_rpc_files" / name))
    middle, half = model.rpc.ground_offset[2], abs(model.rpc.ground_scale[2])
    fitted = fit_rpc(model.with_values([5.0, -3.0, 2.0, 1.0, -1.0, 3.0]), (middle - half, middle + half))
    assert fitted.worst < 0.01


@pytest.fixture(scope="module")
def pair(real_data: RealData, tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Path], Path]:
    """Two images and the surface model another program made of them, its holes filled: matching needs whole tiles."""
    base = real_data("s2p-pair")
    dsm = tmp_path_factory.mktemp("s2p") / "dsm.tif"
    with rasterio.open(base / "expected_output" / "pair" / "dsm.tif") as file:
        heights, profile = file.read(1), file.profile
    profile.update(nodata=None)
    with rasterio.open(dsm, "w", **profile) as file:
        file.write(fillnodata(heights, np.isfinite(heights).astype(np.uint8), max_search_distance=60), 1)
    return [base / "input_pair" / f"img_0{k}.tif" for k in (1, 2)], dsm


def test_two_orthos_of_a_stereo_pair_register(pair: tuple[list[Path], Path], tmp_path: Path) -> None:
    images, dsm = pair
    with rasterio.open(dsm) as file:
        left, bottom, right, top = file.bounds
    area = Area(None, 0.5, (left + 10, bottom + 10, right - 10, top - 10))
    made = []
    for path in images:
        given = Block(images=(path,), sensor="rpc", dem=dsm, dem_heights="ellipsoidal")
        made.append(make_ortho(given, area, tmp_path / path.name, RenderOptions()).path)
    found = against_reference(made[1], made[0], tile=32, reach=6)
    assert found["matched"] > 0.95 * found["tiles"] > 300
    assert found["registration_rms_px"] < 1.0
    assert found["registration_robust_rms_px"] < 1.0


def test_the_pair_is_related_by_tie_points(pair: tuple[list[Path], Path]) -> None:
    """Synthetic tie points of the real geometry: the part of a shift that makes lines of sight miss is found."""
    models = [of_image(path) for path in pair[0]]
    rng = np.random.default_rng(6)
    true = [models[0], models[1].with_values([1.5, -2.0, 0, 0, 0, 0])]
    surface = Dem.open(pair[1], heights="ellipsoidal")
    ground = image_to_ground(true[0], rng.uniform(300, 800, (60, 2)), surface)
    surface.close()
    ground = Transform(surface.crs, WGS84)(ground[np.isfinite(ground).all(axis=1)])
    count = len(ground)
    assert count > 20
    colrow = np.vstack([model.ground_to_image(ground) for model in true]) + rng.normal(0, 0.1, (2 * count, 2))
    sights = TieMeasurements(np.repeat([0, 1], count), np.tile(np.arange(count), 2), colrow)
    found = correct_by_ties(models, sights, sigma_px=0.1)
    assert found.rms_before > 5 * found.rms_after
    assert found.rms_after < 0.12
