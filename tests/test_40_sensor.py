"""The parameters, and the conformance kit: sound models pass it, and every broken one fails where it is broken."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
import pytest
from solve_rig import Camera, CameraWithRays, camera, control, scanner

from geomosaic.errors import InputError, SensorInputError
from geomosaic.sensor.plugin import Capabilities, ControlUse, Parameters, SensorInput, SensorRequest
from geomosaic.testing import SensorModelTests, check_plugin, failures
from geomosaic.types import FloatArray


class TestCamera(SensorModelTests):
    @pytest.fixture
    def model(self) -> Camera:
        return camera(omega=10.0)

    @pytest.fixture
    def ground(self, model: Camera) -> FloatArray:
        return control(model, 20)


class TestCameraWithRays(TestCamera):
    @pytest.fixture
    def model(self) -> CameraWithRays:
        return CameraWithRays(camera(kappa=170.0).values)


class TestScanner(TestCamera):
    @pytest.fixture
    def model(self) -> Camera:
        return scanner()


GROUND = control(camera(), 20)


class Mutating(Camera):
    def with_values(self, values: FloatArray) -> Self:
        object.__setattr__(self, "values", np.array(values))
        return self


class Sharing(Camera):
    def with_values(self, values: FloatArray) -> Self:
        return type(self)(values, self.size, self.sigmas)

    @property
    def parameters(self) -> Parameters:
        given = super().parameters
        object.__setattr__(given, "values", self.values)
        return given


class Spoilt(Camera):
    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        image = super().ground_to_image(xyz)
        return image if np.isfinite(image).all() else np.full_like(image, np.nan)


class Raising(Camera):
    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        if np.isnan(xyz).any():
            raise ValueError("NaN")
        return super().ground_to_image(xyz)


class Crowded(Camera):
    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        return super().ground_to_image(xyz) + 0.01 * len(xyz)


class Single(Camera):
    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        return super().ground_to_image(xyz).astype(np.float32)


class Swapped(Camera):
    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        return super().ground_to_image(xyz).T


class Clipped(Camera):
    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        return np.clip(super().ground_to_image(xyz), 0.0, self.size)


class NaNOutside(Camera):
    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        image = super().ground_to_image(xyz)
        inside = ((image >= 0.0) & (image <= self.size)).all(axis=1)
        return np.where(inside[:, None], image, np.nan)


class Moody(Camera):
    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        return super().ground_to_image(xyz) + np.random.default_rng().normal(0.0, 1e-9, (len(xyz), 2))


class Writing(Camera):
    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        image = super().ground_to_image(xyz)
        xyz -= 1.0
        return image


BUFFER = np.zeros((100_000, 2))


class Buffered(Camera):
    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        BUFFER[: len(xyz)] = super().ground_to_image(xyz)
        return BUFFER[: len(xyz)]


class Rounded(Camera):
    def to_dict(self) -> dict[str, Any]:
        return super().to_dict() | {"values": [round(float(value), 6) for value in self.values + 1e-7]}


class Arrays(Camera):
    def to_dict(self) -> dict[str, Any]:
        return super().to_dict() | {"values": self.values}


class Infinite(Camera):
    def to_dict(self) -> dict[str, Any]:
        return super().to_dict() | {"sigmas": list(self.sigmas)}


class Huge(Camera):
    @property
    def parameters(self) -> Parameters:
        given = super().parameters
        return Parameters(given.names, given.units, given.values, given.sigmas, given.steps * 1e4)


class Twins(Camera):
    @property
    def parameters(self) -> Parameters:
        given = super().parameters
        return Parameters(("up",) * 7, given.units, given.values, given.sigmas, given.steps)


class Negative(Camera):
    @property
    def parameters(self) -> Parameters:
        given = super().parameters
        return Parameters(given.names, given.units, given.values, given.sigmas - 1.0, given.steps)


class Astray(Camera):
    @property
    def seed(self) -> tuple[float, float, float]:
        x, y, z = super().seed
        return x + 1e4, y, z


class WrongSlope(Camera):
    def jacobian(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        from geomosaic.sensor.solve.newton import difference_jacobian

        by_parameters, by_ground = difference_jacobian(self, xyz)
        by_parameters[:, :, 4] *= 1.0 + 5e-7
        return by_parameters, by_ground


class WrongRays(CameraWithRays):
    def rays(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        return super().rays(colrow + 0.01)


class BackwardRays(CameraWithRays):
    def rays(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        origins, directions = super().rays(colrow)
        return origins, -directions


class LongRays(CameraWithRays):
    def rays(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        origins, directions = super().rays(colrow)
        return origins, 2.0 * directions


class Degenerate(Camera):
    """Phi acts like a shift to the east: nothing can tell them apart."""

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        values = self.values.copy()
        values[0] += 30.0 * (values[4] + 3.0)
        values[4] = -3.0
        return Camera(values).ground_to_image(xyz)


class Deaf(Camera):
    """It takes kappa and does nothing with it."""

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        return Camera(np.r_[self.values[:5], 40.0, self.values[6]]).ground_to_image(xyz)


@pytest.mark.parametrize(
    ("broken", "test", "says"),
    [
        (Mutating, "test_with_values", "changes the model"),
        (Sharing, "test_with_values", "shares its values"),
        (Spoilt, "test_bad_points_are_nan", "changes the image of others"),
        (Raising, "test_bad_points_are_nan", "makes ground_to_image raise"),
        (Crowded, "test_points_are_independent", "another image than among others"),
        (Single, "test_shapes", "float32"),
        (Swapped, "test_shapes", "has shape"),
        (Clipped, "test_smooth_across_the_edge", "smoothly"),
        (NaNOutside, "test_smooth_across_the_edge", "NaN at the edge"),
        (Moody, "test_deterministic", "differ"),
        (Writing, "test_pure", "changes the array"),
        (Buffered, "test_pure", "changes the result of an earlier"),
        (Buffered, "test_threads", "threads"),
        (Rounded, "test_state", "maps points elsewhere"),
        (Arrays, "test_state", "not plain JSON"),
        (Infinite, "test_state", "not plain JSON"),
        (Huge, "test_steps_are_about_a_pixel", "not by about one"),
        (Twins, "test_parameters", "same name"),
        (Negative, "test_parameters", "sigma"),
        (Astray, "test_seed_is_visible", "seed falls on"),
        (WrongSlope, "test_jacobian", "phi"),
        (WrongRays, "test_rays", "not mapped onto"),
        (WrongRays, "test_rays_agree_with_the_general_inverse", "other ground points"),
        (BackwardRays, "test_rays", "away from the ground"),
        (LongRays, "test_rays", "not unit vectors"),
        (Degenerate, "test_resection", "apart"),
        (Deaf, "test_resection", "say nothing about kappa"),
    ],
)
def test_broken_models_fail(broken: type[Camera], test: str, says: str) -> None:
    found = failures(broken(camera().values), GROUND.copy())
    assert test in found
    assert says in found[test]


def test_missing_member_fails() -> None:
    class Half:
        crs = camera().crs
        size = (10, 10)
        seed = camera().seed
        parameters = camera().parameters

    assert "lacks a member" in failures(Half(), GROUND)["test_members"]


def test_ground_of_another_place_fails() -> None:
    assert "do not fall inside" in failures(camera(), GROUND + 5000.0)["test_ground_is_visible"]


def test_sound_models_have_no_failures() -> None:
    assert failures(camera(), GROUND) == {}


class SoundPlugin:
    name = "good"
    summary = "a camera"
    inputs = (SensorInput("height", "flying height", "m"),)
    capabilities = Capabilities()
    model = Camera

    def build(self, request: SensorRequest) -> Camera:
        unknown = set(request.options) - {"height"}
        if unknown:
            raise SensorInputError(f"no input {unknown}", name=unknown.pop(), where=request.image)
        if "height" not in request.options:
            raise InputError("'height' is missing", where=request.image)
        return camera()


EXAMPLE = SensorRequest("an image", camera().size, {"height": 900.0}, camera().crs)


class Taciturn(SoundPlugin):
    def build(self, request: SensorRequest) -> Camera:
        if set(request.options) != {"height"}:
            raise InputError("no")
        return camera()


class Nameless(SoundPlugin):
    def build(self, request: SensorRequest) -> Camera:
        if set(request.options) != {"height"}:
            raise InputError("no", where=request.image)
        return camera()


class Crashing(SoundPlugin):
    def build(self, request: SensorRequest) -> Camera:
        request.options["height"]
        return camera()


class Careless(SoundPlugin):
    """Says what is missing, and takes what it does not know."""

    def build(self, request: SensorRequest) -> Camera:
        if "height" not in request.options:
            raise InputError("'height' is missing", where=request.image)
        return camera()


class Vague(SoundPlugin):
    """Names the unknown input in its text only."""

    def build(self, request: SensorRequest) -> Camera:
        try:
            return super().build(request)
        except SensorInputError as error:
            raise InputError(error.what, where=error.where) from None


def declaring(**changes: Any) -> SoundPlugin:
    """Plugin with other capabilities."""
    return type("Declaring", (SoundPlugin,), {"capabilities": Capabilities(**changes)})()


def listing(name: str) -> SoundPlugin:
    """Plugin with one input more."""
    return type("Listing", (SoundPlugin,), {"inputs": (*SoundPlugin.inputs, SensorInput(name, "x"))})()


class Picky(SoundPlugin):
    def build(self, request: SensorRequest) -> Camera:
        raise InputError("no", where=request.image)


class Stranger(SoundPlugin):
    def build(self, request: SensorRequest) -> Any:
        return object()


class Cropping(SoundPlugin):
    def build(self, request: SensorRequest) -> Camera:
        super().build(request)
        return Camera(camera().values, size=(10, 10))


@pytest.mark.parametrize(
    ("plugin", "says"),
    [
        (Taciturn(), "does not name the image"),
        (Nameless(), "does not name the input"),
        (Crashing(), "a missing 'height' makes build raise KeyError"),
        (Picky(), "refuses the example"),
        (Stranger(), "gives a object"),
        (Cropping(), "has the size"),
        (type("Sparing", (SoundPlugin,), {"inputs": (SensorInput("width", "x"),)})(), "does not list"),
        (Careless(), "without a word"),
        (object(), "no 'name'"),
        (type("Two", (SoundPlugin,), {"name": "two words"})(), "not one word"),
        (type("Long", (SoundPlugin,), {"summary": "one\ntwo"})(), "not one line"),
        (type("Dict", (SoundPlugin,), {"inputs": {"height": 1}})(), "not a tuple"),
        (type("Twice", (SoundPlugin,), {"inputs": SoundPlugin.inputs * 2})(), "same name"),
        (type("Mute", (SoundPlugin,), {"inputs": (SensorInput("height", " "),)})(), "no text"),
        (declaring(planar=True), "need the inputs points, transform"),
        (declaring(control=ControlUse.ADJUSTMENT), "need the inputs points, refine"),
        (declaring(exterior=("attitude",)), "capabilities.exterior has attitude"),
        (type("Loose", (SoundPlugin,), {"capabilities": {}})(), "is not a geomosaic.sensor.plugin.Capabilities"),
        (listing("ground_height"), "no capability tells the program that there is an input ground_height"),
        (Vague(), "no SensorInputError"),
        (type("Empty", (SoundPlugin,), {"model": object})(), "has no 'ground_to_image'"),
    ],
)
def test_a_broken_plugin_fails_in_words(plugin: Any, says: str) -> None:
    with pytest.raises(AssertionError, match=says):
        check_plugin(plugin, EXAMPLE)


def test_a_sound_plugin_passes() -> None:
    check_plugin(SoundPlugin(), EXAMPLE)


def test_parameters_are_frozen() -> None:
    given = np.array([1.0, 2.0])
    parameters = Parameters(("a", "b"), ("m", "deg"), given, np.array([0.0, np.inf]), np.ones(2))
    given[0] = 7.0
    assert parameters.values[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        parameters.values[0] = 3.0
    other = parameters.with_values(np.array([5.0, 6.0]))
    assert other.values.tolist() == [5.0, 6.0]
    assert parameters.values.tolist() == [1.0, 2.0]
    with pytest.raises(ValueError, match="shape"):
        parameters.with_values(np.ones(3))
