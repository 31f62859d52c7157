"""Real SPOT and Pléiades metadata against points of other software, the files' own models and RPCs of others."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from pyproj import CRS, Geod

from geomosaic.geo.transform import Transform
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.solve import image_to_height
from geomosaic.types import FloatArray
from geomosaic_pushbroom.metadata import read_metadata
from geomosaic_pushbroom.model import PushbroomModel
from geomosaic_pushbroom.paths import AnglePath
from geomosaic_pushbroom.platform import ReportedFlight

LLH, ECEF = CRS.from_epsg(4979), CRS.from_epsg(4978)
Data = Callable[[str], Path]


def scene(file: Path) -> PushbroomModel:
    size = read_metadata(file).size
    model = registry.build("pushbroom", SensorRequest(file.name, size, {"metadata": file.name}, None, str(file.parent)))
    assert isinstance(model, PushbroomModel)
    return model


def closing(model: PushbroomModel, height: float) -> float:
    """Largest distance in pixels between image points and what inverse and forward model make of them."""
    image = grid(model.size)
    ground = image_to_height(model, image, height, LLH)
    return float(np.abs(model.ground_to_image(Transform(LLH, ECEF)(ground)) - image).max())


def grid(size: tuple[int, int], count: int = 5) -> FloatArray:
    """Image points from the first pixel's centre to the last one's."""
    c, r = (np.linspace(0.5, n - 0.5, count) for n in size)
    return np.stack(np.meshgrid(c, r), axis=-1).reshape(-1, 2)


def test_the_rigorous_spot_model_agrees_with_ossim(real_data: Data) -> None:
    """36 points both ways, each within 0.01 px. OSSIM's file counts columns 0.5 and rows 1 more than we do."""
    folder = real_data("otb-sensor-geoms") / "spot5"
    model = scene(folder / "spot5-1.geom")
    table = np.loadtxt(folder / "spot5-1.gcp")
    image, ground = table[:, :2] - [0.5, 1.0], table[:, [5, 6, 4]]
    assert len(table) == 36
    assert np.abs(model.ground_to_image(Transform(LLH, ECEF)(ground)) - image).max() < 1e-4
    back = image_to_height(model, image, ground[:, 2], LLH)
    metres = Transform(LLH, ECEF)(back) - Transform(LLH, ECEF)(ground)
    assert np.linalg.norm(metres, axis=1).max() < 1e-3  # 0.1 px would be 1 m


# Mean and standard deviation that were measured, metres east and north at height 0, against the simplified model of
# each file (a polynomial of degree 2, good to some metres). SPOT 1 to 4 have no star tracker.
FILES = {
    "SPOT1.DIM": (3.0, 10.0),
    "SP-2.DIM": (5.0, 6.0),
    "SPOT4.DIM": (20.0, 6.0),
    "SPOT5.DIM": (0.1, 0.8),
    "test_ortho_dataset/SP2_METADATA.DIM": (3.0, 10.0),
}


@pytest.mark.parametrize("name", FILES)
def test_footprints_against_the_simplified_model(real_data: Data, name: str) -> None:
    file = real_data("cosicorr-spot-dimap") / name
    off = off_the_simplified_model(scene(file), file)
    print(f"{name}: mean {off.mean(axis=0).round(1)}, standard deviation {off.std(axis=0).round(1)} m east, north")
    most, spread = FILES[name]
    assert np.abs(off.mean(axis=0)).max() < most
    assert off.std(axis=0).max() < spread


@pytest.mark.parametrize("name", [name for name in FILES if name != "SPOT5.DIM"])
def test_the_simplified_model_of_the_first_spots_has_no_attitude(real_data: Data, name: str) -> None:
    """The 17 m of SPOT 4 are its pitch of 20 µrad: without attitude 1 to 3 m are left, the same in all rows."""
    file = real_data("cosicorr-spot-dimap") / name
    told = scene(file)
    assert isinstance(told.platform, ReportedFlight)
    assert isinstance(told.platform.path, AnglePath)
    path = replace(told.platform.path, angles=np.zeros_like(told.platform.path.angles))
    off = off_the_simplified_model(replace(told, platform=replace(told.platform, path=path)), file)
    assert np.abs(off.mean(axis=0)).max() < 3.0
    assert np.ptp(off[:, 1].reshape(5, 5).mean(axis=1)) < 0.3


def off_the_simplified_model(model: PushbroomModel, file: Path) -> FloatArray:
    """Metres east and north (25, 2) from DIMAP's Direct_Location_Model: 1, l, p, l·p, l², p², line and pixel from 1."""
    direct = ElementTree.parse(file).getroot().find(".//Direct_Location_Model")
    assert direct is not None
    image = grid(model.size)
    p, line = (image + 0.5).T
    terms = np.stack([np.ones_like(p), line, p, line * p, line * line, p * p])
    lon, lat = ([float(e.text or "") for e in direct.findall(f"{n}_List/{n}")] @ terms for n in ("lc", "pc"))
    found = image_to_height(model, image, 0.0, LLH)
    azimuth, _, distance = Geod(ellps="WGS84").inv(lon, lat, found[:, 0], found[:, 1])
    off: FloatArray = distance[:, None] * np.column_stack([np.sin(np.radians(azimuth)), np.cos(np.radians(azimuth))])
    return off


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("height", [0.0, 2500.0])
def test_forward_and_inverse_close(real_data: Data, name: str, height: float) -> None:
    assert closing(scene(real_data("cosicorr-spot-dimap") / name), height) < 1e-6


@pytest.mark.parametrize("height", [0.0, 1000.0, 2000.0])
def test_an_early_spot_agrees_with_the_rpc_of_others(real_data: Data, height: float) -> None:
    """The rigorous model of COSI-Corr, seen through the RPC fitted to it; samples and lines count from 1."""
    folder = real_data("cosicorr-spot-dimap") / "test_ortho_dataset"
    model = scene(folder / "SP2_METADATA.DIM")
    words = dict(re.findall(r"(\w+):\s*(\S+)", (folder / "SP2_RPC.txt").read_text()))
    image = grid(model.size)
    ground = image_to_height(model, image, height, LLH)
    off = rpc({name: float(word) for name, word in words.items()}, ground) - (image + 0.5)
    assert np.abs(off).max() < 0.6
    assert np.abs(off.mean(axis=0)).max() < 0.1


@pytest.mark.parametrize(("name", "size"), [("WV1", (35180, 26828)), ("WV3", (35180, 23969))])
def test_worldview_agrees_with_the_rpc_in_the_same_file(real_data: Data, name: str, size: tuple[int, int]) -> None:
    """Its maker's rigorous model, seen through the RPC fitted to it; 'WV3' is another scene of WorldView-1."""
    file = str(real_data("rpcm-rpc-files") / "test_rpc_files" / f"rpc_{name}.xml")
    own = registry.build("pushbroom", SensorRequest("a.tif", size, {"metadata": file}))
    fitted = registry.build("rpc", SensorRequest("a.tif", size, {"rpc": file}))
    image = grid(size)
    for height in (0.0, 300.0):
        off = own.ground_to_image(Transform(LLH, own.crs)(image_to_height(fitted, image, height, LLH))) - image
        assert np.abs(off.mean(axis=0)).max() < 0.2
        assert off.std(axis=0).max() < 0.15


def rpc(k: dict[str, float], llh: FloatArray) -> FloatArray:
    """Sample and line (N, 2) by RPC00B."""
    lon, lat, h = ((llh[:, i] - k[f"{n}_OFF"]) / k[f"{n}_SCALE"] for i, n in enumerate(("LONG", "LAT", "HEIGHT")))
    image = []
    for name in ("SAMP", "LINE"):
        top, below = (
            [k[f"{name}_{part}_COEFF_{i}"] for i in range(1, 21)] @ cubic(lon, lat, h) for part in ("NUM", "DEN")
        )
        image.append(top / below * k[f"{name}_SCALE"] + k[f"{name}_OFF"])
    return np.column_stack(image)


def cubic(a: FloatArray, b: FloatArray, h: FloatArray) -> FloatArray:
    """The twenty terms of RPC00B, a standing for longitude and b for latitude."""
    return np.stack(
        [
            np.ones_like(a), a, b, h, a * b, a * h, b * h, a * a, b * b, h * h, a * b * h, a**3, a * b * b, a * h * h,
            a * a * b, b**3, b * h * h, a * a * h, b * b * h, h**3,
        ]
    )  # fmt: skip


@pytest.mark.parametrize("height", [100.0, 300.0, 500.0])
def test_pleiades_against_its_own_rpc(real_data: Data, height: float) -> None:
    """The direct RFM of the same file, another map of the same model."""
    (file,) = (real_data("shareloc-phr-grids") / "rpc").glob("PHRDIMAP_*.XML")
    model, root = scene(file), ElementTree.parse(file).getroot()

    def values(path: str) -> FloatArray:
        words = root.findtext(f".//Global_RFM/{path}")
        assert words is not None
        return np.array(words.split(), dtype=np.float64)

    def normal(name: str, x: FloatArray) -> FloatArray:
        return (x - values(f"RFM_Validity/{name}/B")) / values(f"RFM_Validity/{name}/A")

    image = grid(model.size)
    col, row = normal("Col", image[:, 0] + 0.5), normal("Row", image[:, 1] + 0.5)
    terms = cubic(col, row, normal("Alt", np.full(len(image), height)))
    place = []
    for axis, name in (("LON", "Lon"), ("LAT", "Lat")):
        c = values(f"Direct_Model/F_{axis}")
        scaled = (c[:20] @ terms) / (c[20:] @ terms)
        place.append(scaled * values(f"RFM_Validity/{name}/A") + values(f"RFM_Validity/{name}/B"))
    ground = np.column_stack([*place, np.full(len(image), height)])
    off = model.ground_to_image(Transform(LLH, ECEF)(ground)) - image
    assert np.abs(off).max() < 0.01
