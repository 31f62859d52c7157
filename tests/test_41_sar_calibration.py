"""Calibration of radar: tables of Sentinel-1 with either form of noise, constants of TerraSAR-X and JSON tables."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from sar_annotation_rig import calibration, noise, sentinel1_detected, terrasar
from sar_rig import Scene, geocentric, lonlat
from scipy.interpolate import RegularGridInterpolator

import geomosaic as gm
from geomosaic.errors import InputError
from geomosaic.sensor.plugin import SensorRequest
from geomosaic_sar.build import build_sar
from geomosaic_sar.entry_point import INPUTS
from geomosaic_sar.model import SarModel
from geomosaic_sar.sentinel1_calibration import read_calibration_bytes, read_noise_bytes

SCENE = Scene(size=(300, 260))
LINES, PIXELS = np.array([-40.0, 90.0, 200.0, 310.0]), np.array([0.0, 40.0, 80.0, 200.0, 299.0])
RANDOM = np.random.default_rng(8)
TABLES = {
    name: RANDOM.uniform(200.0, 600.0, (len(LINES), len(PIXELS)))
    for name in ("sigmaNought", "betaNought", "gamma", "dn")
}
NOISE = RANDOM.uniform(20.0, 80.0, (len(LINES), len(PIXELS)))
PARTS = [
    ((0, 0, 129, 149), np.array([0.0, 60.0, 129.0]), np.array([1.2, 0.8, 1.1])),
    ((130, 0, 259, 149), np.array([130.0, 259.0]), np.array([0.7, 0.9])),
    ((0, 150, 259, 299), np.array([0.0, 259.0]), np.array([1.5, 1.3])),
]
ELEMENTS = {"beta0": "betaNought", "sigma0": "sigmaNought", "gamma0": "gamma"}


def _between(table: np.ndarray) -> np.ndarray:
    """Bilinear values at all pixels, by another program."""
    rows, cols = np.meshgrid(np.arange(SCENE.size[1]), np.arange(SCENE.size[0]), indexing="ij")
    return RegularGridInterpolator((LINES, PIXELS), table)(np.stack([rows, cols], axis=-1))


def _product(folder: Path, **changed: str) -> Path:
    """Product of Sentinel-1 with its folders: the image, annotation, calibration and noise."""
    lon, lat = SCENE.middle()
    off = np.linspace(-0.008, 0.008, 6)
    files = {
        "annotation/a-vv.xml": sentinel1_detected(SCENE, geocentric(lon + off, lat + off, 0 * off)).xml(),
        "annotation/calibration/calibration-a-vv.xml": calibration(LINES, PIXELS, TABLES),
        "annotation/calibration/noise-a-vv.xml": noise(LINES, PIXELS, NOISE, PARTS),
        **changed,
    }
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if text:
            (folder / name).write_text(text)
    image = folder / "measurement" / "a-vv.tiff"
    image.parent.mkdir()
    values = np.random.default_rng(2).integers(60, 400, (1, SCENE.size[1], SCENE.size[0])).astype(np.uint16)
    with rasterio.open(
        image, "w", driver="GTiff", width=SCENE.size[0], height=SCENE.size[1], count=1, dtype="uint16"
    ) as file:
        file.write(values)
    return image


def _model(image: Path, size: tuple[int, int] = SCENE.size, **options: Any) -> SarModel:
    return build_sar(SensorRequest(image.name, size, options, None, str(image.parent), str(image)))


def _terms(model: SarModel) -> tuple[np.ndarray, np.ndarray]:
    assert model.calibration is not None
    width, height = model.size
    factor, offset = model.calibration.at(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.broadcast_to(factor, (height, width)), np.broadcast_to(offset, (height, width))


@pytest.mark.parametrize("kind", ELEMENTS)
def test_sentinel1_is_calibrated_by_its_tables_bilinear_between_their_nodes(tmp_path, kind):
    factor, offset = _terms(_model(_product(tmp_path), calibration=kind))
    assert factor == pytest.approx(_between(TABLES[ELEMENTS[kind]]) ** -2.0, rel=1e-6)
    assert not offset.any()


@pytest.mark.parametrize("form", ["old", "new"])
def test_thermal_noise_of_either_form_is_taken_off(tmp_path, form):
    expected = _between(NOISE)
    changed = {}
    if form == "old":
        changed["annotation/calibration/noise-a-vv.xml"] = noise(LINES, PIXELS, NOISE)
    else:
        for (top, left, bottom, right), lines, factors in PARTS:
            part = np.s_[top : bottom + 1, left : right + 1]
            expected[part] *= np.interp(np.arange(top, bottom + 1), lines, factors)[:, None]
    factor, offset = _terms(_model(_product(tmp_path, **changed), calibration="sigma0", noise_removal=True))
    assert -offset / factor == pytest.approx(expected, rel=3e-6)


def test_a_cut_scene_and_a_state_keep_the_calibration_of_their_pixels(tmp_path):
    image = _product(tmp_path)
    options = {"calibration": "gamma0", "noise_removal": True}
    whole = _model(image, **options)
    cut = _model(image, (90, 120), offset=[100, 70], **options)
    again = SarModel.from_dict(json.loads(json.dumps(cut.to_dict())))
    for one, other in zip(_terms(whole), _terms(again), strict=True):
        assert other == pytest.approx(one[70:190, 100:190], rel=3e-6)
    assert "gamma nought, without thermal noise" in whole.notes


def test_an_ortho_holds_the_mean_of_calibrated_powers(tmp_path):
    """Of pixels that it averages: power first, then the mean, whatever the values; noise taken off before."""
    image = _product(tmp_path)
    with rasterio.open(image) as file:
        values = file.read(1).astype(float)
    scene = gm.Scene(image, "sar", options={"calibration": "sigma0", "noise_removal": True}, height=0.0,
                     dem_heights="ellipsoidal")  # fmt: skip
    made = gm.ortho(scene, tmp_path / "out.tif", resampling="average", resolution=60.0)
    factor, offset = _terms(_model(image, calibration="sigma0", noise_removal=True))
    expected = (factor * values**2 + offset).mean()
    assert made.read().mean() == pytest.approx(expected, rel=0.02)
    with rasterio.open(tmp_path / "out.tif") as file:
        assert (file.dtypes[0], file.descriptions[0], file.units[0]) == (
            "float32", "sigma nought (m2/m2)", "m2/m2",
        )  # fmt: skip
    mosaic = gm.mosaic(scene, tmp_path / "mosaic.tif", resampling="average", resolution=60.0)
    assert mosaic.read().mean() == pytest.approx(made.read().mean(), rel=1e-3)
    with rasterio.open(tmp_path / "mosaic.tif") as file:
        assert (file.dtypes[0], file.descriptions[0]) == ("float32", "sigma nought (m2/m2)")
    with pytest.raises(InputError, match="is power already"):
        gm.ortho(scene, tmp_path / "rms.tif", resampling="rms", resolution=60.0)
    assert not (tmp_path / "rms.tif").exists()


def test_images_of_two_quantities_become_no_mosaic(tmp_path):
    image = _product(tmp_path)
    other = image.with_name("b-vv.tiff")
    other.write_bytes(image.read_bytes())
    block = gm.Block(
        [image, other], "sar", options={"metadata": "../annotation/a-vv.xml", "calibration": "sigma0"},
        image_options={"b-vv.tiff": {"calibration": "beta0"}}, base=image.parent, height=0.0,
        dem_heights="ellipsoidal",
    )  # fmt: skip
    with pytest.raises(InputError, match=r"holds beta nought, 'a-vv.tiff' holds sigma nought"):
        gm.mosaic(block, tmp_path / "mosaic.tif", resolution=60.0)


def _incidence(cols: np.ndarray, row: float) -> np.ndarray:
    """Angles between the line of sight and the ellipsoid's normal at a height of 300 m, by bisection and geodesy."""
    angles = []
    for col in cols:
        moved = replace(
            SCENE, near=SCENE.near + (col - 150.0) * SCENE.spacing, first_row=SCENE.first_row
            + (row - 130.0) * SCENE.row_interval,
        )  # fmt: skip
        lon, lat = moved.middle(300.0)
        point = geocentric(np.array([lon]), np.array([lat]), np.array([300.0]))[0]
        sensor = SCENE.orbit.at(SCENE.first_row + (row - 0.5) * SCENE.row_interval)[0]
        up = geocentric(np.array([lon]), np.array([lat]), np.array([400.0]))[0] - point
        line = sensor - point
        angles.append(np.arccos(line @ up / (np.linalg.norm(line) * np.linalg.norm(up))))
    assert lonlat(point)[2] == pytest.approx(300.0, abs=1e-3)
    return np.array(angles)


def test_terrasar_is_calibrated_by_its_factor_and_the_incidence_angle(tmp_path):
    (tmp_path / "x.xml").write_text(terrasar(SCENE, factors={"HH": 1.1e-5, "VV": 2.2e-5}))
    image = tmp_path / "IMAGE_VV_SRA_strip.tif"
    cols = np.array([0.5, 77.5, 150.5, 299.5])
    # Half a pixel: `_incidence` takes the middle of a scene for its point.
    angle = _incidence(cols - 0.5, 100.0)
    for kind, by in (("beta0", 1.0), ("sigma0", np.sin(angle)), ("gamma0", np.tan(angle))):
        found = _model(image, metadata="x.xml", calibration=kind, noise_removal=True).calibration
        factor, offset = found.at(cols, np.array([100.0]))
        factor = np.broadcast_to(factor, (1, 4))[0]
        assert factor == pytest.approx(np.broadcast_to(2.2e-5 * by, 4), rel=2e-6)
        delay = 2.0 / 299792458.0 * (cols - 0.5) * SCENE.spacing
        assert -offset[0] / factor == pytest.approx(40.0 + 2e5 * delay, rel=3e-6)
    with pytest.raises(InputError, match="polarisations HH, VV"):
        _model(tmp_path / "image.tif", metadata="x.xml", calibration="beta0")


def test_a_table_gives_any_quantity_by_number_or_by_column(tmp_path):
    known = {"quantity": "sigma0", "factor": [1e-5, 3e-5], "columns": [0.5, 299.5]}
    table = SCENE.table() | {"calibration": known, "ground_height": 300.0}
    (tmp_path / "scene.radar.json").write_text(json.dumps(table))
    image = tmp_path / "scene.tif"
    found = _model(image, metadata="scene.radar.json", calibration="sigma0").calibration
    assert found.at(np.array([0.5, 299.5]), np.array([3.0]))[0][0] == pytest.approx([1e-5, 3e-5])
    beta = _model(image, metadata="scene.radar.json", calibration="beta0").calibration
    angle = _incidence(np.array([0.0, 299.0]), 100.0)
    assert beta.at(np.array([0.5, 299.5]), np.array([100.0]))[0][0] == pytest.approx(
        np.array([1e-5, 3e-5]) / np.sin(angle), rel=1e-4
    )
    with pytest.raises(InputError, match="tell no thermal noise"):
        _model(image, metadata="scene.radar.json", calibration="beta0", noise_removal=True)
    SCENE.write(tmp_path)
    with pytest.raises(InputError, match="hold no calibration"):
        _model(image, metadata="scene.radar.json", calibration="beta0")


def test_missing_and_damaged_calibrations_are_refused_by_the_name_of_their_file(tmp_path):
    for number, (file, text, message) in enumerate(
        [
            ("calibration", "", "the calibration of the product does not exist"),
            ("noise", "", "the thermal noise of the product does not exist"),
            ("calibration", calibration(LINES, PIXELS, TABLES, "VH"), "polarisation VH, the scene is VV"),
            ("calibration", calibration(LINES[::-1], PIXELS, TABLES), "do not grow"),
            ("calibration", calibration(LINES, PIXELS, {**TABLES, "sigmaNought": 0 * NOISE}), "not above 0"),
            ("calibration", calibration(LINES, PIXELS[:3], TABLES), "5 values of <sigmaNought> at 3 pixels"),
            ("calibration", "<noise/>", "not <calibration>"),
            ("noise", noise(LINES, PIXELS, 0 * NOISE, PARTS), "0 everywhere"),
            ("noise", noise(LINES, PIXELS, -NOISE), "below 0"),
        ]
    ):
        image = _product(tmp_path / str(number), **{f"annotation/calibration/{file}-a-vv.xml": text})
        with pytest.raises(InputError) as caught:
            _model(image, calibration="sigma0", noise_removal=True)
        assert message in caught.value.what
        assert f"{file}-a-vv.xml" in caught.value.where
        assert caught.value.hint
        # What a hint names is an input of the sensor.
        named = set(re.findall(r"(\w+) = ", caught.value.hint))
        assert named <= {one.name for one in INPUTS}
        assert not ("not exist" in message or "everywhere" in message) or named
    with pytest.raises(InputError, match="would do nothing"):
        _model(image, noise_removal=True)
    with pytest.raises(InputError, match="calibration = 'sigma' is not known"):
        _model(image, calibration="sigma")


def test_a_project_notices_calibration_files_of_named_metadata(tmp_path):
    image = _product(tmp_path)
    image.rename(tmp_path / image.name)
    (tmp_path / "project.toml").write_text(
        f"""format = 1
project = {{ name = "radar", images = ["{image.name}"] }}
sensor = {{ name = "sar", metadata = "annotation/a-vv.xml", calibration = "sigma0" }}
dem = {{ height = 0.0, heights = "ellipsoidal" }}
output = {{ folder = "output", resolution = 60.0 }}
"""
    )
    corner = []
    for factor in (1.0, 2.0):
        tables = {name: factor * values for name, values in TABLES.items()}
        (tmp_path / "annotation/calibration/calibration-a-vv.xml").write_text(calibration(LINES, PIXELS, tables))
        gm.run_project(tmp_path / "project.toml", steps=("orient",))
        state = json.loads((tmp_path / "output/models/a-vv.tiff.json").read_text())["state"]
        corner.append(state["calibration"]["amplitude"]["values"][0][0])
    assert corner[1] == pytest.approx(2.0 * corner[0], rel=1e-6)


def test_readers_take_bytes_of_any_product():
    assert read_calibration_bytes(calibration(LINES, PIXELS, TABLES).encode(), "c.xml", "gamma0").values.shape == (4, 5)
    assert len(read_noise_bytes(noise(LINES, PIXELS, NOISE, PARTS).encode(), "n.xml").blocks) == 3
