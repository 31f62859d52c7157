"""RPCs fitted to other models, written, and read by GDAL: the same result."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import rasterio.shutil
import rpc_rig as rig
from rasterio.vrt import WarpedVRT
from rpc_rig import gdal

from geomosaic.errors import OutputError, OutputExistsError, SolveError
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.transform import Transform
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorModel, SensorRequest
from geomosaic.sensor.solve import image_to_height
from geomosaic_rpc import RpcModel, fit_rpc, write_tags, write_text
from geomosaic_rpc.model import WGS84

UTM = with_heights(parse_crs("EPSG:32633"), "ellipsoidal")
AERIAL = {"model": "brown", "k1": -0.008, "k2": 0.001, "p1": 1e-4, "p2": -1e-4}
"""Distortion of a mapping camera: 10 pixels in the corners."""


STRONG = {"model": "opencv", "k1": -0.05, "k2": 0.01, "p1": 4e-4, "p2": -3e-4}
"""62 pixels in the corners, 8 of them of fifth order."""


def frame(distortion: dict[str, Any], omega: float = 4.0) -> SensorModel:
    options = {
        "camera": {"focal_length": 20.0, "sensor_size": [24.0, 18.0], "distortion": distortion},
        "position": [500000.0, 5400000.0, 1500.0],
        "orientation": {"system": "opk", "omega": omega, "phi": -3.0, "kappa": 25.0},
        "ground_height": 450.0,
    }
    return registry.build("frame", SensorRequest("photo", (4000, 3000), options, UTM))


def off(model: SensorModel, fitted: RpcModel, low: float, high: float) -> float:
    """Largest distance in pixels at random places and heights, which the fit has not seen."""
    rng = np.random.default_rng(8)
    places = rng.uniform([0, 0], model.size, (500, 2))
    ground = image_to_height(model, places, rng.uniform(low, high, 500), WGS84)
    exact = model.ground_to_image(Transform(WGS84, model.crs)(ground))
    return float(np.hypot(*(fitted.ground_to_image(ground) - exact).T).max())


@pytest.mark.parametrize("omega", [4.0, 25.0])
@pytest.mark.parametrize("heights", [(400.0, 500.0), (200.0, 900.0)])
@pytest.mark.parametrize("distortion", [{"model": "none"}, AERIAL], ids=["ideal", "distorted"])
def test_a_frame_photo(distortion: dict[str, Any], heights: tuple[float, float], omega: float) -> None:
    model = frame(distortion, omega)
    fitted = fit_rpc(model, heights)
    apart = off(model, fitted.model, *heights)
    # A distortion of fifth order is beyond cubics; on an oblique photo of high relief it begins to show.
    limit = 0.02 if distortion is AERIAL and omega > 20.0 else 0.01
    assert max(apart, fitted.worst) < limit
    assert apart < 2.0 * fitted.worst + 1e-4  # what it says of itself is true
    if distortion["model"] == "none":
        assert apart < 1e-3


def test_a_lens_beyond_cubics_is_reported() -> None:
    model = frame(STRONG)
    fitted = fit_rpc(model, (200.0, 900.0))
    assert 0.02 < fitted.worst < 0.05
    assert off(model, fitted.model, 200.0, 900.0) < 1.2 * fitted.worst


def test_an_rpc_is_found_again() -> None:
    model = rig.model()
    fitted = fit_rpc(model, (-80.0, 920.0))
    assert fitted.worst < 1e-3
    assert off(model, fitted.model, -80.0, 920.0) < 1e-3


def test_heights_without_a_range_or_beyond_the_camera_are_refused() -> None:
    with pytest.raises(SolveError, match="are no box"):
        fit_rpc(frame({"model": "none"}), (400.0, 400.0))
    with pytest.raises(SolveError, match="the model sees ground at"):
        fit_rpc(frame({"model": "none"}), (2000.0, 2500.0))


def picture(path: Path) -> Path:
    """Pixels that tell where they come from."""
    rng = np.random.default_rng(4)
    width, height = rig.SIZE
    coarse = rng.integers(0, 255, (height // 100, width // 100), dtype=np.uint8)
    with rasterio.open(
        path, "w", driver="GTiff", dtype="uint8", count=1, width=width, height=height, tiled=True, compress="deflate"
    ) as file:
        file.write(np.kron(coarse, np.ones((100, 100), dtype=np.uint8)), 1)
    return path


REFINED = {
    "raw": np.zeros(6),
    "shift": np.array([3.25, -2.5, 0, 0, 0, 0]),
    "affine": np.array([3.25, -2.5, 1.2, -0.8, 0.5, 0.9]),
}


@pytest.mark.parametrize("kind", REFINED)
@pytest.mark.parametrize("how", [write_tags, write_text])
def test_gdal_takes_what_is_written(how: Any, kind: str, tmp_path: Path) -> None:
    image = picture(tmp_path / "scene.tif")
    model = rig.model("affine").with_values(REFINED[kind])
    how(model, image)
    ours, theirs = model.ground_to_image(rig.ground()), gdal(image, rig.ground())
    assert np.abs(ours - theirs).max() < (1e-3 if kind == "affine" else 1e-6)
    again = registry.build("rpc", SensorRequest("scene.tif", rig.SIZE, {}, None, ".", str(image)))
    assert np.abs(again.ground_to_image(rig.ground()) - theirs).max() < 1e-6


def test_the_pixels_are_left_alone(tmp_path: Path) -> None:
    image = picture(tmp_path / "scene.tif")
    with rasterio.open(image) as file:
        before = file.read()
    write_tags(rig.model(), image)
    with rasterio.open(image) as file:
        assert np.array_equal(file.read(), before)
    assert not list(tmp_path.glob("*.aux.xml"))


def test_gdal_warps_onto_the_same_place(tmp_path: Path) -> None:
    """One height: GDAL's rectified image, against pixels looked up at the place that the model gives."""
    image = picture(tmp_path / "scene.tif")
    model = rig.model().with_values(REFINED["shift"])
    write_tags(model, image)
    height = 300.0
    with (
        rasterio.open(image) as file,
        WarpedVRT(
            file, src_crs="EPSG:4326", crs="EPSG:4326", rpc_height=height, RPC_HEIGHT=height, tolerance=0.0
        ) as vrt,
    ):
        warped, transform = vrt.read(1), vrt.transform
        raw = file.read(1)
    rows, cols = np.mgrid[100 : warped.shape[0] - 100 : 37, 100 : warped.shape[1] - 100 : 37]
    lon = transform.c + transform.a * (cols.ravel() + 0.5)
    lat = transform.f + transform.e * (rows.ravel() + 0.5)
    at = model.ground_to_image(np.column_stack([lon, lat, np.full(lon.size, height)]))
    inside = ((at > 1.0) & (at < np.array(rig.SIZE) - 1.0)).all(axis=1)
    sure = inside & (np.abs(np.mod(at, 100.0) - 50.0) < 49.5).all(axis=1)  # half a pixel from an edge of the pattern
    col, row = np.floor(at[sure]).astype(int).T
    assert sure.sum() > 1000
    assert np.array_equal(warped[rows.ravel()[sure], cols.ravel()[sure]], raw[row, col])


def test_gdal_writes_the_rpc_into_a_nitf(tmp_path: Path) -> None:
    """GDAL writes the extension RPC00B; its LINE_OFF has no decimals, and 1499.5 becomes 1500."""
    image = picture(tmp_path / "scene.tif")
    write_tags(rig.model(), image)
    nitf = tmp_path / "scene.ntf"
    rasterio.shutil.copy(str(image), str(nitf), driver="NITF")
    for sidecar in tmp_path.glob("scene.ntf.*"):
        sidecar.unlink()
    image.unlink()
    made = registry.build("rpc", SensorRequest("scene.ntf", rig.SIZE, {}, None, ".", str(nitf)))
    away = made.ground_to_image(rig.ground()) - rig.model().ground_to_image(rig.ground())
    assert np.abs(away - [0.0, 0.5]).max() < 1e-3
    assert np.abs(made.ground_to_image(rig.ground()) - gdal(nitf, rig.ground())).max() < 1e-6


def test_files_that_cannot_be_written(tmp_path: Path) -> None:
    image = picture(tmp_path / "scene.tif")
    write_text(rig.model(), image)
    with pytest.raises(OutputExistsError):
        write_text(rig.model(), image)
    write_text(rig.model(), image, overwrite=True)
    other = tmp_path / "scene.txt"
    other.write_text("no raster")
    with pytest.raises(OutputError, match="cannot be written into this file"):
        write_tags(rig.model(), other)
