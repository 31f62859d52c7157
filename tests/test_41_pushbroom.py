"""The physical scanner: the contract, a satellite written a second time, and refinement by few control points."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from numpy.polynomial.legendre import legval
from pyproj import CRS
from spot_rig import SIZE, Satellite, with_places

from geomosaic.errors import GeomosaicWarning, HeightDatumError, InputError, SensorInputError
from geomosaic.geo.crs import parse_crs
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.solve import resect
from geomosaic.sensor.solve.newton import difference_jacobian
from geomosaic.testing import SensorModelTests, check_plugin
from geomosaic.types import FloatArray
from geomosaic_pushbroom.model import PushbroomModel

ECEF = CRS.from_epsg(4978)
TOLD = Satellite(attitude=(0.0, 0.0, 0.0), rate=(0.0, 0.0, 0.0))
"""What the metadata say, true."""
BIASED = Satellite()
"""A flight whose attitude differs from what its metadata say."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene")
    (path / "METADATA.DIM").write_text(TOLD.dimap())
    (path / "SPEEDS.DIM").write_text(TOLD.dimap(speeds=True))
    return path


def request(folder: Path, size: tuple[int, int] = SIZE, crs: CRS | None = ECEF, **options: Any) -> SensorRequest:
    return SensorRequest("scene.tif", size, options, crs, str(folder), str(folder / "scene.tif"))


def build(folder: Path, **options: Any) -> PushbroomModel:
    model = registry.build("pushbroom", request(folder, **options))
    assert isinstance(model, PushbroomModel)
    return model


def as_points(ground: FloatArray, image: FloatArray, sigma: float = 0.3) -> list[dict[str, float]]:
    rows = np.column_stack([ground, image]).tolist()
    return [dict(zip(("x", "y", "z", "col", "row"), row, strict=True)) | {"sigma": sigma} for row in rows]


class TestAngles(SensorModelTests):
    """Corrections one by one are free; with all of them roll and a side shift would be nearly the same."""

    @pytest.fixture
    def model(self, folder: Path) -> PushbroomModel:
        return build(folder, sigmas={"position": 0, "rates": 1e-4, "angles": 0.01})

    @pytest.fixture
    def ground(self) -> FloatArray:
        points: FloatArray = TOLD.points(20, 800.0, 3)[0]
        return points


class TestCurves(TestAngles):
    @pytest.fixture
    def model(self, folder: Path) -> PushbroomModel:
        model = build(folder, sigmas={"position": 0, "rates": 1e-4, "angles": 0.01}, attitude_degree=4)
        curves = np.r_[np.zeros(10), 1e-3 * np.array([1.0, -2.0, 3.0, 2.0, 1.0, -1.0, -3.0, 2.0, 1.0])]
        return model.with_values(model.parameters.values + curves)


class Swinging(Satellite):
    """Satellite whose roll and pitch swing once in seven seconds."""

    SWING = np.array([60e-6, -60e-6, 0.0])

    def angles(self, t: float) -> np.ndarray:
        return super().angles(t) + self.SWING * np.sin(2.0 * np.pi * t / 7.0)


def test_an_attitude_that_bends_over_the_scene_is_found(folder: Path) -> None:
    """Against the satellite written a second time; its metadata say nothing of the swing."""
    true = Swinging(attitude=(0.0, 0.0, 0.0), rate=(0.0, 0.0, 0.0))
    ground, image = true.points(60, 800.0, 3)
    measured = image + np.random.default_rng(5).normal(0.0, 0.1, image.shape)
    left, found = [], None
    for degree in (1, 8):
        # Looking aside through a narrow field, yaw and pitch are nearly the same.
        sigmas = {"curve": 0.01, **{f"yaw_{k}": 0 for k in range(2, 9)}} if degree > 1 else {}
        start = build(folder, attitude_degree=degree, sigmas=sigmas)
        found = resect(start, ground, measured, np.full(len(ground), 0.1)).model
        left.append(float(np.sqrt(((found.ground_to_image(ground) - image) ** 2).sum(axis=1).mean())))
    assert isinstance(found, PushbroomModel)
    t = np.linspace(-4.4, 4.4, 50)
    values = dict(zip(found.parameters.names, np.radians(found.parameters.values), strict=True))
    for angle, true_swing in zip(("roll", "pitch"), true.SWING, strict=False):
        curve = [values[angle], values[f"{angle}_rate"] * 4.512, *(values[f"{angle}_{k}"] for k in range(2, 9))]
        off = legval(t / 4.512, curve) - true_swing * np.sin(2.0 * np.pi * t / 7.0)
        # Its mean is told apart from the position by relief alone.
        assert off.std() < 4e-6
    assert left[1] < 0.1 < 1.0 < left[0]


class TestShifts(TestAngles):
    @pytest.fixture
    def model(self, folder: Path) -> PushbroomModel:
        sigmas = {"position": 20, "rates": 1e-4, "angles": 0, "yaw": 0.01, "pitch_rate": 0}
        return build(folder, sigmas=sigmas)


def test_the_plugin_passes_the_check(folder: Path) -> None:
    options = {"metadata": "SPEEDS.DIM", "band": 1, "sigmas": {"time": 1e-3}, "ground_height": 400.0, "offset": [0, 0]}
    check_plugin(registry.plugin("pushbroom"), request(folder, **options))


@pytest.mark.parametrize("file", ["METADATA.DIM", "SPEEDS.DIM"])
def test_against_a_second_implementation(folder: Path, file: str) -> None:
    """The rig knows the orbit by its formula; the model has points a minute apart, and times in microseconds."""
    ground, image = TOLD.points(60, 3000.0, 1)
    model = build(folder, metadata=file)
    np.testing.assert_allclose(model.ground_to_image(ground), image, atol=1e-4)
    origins, directions = model.rays(image)
    for place, origin, direction in zip(image, origins, directions, strict=True):
        there, towards = TOLD.ray(*place)
        assert np.linalg.norm(origin - there) < 2e-3
        assert np.linalg.norm(direction - towards / np.linalg.norm(towards)) < 1e-10


def test_a_keyword_list(tmp_path: Path) -> None:
    """Of the biased flight, whose attitude it tells."""
    (tmp_path / "scene.geom").write_text(BIASED.keyword_list())
    ground, image = BIASED.points(40, 3000.0, 1)
    np.testing.assert_allclose(build(tmp_path, metadata="scene.geom").ground_to_image(ground), image, atol=1e-4)


def test_speeds_are_integrated(folder: Path, tmp_path: Path) -> None:
    """A constant angular speed is a growing angle: the rates of the biased flight, put into its metadata."""
    roll, pitch, yaw = BIASED.rate
    text = TOLD.dimap(speeds=True)
    start = text.index("<Angular_Speeds_List>")
    rates = text[start:].replace("<YAW>0.0", f"<YAW>{yaw}").replace("<PITCH>0.0", f"<PITCH>{pitch}")
    first = dict(zip(("ROLL", "PITCH", "YAW"), BIASED.angles(-5.0).tolist(), strict=True))
    head = text[:start]
    for name, value in first.items():
        head = head.replace(f"<{name}>0.0", f"<{name}>{value!r}")
    (tmp_path / "METADATA.DIM").write_text(head + rates.replace("<ROLL>0.0", f"<ROLL>{roll}"))
    ground, image = BIASED.points(40, 800.0, 2)
    np.testing.assert_allclose(build(tmp_path).ground_to_image(ground), image, atol=1e-4)


def test_closed_derivatives_are_those_of_differences(folder: Path) -> None:
    model, ground = build(folder), TOLD.points(30, 800.0, 4)[0]
    for closed, measured in zip(model.jacobian(ground), difference_jacobian(model, ground), strict=True):
        assert (np.abs(closed - measured) <= 1e-6 * np.abs(measured).max(axis=(0, 1))).all()


def test_one_point_is_the_same_alone_and_among_many(folder: Path) -> None:
    model, ground = build(folder), TOLD.points(50, 800.0, 5)[0]
    together = model.ground_to_image(ground)
    for i in (0, 17, 49):
        np.testing.assert_array_equal(model.ground_to_image(ground[i : i + 1])[0], together[i])


def test_what_cannot_be_seen(folder: Path) -> None:
    """The far side of the Earth, above the satellite, NaN; and their neighbours are as without them."""
    model, ground = build(folder), TOLD.points(3, 800.0, 6)[0]
    odd = np.vstack([ground[0], -ground[0], 1.5 * ground[1], [np.nan, 0.0, 0.0], ground[2]])
    image = model.ground_to_image(odd)
    assert np.isnan(image[1:4]).all()
    np.testing.assert_array_equal(image[[0, 4]], model.ground_to_image(ground[[0, 2]]))
    beside = model.rays(np.array([[-800.0, 1500.0], [1500.0, 4100.0]]))
    assert np.isfinite(beside[0]).all()


# A seeded share by default; the whole table is in test_41_pushbroom_table.py.
@pytest.mark.parametrize(("count", "most"), [(1, 1.2), (3, 0.7), (4, 0.6), (6, 0.5), (9, 0.4)])
def test_refined_by_a_small_number_of_points(folder: Path, count: int, most: float) -> None:
    """Roll, pitch and yaw off by 20" to 100" and drifting, 800 m of relief, 0.3 px noise: RMS of 80 check points."""
    check, truth = BIASED.points(80, 800.0, 9)
    assert np.hypot(*(build(folder).ground_to_image(check) - truth).T).min() > 3.0
    rms = []
    for trial in range(3):
        ground, image = BIASED.points(count, 800.0, 100 + trial, with_places(count))
        noisy = image + np.random.default_rng(trial).normal(0.0, 0.3, image.shape)
        model = build(folder, points=as_points(ground, noisy))
        rms.append(np.sqrt((np.hypot(*(model.ground_to_image(check) - truth).T) ** 2).mean()))
    assert max(rms) < most


def test_refinement_finds_the_attitude(folder: Path) -> None:
    """Without noise the corrections are the attitude itself; sigmas far above it leave room."""
    ground, image = BIASED.points(16, 800.0, 7, with_places(16))
    sigmas = {"angles": 1.0, "rates": 0.1, "position": 0.0}
    model = build(folder, points=as_points(ground, image, 0.01), sigmas=sigmas)
    found = np.radians(model.parameters.values[:6])
    # The plugin counts from the row of SCENE_CENTER_LINE as the rig does.
    np.testing.assert_allclose(found[:3], BIASED.attitude, atol=1e-8)
    np.testing.assert_allclose(found[3:], BIASED.rate, atol=1e-9)
    assert "16 control points" in model.notes[-1]


def test_refine_none_leaves_the_metadata(folder: Path) -> None:
    ground, image = BIASED.points(4, 800.0, 7, with_places(4))
    model = build(folder, points=as_points(ground, image), refine="none")
    np.testing.assert_array_equal(model.parameters.values, 0.0)


def test_a_cut_of_a_scene(folder: Path) -> None:
    ground, _ = TOLD.points(20, 800.0, 8)
    whole, cut = build(folder), build(folder, size=(500, 700), offset=[1200, 900])
    moved = whole.ground_to_image(ground) - [1200, 900]
    np.testing.assert_allclose(cut.ground_to_image(ground), moved, atol=1e-6)


def test_a_cut_whose_geotransform_tells_its_corner_proposes_the_offset(folder: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.tif"
    with rasterio.open(
        cut, "w", driver="GTiff", width=500, height=700, count=1, dtype="uint8", transform=Affine(1, 0, 1200, 0, 1, 900)
    ):
        pass
    asked = replace(request(folder, (500, 700), metadata="METADATA.DIM"), path=str(cut))
    with pytest.raises(SensorInputError, match="column 1200, row 900") as caught:
        registry.build("pushbroom", asked)
    assert (caught.value.name, caught.value.proposed) == ("offset", [1200, 900])
    near = replace(asked, options={**asked.options, "offset": [1190, 900]})
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        registry.build("pushbroom", near)
    assert not any("is declared" in str(one.message) for one in told)
    with pytest.warns(GeomosaicWarning, match=r"offset = \[900, 1200\] is declared, .*give offset = \[1200, 900\]"):
        registry.build("pushbroom", replace(asked, options={**asked.options, "offset": [900, 1200]}))


def replaced(old: str, new: str) -> str:
    text = TOLD.dimap()
    assert old in text
    return text.replace(old, new)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (replaced("<PROCESSING_LEVEL>1A", "<PROCESSING_LEVEL>2A"), "level 2A"),
        (replaced("LINE_PERIOD>", "LINE_PERIODS>"), "LINE_PERIOD"),
        (replaced("<MISSION>SPOT", "<MISSION>FORMOSAT"), "metadata of FORMOSAT 2"),
        (replaced("<LINE_PERIOD>0.003008", "<LINE_PERIOD>nan"), "finite"),
        (replaced("<LINE_PERIOD>0.003008", "<LINE_PERIOD>0"), "line period is 0 s"),
        (replaced("<LINE_PERIOD>0.003008", "<LINE_PERIOD>0.03008"), "attitudes leave"),
        (replaced("Points>", "Pointless>"), "0 ephemeris points"),
        (replaced("<Location>", "<Location><X>0.0</X>"), "not those of a satellite"),
        (replaced("<PITCH>0.0", "<PITCH>3.0"), "no radians"),
        (replaced("<DETECTOR_ID>3000", "<DETECTOR_ID>1"), "look angles"),
        (replaced("Look_Angles_List", "Lost_List"), "Instrument_Look_Angles"),
        (replaced("T10:00:00", "T99:00"), "not a time"),
        (replaced("Dimap_Document>", "Other>"), "not <Dimap_Document>"),
        ('<!DOCTYPE a [<!ENTITY b "c">]>' + TOLD.dimap().partition("?>")[2], "document type"),
        (TOLD.dimap()[:900], "damaged"),
        ("<a>" * 100, "nested"),
        ("type: ossimQuickbirdRpc", "keyword list is of type"),
        ("type: ossimFormosatModel", "control points alone: metadata = 'none', flying_height"),
        (BIASED.keyword_list().replace("param_0.parameter:  0", "param_0.parameter:  1e-3"), "adjustment made by"),
        (BIASED.keyword_list().replace("sub_image_offset:  0.0", "sub_image_offset:  8"), "part of the scene"),
        (BIASED.keyword_list().replace("sampling_period:  ", "sampling_period:  -"), "line period is -0.003"),
        (BIASED.keyword_list().replace("sampling_period:  0.0", "sampling_period:  0.1"), "attitudes leave"),
        (re.sub(r"(attitude_samples: ) \S+", r"\1 5.0", BIASED.keyword_list()), "no radians"),
        (BIASED.keyword_list().replace("image_size:  3000.0", "image_size:  2000.0"), "3000 detectors for 2000"),
        ("", "no keyword list"),
    ],
)
def test_bad_metadata_are_refused_by_name(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "METADATA.DIM").write_text(text)
    with pytest.raises(InputError) as told:
        build(tmp_path)
    assert words in str(told.value)
    assert "scene.tif" in str(told.value)
    assert "METADATA.DIM" in str(told.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"size": (100, 100)}, "3000 x 3000"),
        ({"size": (100, 100), "offset": [2950, 0]}, "reach beyond"),
        ({"metadata": "lost.dim"}, "does not exist"),
        ({"metadata": "none"}, "neither metadata nor a track"),
        ({"metadata": 3}, "not a file name"),
        ({"band": 7}, "no look angles of band 7"),
        ({"sigmas": {"rol": 1}}, "did you mean 'roll'"),
        ({"sigmas": {"roll": -1}}, "negative"),
        ({"flying_height": 8e5}, "no meaning"),
        ({"refine": "all"}, "refine = 'all'"),
        ({"points": 3}, "not a list"),
        ({"points": [{"x": 1}]}, "has no y, z, col, row"),
        ({"points": as_points(np.zeros((1, 3)), np.zeros((1, 2))), "crs": None}, "no CRS"),
        ({"points": as_points(np.zeros((1, 3)), np.zeros((1, 2))), "crs": parse_crs("EPSG:32624")}, "vertical datum"),
    ],
)
def test_bad_inputs_are_named(folder: Path, options: dict[str, Any], words: str) -> None:
    with pytest.raises((InputError, HeightDatumError)) as told:
        build(folder, **options)
    assert words in str(told.value)
    assert "scene.tif" in str(told.value)


def test_bands_that_look_apart(tmp_path: Path) -> None:
    text = TOLD.dimap()
    first = text[text.index("<Instrument_Look_Angles>") : text.index("</Instrument_Look_Angles_List>")]
    for move, apart in ((1e-6, False), (1e-4, True)):
        psi = TOLD.psi(1.0)[0]
        second = first.replace("<BAND_INDEX>1", "<BAND_INDEX>2").replace(repr(psi), repr(psi + move))
        (tmp_path / "METADATA.DIM").write_text(text.replace(first, first + second))
        if apart:
            with pytest.raises(InputError, match=r"look apart by up to 4\."):
                build(tmp_path)
        assert build(tmp_path, band=2).look.along[0] == pytest.approx(psi + move, abs=1e-12)
        if not apart:
            build(tmp_path)
