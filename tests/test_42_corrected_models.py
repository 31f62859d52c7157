"""Corrected models keep the sensor contract, with rays and without, wrapped once and twice."""

from __future__ import annotations

import json

import numpy as np
import pytest
from solve_rig import control
from test_41_planar import SIZE, bent, ground3, scattered
from test_42_kit_frame import frame

from geomosaic.sensor import corrected as state_of
from geomosaic.sensor.corrected import Corrected, CorrectionGrid
from geomosaic.sensor.plugin import HasRays, SensorModel
from geomosaic.testing import SensorModelTests
from geomosaic.types import FloatArray


def smooth(size: tuple[int, int], amplitude: float = 3.0, method: str = "bicubic") -> CorrectionGrid:
    """A wave of some pixels over the image, nodes every 200 pixels."""
    columns, rows = (-(-n // 200) + 1 for n in size)
    c, r = np.meshgrid(np.arange(columns) * 200.0, np.arange(rows) * 200.0)
    nodes = amplitude * np.dstack([np.sin(c / 900.0 + 1.0) * np.cos(r / 700.0), np.cos((c + r) / 800.0)])
    return CorrectionGrid([0.0, 0.0], [200.0, 200.0], nodes, method, "held")


class TestAroundAFrame(SensorModelTests):
    @pytest.fixture
    def model(self) -> SensorModel:
        inner = frame("opencv")
        return Corrected.of(inner, smooth(inner.size), "frame")

    @pytest.fixture
    def ground(self, model: SensorModel) -> FloatArray:
        points = control(model, 20)
        image = model.ground_to_image(points)
        return points[((image > 0.0) & (image < np.array(model.size))).all(axis=1)]


@pytest.mark.parametrize(("kind", "order"), [("affine", 1), ("projective", 1), ("polynomial", 3)])
class TestAroundAPlane(SensorModelTests):
    @pytest.fixture
    def model(self, kind: str, order: int) -> SensorModel:
        return Corrected.of(bent(kind, order, *scattered()), smooth(SIZE), "planar")

    @pytest.fixture
    def ground(self, model: SensorModel) -> FloatArray:
        points = ground3(scattered()[0])
        image = model.ground_to_image(points)
        return points[((image > 1.0) & (image < np.array(SIZE) - 1.0)).all(axis=1)]


def test_the_correction_is_added_where_the_ideal_point_lies() -> None:
    inner = bent("affine", 1, *scattered())
    model = Corrected.of(inner, smooth(SIZE), "planar")
    ground = ground3(scattered()[0])
    ideal = inner.ground_to_image(ground)
    np.testing.assert_array_equal(model.ground_to_image(ground), ideal + smooth(SIZE).at(ideal))


def test_rays_only_where_the_model_has_them() -> None:
    """The way back is exact to 1e-9 pixel."""
    plane, camera = bent("affine", 1, *scattered()), frame("opencv")
    assert not isinstance(Corrected.of(plane, smooth(SIZE), "planar"), HasRays)
    model = Corrected.of(camera, smooth(camera.size), "frame")
    assert isinstance(model, HasRays)
    colrow = np.random.default_rng(2).uniform([0.0, 0.0], camera.size, (500, 2))
    origins, directions = model.rays(colrow)
    back = model.ground_to_image(origins + 900.0 * directions)
    # The camera's own undistortion is part of the way; its share is what it misses without the grid.
    bare_origins, bare = camera.rays(colrow)
    own = np.abs(camera.ground_to_image(bare_origins + 900.0 * bare) - colrow).max()
    assert np.abs(back - colrow).max() < 1e-9 + 2.0 * own


def test_state_through_the_registry_also_twice() -> None:
    camera = frame("opencv")
    once = Corrected.of(camera, smooth(camera.size), "frame")
    twice = Corrected.of(once, smooth(camera.size, 1.0, "bilinear"), "frame")
    ground = control(camera, 20)
    for model in (camera, once, twice):
        state = json.loads(json.dumps(state_of.model_to_dict("frame", model)))
        assert state["sensor"] == "frame"
        back = state_of.model_from_dict(state)
        assert type(back) is type(model)
        np.testing.assert_array_equal(back.ground_to_image(ground), model.ground_to_image(ground))
