"""Inverse, derivatives and resection of models that give only the required members."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS
from solve_rig import (
    FRAME,
    MAP,
    PLACE,
    Camera,
    CameraWithRays,
    Cliff,
    Hills,
    Level,
    camera,
    control,
    image_of,
    pixels,
    scanner,
)

from geomosaic.errors import HeightDatumError, InputError, SolveError
from geomosaic.geo.crs import geographic
from geomosaic.geo.transform import Transform
from geomosaic.sensor.solve import fit, image_to_ground, image_to_height, jacobian, resect
from geomosaic.sensor.solve.newton import difference_jacobian
from geomosaic.surface.dem import Dem

MODELS = {
    "near vertical": camera(),
    "oblique": camera(omega=35.0, phi=20.0, kappa=-100.0),
    "low": camera(up=400.0),
    "scanner": scanner(),
}


@pytest.fixture(params=list(MODELS))
def model(request: pytest.FixtureRequest) -> Camera:
    return MODELS[request.param]


def test_ground_at_a_height_is_imaged_on_the_same_pixel(model: Camera) -> None:
    image = pixels(model)
    heights = np.linspace(PLACE[2] - 300.0, PLACE[2] + 150.0, len(image))
    ground = image_to_height(model, image, heights, MAP)
    np.testing.assert_array_equal(ground[:, 2], heights)
    np.testing.assert_allclose(image_of(model, ground), image, atol=1e-7)


def test_height_in_degrees(model: Camera) -> None:
    image, crs = pixels(model), geographic(MAP)
    ground = image_to_height(model, image, 500.0, crs)
    np.testing.assert_allclose(image_of(model, ground, crs), image, atol=1e-7)


@pytest.mark.parametrize(
    "surface", [Level(437.5), Hills(), Hills(amplitude=30.0, length=80.0)], ids=["level", "hills", "bumps"]
)
def test_ground_closes_and_lies_on_the_surface(model: Camera, surface: Hills) -> None:
    image = pixels(model)
    ground = image_to_ground(model, image, surface)
    assert np.isfinite(ground).all()
    np.testing.assert_allclose(image_of(model, ground), image, atol=1e-7)
    np.testing.assert_allclose(surface.height(ground[:, :2]), ground[:, 2], atol=1e-6)


def test_known_ground_comes_back() -> None:
    """A nadir view of gentle hills hides nothing, so the way back ends where it began."""
    model, surface = camera(omega=1.0, phi=1.0), Hills(amplitude=40.0)
    xy = PLACE[:2] + np.random.default_rng(4).uniform(-350.0, 350.0, (200, 2))
    ground = np.column_stack([xy, surface.height(xy)])
    found = image_to_ground(model, image_of(model, ground), surface)
    np.testing.assert_allclose(found, ground, atol=1e-6)


def test_first_crossing_is_taken() -> None:
    """Straight lines in the camera's frame against a fine march over them: nothing of the surface lies above."""
    model, surface = camera(omega=45.0, phi=0.0, kappa=0.0), Cliff()
    model = model.with_values(np.r_[20.0, -1500.0, model.values[2:]])
    image = pixels(model, 300)
    ground = image_to_ground(model, image, surface)
    met = ground[np.isfinite(ground[:, 0])]
    on_top = met[:, 2] > PLACE[2] + 299.0
    assert on_top.sum() > 5
    origin = Transform(model.crs, MAP)(np.asarray(_centre(model))[None])[0]
    for share in np.linspace(0.3, 0.999, 400):
        between = origin + share * (met - origin)
        # The map bends straight lines by some millimetres here.
        assert (surface.height(between[:, :2]) < between[:, 2] + 0.1).all()


def _centre(model: Camera) -> np.ndarray:
    return FRAME.to_geocentric(model.values[None, :3])[0]


@pytest.mark.parametrize("name", ["near vertical", "oblique", "low"])
def test_rays_and_the_general_way_agree(name: str) -> None:
    model = MODELS[name]
    image, surface = pixels(model), Hills()
    with_rays = CameraWithRays(model.values, model.size)
    np.testing.assert_allclose(
        image_to_ground(with_rays, image, surface), image_to_ground(model, image, surface), atol=1e-5
    )


def test_surface_higher_than_the_camera() -> None:
    """The highest height of a DEM may lie above a low camera."""
    model = camera(up=300.0)
    surface = Hills(amplitude=50.0, spread=(PLACE[2] - 50.0, PLACE[2] + 3000.0))
    image = pixels(model)
    ground = image_to_ground(model, image, surface)
    assert np.isfinite(ground).all()
    np.testing.assert_allclose(image_of(model, ground), image, atol=1e-7)
    np.testing.assert_allclose(surface.height(ground[:, :2]), ground[:, 2], atol=1e-6)


def test_above_the_horizon_is_nan_and_spoils_nothing() -> None:
    model = camera(omega=75.0, phi=0.0, kappa=0.0)
    image = np.column_stack([np.full(61, 2000.0), np.linspace(0.0, 3000.0, 61)])
    image[7] = np.nan
    ground = image_to_ground(model, image, Level(PLACE[2]))
    # The optical axis looks 15 degrees down, so the horizon lies f tan 15° above the middle, less its own dip.
    horizon = 1500.0 - 3500.0 * np.tan(np.radians(15.0))
    seen = image[:, 1] > horizon + 150.0
    assert np.isfinite(ground[seen]).all()
    assert np.isnan(ground[image[:, 1] < horizon - 1.0]).all()
    assert np.isnan(ground[7]).all()
    np.testing.assert_allclose(image_of(model, ground[seen]), image[seen], atol=1e-6)


def test_unknown_heights_are_nan() -> None:
    model, surface = camera(), Hills(radius=300.0)
    image = pixels(model)
    ground = image_to_ground(model, image, surface)
    whole = image_to_ground(model, image, Hills())
    inside = np.hypot(*(whole[:, :2] - PLACE[:2]).T) < 300.0
    assert 0.1 < inside.mean() < 0.9
    np.testing.assert_array_equal(np.isfinite(ground).all(axis=1), inside)
    np.testing.assert_allclose(ground[inside], whole[inside], atol=1e-6)


@pytest.mark.parametrize("kind", [Camera, CameraWithRays])
def test_lines_that_come_from_under_the_known_heights_are_nan(kind: type[Camera]) -> None:
    """A table mountain known only within 150 m: what enters its disc below the top is not on its surface."""
    surface = Cliff(radius=150.0)
    model = kind(np.r_[20.0, -1500.0, camera(omega=45.0, phi=0.0, kappa=0.0).values[2:]])
    image = pixels(model, 3000)
    top = image_to_height(model, image, PLACE[2] + 300.0, MAP)
    ground = image_to_ground(model, image, surface)
    hit = np.hypot(*(top[:, :2] - PLACE[:2]).T) < 150.0
    assert hit.sum() > 20
    np.testing.assert_array_equal(np.isfinite(ground).all(axis=1), hit)
    np.testing.assert_allclose(ground[hit], top[hit], atol=1e-5)


def test_dem_through_rays_and_without(tmp_path: Path) -> None:
    """A DEM of 5 m nodes under the general march and under the rays of the same camera."""
    nodes = np.arange(300) * 5.0 + 2.5 - 750.0
    x, y = np.meshgrid(PLACE[0] + nodes, PLACE[1] - nodes)
    heights = Hills().height(np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape).astype(np.float32)
    place = Affine(5.0, 0.0, PLACE[0] - 750.0, 0.0, -5.0, PLACE[1] + 750.0)
    profile = {"driver": "GTiff", "width": 300, "height": 300, "count": 1, "dtype": "float32"}
    with rasterio.open(tmp_path / "dem.tif", "w", **profile, crs="EPSG:32633", transform=place) as file:
        file.write(heights, 1)
    surface = Dem.open(tmp_path / "dem.tif", heights="egm96")
    model = camera(omega=20.0, up=600.0)
    image = pixels(model)
    ground = image_to_ground(model, image, surface)
    short = image_to_ground(CameraWithRays(model.values), image, surface)
    np.testing.assert_allclose(short, ground, atol=1e-5)
    seen = np.isfinite(ground[:, 0])
    assert seen.mean() > 0.9
    np.testing.assert_allclose(surface.height(ground[seen, :2]), ground[seen, 2], atol=1e-6)


def test_models_without_heights_take_them_from_the_surface() -> None:
    class Flat(Camera):
        """The image of the map plane at zero height of `MAP`, in a horizontal CRS."""

        @property
        def crs(self) -> CRS:
            return CRS.from_epsg(32633)

        @property
        def seed(self) -> tuple[float, float, float]:
            return float(PLACE[0]), float(PLACE[1]), 0.0

        def ground_to_image(self, xyz: np.ndarray) -> np.ndarray:
            x, y = (np.asarray(xyz)[:, :2] - PLACE[:2]).T
            return np.column_stack([2000.0 + 2.0 * x + 1e-4 * y**2, 1500.0 - 2.0 * y])

    image = pixels(camera())
    flat, surface = Flat(camera().values), Hills(radius=400.0)
    ground = image_to_ground(flat, image, surface)
    y = (1500.0 - image[:, 1]) / 2.0
    xy = PLACE[:2] + np.column_stack([(image[:, 0] - 2000.0 - 1e-4 * y**2) / 2.0, y])
    inside = np.hypot(*(xy - PLACE[:2]).T) < 400.0
    np.testing.assert_allclose(ground[inside, :2], xy[inside], atol=1e-7)
    np.testing.assert_allclose(ground[inside, 2], surface.height(xy[inside]), atol=1e-6)
    assert np.isnan(ground[~inside]).all()
    np.testing.assert_allclose(image_to_ground(flat, image), np.column_stack([xy, np.zeros(len(xy))]), atol=1e-7)


def test_no_points_give_no_places() -> None:
    assert image_to_ground(camera(), np.zeros((0, 2)), Hills()).shape == (0, 3)


def test_surface_is_needed_and_its_heights_must_be_declared() -> None:
    with pytest.raises(InputError, match="need a surface"):
        image_to_ground(camera(), pixels(camera()))
    with pytest.raises(HeightDatumError, match="no vertical datum"):
        image_to_ground(camera(), pixels(camera()), Level(400.0, CRS.from_epsg(32633)))


def test_ground_derivatives_against_analysis() -> None:
    """At the foot of a vertical photo: f / h pixels per metre east, none per metre up."""
    model = camera(omega=0.0, phi=0.0, kappa=0.0)
    foot = FRAME.to_geocentric(np.array([[20.0, -30.0, 0.0]]))
    by_parameters, by_ground = jacobian(model, foot)
    local = by_ground[0] @ FRAME.axes.T
    scale = 3500.0 / 1500.0
    np.testing.assert_allclose(local, [[scale, 0, 0], [0, -scale, 0]], atol=2e-6)
    np.testing.assert_allclose(by_parameters[0][:, :2], [[-scale, 0], [0, scale]], atol=2e-6)
    # A turn tilts the axis north (omega) or west (phi): the foot moves down the image, or right.
    degree = 3500.0 * np.radians(1.0)
    np.testing.assert_allclose(by_parameters[0][:, 3:6], [[0, degree, 0], [degree, 0, 0]], rtol=1e-6, atol=1e-6)


def test_closed_form_is_used_where_there_is_one() -> None:
    class Closed(Camera):
        def jacobian(self, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return np.full((len(xyz), 2, 7), 4.0), np.full((len(xyz), 2, 3), 5.0)

    closed = Closed(camera().values)
    points = control(camera(), 4)
    assert (jacobian(closed, points)[0] == 4.0).all()
    assert not (difference_jacobian(closed, points)[0] == 4.0).any()


def rough(model: Camera, steps: float = 60.0) -> Camera:
    signs = np.array([1.0, -1.0, 1.0, -1.0, 1.0, 1.0, 0.0])
    return model.with_values(model.values + steps * signs * model.parameters.steps)


def test_resection_recovers_the_parameters(model: Camera) -> None:
    ground = control(model)
    truth = model.ground_to_image(ground)
    solved = resect(rough(model), ground, truth)
    assert np.abs(solved.residuals).max() < 1e-7
    off = np.abs(solved.model.values - model.values) / np.maximum(np.abs(model.values), model.parameters.steps)
    assert off.max() < 1e-9 * max(1.0, solved.condition / 10.0)
    assert solved.redundancy == 2 * len(ground) - 6
    assert solved.sigmas[6] == 0.0


def test_sigmas_are_the_scatter_of_noisy_trials() -> None:
    model = camera()
    ground = control(model, 12)
    truth = model.ground_to_image(ground)
    rng = np.random.default_rng(11)
    sigmas = np.where(np.arange(12) % 2, 0.3, 0.8)
    trials = [resect(model, ground, truth + rng.normal(size=(12, 2)) * sigmas[:, None], sigmas) for _ in range(300)]
    values = np.array([trial.model.values for trial in trials])
    np.testing.assert_allclose(values.std(axis=0)[:6], trials[0].sigmas[:6], rtol=0.1)
    correlation = np.corrcoef(values[:, 0], values[:, 4])[0, 1]
    predicted = trials[0].covariance[0, 4] / (trials[0].sigmas[0] * trials[0].sigmas[4])
    assert correlation == pytest.approx(predicted, abs=0.05)
    assert np.mean([trial.sigma0**2 for trial in trials]) == pytest.approx(1.0, abs=0.05)
    # Without sigmas the deviation is estimated from the residuals, and the covariance with it.
    alike = [resect(model, ground, truth + rng.normal(0.0, 0.5, (12, 2))) for _ in range(40)]
    assert np.mean([trial.sigma0 for trial in alike]) == pytest.approx(0.5, rel=0.1)
    free = resect(model, ground, truth, 0.5)
    assert np.mean([trial.sigmas[0] for trial in alike]) == pytest.approx(free.sigmas[0], rel=0.1)


def test_prior_values_hold_what_the_points_do_not() -> None:
    """With one point, a-priori values decide; a tight one stays, a loose one gives way."""
    model = camera()
    ground = control(model, 1)
    moved = model.ground_to_image(ground) + np.array([12.0, 0.0])
    sigmas = np.array([10.0, 10.0, 10.0, 1e-4, 1e-4, 1e-4, 0.0])
    solved = resect(model, ground, moved, 0.1, priors=sigmas)
    assert np.abs(solved.residuals).max() < 0.05
    assert np.abs(solved.model.values[3:6] - model.values[3:6]).max() < 1e-4
    assert np.hypot(*(solved.model.values[:2] - model.values[:2])) == pytest.approx(12.0 * 1500.0 / 3500.0, rel=0.2)
    assert solved.redundancy == 2


def test_a_prior_value_and_measurements_share_the_misfit() -> None:
    """One unknown: the weighted mean of where the points and the a-priori value want the camera."""
    model = camera(omega=0.0, phi=0.0, kappa=0.0)
    ground = control(model, 9, relief=0.0)
    image = model.ground_to_image(ground)
    slope = jacobian(model, ground)[0][:, :, 0]  # pixels per metre east
    for sigma in (0.02, 0.2, 2.0):
        solved = resect(model, ground, image + 3.0 * slope, 1.5, priors=np.r_[sigma, np.zeros(6)])
        information = (slope**2).sum() / 1.5**2
        moved = 3.0 * information / (information + 1.0 / sigma**2)
        assert solved.model.values[0] - model.values[0] == pytest.approx(moved, rel=1e-6)
        assert solved.sigmas[0] == pytest.approx((information + 1.0 / sigma**2) ** -0.5, rel=1e-6)
        cost = (3.0 - moved) ** 2 * information + (moved / sigma) ** 2
        assert solved.sigma0 == pytest.approx(np.sqrt(cost / 18), rel=1e-6)


def test_fixed_parameters_stay() -> None:
    model = camera()
    ground = control(model)
    sigmas = np.array([np.inf, np.inf, np.inf, np.inf, np.inf, 0.0, 0.0])
    start = rough(model).with_values(np.r_[rough(model).values[:5], model.values[5:]])
    solved = resect(start, ground, model.ground_to_image(ground), priors=sigmas)
    np.testing.assert_array_equal(solved.model.values[5:], model.values[5:])
    np.testing.assert_allclose(solved.model.values[:5], model.values[:5], atol=1e-6)


def test_bad_rows_take_no_part() -> None:
    model = camera()
    ground = control(model, 12)
    image = model.ground_to_image(ground)
    ground[3] = np.nan
    image[5, 0] = np.nan
    solved = resect(rough(model), ground, image)
    np.testing.assert_allclose(solved.model.values, model.values, atol=1e-6)
    assert np.isnan(solved.residuals).any(axis=1).tolist() == [k in (3, 5) for k in range(12)]
    assert solved.redundancy == 2 * 10 - 6


def test_undetermined_names_the_parameters() -> None:
    model = camera(omega=0.0, phi=0.0, sigmas=(np.inf,) * 7)
    flat = Transform(MAP, model.crs)(image_to_height(model, pixels(model, 20), PLACE[2], MAP))
    level = model.ground_to_image(flat)
    with pytest.raises(SolveError, match="2 points give 4 observations for 7 unknowns"):
        resect(model, flat[:2], level[:2])
    with pytest.raises(SolveError, match="sees none of the points"):
        resect(model, 1.01 * flat, level)
    with pytest.raises(SolveError, match="nothing to estimate"):
        resect(model, flat, level, priors=np.zeros(7))

    class Idle(Camera):
        def ground_to_image(self, xyz: np.ndarray) -> np.ndarray:
            return camera().with_values(np.r_[self.values[:5], 0.0, self.values[6]]).ground_to_image(xyz)

    with pytest.raises(SolveError, match="say nothing about kappa"):
        resect(Idle(model.values), flat, level)

    class Doubled(Camera):
        def ground_to_image(self, xyz: np.ndarray) -> np.ndarray:
            values = self.values.copy()
            values[0] += 0.5 * values[6]
            values[6] = 3500.0
            return camera().with_values(values).ground_to_image(xyz)

    with pytest.raises(SolveError, match="cannot tell east, focal apart"):
        resect(Doubled(model.values, sigmas=(np.inf,) * 7), flat, level)


def test_fit_ignores_prior_values() -> None:
    tight = camera(sigmas=(1e-6,) * 6 + (0.0,))
    ground = control(tight)
    solved = fit(rough(tight, 5.0), ground, tight.ground_to_image(ground))
    np.testing.assert_allclose(solved.model.values, tight.values, atol=1e-6)
