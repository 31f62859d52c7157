"""Radar metadata: Sentinel-1, TerraSAR-X, JSON tables; what is not taken is refused with what to do."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from sar_annotation_rig import published, sentinel1_detected, sentinel1_stripmap, terrasar
from sar_rig import Scene, geocentric

from geomosaic.errors import InputError
from geomosaic.sensor.plugin import SensorRequest
from geomosaic_sar.build import build_sar
from geomosaic_sar.metadata import find_beside, read_bytes
from geomosaic_sar.model import SarModel

SCENE = Scene()


def _ground(scene: Scene) -> np.ndarray:
    lon, lat = scene.middle()
    off = np.random.default_rng(3).uniform(-0.012, 0.012, (20, 2))
    return geocentric(lon + off[:, 0], lat + off[:, 1], np.linspace(0, 900, 20))


def _model(text: str) -> SarModel:
    scene = read_bytes(text.encode(), "annotation.xml")
    return SarModel.of(scene.geometry, scene.size)


def test_published_tie_points_of_a_sentinel1_product_are_reproduced():
    found = published()
    ties = np.array(found.ties)
    image = _model(found.xml()).ground_to_image(geocentric(ties[:, 2], ties[:, 3], ties[:, 4]))
    # The azimuth times that the annotation gives along one line differ by 0.4 ms, 0.3 rows, from near to far range.
    assert np.abs(image - ties[:, :2] - 0.5).max() < 0.2
    scene = read_bytes(found.xml().encode(), "annotation.xml")
    assert any("back agree within 0.006 px" in note for note in scene.notes)


def test_a_stripmap_annotation_of_sentinel1_is_the_exact_orbit():
    ground = _ground(SCENE)
    assert np.abs(_model(sentinel1_stripmap(SCENE).xml()).ground_to_image(ground) - SCENE.image(ground)).max() < 1e-3


def test_a_ground_range_annotation_of_sentinel1_is_the_exact_orbit():
    written = sentinel1_detected(SCENE, _ground(SCENE))
    ties = np.array(written.ties)
    image = _model(written.xml()).ground_to_image(_ground(SCENE))
    assert np.abs(image - ties[:, :2] - 0.5).max() < 1e-3


@pytest.mark.parametrize("scene", [SCENE, SCENE.left()], ids=["right", "left"])
def test_a_slant_range_annotation_of_terrasar_is_the_exact_orbit(scene):
    ground = _ground(scene)
    assert np.abs(_model(terrasar(scene)).ground_to_image(ground) - scene.image(ground)).max() < 1e-3


def test_a_detected_annotation_of_terrasar_has_lengths_on_the_ground_as_columns():
    model = _model(terrasar(SCENE, "MGD"))
    ground = _ground(SCENE)
    # One polynomial serves all rows: that of the first row, and there the lengths are exact.
    slant = SCENE.image(ground)
    ranges = SCENE.near + (slant[:, 0] - 0.5) * SCENE.spacing
    length = SCENE.ground_range(ranges, SCENE.first_row) - SCENE.ground_range(np.array([SCENE.near]), SCENE.first_row)
    far = SCENE.near + (SCENE.size[0] - 1) * SCENE.spacing
    spacing = (SCENE.ground_range(np.array([SCENE.near, far]), SCENE.first_row) @ [-1, 1]) / (SCENE.size[0] - 1)
    assert np.abs(model.ground_to_image(ground)[:, 0] - (length / spacing + 0.5)).max() < 1e-3
    assert read_bytes(terrasar(SCENE, "MGD").encode(), "x").height == 300.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (replace(sentinel1_stripmap(SCENE), mode="IW", bursts=9).xml(), "bursts are not read"),
        (replace(sentinel1_detected(SCENE, _ground(SCENE)), records=[]).xml(), "<coordinateConversion> has no record"),
        (replace(sentinel1_stripmap(SCENE), states=sentinel1_stripmap(SCENE).states[5:]).xml(), "orbit is too short"),
        (sentinel1_stripmap(SCENE).xml().replace("<azimuthTimeInterval>", "<azimuthTimeInterval>-"), "not above 0"),
        (replace(published(), first="2021-04-01T05:26:13.794457").xml(), "tie points of the same annotation"),
        (terrasar(SCENE, "EEC"), "is geocoded"),
        (terrasar(SCENE, "SSC", "SC"), "bursts are not read"),
        (terrasar(SCENE).replace("EARLYAZNEARRG", "LATEAZNEARRG"), "LATEAZNEARRG"),
        ("<isd/>", "starts with <isd>"),
        ("{", "no JSON"),
    ],
    ids=lambda value: value[:12] if value[0] != "<" else "",
)
def test_what_is_not_taken_is_refused_with_what_to_do(text, message):
    with pytest.raises(InputError) as caught:
        read_bytes(text.encode(), "annotation.xml")
    assert message in caught.value.what
    assert caught.value.hint


def test_metadata_are_found_where_products_have_them(tmp_path):
    for image, metadata in (
        ("S1.SAFE/measurement/s1a-iw-grd-vv.tiff", "S1.SAFE/annotation/s1a-iw-grd-vv.xml"),
        ("TSX1_SAR__MGD/IMAGEDATA/IMAGE_HH.tif", "TSX1_SAR__MGD/TSX1_SAR__MGD.xml"),
        ("a.tif", "a.radar.json"),
    ):
        for name in (image, metadata):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).touch()
        assert find_beside(str(tmp_path / image)) == tmp_path / metadata
    assert find_beside(str(tmp_path / "b.tif")) is None


def _request(folder, **more) -> SensorRequest:
    SCENE.write(folder)
    return SensorRequest("scene.tif", more.pop("size", SCENE.size), more.pop("options", {}), None, str(folder), None)


def test_a_cut_scene_needs_its_offset_and_keeps_its_ground(tmp_path):
    whole = build_sar(_request(tmp_path, options={"metadata": "scene.radar.json"}))
    ground = _ground(SCENE)
    options = {"metadata": "scene.radar.json", "offset": [100, 200]}
    cut = build_sar(_request(tmp_path, size=(300, 400), options=options))
    assert cut.ground_to_image(ground) == pytest.approx(whole.ground_to_image(ground) - [100.0, 200.0], abs=1e-6)
    for wrong, message in (({"offset": [600, 0]}, "reach beyond"), ({}, "give offset")):
        with pytest.raises(InputError) as caught:
            build_sar(_request(tmp_path, size=(300, 400), options={"metadata": "scene.radar.json", **wrong}))
        assert message in str(caught.value.what) + str(caught.value.hint)


def test_control_of_another_place_is_refused(tmp_path):
    from pyproj import CRS

    request = replace(
        _request(tmp_path, options={"metadata": "scene.radar.json"}),
        crs=CRS.from_epsg(4979),
    )
    points = [{"x": 10.0 + k, "y": 50.0, "z": 100.0, "col": 10.0 * k, "row": 5.0} for k in range(4)]
    with pytest.raises(InputError, match="no control point lies near the scene"):
        build_sar(replace(request, options={**request.options, "points": points}))


def test_the_state_of_a_model_is_plain_json():
    model = _model(sentinel1_detected(SCENE, _ground(SCENE)).xml())
    again = SarModel.from_dict(json.loads(json.dumps(model.to_dict())))
    assert np.array_equal(again.ground_to_image(_ground(SCENE)), model.ground_to_image(_ground(SCENE)))
