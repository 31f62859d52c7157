"""Lenses against formulas written a second time, numbers of another program, and their own inverse."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lens_rig import distorted, undistorted

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.sensor.inputs import choice, known_keys
from geomosaic.types import FloatArray
from geomosaic_frame.camera import Camera
from geomosaic_frame.distortion import LEAST_SLOPE, Lens, NoDistortion, fold_radius
from geomosaic_frame.film import FilmLens
from geomosaic_frame.fisheye import Fisheye
from geomosaic_frame.lenses import DecentredLens, ShearedLens, adjustable, lens_from_dict, lens_from_table
from geomosaic_frame.polynomial import Brown, Rational
from geomosaic_frame.radial_tables import Corrections, RadialPolynomial

BROWN = Brown(k1=-0.264, k2=0.1019, k3=-0.0258, p1=7.3e-4, p2=-2.6e-4)
BARREL = Brown(k1=-0.3, p1=0.01, p2=-0.02)
PINCUSHION = Brown(k1=0.2, k2=0.05)
RATIONAL = Rational(0.31, -0.05, 1.1e-3, -7e-4, 0.012, 0.52, -0.03, 0.004, 1e-3, -2e-4, 5e-4, 3e-4)
POLE = Rational(k1=0.1, k4=-0.3)
FISHEYE = Fisheye(0.012, -0.03, 0.008, -0.0007)
CERTIFICATE = Corrections.photogrammetric((2e-5, -3e-8, 1e-11), (4e-6, -7e-6), 35.0)
LENSES = [NoDistortion(), BROWN, BARREL, PINCUSHION, RATIONAL, POLE, FISHEYE, CERTIFICATE]


def disc(radius: float, count: int = 400) -> FloatArray:
    rng = np.random.default_rng(3)
    r, a = radius * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    return np.column_stack([r * np.cos(a), r * np.sin(a)])


def plain_opencv(x: float, y: float, c: dict[str, float]) -> tuple[float, float]:
    """OpenCV's documented formula, one point, plain floats."""

    def g(name: str) -> float:
        return c.get(name, 0.0)

    r2 = x * x + y * y
    radial = (1 + g("k1") * r2 + g("k2") * r2**2 + g("k3") * r2**3) / (
        1 + g("k4") * r2 + g("k5") * r2**2 + g("k6") * r2**3
    )
    u = x * radial + 2 * g("p1") * x * y + g("p2") * (r2 + 2 * x * x) + g("s1") * r2 + g("s2") * r2**2
    v = y * radial + g("p1") * (r2 + 2 * y * y) + 2 * g("p2") * x * y + g("s3") * r2 + g("s4") * r2**2
    return u, v


@pytest.mark.parametrize("lens", [BROWN, PINCUSHION, RATIONAL])
def test_polynomials_are_the_documented_formula(lens: Brown | Rational) -> None:
    state = {key: value for key, value in lens.to_dict().items() if key != "model"}
    points = disc(0.99 * min(lens.fold, 1.2))
    expected = [plain_opencv(float(x), float(y), state) for x, y in points]
    assert np.abs(distorted(lens, points) - expected).max() < 1e-15


def test_fisheye_is_the_documented_formula() -> None:
    for x, y, z in ((0.1, -0.2, 1.0), (-0.7, 0.3, 0.1), (1.0, 1.0, 0.0), (0.3, -1.0, -0.2)):
        r = math.hypot(x, y)
        t = math.acos(z / math.sqrt(x * x + y * y + z * z))
        d = t * (1 + 0.012 * t**2 - 0.03 * t**4 + 0.008 * t**6 - 0.0007 * t**8)
        if t > FISHEYE.fold:
            continue
        u, v = FISHEYE.project(np.array([x]), np.array([y]), np.array([z]))
        assert abs(u[0] - d * x / r) < 1e-15
        assert abs(v[0] - d * y / r) < 1e-15


# Made once with OpenCV 4.14.0: projectPoints and fisheye.projectPoints, identity camera, the coefficients above.
OPENCV = {
    "brown": (
        BROWN,
        [[0.1, -0.2, 1], [0.5, 0.4, 1], [-0.7, 0.3, 1.1], [0.9, -0.6, 1]],
        [
            [0.09865775250000001, -0.197305005],
            [0.45361101410000004, 0.36327339128],
            [-0.5695143418313516, 0.24437408038344818],
            [0.70884656514, -0.47191307675999994],
        ],
    ),
    "rational": (
        RATIONAL,
        [[0.1, -0.2, 1], [0.5, 0.4, 1], [-0.7, 0.3, 1.1], [0.9, -0.6, 1]],
        [
            [0.0989282576958561, -0.1977467653917122],
            [0.4633917983758008, 0.37134836470064064],
            [-0.5837703101490179, 0.2510650827195187],
            [0.7489131825824873, -0.4969413050549915],
        ],
    ),
    "fisheye": (
        FISHEYE,
        [[0.1, -0.2, 1], [0.5, 0.4, 1], [-0.7, 0.3, 0.1]],
        [
            [0.09843192452952329, -0.19686384905904658],
            [0.44517724679186416, 0.35614179743349134],
            [-1.2632262975138622, 0.5413826989345123],
        ],
    ),
}


@pytest.mark.parametrize("name", OPENCV)
def test_a_lens_of_opencv_gives_the_numbers_of_opencv(name: str) -> None:
    lens, points, expected = OPENCV[name]
    u, v = lens.project(*np.array(points, dtype=np.float64).T)
    assert np.abs(np.column_stack([u, v]) - expected).max() < 2e-15


@pytest.mark.parametrize("lens", LENSES, ids=repr)
def test_undistort_inverts_distort_to_rounding(lens: Lens) -> None:
    points = np.vstack([disc(0.8), disc(5.0), [[0.0, 0.0]]])
    back = undistorted(lens, distorted(lens, points))
    # Where the lens compresses, a rounding of the image counts for more on the ray: by at most 1 / least slope.
    assert np.abs(back - points)[:400].max() < 1e-14 / LEAST_SLOPE
    assert np.nanmax(np.abs(back - points)) < 1e-13 / LEAST_SLOPE
    # Nothing is lost, but beyond what this fisheye can see at all.
    assert np.isfinite(back).all() or isinstance(lens, Fisheye)


@pytest.mark.parametrize("lens", LENSES, ids=repr)
def test_derivatives_against_differences(lens: Lens) -> None:
    rng = np.random.default_rng(5)
    xyz = np.vstack([rng.normal(size=(200, 3)) * [1.0, 1.0, 0.2] + [0, 0, 1.2], [[0.0, 0.0, 2.0]]])
    exact = lens.derivatives(*xyz.T)
    step = 1e-6
    for axis in range(3):
        moved = np.zeros(3)
        moved[axis] = step
        high, low = (np.column_stack(lens.project(*(xyz + s * moved).T)) for s in (1, -1))
        difference = (high - low) / (2 * step)
        scale = 1.0 + np.abs(exact).max(axis=(1, 2))[:, None]
        assert np.nanmax(np.abs(exact[:, :, axis] - difference) / scale) < 1e-7


ADJUSTED = [
    *LENSES,
    DecentredLens(RATIONAL, (0.02, -0.01)),
    ShearedLens(DecentredLens(BROWN, (-0.01, 0.03)), 0.002),
    ShearedLens(FISHEYE, -0.001),
    FilmLens(100.0, RadialPolynomial((1e-4, -3e-8, 2e-12)), (0.1, -0.2), (3e-7, -2e-7)),
]


@pytest.mark.parametrize("lens", ADJUSTED, ids=repr)
def test_derivatives_by_coefficients_are_those_of_differences(lens: Lens) -> None:
    lens = lens if isinstance(lens, FilmLens) else adjustable(lens)
    points = np.column_stack([disc(0.5, 50), np.ones(50)])
    xyz = np.vstack([points, 3.0 * points[:5], [[0.0, 0.0, 2.0]]])
    given = lens.coefficients
    exact = lens.by_coefficients(*xyz.T)
    for index, (name, value) in enumerate(given.items()):
        # A step that moves an image point by a ten-thousandth of the focal length.
        step = 1e-4 / np.abs(exact[:, :, index]).max()
        moved = [lens.with_coefficients({**given, name: value + by}) for by in (step, -step)]
        high, low = (np.column_stack(each.project(*xyz.T)) for each in moved)
        assert np.abs((high - low) / 2.0 - step * exact[:, :, index]).max() < 1e-9, name


def test_a_lens_without_distortion_can_be_given_one_and_lose_it_again() -> None:
    camera = Camera((2000, 1500), (1000.0, 1010.0), (990.0, 760.0))
    interior = camera.interior
    assert interior.values[:4].tolist() == [1010.0, 1000.0 / 1010.0, 990.0, 760.0]
    changed = interior.values.copy()
    changed[interior.names.index("k2")] = 0.01
    changed[interior.names.index("shear")] = 1e-3
    other = camera.with_interior(changed)
    assert other.lens == ShearedLens(Brown(k2=0.01), 1e-3)
    assert Camera.from_dict(other.to_dict()).interior.values.tolist() == changed.tolist()
    assert other.with_interior(interior.values).lens == NoDistortion()


def test_a_step_of_the_interior_moves_a_corner_by_one_pixel() -> None:
    camera = Camera((2000, 1500), (2000.0, 2010.0), (990.0, 760.0), BROWN)
    interior, corners = camera.interior, camera.directions(camera.corners)
    for index, step in enumerate(interior.steps):
        values = interior.values.copy()
        values[index] += step
        moved = camera.with_interior(values).project(*corners.T) - camera.corners
        assert np.linalg.norm(moved, axis=1).max() == pytest.approx(1.0, abs=0.02)


def test_fold_radius_is_where_the_radial_polynomial_turns() -> None:
    # ρ' = 1 − 0.9 r² is 0.05 at √(0.95 / 0.9) and 0 at √(1 / 0.9).
    assert fold_radius((-0.3,)) == pytest.approx(math.sqrt(0.95 / 0.9), abs=1e-12)
    assert fold_radius((0.2, 0.05)) == math.inf
    # ρ' = 1 − 6·0.05·r from tangential terms alone, at their worst.
    assert fold_radius((0.0,), tangential=0.05) == pytest.approx(0.95 / 0.3, abs=1e-12)
    assert POLE.fold < math.sqrt(1 / 0.3)


@pytest.mark.parametrize("lens", [BROWN, BARREL, RATIONAL, POLE, CERTIFICATE, FISHEYE], ids=repr)
def test_far_points_never_come_back(lens: Lens) -> None:
    """Along every ray from the centre the image goes on outwards, at least along the ray."""
    r = np.concatenate([np.linspace(0.0, 5.0, 2000), np.geomspace(5.1, 1e7, 300)])
    for angle in np.radians(np.arange(0, 360, 7)):
        along = np.array([math.cos(angle), math.sin(angle)])
        image = distorted(lens, r[:, None] * along) @ along
        image = image[np.isfinite(image)]
        assert (np.diff(image) > 0.0).all()


def test_without_continuation_there_would_be_ghosts() -> None:
    state = {key: value for key, value in BROWN.to_dict().items() if key != "model"}
    ghost = np.hypot(*plain_opencv(1.9, 0.0, state))
    assert ghost < 0.9 * BROWN.edge
    assert np.hypot(*distorted(BROWN, np.array([[1.9, 0.0]]))[0]) > BROWN.edge


@pytest.mark.parametrize(
    "lens", [BROWN, BARREL, Rational(k1=-0.3, s1=0.01, s2=0.004, s3=-0.01, s4=0.002), FISHEYE], ids=repr
)
def test_continuation_is_smooth(lens: Brown) -> None:
    def at(r: float) -> FloatArray:
        if isinstance(lens, Fisheye):
            u, v = lens.project(np.array([0.6 * math.sin(r)]), np.array([0.8 * math.sin(r)]), np.array([math.cos(r)]))
            return np.array([u[0], v[0]])
        return distorted(lens, np.array([[0.6 * r, 0.8 * r]]))[0]

    end, h = lens.fold, 1e-5
    assert np.abs(at(end * (1 + 1e-12)) - at(end * (1 - 1e-12))).max() < 1e-10
    before, after = (at(end) - at(end - h)) / h, (at(end + h) - at(end)) / h
    assert np.abs(before - after).max() < 20 * h


def test_fisheye_sees_beyond_ninety_degrees_but_not_behind() -> None:
    camera = Camera((2000, 2000), (500.0, 500.0), (1000.0, 1000.0), Fisheye())
    angle = np.radians([0.0, 60.0, 89.9, 90.0, 100.0, 150.0, 179.9, 180.0])
    pixels = camera.project(np.sin(angle), np.zeros(8), np.cos(angle))
    assert np.isfinite(pixels[:6]).all()
    assert np.abs(pixels[:6, 0] - 1000 - 500 * angle[:6]).max() < 1e-9
    assert np.isnan(pixels[7]).all()
    back = camera.directions(pixels[:6])
    assert np.abs(back[:, 0] - np.sin(angle[:6])).max() < 1e-14
    assert np.abs(back[:, 2] - np.cos(angle[:6])).max() < 1e-14


def test_corrections_of_a_certificate_are_added_to_the_measured_place() -> None:
    """Measured + correction = ideal, in mm with y up, from a plain second formula."""
    table = {
        "size": [1000, 800],
        "focal_length": 35.0,
        "pixel_size": 8.0,
        "principal_point": [0.05, -0.03],
        "distortion": {
            "model": "brown",
            "convention": "photogrammetric",
            **{"k1": 2e-5, "k2": -3e-8, "k3": 1e-11, "p1": 4e-6, "p2": -7e-6},
        },
    }
    camera = Camera.from_table(table, (1000, 800), "photo")
    for col, row in ((120.0, 60.0), (950.5, 700.25), (500.0, 400.0)):
        x, y = (col - 500) * 0.008 - 0.05, (400 - row) * 0.008 + 0.03
        r2 = x * x + y * y
        radial = 2e-5 * r2 - 3e-8 * r2**2 + 1e-11 * r2**3
        ideal_x = x + x * radial + 4e-6 * (r2 + 2 * x * x) + 2 * -7e-6 * x * y
        ideal_y = y + y * radial + 2 * 4e-6 * x * y + -7e-6 * (r2 + 2 * y * y)
        expected = np.array([ideal_x, -ideal_y, 35.0]) / math.sqrt(ideal_x**2 + ideal_y**2 + 35.0**2)
        direction = camera.directions(np.array([[col, row]]))[0]
        assert np.abs(direction - expected).max() < 1e-15
        assert np.abs(camera.project(*direction[:, None])[0] - [col, row]).max() < 1e-10


@pytest.mark.parametrize("lens", LENSES, ids=repr)
def test_state_of_a_lens(lens: Lens) -> None:
    assert lens_from_dict(lens.to_dict()) == lens


def test_a_fold_inside_the_image_is_warned_of() -> None:
    camera = Camera((4000, 3000), (2000.0, 2000.0), (2000.0, 1500.0), Brown(k1=-0.3))
    edge = 2000 * BARREL_EDGE
    with pytest.warns(GeomosaicWarning, match=rf"photo: the distortion polynomial folds back {edge:.0f} px .* 2500 px"):
        camera.warn_of_fold("photo")
    Camera((2000, 1500), (2000.0, 2000.0), (1000.0, 750.0), Brown(k1=-0.3)).warn_of_fold("photo")


BARREL_EDGE = math.sqrt(0.95 / 0.9) * (1 - 0.3 * 0.95 / 0.9)


def test_camera_table_in_millimetres_and_in_pixels() -> None:
    mm = Camera.from_table(
        {"focal_length": 120.0, "sensor_size": [92.16, 165.888], "principal_point": [0.144, 0.288]},
        (640, 1152),
        "photo",
    )
    assert mm.focal == pytest.approx((120 / 0.144, 120 / 0.144), rel=1e-14)
    assert mm.principal_point == pytest.approx((321.0, 574.0))  # right and UP
    um = Camera.from_table({"focal_length": 120.0, "pixel_size": [144.0, 144.0]}, (640, 1152), "photo")
    assert um.focal == pytest.approx(mm.focal, rel=1e-14)
    px = Camera.from_table({"focal_length_px": 833.0, "principal_point_px": [321, 574.5]}, (640, 1152), "photo")
    assert (px.focal, px.principal_point) == ((833.0, 833.0), (321.0, 574.5))


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"focal_lenght": 120.0}, "did you mean 'focal_length'"),
        ({"focal_length": 120.0}, "sensor_size"),
        ({"focal_length": -1.0, "pixel_size": 4.0}, "-1 is out of range"),
        ({}, "'focal_length' is missing"),
        ({"focal_length": 120.0, "sensor_size": [165.888, 92.16]}, "not square"),
        ({"focal_length": 120.0, "pixel_size": 12.0, "principal_point": [320, 576]}, "principal_point_px"),
        ({"focal_length_px": 120.0, "principal_point": [0.1, 0.0]}, "size of a pixel"),
        ({"focal_length_px": 120.0, "focal_length": 12.0}, "give one of them"),
        ({"focal_length_px": 120.0, "distortion": {"model": "browns"}}, "did you mean 'brown'"),
        ({"focal_length_px": 120.0, "distortion": {"model": "brown", "k7": 0.1}}, "unknown key 'k7'"),
        ({"focal_length_px": 120.0, "distortion": {"k1": 0.1}}, "'model' is missing"),
        ({"focal_length_px": 120.0, "distortion": {"model": "brown", "k1": "a"}}, "k1 = 'a' is not a finite number"),
        (
            {"focal_length_px": 120.0, "distortion": {"model": "brown", "convention": "photogrammetric"}},
            "in millimetres",
        ),
        ({"focal_length_px": 120.0, "size": [640.5, 1152]}, "whole pixels"),
        ({"focal_length": 0.12, "sensor_size": [92.16, 165.888]}, "field of view of 180°"),  # metres
        ({"focal_length_px": 35.0}, "field of view of 174°"),  # mm
        ({"focal_length": 120.0, "pixel_size": 0.004}, "pixel_size in µm"),  # mm
    ],
)
def test_camera_errors_say_what_and_where(table: dict[str, object], words: str) -> None:
    with pytest.raises(InputError) as caught:
        Camera.from_table(table, (640, 1152), "photo 7")
    assert words in str(caught.value)
    assert "photo 7" in str(caught.value)


def test_a_fisheye_may_see_more_than_any_other_lens() -> None:
    """An equidistant lens of 180° shows the horizon at f · π/2."""
    table = {"focal_length_px": 100.0, "distortion": {"model": "fisheye"}}
    assert Camera.from_table(table, (2000, 2000), "photo").focal == (100.0, 100.0)
    with pytest.raises(InputError, match="field of view"):
        Camera.from_table({"focal_length_px": 100.0}, (2000, 2000), "photo")


def test_coefficients_not_given_are_zero() -> None:
    assert lens_from_table({"model": "none"}, None, "photo") == NoDistortion()
    assert lens_from_table({"model": "brown", "p2": 1e-4}, None, "photo") == Brown(p2=1e-4)
    assert lens_from_table({"model": "fisheye", "k4": 1e-4}, None, "photo") == Fisheye(k4=1e-4)


def test_names_are_suggested_whatever_their_case() -> None:
    """`K1` is k1, not the p1 that shares its digit."""
    for word, meant in (("K1", "k1"), ("P2", "p2"), ("Convention", "convention")):
        with pytest.raises(InputError, match=f"unknown key '{word}'") as caught:
            known_keys({word: 0.1}, ("model", "p1", "p2", "k1", "k2", "convention"), "photo")
        assert f"did you mean '{meant}'?" in str(caught.value.hint)
    with pytest.raises(InputError, match="'BROWN'") as caught:
        choice("BROWN", ("none", "brown", "opencv"), "model", "photo")
    assert "did you mean 'brown'?" in str(caught.value.hint)
    with pytest.raises(InputError) as caught:
        known_keys({"zzz": 1}, ("k1",), "photo")
    assert "did you mean" not in str(caught.value.hint)
