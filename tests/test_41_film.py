"""Film cameras: certificate, interior orientation, and what is said of marks that cannot be right."""

from __future__ import annotations

import re
import warnings
from typing import Any

import film_rig as rig
import numpy as np
import pytest
from lens_rig import distorted, undistorted
from scipy.spatial.transform import Rotation

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.testing import SensorModelTests, check_plugin
from geomosaic.types import FloatArray
from geomosaic_frame import plugin
from geomosaic_frame.certificate import read_certificate
from geomosaic_frame.film import FilmLens
from geomosaic_frame.interior_orientation import apply, fit_interior
from geomosaic_frame.model import FrameModel
from geomosaic_frame.radial_tables import RadialPolynomial, RadialTable

CRS = with_heights(parse_crs("EPSG:32633"), "ellipsoidal")
CENTRE = np.array([500_000.0, 5_500_000.0, 2600.0])
ANGLES = (1.5, -2.0, 37.0)


def request(**changes: Any) -> SensorRequest:
    given: dict[str, Any] = {
        "camera": rig.CERTIFICATE,
        "fiducials": rig.marks(),
        "position": CENTRE.tolist(),
        "orientation": {"system": "opk", **dict(zip(("omega", "phi", "kappa"), ANGLES, strict=True))},
        "ground_height": 300.0,
        "treatment": "planar",
    }
    return SensorRequest("scan", rig.SIZE, {k: v for k, v in (given | changes).items() if v is not None}, CRS)


def build(**changes: Any) -> FrameModel:
    model = registry.build("frame", request(**changes))
    assert isinstance(model, FrameModel)
    return model


def ground_of(model: FrameModel, count: int = 30) -> FloatArray:
    rng = np.random.default_rng(4)
    origins, directions = model.rays(rng.uniform(0.03, 0.97, (count, 2)) * model.size)
    points: FloatArray = origins + directions * rng.uniform(2000.0, 2400.0, (count, 1))
    return points


class TestFilm(SensorModelTests):
    @pytest.fixture
    def model(self) -> FrameModel:
        return build(treatment="rigorous")

    @pytest.fixture
    def ground(self, model: FrameModel) -> FloatArray:
        return ground_of(model)


class TestProjectiveWithRefraction(TestFilm):
    @pytest.fixture
    def model(self) -> FrameModel:
        return build(treatment="rigorous", interior="projective", refraction=True)


class TestPlanarWithCurvature(TestFilm):
    @pytest.fixture
    def model(self) -> FrameModel:
        return build(refraction=True, curvature=True)


class TestPolynomial(TestFilm):
    @pytest.fixture
    def model(self) -> FrameModel:
        lens = {
            "model": "polynomial",
            "sign": "distortion",
            "k0": 1e-5,
            "k1": -3e-9,
            "k2": 1e-13,
            "p1": 1e-8,
            "p2": -2e-8,
        }
        return build(camera=rig.CERTIFICATE | {"distortion": lens})


class TestAdditionalParameters(TestFilm):
    @pytest.fixture
    def model(self) -> FrameModel:
        return build(camera=rig.CERTIFICATE | {"additional": {"model": "ebner", "b3": 0.02, "b8": -0.03, "b11": 0.01}})


class TestDeformed(TestFilm):
    """The film moved by pixels against what the marks say."""

    @pytest.fixture
    def model(self) -> FrameModel:
        model = build(treatment="rigorous", fiducial_sigma=0.2)
        return model.with_values(model.parameters.values + np.r_[np.zeros(6), 3.0, -2.0, 4.0, 1.0, -2.0, 5.0])


@pytest.mark.parametrize("kind", ["conformal", "affine"])
def test_a_deformation_is_what_other_places_of_the_marks_would_be(kind: str) -> None:
    """So its amounts, with the sigma of a mark, are the marks as observations beside those of the ground."""
    model = build(fiducial_sigma=0.2, interior=kind)
    moved = {name: np.random.default_rng(int(name)).normal(0.0, 0.5, 2) for name in rig.FIDUCIALS}
    other = build(fiducials={name: list(place + moved[name]) for name, place in rig.marks().items()}, interior=kind)
    film = model.camera.deformation
    assert film is not None
    by = film.by_values(np.array(list(rig.marks().values())))
    np.testing.assert_allclose(np.einsum("nik,nil->kl", by, by), np.eye(len(film.names)), atol=1e-9)
    amounts = np.einsum("nik,ni->k", by, np.array(list(moved.values())))
    same = model.with_values(np.r_[model.parameters.values[:6], amounts])
    ground = ground_of(model)
    apart = np.abs(same.ground_to_image(ground) - other.ground_to_image(ground)).max()
    assert apart < 2e-3 < np.abs(model.ground_to_image(ground) - other.ground_to_image(ground)).max()
    assert same.parameters.sigmas[6:].tolist() == [0.2] * len(amounts)


def test_the_plugin_passes_the_check() -> None:
    check_plugin(plugin, request(angle_unit="deg", interior="affine"))


# --- truth ------------------------------------------------------------------------------------------------------------


def test_projection_against_the_formulas_written_a_second_time() -> None:
    model = build()
    rng = np.random.default_rng(1)
    local = np.column_stack([rng.uniform(-1500, 1500, (500, 2)), rng.uniform(-2400, -2200, 500)])
    rotation = Rotation.from_euler("XYZ", ANGLES, degrees=True).as_matrix().T
    there = rig.project(local, rotation)
    here = model.ground_to_image(CENTRE + local)
    inside = ((there > 0) & (there < rig.SIZE)).all(axis=1)
    assert inside.sum() > 300
    assert np.abs(here - there)[inside].max() < 1e-6  # pixels of 50 µm: 5e-8 mm of coordinates of 5.5e6 m


def test_radial_table_to_a_billionth() -> None:
    """Noise-free: forward and back, and against scipy's odd not-a-knot spline."""
    lens = read_certificate(rig.CERTIFICATE, "certificate").lens
    rng = np.random.default_rng(2)
    film = rng.uniform(-110.0, 110.0, (400, 2))
    measured = rig.distorted(film) - rig.CERTIFICATE["principal_point_autocollimation"]
    c = rig.CERTIFICATE["focal_length"]
    down = np.array([1.0, -1.0])
    assert np.abs(undistorted(lens, measured * down / c) * down * c - film).max() < 1e-9
    assert np.abs(distorted(lens, film * down / c) * down * c - measured).max() < 1e-9


def test_a_correction_is_a_distortion_the_other_way_and_angles_are_radii() -> None:
    table = rig.CERTIFICATE["distortion"]
    flipped = {"model": "radial", "radius": table["radius"], "correction": [-d for d in table["distortion"]]}
    first = read_certificate(rig.CERTIFICATE, "c").lens
    assert read_certificate(rig.CERTIFICATE | {"distortion": flipped}, "c").lens == first
    angles = np.degrees(np.arctan(np.array(table["radius"]) / 152.818)).tolist()
    turned = {"model": "radial", "angle": angles, "distortion": table["distortion"]}
    for words, off in (({"radius_is": "measured"}, 0.0), ({}, np.array(table["distortion"][1:]) / 1000.0)):
        radial = read_certificate(rig.CERTIFICATE | {"distortion": turned | words}, "c").lens.radial
        assert isinstance(radial, RadialTable)
        assert np.abs(np.array(radial.radii) - table["radius"][1:] - off).max() < 1e-12


@pytest.mark.parametrize("radius_is", ["measured", "ideal"])
def test_a_radial_table_follows_the_polynomial_it_was_printed_from(radius_is: str) -> None:
    """Distortions up to 1 mm at 150 mm, tabulated every 10 mm as a function of the measured or the ideal radius."""

    def distortion(r: np.ndarray) -> np.ndarray:
        return 2e-3 * r - 5e-7 * r**3 + 2.5e-11 * r**5

    at = np.arange(0.0, 151.0, 10.0)
    lens = {"model": "radial", "radius": at.tolist(), "distortion": (1000.0 * distortion(at)).tolist()}
    radial = read_certificate(rig.CERTIFICATE | {"distortion": lens | {"radius_is": radius_is}}, "c").lens.radial
    r = np.linspace(0.0, 149.0, 1000)
    measured = r if radius_is == "measured" else r + distortion(r)
    correction, _ = radial.correction(measured)
    assert np.abs(correction + distortion(r)).max() < 2e-4  # mm


def test_two_radii_are_an_odd_cubic() -> None:
    r = np.linspace(0.0, 100.0, 50)
    odd = 1e-4 * r - 3e-9 * r**3
    table = RadialTable((60.0, 100.0), (1e-4 * 60 - 3e-9 * 60**3, 1e-4 * 100 - 3e-9 * 100**3))
    assert np.abs(table.correction(r)[0] - odd).max() < 1e-15


def test_polynomial_of_a_certificate_by_hand() -> None:
    """r = 100 mm on the x axis, k1 = -3e-9: Δr = -3 µm, so a distortion is undone by +3 µm."""
    lens = read_certificate(
        {
            "focal_length": 150.0,
            "principal_point_autocollimation": [0, 0],
            "fiducials": {"a": [-100, 0], "b": [100, 0]},
            "distortion": {"model": "polynomial", "sign": "distortion", "k1": -3e-9, "p1": 2e-8},
        },
        "c",
    ).lens
    u, v = lens._undistort(np.array([100 / 150]), np.array([0.0]))
    assert u[0] * 150 == pytest.approx(100 + 0.003 - 2e-8 * 3 * 100**2, abs=1e-12)
    assert v[0] == 0.0


@pytest.mark.parametrize(
    "lens",
    [
        FilmLens(150.0, RadialPolynomial((1e-5, -4e-9, 3e-13)), (0.02, -0.03), (2e-7, -3e-7)),
        read_certificate(rig.CERTIFICATE, "c").lens,
        FilmLens(88.0, RadialTable((50.0, 100.0), (0.3, -0.5)), (0.5, 0.0), (4e-6, 1e-6)),
    ],
)
def test_derivatives_and_inverse_far_beyond_the_film(lens: FilmLens) -> None:
    rng = np.random.default_rng(5)
    xy = rng.uniform(-3.0, 3.0, (2, 300)).T
    measured = distorted(lens, xy)
    assert np.nanmax(np.abs(undistorted(lens, measured) - xy)) < 1e-11
    assert np.isfinite(measured).all()
    h = 1e-6
    closed = lens.derivatives(*xy.T, np.ones(len(xy)))[:, :, :2]
    steps = [(distorted(lens, xy + step) - distorted(lens, xy - step)) / (2 * h) for step in h * np.eye(2)]
    measured = np.stack(steps, axis=2)
    assert np.median(np.abs(closed - measured)) < 1e-9
    assert np.percentile(np.abs(closed - measured), 99) < 1e-7  # but where the difference straddles a kink


# --- interior orientation ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["conformal", "affine", "projective"])
@pytest.mark.parametrize("turn", [0.3, 91.0, -178.0])
def test_interior_orientation_finds_what_made_the_marks(kind: str, turn: float) -> None:
    t = np.radians(turn)
    matrix = np.array(
        [[0.02 * np.cos(t), 0.02 * np.sin(t), -110.0], [0.02 * np.sin(t), -0.02 * np.cos(t), 112.0], [0, 0, 1]]
    )
    if kind != "conformal":
        matrix[0] *= 1.0003
    if kind == "projective":
        matrix[2, :2] = 2e-8, -1e-8
    rng = np.random.default_rng(3)
    colrow = rng.uniform(0, 11000, (8, 2))
    found = fit_interior(colrow, apply(matrix, colrow), kind)
    assert np.abs(found.residuals).max() < 1e-8  # micrometres
    pixels = rng.uniform(0, 11000, (50, 2))
    assert np.abs(apply(found.matrix, pixels) - apply(matrix, pixels)).max() < 1e-9
    assert not found.mirrored
    # Here x rises along (cos, sin) of (col, row): clockwise, as rows count downwards.
    assert (found.turn + turn + 180) % 360 - 180 == pytest.approx(0.0, abs=0.05)


def test_the_sigma_of_unit_weight_is_the_noise_of_the_marks() -> None:
    rng = np.random.default_rng(8)
    film = np.array(list(rig.FIDUCIALS.values()))
    found = [fit_interior(rig.scan_of(film) + rng.normal(0, 0.1, (8, 2)), film, "affine").sigma0 for _ in range(300)]
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(0.1 * 50.0, rel=0.05)  # 0.1 px of 50 µm


@pytest.mark.parametrize("kind", ["conformal", "affine", "projective"])
def test_sigmas_of_the_interior_orientation_are_the_scatter_of_many_trials(kind: str) -> None:
    """Marks measured to 0.1 px: where pixels come to lie in the film scatters as it is said, within 10 %."""
    rng, film = np.random.default_rng(12), np.array(list(rig.FIDUCIALS.values()))
    pixels = np.array([[2310.0, 2295.0], [300.0, 350.0], [4300.0, 2200.0]])
    # An exact conformal scan, so that the noise is all that is left whatever the kind.
    clean = np.column_stack([2310.0 + film[:, 0] / 0.05, 2295.0 - film[:, 1] / 0.05])
    fits = [fit_interior(clean + rng.normal(0.0, 0.1, clean.shape), film, kind) for _ in range(300)]
    places = np.array([apply(one.matrix, pixels) for one in fits])
    reported = np.sqrt(np.mean([one.sigmas(pixels) ** 2 for one in fits], axis=0))
    scatter = 1000.0 * places.std(axis=0)
    # x and y alike by symmetry of the frame: their mean is known to 3 %.
    assert reported.mean(axis=1) == pytest.approx(np.sqrt((scatter**2).mean(axis=1)), rel=0.1)
    assert np.isnan(fit_interior(clean[:4], film[:4], "projective").sigmas(pixels)).all()


def said(**changes: Any) -> list[str]:
    return [note for note in build(**changes).notes if "interior" in note or "fiducial" in note]


def test_residuals_pixel_size_and_rotation_are_reported() -> None:
    (note,) = said()
    assert re.search(
        r"affine, 8 fiducials, residuals 0\.0 µm RMS.*pixels of 49\.99\d x 50\.00\d µm, turned by 0\.4\d°", note
    )


def test_missing_marks_are_reported() -> None:
    notes = said(fiducials=rig.marks(["1", "2", "4", "7"]))
    assert "fiducials not measured: 3, 5, 6, 8" in notes
    notes = said(fiducials=rig.marks(["1", "2"]))
    assert "conformal, 2 fiducials" in notes[0]
    assert "no check" in notes[-1]


def test_marks_numbered_the_other_way_round() -> None:
    names = ["1", "3", "2", "4"]  # around the frame, clockwise
    good = rig.marks(names)
    wrong = dict(zip(names, [good[name] for name in ["1", "4", "2", "3"]], strict=True))
    with pytest.raises(InputError, match=r"(?s)numbered the other way round they do, to \d+ µm.*mirrored = true"):
        build(fiducials=wrong)
    assert "mirrored" in said(fiducials=wrong, mirrored=True)[0]
    with pytest.raises(InputError, match=r"(?s)the other way round.*mirrored = false"):
        build(fiducials=good, mirrored=True)


def test_a_scan_from_the_back_is_the_same_camera() -> None:
    """Mirrored: the same directions at mirrored pixels."""
    plain = build()
    back = build(fiducials={name: [rig.SIZE[0] - c, r] for name, (c, r) in rig.marks().items()}, mirrored=True)
    pixels = np.random.default_rng(0).uniform(0, 4600, (20, 2))
    mirrored = np.column_stack([rig.SIZE[0] - pixels[:, 0], pixels[:, 1]])
    assert np.abs(plain.rays(pixels)[1] - back.rays(mirrored)[1]).max() < 1e-12


def test_two_marks_exchanged() -> None:
    marks = rig.marks(["1", "2", "3", "4"])
    marks["2"], marks["3"] = marks["3"], marks["2"]
    # Of four marks at the corners of a square, two exchanged opposite each other mirror it; two neighbours do not.
    with pytest.raises(InputError, match=r"the other way round|with other numbers"):
        build(fiducials=marks)
    marks = rig.marks()
    marks["5"], marks["7"] = marks["7"], marks["5"]
    with pytest.raises(InputError, match=r"with other numbers they do, to .* 5 is in truth 7, 7 is in truth 5"):
        build(fiducials=marks)


def test_one_gross_mark_is_named() -> None:
    marks = rig.marks()
    marks["6"][0] -= 100.0  # 5 mm
    with pytest.raises(InputError, match=r"without 6 they do, to \d+ µm, and it is off by 5\.0 mm"):
        build(fiducials=marks)
    marks = rig.marks()
    marks["6"][0] += 3.0
    with pytest.warns(GeomosaicWarning, match="a fiducial fits badly: 6"):
        build(fiducials=marks)


def test_numbers_moved_on_are_found_where_the_frame_is_not_symmetric() -> None:
    """A frame with marks 0.1 mm off the square, numbered from the wrong corner."""
    fiducials = {"1": [-106.1, -106.0], "2": [106.0, -105.9], "3": [106.05, 106.0], "4": [-106.0, 106.12]}
    camera = rig.CERTIFICATE | {"fiducials": fiducials}
    names = list(fiducials)
    image = rig.scan_of(np.array(list(fiducials.values()))).tolist()
    build(camera=camera, fiducials=dict(zip(names, image, strict=True)))
    turned = dict(zip(names, image[1:] + image[:1], strict=True))
    with pytest.raises(InputError, match="probably the scan is turned"):
        build(camera=camera, fiducials=turned)


def test_a_turned_scan_of_a_right_numbering_is_silent() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        turned = said(fiducials=rig.marks(turn=90.0))
    assert "turned by 90.0" in turned[0] or "turned by 89.9" in turned[0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"fiducials": None}, ["'fiducials' is missing", "mark = [col, row]"]),
        ({"fiducials": rig.marks(["1"])}, ["do not determine a conformal", "measure 2"]),
        ({"fiducials": rig.marks(["1", "2", "3"]), "interior": "projective"}, ["projective", "measure 4"]),
        ({"fiducials": {"9": [1, 2]}}, ["no fiducial '9'", "it has 1, 2, 3"]),
        ({"fiducials": rig.marks() | {"1": [9000, 10]}}, ["fiducial 1", "outside the image of 4600 x 4640"]),
        ({"fiducials": {k: [v[1], v[0]] for k, v in rig.marks().items()}}, ["numbered the other way round"]),
        ({"fiducials": {k: [c / 2, r / 2] for k, (c, r) in rig.marks().items()} | {"1": [3, 4]}}, ["without 1"]),
        ({"interior": "affin"}, ["did you mean 'affine'"]),
        ({"camera": {"focal_length_px": 3000}}, ["'fiducials' is about film"]),
        ({"camera": {k: v for k, v in rig.CERTIFICATE.items() if k != "principal_point_autocollimation"}}, ["in mm"]),
        ({"camera": rig.CERTIFICATE | {"principal_point_autocollimation": [2300, 2300]}}, ["far from the middle"]),
        ({"camera": rig.CERTIFICATE | {"distortion": {"model": "radial", "radius": [0, 1]}}}, ["neither 'distortion'"]),
        (
            {
                "camera": rig.CERTIFICATE
                | {"distortion": {"model": "radial", "radius": [0, 9, 5], "distortion": [0, 1, 2]}}
            },
            ["does not rise"],
        ),
        (
            {
                "camera": rig.CERTIFICATE
                | {"distortion": {"model": "radial", "radius": [0, 9], "distortion": [0, 1, 2]}}
            },
            ["3 values, not 2"],
        ),
        ({"camera": rig.CERTIFICATE | {"distortion": {"model": "polynomial", "k1": 1e-8}}}, ["'sign' is missing"]),
        (
            {"camera": rig.CERTIFICATE | {"distortion": {"model": "polynomial", "k1": -0.1, "sign": "correction"}}},
            ["coefficients in mm"],
        ),
        ({"curvature": True, "treatment": "rigorous"}, ["has the Earth's curvature"]),
        ({"refraction": True, "ground_height": None}, ["give ground_height"]),
        ({"refraction": "yes"}, ["refraction", "number"]),
    ],
)
def test_what_cannot_be_meant_is_refused(changes: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(InputError) as refused:
        build(**changes)
    assert str(refused.value).startswith("scan")
    for word in words:
        assert word in str(refused.value)
