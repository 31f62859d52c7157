"""The RPC model and its readers: one scene, written in every format, is the same scene."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import rpc_rig as rig
from affine import Affine
from helpers import examples
from hypothesis import given
from hypothesis import strategies as st

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.raster.image_metadata import read_rpc_tags
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.testing import SensorModelTests, check_plugin
from geomosaic_rpc import RpcModel, plugin, write_tags, write_text
from geomosaic_rpc.build import read_rpc_bytes
from geomosaic_rpc.coefficients import combine, evaluate, terms
from geomosaic_rpc.formats import FIRST_PIXEL

FORMATS: dict[str, Callable[[], str]] = {
    "RPC.TXT": rig.rpc_txt,
    "RPB": rig.rpb,
    "OSSIM": rig.ossim,
    "DIMAP PHR_SENSOR": rig.dimap,
    "DIMAP S6_SENSOR": lambda: rig.dimap("S6_SENSOR"),
    "DIMAP 1 PHR": rig.dimap_phr,
    "DIMAP PNEO_SENSOR": lambda: rig.dimap("PNEO_SENSOR", 0.0, "GroundtoImage_Values"),
    "DigitalGlobe XML": rig.digital_globe,
}


@pytest.mark.parametrize("values", [np.zeros(6), np.array([3.0, -2.0, 5.0, 4.0, -6.0, 3.0])], ids=["raw", "refined"])
class TestContract(SensorModelTests):
    @pytest.fixture
    def model(self, values: np.ndarray) -> RpcModel:
        return rig.model("affine").with_values(values)

    @pytest.fixture
    def ground(self) -> np.ndarray:
        return rig.ground()


def by_hand(lonlath: np.ndarray) -> np.ndarray:
    """The formula of RPC00B, written out term by term for one point; (col, row) with the first pixel's centre at 0."""
    n = rig.scalars(0.0)
    lon, lat, h = lonlath
    P = (lat - n["LAT_OFF"]) / n["LAT_SCALE"]
    L = (lon - n["LONG_OFF"]) / n["LONG_SCALE"]
    H = (h - n["HEIGHT_OFF"]) / n["HEIGHT_SCALE"]
    t = [
        1, L, P, H, L * P, L * H, P * H, L**2, P**2, H**2, P * L * H, L**3, L * P**2, L * H**2, L**2 * P, P**3,
        P * H**2, L**2 * H, P**2 * H, H**3,
    ]  # fmt: skip
    value = {name: sum(c * x for c, x in zip(row, t, strict=True)) for name, row in rig.polynomials().items()}
    sample = n["SAMP_SCALE"] * value["SAMP_NUM_COEFF"] / value["SAMP_DEN_COEFF"] + n["SAMP_OFF"]
    line = n["LINE_SCALE"] * value["LINE_NUM_COEFF"] / value["LINE_DEN_COEFF"] + n["LINE_OFF"]
    return np.array([sample, line])


def test_an_rpc_is_its_formula() -> None:
    points = rig.ground()
    expected = np.array([by_hand(point) for point in points]) + 0.5
    assert np.abs(rig.model().ground_to_image(points) - expected).max() < 1e-9


def test_the_compiled_polynomials_are_to_the_byte_the_sums_of_their_terms() -> None:
    rng = np.random.default_rng(5)
    coefficients, places = rng.normal(0.0, 1.0, (4, 20)), rng.uniform(-3.0, 3.0, (331, 3))
    places[7] = -0.0
    for number in (0, 1, 64, 331):
        found, sums = evaluate(coefficients, places[:number]), combine(coefficients, terms(places[:number]))
        assert found.tobytes() == sums.tobytes()


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_same_scene(name: str) -> None:
    fields = read_rpc_bytes(FORMATS[name]().encode(), name)
    assert fields.format == name
    rpc = fields.rpc(name)
    assert np.abs(rpc.image(rig.ground()) - rig.rpc().image(rig.ground())).max() < 1e-9
    shifted = fields.rpc(name, first_pixel=FIRST_PIXEL[name] + 1.0)
    assert np.allclose(shifted.image_offset, rpc.image_offset - 1.0)


def test_the_projection_of_an_ossim_geometry_is_read_as_the_rpc_alone() -> None:
    alone, within = (read_rpc_bytes(text.encode(), "a.geom") for text in (rig.ossim(), rig.ossim_geometry()))
    assert (alone.numbers, alone.polynomials) == (within.numbers, within.polynomials)


def test_an_unknown_product_does_not_get_a_pixel_origin() -> None:
    fields = read_rpc_bytes(rig.dimap("NEW_SENSOR").encode(), "new")
    with pytest.raises(InputError, match="how this product counts its pixels") as caught:
        fields.rpc("RPC_new.XML")
    assert "first_pixel" in str(caught.value)
    assert np.allclose(fields.rpc("RPC_new.XML", 1.0).image_offset, rig.rpc().image_offset)


BROKEN = {
    "no format": ("LINE_OFF 12", "no RPC file that is known"),
    "other sensor": ("type:  ossimSpot5Model\nref_point_line:  3\n", "ossimSpot5Model and has no RPC"),
    "other xml": ("<VRTDataset/>", "starts with <VRTDataset>"),
    "entities": ('<!DOCTYPE a [<!ENTITY b "c">]><isd>&b;</isd>', "document type"),
    "cut xml": (rig.dimap()[:-30], "damaged"),
    "no model": ("<Dimap_Document/>", "no rational function model"),
    "phr without model": ("<PHR_Dimap_Document/>", "no rational function model"),
    "phr short list": (re.sub(r"<F_COL>\S+ ", "<F_COL>", rig.dimap_phr()), "39 numbers in F_COL"),
    "phr no scale": (rig.dimap_phr().replace("<Alt>", "<Al>").replace("</Alt>", "</Al>"), "RFM_Validity/Alt/A"),
    "phr origin": (rig.dimap_phr().replace("ORIGIN>1", "ORIGIN>0"), "PIXEL_ORIGIN is 0"),
    "feet": (rig.rpc_txt().replace("420.0 meters", "420.0 feet"), "in 'feet'"),
    "missing scalar": (rig.rpc_txt().replace("LAT_OFF", "LAT_OF"), "no LAT_OFF"),
    "missing term": (rig.rpc_txt().replace("SAMP_DEN_COEFF_7:", "SAMP_DEN_COEFF_x:"), "no SAMP_DEN_COEFF_7"),
    "no number": (rig.rpc_txt().replace("420.0 meters", "high"), "HEIGHT_OFF is 'high'"),
    "nan": (rig.rpc_txt().replace("420.0 meters", "nan"), "not a finite number"),
    "zero scale": (rig.rpc_txt().replace("HEIGHT_SCALE: 500.0", "HEIGHT_SCALE: 0"), "HEIGHT_SCALE of the RPC is 0"),
    "no place": (rig.rpc_txt().replace("LAT_OFF: 45.6", "LAT_OFF: 145.6"), "no place on the Earth"),
    "twice": (rig.rpc_txt() + "LAT_OFF: 44\n", "LAT_OFF stands twice"),
    "rpc00a": (rig.rpb().replace("RPC00B", "RPC00A"), "'RPC00A', not RPC00B"),
    "format a": (rig.ossim().replace("format:  B", "format:  A"), "of format A"),
    "turned": (rig.ossim_geometry().replace("2dIdentity", "2dLinear"), "transforms the image"),
    "adjusted": (rig.ossim().replace("parameter:  0", "parameter:  1.5"), "adjustment made by OSSIM"),
    "short list": (rig.rpb().replace(",", "", 1), "lineNumCoef|sampNumCoef"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_files_are_reported(case: str) -> None:
    text, words = BROKEN[case]
    with pytest.raises(InputError, match=words) as caught:
        read_rpc_bytes(text.encode(), "scene.rpc").rpc("scene.rpc")
    assert "scene.rpc" in str(caught.value)


@examples(150)
@given(st.sampled_from(sorted(FORMATS)), st.data())
def test_damaged_files_give_an_error_or_a_finite_model(name: str, data: st.DataObject) -> None:
    good = FORMATS[name]().encode()
    start = data.draw(st.integers(0, len(good) - 1))
    stop = data.draw(st.integers(start, min(len(good), start + 40)))
    changed = good[:start] + data.draw(st.binary(max_size=20)) + good[stop:]
    try:
        rpc = read_rpc_bytes(changed, name).rpc(name)
    except InputError:
        return
    image = rpc.image(rig.ground(5))
    assert image.shape == (5, 2)


@examples(100)
@given(st.binary(max_size=400))
def test_anything_is_read_or_refused(data: bytes) -> None:
    with pytest.raises(InputError):
        read_rpc_bytes(data, "x")


@pytest.mark.parametrize("filling", [b"(", b" ", b"\n", b"\t=", b";", b"<a>"])
def test_large_nonsense_is_refused_at_once(filling: bytes) -> None:
    start = time.perf_counter()
    for head in (b"lineNumCoef = ", b"LINE_NUM_COEFF_1: ", b"line_num_coeff_00: ", b"<isd>"):
        with pytest.raises(InputError):
            read_rpc_bytes(head + filling * 200_000, "x").rpc("x")
    assert time.perf_counter() - start < 10.0


def picture(path: Path, size: tuple[int, int] = rig.SIZE) -> Path:
    """An image file of the scene's size that holds next to nothing."""
    profile: dict[str, Any] = {"driver": "GTiff", "dtype": "uint8", "count": 1, "width": size[0], "height": size[1]}
    with rasterio.open(path, "w", sparse_ok=True, tiled=True, **profile):
        pass
    return path


def request(path: Path | None, size: tuple[int, int] = rig.SIZE, **options: Any) -> SensorRequest:
    return SensorRequest("scene.tif", size, options, None, ".", None if path is None else str(path))


def build(path: Path | None, size: tuple[int, int] = rig.SIZE, **options: Any) -> RpcModel:
    made = registry.build("rpc", request(path, size, **options))
    assert isinstance(made, RpcModel)
    return made


def same(one: RpcModel, other: RpcModel) -> bool:
    points = rig.ground()
    return bool(np.abs(one.ground_to_image(points) - other.ground_to_image(points)).max() < 1e-9)


SIDECARS = {
    "scene_RPC.TXT": rig.rpc_txt, "scene_rpc.txt": rig.rpc_txt, "scene.RPB": rig.rpb, "scene.geom": rig.ossim,
    "scene.kwl": rig.ossim, "scene.XML": rig.digital_globe,
}  # fmt: skip


@pytest.mark.parametrize("name", SIDECARS)
def test_the_file_beside_the_image_is_found(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(SIDECARS[name]())
    assert same(build(picture(tmp_path / "scene.tif")), rig.model())


@pytest.mark.parametrize("image", ["IMG_PHR1A_P_001.tif", "IMG_PHR1A_P_001_R1C1.tif"])
def test_the_file_of_a_dimap_product_is_found(image: str, tmp_path: Path) -> None:
    (tmp_path / "RPC_PHR1A_P_001.XML").write_text(rig.dimap())
    assert same(build(picture(tmp_path / image)), rig.model())


def test_tags_and_sidecar_that_agree(tmp_path: Path) -> None:
    image = picture(tmp_path / "scene.tif")
    write_tags(rig.model(), image)
    (tmp_path / "scene.geom").write_text(rig.ossim())
    assert same(build(image), rig.model())


def test_tags_and_sidecar_that_differ(tmp_path: Path) -> None:
    image = picture(tmp_path / "scene.tif")
    write_tags(rig.model(), image)
    (tmp_path / "scene.geom").write_text(rig.ossim().replace("line_off:  1499.5", "line_off:  1500.5"))
    with pytest.raises(InputError, match=r"scene.geom and of image differ, by up to 1 pixels"):
        build(image)
    assert same(build(image, rpc="image"), rig.model())
    chosen = build(image, rpc=str(tmp_path / "scene.geom"))
    moved = chosen.ground_to_image(rig.ground()) - rig.model().ground_to_image(rig.ground())
    assert np.allclose(moved, [0.0, 1.0])


@pytest.mark.parametrize("name", ["scene_RPC.TXT", "scene.RPB"])
def test_a_sidecar_that_gdal_prefers_does_not_hide_the_tags(name: str, tmp_path: Path) -> None:
    """GDAL reads these two itself, and then says nothing of the tags."""
    image = picture(tmp_path / "scene.tif")
    write_tags(rig.model(), image)
    moved = {"scene_RPC.TXT": ("LINE_OFF: 1499.5", "LINE_OFF: 1500.5"), "scene.RPB": ("= 1499.5", "= 1500.5")}[name]
    text = SIDECARS[name]()
    assert moved[0] in text
    (tmp_path / name).write_text(text.replace(*moved))
    with pytest.raises(InputError, match=r"and of image differ, by up to 1 pixels"):
        build(image)
    assert same(build(image, rpc="image"), rig.model())


def test_no_rpc_at_all(tmp_path: Path) -> None:
    image = picture(tmp_path / "scene.tif")
    assert read_rpc_tags(image) == {}
    with pytest.raises(InputError, match="carries no RPC, and none lies beside it"):
        build(image)
    with pytest.raises(InputError, match="the image carries no RPC"):
        build(image, rpc="image")
    with pytest.raises(InputError, match=r"no RPC file 'gone\.txt'"):
        build(image, rpc="gone.txt")
    with pytest.raises(InputError, match="nothing says where the RPC is"):
        build(None)


def test_a_part_of_a_scene(tmp_path: Path) -> None:
    image = picture(tmp_path / "scene.tif", (500, 400))
    write_text(rig.model(), image)
    with pytest.warns(GeomosaicWarning, match="taken for the upper-left part"):
        build(image, (500, 400))
    part = build(image, (500, 400), offset=[2000, 1000])
    whole = rig.model().ground_to_image(rig.ground())
    assert np.allclose(part.ground_to_image(rig.ground()), whole - [2000, 1000])
    assert np.allclose(part.ground_to_image(np.array([part.seed])), [[250, 200]], atol=1e-2)


def test_an_offset_that_the_image_contradicts_is_doubted(tmp_path: Path) -> None:
    image = picture(tmp_path / "scene.tif", (500, 400))
    write_text(rig.model(), image)
    with rasterio.open(image, "r+") as file:
        file.transform = Affine(1.0, 0.0, 2000.0, 0.0, 1.0, 1000.0)
    with pytest.warns(GeomosaicWarning, match=r"begins in its scene at column 2000, row 1000"):
        build(image, (500, 400), offset=[1000, 2000])


def test_an_rpc_of_another_image(tmp_path: Path) -> None:
    image = picture(tmp_path / "scene.tif")
    write_text(rig.model(), image)
    with pytest.raises(InputError, match="does not show the middle of this image"):
        build(image, offset=[200_000, 0])


def test_the_plugin_passes_the_check(tmp_path: Path) -> None:
    image = picture(tmp_path / "scene.tif")
    write_text(rig.model(), image)
    made = request(image, rpc=str(tmp_path / "scene_RPC.TXT"), first_pixel=0, offset=[0, 0], refine="shift")
    check_plugin(plugin, made)
    with pytest.raises(InputError, match="did you mean 'drift'"):
        build(image, refine="drfit")


def test_the_date_line() -> None:
    here, moved = rig.rpc(), rig.rpc()
    turned = type(here)(
        here.image_offset, here.image_scale, here.ground_offset * [0, 1, 1] + [179.995, 0, 0], here.ground_scale,
        here.coefficients,
    )  # fmt: skip
    points = rig.ground()
    across = points + np.array([179.995 - 12.3, 0, 0])
    across[:, 0] = np.where(across[:, 0] > 180.0, across[:, 0] - 360.0, across[:, 0])
    assert (across[:, 0] < 0).any()
    assert np.abs(turned.image(across) - moved.image(points)).max() < 1e-6


def test_far_from_the_scene_nothing_is_seen() -> None:
    offset, scale = rig.rpc().ground_offset, rig.rpc().ground_scale
    image = rig.rpc().image(offset + np.array([[11.0, 0.0, 0.0], [0.0, -11.0, 0.0], [3.0, 3.0, 0.0]]) * scale)
    assert np.isnan(image[:2]).all()
    assert np.isfinite(image[2]).all()
