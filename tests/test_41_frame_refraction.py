"""Refraction against light traced through the standard atmosphere, curvature against the rigorous treatment."""

from __future__ import annotations

from typing import Any

import film_rig as rig
import numpy as np
import pytest

from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.transform import Transform
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.ray_corrections import (
    RayCorrection,
    curvature_shift,
    earth_radius,
    refraction_constant,
    refraction_shift,
)
from geomosaic.types import FloatArray
from geomosaic_frame.model import FrameModel


def density(height: FloatArray) -> FloatArray:
    """ICAO standard atmosphere in kg/m³: 6.5 K/km to 11 km, isothermal to 20 km."""
    below = 1.225 * (1.0 - 2.25577e-5 * np.minimum(height, 11000.0)) ** 4.25588
    return below * np.exp(-np.maximum(height - 11000.0, 0.0) / 6341.6)


def index(height: FloatArray) -> FloatArray:
    """Refractive index of air at 550 nm, Gladstone-Dale: 2.26e-4 m³/kg."""
    return 1.0 + 2.26e-4 * density(height)


def traced(angle: float, height: float, ground: float) -> float:
    """Tangent of the straight line's nadir angle where a camera sees a ray at `angle` (Snell's law, level layers)."""
    z = np.linspace(ground, height, 20001)
    sine = index(np.array(height)) * np.sin(angle) / index(z)
    return float(np.trapezoid(sine / np.sqrt(1.0 - sine**2), z) / (height - ground))


@pytest.mark.parametrize("height", [1500.0, 3000.0, 6000.0, 9000.0, 11600.0, 15000.0, 20000.0])
@pytest.mark.parametrize("ground", [0.0, 500.0])
def test_constant_against_light_traced_through_the_atmosphere(height: float, ground: float) -> None:
    """Pressure weighs what the trace sums up."""
    angle = np.radians(45.0)
    bent = angle - np.arctan(traced(angle, height, ground))
    assert refraction_constant(height, ground) == pytest.approx(bent, abs=1e-7)


@pytest.mark.parametrize("height", [1.0, 2.0, 3.0, 5.0, 7.0, 9.0])
@pytest.mark.parametrize("ground", [0.0, 0.5])
def test_constant_against_published_formulas(height: float, ground: float) -> None:
    """Saastamoinen 1972 within 1 µrad; Bertram 1966, of the older ARDC atmosphere, within 5 at the sea's height."""
    here = 1e6 * refraction_constant(1000.0 * height, 1000.0 * ground)
    assert here == pytest.approx(13.0 * (height - ground) * (1.0 - 0.02 * (2.0 * height + ground)), abs=1.0)
    if not ground:
        assert here == pytest.approx(2410.0 * height / (height**2 - 6.0 * height + 250.0), abs=5.0)


def test_constant_by_hand() -> None:
    """Tables of the standard atmosphere: p(0) 1013.25 hPa, p(6 km) 471.81 hPa, ρ(6 km) 0.65970 kg/m³."""
    k = 2.26e-4 * ((101325 - 47181) / (9.80665 * 6000) - 0.65970)
    assert refraction_constant(6000.0, 0.0) == pytest.approx(k, abs=2e-8)
    # 58.87 µrad · (100 mm + 100³/150² mm) = 8.50 µm.
    assert refraction_shift(np.array(100.0), 150.0, 6000.0, 0.0) == pytest.approx(8.50, abs=0.01)


def test_curvature_by_hand() -> None:
    """H = 3000 m, c = 150 mm, r = 100 mm, R = 6371 km: 3000·1e6 / (2·6.371e6·22500) mm = 10.46 µm."""
    assert curvature_shift(np.array(100.0), 150.0, 3000.0, 6.371e6) == pytest.approx(10.464, abs=1e-3)


@pytest.mark.parametrize("degrees", [5.0, 20.0, 35.0, 50.0, 65.0])
def test_directions_follow_the_traced_light(degrees: float) -> None:
    """The form K·tan α is that of a level atmosphere: with its K from 45°, other angles follow within 1 µrad."""
    seen = np.radians(degrees)
    at_45 = np.radians(45.0) - np.arctan(traced(np.radians(45.0), 9000.0, 0.0))
    correction = RayCorrection(refraction=at_45)
    true = np.array([[traced(seen, 9000.0, 0.0), 0.0, -1.0]])
    east, _, up = correction.seen(*true.T)
    assert np.arctan(east[0] / -up[0]) == pytest.approx(seen, abs=1e-6)


@pytest.mark.parametrize("correction", [RayCorrection(9e-5), RayCorrection(0.0, 9e-4), RayCorrection(9e-5, 9e-4)])
def test_inverse_and_slopes(correction: RayCorrection) -> None:
    rng = np.random.default_rng(1)
    local = np.column_stack([rng.uniform(-3, 3, (500, 2)), -np.ones(500)])
    local[:5] = [[0, 0, -1], [30, 0, -1], [0, 40, -1], [1, 1, 0.0], [1, 2, 0.5]]
    seen = np.column_stack(correction.seen(*local.T))
    assert np.abs(correction.true(seen) - local).max() < 1e-12
    closed, h = correction.slopes(*local.T), 1e-6
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = h
        plus, minus = (np.column_stack(correction.seen(*(local + s).T)) for s in (step, -step))
        usual = np.r_[0:3, 5:500]
        assert np.abs(closed[:, :, axis] - (plus - minus) / (2 * h))[usual].max() < 1e-8


# --- a high photo: 11.6 km above the sea with a super-wide lens -------------------------------------------------------

HIGH = {
    "focal_length": 85.52,
    "principal_point_autocollimation": [0.0, 0.0],
    "fiducials": rig.FIDUCIALS,
}
HEIGHT, GROUND = 11_600.0, 300.0


def photo(crs: str, x: float, y: float, z: float = HEIGHT, **changes: Any) -> FrameModel:
    given: dict[str, Any] = {
        "camera": HIGH,
        "fiducials": rig.marks(pixel=0.02, middle=(5800.0, 5800.0), turn=0.0),
        "position": [x, y, z],
        "orientation": {"system": "opk", "omega": 0.8, "phi": -0.5, "kappa": 12.0},
        "ground_height": GROUND,
    }
    place = with_heights(parse_crs(crs), "ellipsoidal")
    model = registry.build("frame", SensorRequest("high", (11600, 11600), given | changes, place))
    assert isinstance(model, FrameModel)
    return model


def ground_grid(relief: float = 0.0) -> FloatArray:
    """Offsets of points in the photo from its centre, and heights."""
    x, y = np.meshgrid(np.linspace(-13_000, 13_000, 27), np.linspace(-13_000, 13_000, 27))
    z = GROUND + relief * np.sin(x / 2000.0) * np.cos(y / 3000.0)
    return np.column_stack([x.ravel(), y.ravel(), z.ravel()])


# A map true to scale about its middle: what is left between the treatments is the Earth's curvature alone.
LOCAL = "+proj=tmerc +lat_0=47 +lon_0=15 +k=1 +x_0=0 +y_0=0 +ellps=WGS84"


def worst(first: FrameModel, second: FrameModel, ground: FloatArray, crs: str) -> float:
    """Largest distance of two models' images of points inside the photo, in pixels."""
    place = with_heights(parse_crs(crs), "ellipsoidal")
    a = first.ground_to_image(Transform(place, first.crs)(ground))
    b = second.ground_to_image(Transform(place, second.crs)(ground))
    inside = ((a > 0) & (a < 11600)).all(axis=1)
    assert inside.sum() > 200
    return float(np.hypot(*(a - b)[inside].T).max())


def test_a_constant_that_is_given_takes_the_place_of_the_atmosphere() -> None:
    k = refraction_constant(HEIGHT, GROUND)
    standard, given = photo(LOCAL, 0.0, 0.0, refraction=True), photo(LOCAL, 0.0, 0.0, refraction=1e6 * k)
    assert given.ray_correction.refraction == pytest.approx(standard.ray_correction.refraction, rel=1e-12)
    assert any("refraction as given" in note for note in given.notes)


def test_what_curvature_and_refraction_are_worth_in_a_high_photo() -> None:
    strict, flat = photo(LOCAL, 0.0, 0.0), photo(LOCAL, 0.0, 0.0, treatment="planar")
    ground = ground_grid()
    assert worst(strict, flat, ground, LOCAL) > 15.0
    corrected = photo(LOCAL, 0.0, 0.0, treatment="planar", curvature=True)
    assert worst(strict, corrected, ground, LOCAL) < 0.35
    refracted = photo(LOCAL, 0.0, 0.0, refraction=True)
    assert 2.0 < worst(strict, refracted, ground, LOCAL) < 4.0
    assert (
        worst(refracted, photo(LOCAL, 0.0, 0.0, treatment="planar", curvature=True, refraction=True), ground, LOCAL)
        < 0.35
    )


@pytest.mark.parametrize(("relief", "limit"), [(0.0, 0.05), (400.0, 0.2)])
def test_the_strict_model_is_the_truth_of_a_traced_ray(relief: float, limit: float) -> None:
    """Light traced to every point of level ground: the strict model with refraction is right to 0.05 px."""
    model = photo(LOCAL, 0.0, 0.0, refraction=True)
    place = with_heights(parse_crs(LOCAL), "ellipsoidal")
    ground = ground_grid(relief)
    local = model.frame.to_enu(Transform(place, model.crs)(ground))
    out = []
    for (e, n, u), height in zip(local, ground[:, 2], strict=True):
        distance = np.hypot(e, n)
        tangent = distance / -u
        low, high = np.arctan(tangent), np.arctan(tangent) + 3e-4
        for _ in range(40):  # the angle at which the camera sees a ray that arrives there
            middle = (low + high) / 2
            low, high = (middle, high) if traced_fast(middle, HEIGHT, height) < tangent else (low, middle)
        factor = np.tan(low) / tangent
        out.append([e * factor, n * factor, u])
    bent = np.array(out)
    plain = photo(LOCAL, 0.0, 0.0)
    there = plain.ground_to_image(plain.frame.to_geocentric(bent))
    here = model.ground_to_image(Transform(place, model.crs)(ground))
    inside = ((there > 0) & (there < 11600)).all(axis=1)
    assert np.hypot(*(here - there)[inside].T).max() < limit


def traced_fast(angle: float, height: float, ground: float) -> float:
    """`traced` with fewer layers."""
    z = np.linspace(ground, height, 401)
    sine = index(np.array(height)) * np.sin(angle) / index(z)
    return float(np.trapezoid(sine / np.sqrt(1.0 - sine**2), z) / (height - ground))


def test_radius_of_the_earth() -> None:
    place = with_heights(parse_crs("EPSG:4326"), "ellipsoidal")
    assert earth_radius(place, np.array([0.0, 0.0, 0.0])) == pytest.approx(6356752.314, abs=0.01)
    assert earth_radius(place, np.array([0.0, 90.0, 0.0])) == pytest.approx(6399593.626, abs=0.01)


def test_applied_and_missing_corrections_are_reported() -> None:
    assert any("refraction of the standard atmosphere: 8" in note for note in photo(LOCAL, 0, 0, refraction=True).notes)
    notes = photo(LOCAL, 0.0, 0.0, treatment="planar").notes
    assert any("refraction is not corrected; it moves the corners by" in note for note in notes)
    assert any("curvature is not corrected; it moves the corners by" in note for note in notes)
