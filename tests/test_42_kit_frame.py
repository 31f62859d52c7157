"""The kit and the general solvers on frame cameras made through the registry."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pyproj import CRS
from solve_rig import MAP, PLACE, Hills, control, pixels

from geomosaic.geo.transform import Transform
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorModel, SensorRequest
from geomosaic.sensor.solve import image_to_ground, jacobian, resect
from geomosaic.sensor.solve.inverse import SightLines, first_meeting
from geomosaic.sensor.solve.newton import difference_jacobian
from geomosaic.testing import SensorModelTests, check_plugin
from geomosaic.types import FloatArray

LENSES: dict[str, dict[str, Any]] = {
    "none": {"model": "none"},
    "opencv": {"model": "opencv", "k1": -0.05, "k2": 0.01, "p1": 4e-4, "p2": -3e-4},
    "fisheye": {"model": "fisheye", "k1": -0.02, "k2": 0.002},
    "additional": {"model": "brown", "k1": -0.02},
    "rolling": {"model": "brown", "k1": -0.02},
}
# A low jet: 3 m and half a degree during the readout.
MOVING = {"velocity": [80.0, 50.0, -10.0], "sigmas": {"motion": 1e4, "turn": 1e4}}
ADDITIONAL = {"model": "ebner", "base": 1500.0, "b1": 2.0, "b3": -1.0, "b9": 1.5, "b12": 0.8}


def request(lens: str, treatment: str = "rigorous", omega: float = 4.0, crs: CRS = MAP) -> SensorRequest:
    return SensorRequest(
        "photo",
        (4000, 3000),
        {
            "camera": {
                "focal_length": 20.0,
                "sensor_size": [24.0, 18.0],
                "distortion": LENSES[lens],
                **({"additional": ADDITIONAL} if lens == "additional" else {}),
                **({"rolling_shutter": {"readout_time": 0.03, "direction": "up"}} if lens == "rolling" else {}),
            },
            **(MOVING if lens == "rolling" else {}),
            "position": [*PLACE[:2], 1500.0],
            "orientation": {"system": "opk", "omega": omega, "phi": -3.0, "kappa": 25.0},
            "ground_height": 450.0,
            "treatment": treatment,
        },
        crs,
    )


def frame(lens: str, treatment: str = "rigorous", omega: float = 4.0, crs: CRS = MAP) -> SensorModel:
    model = registry.build("frame", request(lens, treatment, omega, crs))
    if lens != "rolling":
        return model
    return model.with_values(np.concatenate([model.parameters.values[:9], [0.3, -0.2, 0.5]]))


CASES = [(lens, "rigorous") for lens in LENSES] + [("opencv", "planar")]


@pytest.mark.parametrize(("lens", "treatment"), CASES)
class TestContract(SensorModelTests):
    @pytest.fixture
    def model(self, lens: str, treatment: str) -> SensorModel:
        return frame(lens, treatment)

    @pytest.fixture
    def ground(self, model: SensorModel) -> FloatArray:
        return control(model, 20)


def test_the_plugin_passes_the_check() -> None:
    check_plugin(registry.plugin("frame"), request("opencv"))


@pytest.mark.parametrize("omega", [4.0, 45.0])
@pytest.mark.parametrize(("lens", "treatment"), CASES)
def test_rays_and_the_general_inverse_agree_on_hills(lens: str, treatment: str, omega: float) -> None:
    model, surface = frame(lens, treatment, omega), Hills()
    image = pixels(model)
    general = first_meeting(SightLines.of(model, image, MAP), surface)
    short = image_to_ground(model, image, surface)
    np.testing.assert_allclose(short, general, atol=1e-5)
    seen = np.isfinite(short).all(axis=1)
    assert seen.mean() > 0.95
    back = model.ground_to_image(Transform(MAP, model.crs)(short[seen]))
    np.testing.assert_allclose(back, image[seen], atol=1e-6)


@pytest.mark.parametrize(("lens", "treatment"), CASES)
def test_closed_derivatives_are_those_of_differences(lens: str, treatment: str) -> None:
    model = frame(lens, treatment)
    points = control(model, 20)
    for closed, measured in zip(jacobian(model, points), difference_jacobian(model, points), strict=True):
        np.testing.assert_allclose(closed, measured, atol=1e-6 * np.abs(measured).max(axis=(0, 1)).max())


def test_resection_by_the_plugin() -> None:
    model = frame("opencv")
    ground = control(model, 20)
    steps = model.parameters.steps
    start = model.with_values(model.parameters.values + 100.0 * steps * np.array([1, -1, 1, 1, -1, 1]))
    solved = resect(start, ground, model.ground_to_image(ground))
    assert np.abs(solved.residuals).max() < 1e-7
    off = np.abs(solved.model.parameters.values - model.parameters.values) / steps
    assert off.max() < 1e-7
