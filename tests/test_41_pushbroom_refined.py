"""DIMAP 2 with Refined_Model: SPOT 6 and 7, Pléiades, Pléiades Neo, against a satellite of which all is known."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import examples
from hypothesis import HealthCheck, example, given
from hypothesis import strategies as st
from refined_rig import Agile
from spot_rig import SIZE

from geomosaic.errors import InputError
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.testing import SensorModelTests
from geomosaic.types import FloatArray
from geomosaic_pushbroom.build import of_scene
from geomosaic_pushbroom.metadata import find_beside, read_bytes
from geomosaic_pushbroom.model import PushbroomModel

TRUTH = Agile()
WAYS = {"polynomials": {"table": False}, "table": {"table": True}, "dense": {"table": True, "dense": True, "unit": 1e6}}
NUMBER = re.compile(r"(?<=>)-?\d[\d.e+ -]*(?=<)")
"""A number, or a row of them."""


def scene(text: str, band: str | None = None, size: tuple[int, int] = SIZE) -> PushbroomModel:
    return of_scene(read_bytes(text.encode(), "scene.tif", band), SensorRequest("scene.tif", size))


@cache
def text_of(way: str) -> str:
    return TRUTH.primary() if way == "primary" else TRUTH.refined(table=way == "table")


@cache
def ground_of_kit() -> FloatArray:
    points: FloatArray = TRUTH.points(20, 800.0, 3)[0]
    return points


@pytest.mark.parametrize("way", WAYS)
def test_against_a_second_implementation(way: str) -> None:
    """Microseconds of the times are 0.3 mm of flight; linear quaternions 32 a second apart miss some 1e-9 rad."""
    ground, image = TRUTH.points(30, 3000.0, 1)
    model = scene(TRUTH.refined(**WAYS[way]))
    np.testing.assert_allclose(model.ground_to_image(ground), image, atol=1e-3)
    origins, directions = model.rays(image)
    for place, origin, direction in zip(image, origins, directions, strict=True):
        there, towards = TRUTH.ray(*place)
        assert np.linalg.norm(origin - there) < 5e-3
        assert np.linalg.norm(direction - towards / np.linalg.norm(towards)) < 5e-9


def test_the_earlier_profile_of_pleiades() -> None:
    ground, image = TRUTH.points(30, 3000.0, 1)
    np.testing.assert_allclose(scene(TRUTH.primary()).ground_to_image(ground), image, atol=1e-3)


@pytest.mark.parametrize("width", [SIZE[0], 39951])
def test_a_retina_with_one_value_more_than_columns(width: int) -> None:
    """As real products have it: columns count from the first value. Any other number of values is refused."""
    ground, image = TRUTH.points(30, 3000.0, 1)
    text = TRUTH.primary()
    for key in ("NCOLS", "LAST_COL"):
        text = text.replace(f"<{key}>{SIZE[0]}<", f"<{key}>{width}<")
    size = (width, SIZE[1])

    def ending(last: int) -> str:
        return text.replace(f"<LAST_COL>{width}<", f"<LAST_COL>{last}<")

    model = scene(ending(width + 1), size=size)
    np.testing.assert_allclose(model.ground_to_image(ground), image, atol=1e-3)
    assert any("one value more" in note for note in model.notes)
    assert not any("one value more" in note for note in scene(text, size=size).notes)
    for last in (width - 1, width + 2):
        with pytest.raises(InputError, match="where each column looks is unknown"):
            scene(ending(last), size=size)


def test_a_product_that_is_part_of_the_line() -> None:
    part = Agile(first_col=701)
    ground, image = part.points(30, 800.0, 2)
    np.testing.assert_allclose(scene(part.refined(table=False)).ground_to_image(ground), image, atol=1e-3)


def test_beyond_the_image() -> None:
    """Where the table of an agile satellite ends with the scene, a margin of its rows is still seen."""
    ground, image = TRUTH.points(3, 0.0, 3, np.array([[1500.0, -150.0], [1500.0, 3150.0], [-100.0, 100.0]]))
    np.testing.assert_allclose(scene(TRUTH.refined(**WAYS["dense"])).ground_to_image(ground), image, atol=0.3)


class TestKit(SensorModelTests):
    @pytest.fixture
    def model(self) -> PushbroomModel:
        return scene(text_of("table"))

    @pytest.fixture
    def ground(self) -> FloatArray:
        return ground_of_kit()


def true_ground(col: float, row: float, height: float) -> FloatArray:
    """Where light came from: aslant for the speed of the satellite, and along n·r·sin z through the atmosphere."""
    origin, appears = TRUTH.ray(col, row)
    _, velocity = TRUTH.state(TRUTH.period * (row + 0.5 - TRUTH.centre_line))
    straight = looking(TRUTH, origin, appears / np.linalg.norm(appears) - velocity / 299792458.0)
    point = straight.ground(col, row, height)
    down = (origin - point) / np.linalg.norm(origin - point)
    up = point / np.array([6378137.0, 6378137.0, 6356752.3]) ** 2
    up /= np.linalg.norm(up)
    radius = 6.37e6 + np.linspace(0.0, 1e5, 20001)
    bent = radius[0] * np.sqrt(1.0 - (down @ up) ** 2) / radius
    refracted = bent / (1.0 + 2.77e-4 * np.exp((radius[0] - radius) / 8434.0))
    along = [s / np.sqrt(1.0 - s * s) / radius for s in (refracted, bent)]
    moved = radius[0] * np.trapezoid(along[0] - along[1], radius)
    away = point - origin - ((point - origin) @ up) * up
    result: FloatArray = point + away / np.linalg.norm(away) * moved
    return result


def looking(satellite: Agile, origin: FloatArray, direction: FloatArray) -> Agile:
    class Straight(Agile):
        def ray(self, col: float, row: float) -> tuple[FloatArray, FloatArray]:
            return origin, direction

    return Straight(**vars(satellite))


def test_basic_products_of_worldview_see_along_bent_light() -> None:
    """Aberration is 0.8 of these 20 m pixels, refraction 0.06; what is left, of a line 4° wide, is 0.1 m."""
    model = scene(TRUTH.basic())
    image = np.random.default_rng(4).uniform(0.0, 1.0, (25, 2)) * SIZE
    ground = np.array([true_ground(*place, 0.0) for place in image])
    assert np.abs(model.ground_to_image(ground) - image).max() < 0.008
    unbent = np.array([TRUTH.ground(*place, 0.0) for place in image])
    assert np.abs(model.ground_to_image(unbent) - image).max() > 0.5


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<GEO>.*</GEO>", "", "no ephemeris, attitudes and camera"),
        ("<POLYORDER>-1", "<POLYORDER>2", "optical distortion"),
        ("<CZ>0", "<CZ>0.5", "perspective centre"),
        ("<TLCLIST>0.0 0.0", "<TLCLIST>0.0 9.9", "TLCLIST"),
        ("<STARTTIME>1999", "<STARTTIME>1998", "ephemeris"),
        ("<PD>1", "<PD>-1", "PD is"),
    ],
)
def test_what_a_basic_product_lacks_is_named(old: str, new: str, words: str) -> None:
    text = re.sub(old, new, TRUTH.basic(0.5), flags=re.DOTALL)
    with pytest.raises(InputError, match=words) as told:
        scene(text)
    assert told.value.hint


def test_found_beside_the_image_and_refined(tmp_path: Path) -> None:
    (tmp_path / "DIM_SPOT6_P_1.XML").write_text(Agile(attitude=(0.0, 0.0, 0.0)).refined(table=True))
    image = tmp_path / "IMG_SPOT6_P_1_R1C1.TIF"
    assert find_beside(str(image)) == tmp_path / "DIM_SPOT6_P_1.XML"
    assert find_beside(str(tmp_path / "IMG_SPOT6_P_2.TIF")) is None
    off = Agile(attitude=(2e-5, -1e-5, 3e-5))
    ground, colrow = off.points(4, 800.0, 5, np.array([[300.0, 300], [2700, 300], [300, 2700], [2700, 2700]]))
    points = [
        dict(zip("xyz", g, strict=True)) | {"col": c, "row": r, "sigma": 0.02}
        for g, (c, r) in zip(ground, colrow, strict=True)
    ]
    options: dict[str, Any] = {"points": points}
    crs = scene(TRUTH.refined(table=False)).crs
    model = registry.build("pushbroom", SensorRequest(image.name, SIZE, options, crs, str(tmp_path), str(image)))
    check, truth = off.points(50, 800.0, 6)
    assert np.abs(model.ground_to_image(check) - truth).max() < 0.05


def test_bands_that_look_apart_are_refused() -> None:
    text = TRUTH.refined(table=False, bands=("B0", "B1"))
    with pytest.raises(InputError, match=r"look apart by up to 4.17 pixels"):
        scene(text)
    ground, image = TRUTH.points(10, 800.0, 7)
    np.testing.assert_allclose(scene(text, "B0").ground_to_image(ground), image, atol=1e-3)
    with pytest.raises(InputError, match="known bands are: B0, B1"):
        scene(text, "B9")


def replaced(old: str, new: str, *, table: bool = False) -> str:
    text = TRUTH.refined(table=table)
    assert old in text
    return text.replace(old, new)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (replaced("<PROCESSING_LEVEL>SENSOR", "<PROCESSING_LEVEL>ORTHO"), "level ORTHO"),
        (replaced("<LINE_PERIOD>3.0", "<LINE_PERIOD>3.1"), "be it in s, ms or"),
        (replaced("<LAST_COL>3000", "<LAST_COL>2999"), "which detectors they are"),
        (replaced("<YAW>0.0", "<YAW>0.1"), "bias in yaw"),
        (replaced("XLOS_0>", "XLOS>"), "XLOS_0"),
        (replaced("<XLOS_0>0.3", "<XLOS_0>3.3"), "beyond 45"),
        (replaced("<XLOS_1>2.4e-05", "<XLOS_1>0"), "look angles of the line"),
        (replaced("<SCALE>5.0", "<SCALE>0"), "no attitude"),
        (replaced("Polynomial_Quaternions>", "Polynomials>"), "Quaternion_List/Quaternion"),
        (replaced("Q3>", "Q4>", table=True), "Q3"),
        (replaced("<Q3>-0", "<Q3>-9", table=True), "not of length one"),
        (replaced("LOCATION_XYZ>", "LOCATION>"), "LOCATION_XYZ"),
        (replaced("<LOCATION_XYZ>", "<LOCATION_XYZ>1 "), "4 numbers, not 3"),
        (replaced("T10:0", "T10:9"), "not a time"),
        ("<Dimap_Document><Rational_Function_Model/></Dimap_Document>", "the sensor 'rpc'"),
        (TRUTH.primary().replace("<LOCATION_VALUES>", "<LOCATION_VALUES>1 ", 1), "4 numbers, not 3"),
        (TRUTH.primary().replace("<SCALE>5.0", "<SCALE>0"), "no attitude"),
        (TRUTH.primary().replace("<LAST_COL>3000", "<LAST_COL>2999"), "where each column looks"),
        (TRUTH.primary().replace(f">{0.30} {2.4e-5}<", "><"), "0 and 2 coefficients"),
    ],
)
def test_bad_metadata_are_refused_by_name(text: str, words: str) -> None:
    with pytest.raises(InputError) as told:
        scene(text)
    assert words in str(told.value)


@examples(60, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.sampled_from(["polynomials", "table", "primary"]),
    st.integers(0, 10_000),
    st.sampled_from(["", "nan", "inf", "-1", "0", "1e300", "-1e9", "x", "1 2"]),
)
@example("primary", 32, "1e300")  # once squared before anything asked whether it can be meant
def test_a_number_replaced(way: str, which: int, word: str) -> None:
    """A clear error, or a model whose pixels meet the ground or NaN."""
    text = text_of(way)
    places = list(NUMBER.finditer(text))
    place = places[which % len(places)]
    assert told(text[: place.start()] + word + text[place.end() :])


def told(text: str) -> bool:
    """Whether an error names the scene, or a model maps its rays, if only to NaN."""
    try:
        model = scene(text)
    except InputError as error:
        return "scene.tif" in str(error)
    origins, directions = model.rays(np.array([[0.0, 0.0], [1500.0, 1500.0]]))
    return model.ground_to_image(origins + 9e5 * directions).shape == (2, 2)
