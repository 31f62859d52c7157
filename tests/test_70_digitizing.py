"""Vertices carried between a layer and a picture: relief, shared borders, and what is not moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import shapely
from affine import Affine
from helpers import GROUND, Hills
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.transform import Transform
from geomosaic.monoplotting.digitizing import ShownLayer, with_shared_vertices
from geomosaic.monoplotting.line_drawing import View
from geomosaic.monoplotting.pictures import MapPicture, PhotoPicture, RasterPicture
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorModel, SensorRequest

UTM = horizontal(GROUND)
SIZE = (1000, 800)


@dataclass(frozen=True)
class Island(Hills):
    """Hills whose heights are known in a part only."""

    def height(self, xy: np.ndarray) -> np.ndarray:
        return np.where(xy[:, 0] < 500200.0, super().height(xy), np.nan)


def camera(omega: float = 8.0) -> SensorModel:
    options = {
        "camera": {"focal_length_px": 1000.0, "distortion": {"model": "brown", "k1": -0.02}},
        "position": [500000.0, 5500000.0, 1000.0],
        "orientation": {"system": "opk", "omega": omega, "phi": -5.0, "kappa": 25.0},
        "ground_height": 0.0,
    }
    return registry.build("frame", SensorRequest("photo", SIZE, options, GROUND))


@pytest.fixture(scope="module")
def photo() -> PhotoPicture:
    return PhotoPicture(View.of(camera(), Hills(), UTM))


def test_a_line_drawn_on_a_photo_follows_the_relief(photo: PhotoPicture) -> None:
    """Its ends alone would lie 2 pixels and more beside it; its vertices keep it within a tenth of one."""
    ends = np.array([[120.0, 90.0], [880.0, 700.0]])
    (made,), notes = ShownLayer.of(photo, []).carried([shapely.LineString(ends)])
    assert not notes
    drawn = shapely.LineString(ends)

    def apart(line: shapely.LineString) -> float:
        along = shapely.get_coordinates(line.segmentize(1.0))
        return float(shapely.distance(shapely.points(photo.shown(along)), drawn).max())

    assert apart(shapely.LineString([made.coords[0], made.coords[-1]])) > 2.0
    assert apart(made) < 0.1
    assert 10 < len(made.coords) < 120


def test_what_is_not_moved_stays_to_the_bit_and_what_is_moved_goes_where_it_is_put(photo: PhotoPicture) -> None:
    rng = np.random.default_rng(2)
    line = shapely.LineString(np.array([500000.0, 5500000.0]) + rng.uniform(-150.0, 150.0, (30, 2)))
    layer = ShownLayer.of(photo, [line])
    shown = shapely.get_coordinates(layer.shown()[0])
    (same,), _ = layer.carried([shapely.LineString(shown)])
    assert same.wkb == line.wkb
    moved = shown.copy()
    moved[11] += [3.0, -2.0]
    (made,), _ = layer.carried([shapely.LineString(moved)])
    kept = shapely.get_coordinates(made)
    np.testing.assert_array_equal(kept[:11], shapely.get_coordinates(line)[:11])
    np.testing.assert_array_equal(kept[-18:], shapely.get_coordinates(line)[-18:])
    vertices = photo.shown(kept)
    assert np.hypot(*(vertices - moved[11]).T).min() < 1e-5


def test_neighbours_drawn_on_a_photo_share_their_border_to_the_bit(photo: PhotoPicture) -> None:
    """Their common side is drawn in either direction, and once as an edge that the layer has already."""
    first = shapely.box(200.0, 200.0, 500.0, 500.0)
    second = shapely.Polygon([(500.0, 200.0), (500.0, 500.0), (800.0, 500.0), (800.0, 200.0)])
    (one, other), _ = ShownLayer.of(photo, []).carried([first, second])
    side = one.boundary.intersection(other.boundary)
    assert one.is_valid
    assert other.is_valid
    assert shapely.line_merge(side).length == pytest.approx(
        shapely.distance(*shapely.points(photo.drawn(np.array([[500.0, 200.0], [500.0, 500.0]])))), rel=0.02
    )
    assert one.intersection(other).area == 0.0
    later = ShownLayer.of(photo, [one])
    corners = later.shown()[0].exterior.coords[:]
    third = shapely.Polygon([corners[0], *corners[1:4], (820.0, 300.0)])
    (made,), _ = later.carried([third])
    kept = set(map(tuple, shapely.get_coordinates(one).tolist()))
    assert len(kept & set(map(tuple, shapely.get_coordinates(made).tolist()))) == 4


def test_a_line_over_ground_that_hills_hide_is_told() -> None:
    """Seen aslant: behind a crest the next pixel shows ground far away."""
    low = PhotoPicture(View.of(camera(omega=62.0), Hills(amplitude=120.0), UTM))
    lines = [shapely.LineString([(500.0, row), (520.0, 795.0)]) for row in (100.0, 200.0, 300.0)]
    notes = []
    for line in lines:
        try:
            notes += ShownLayer.of(low, []).carried([line])[1]
        except InputError:
            continue
    assert any("hidden" in note for note in notes)


def test_a_place_without_known_ground_saves_nothing_and_is_named(photo: PhotoPicture) -> None:
    island = PhotoPicture(View.of(camera(), Island(), UTM))
    beyond = photo.shown(np.array([[500000.0, 5500000.0], [500250.0, 5500000.0]]))
    with pytest.raises(InputError, match="shows no known ground") as raised:
        ShownLayer.of(island, []).carried([shapely.LineString(beyond)])
    assert "DEM" in raised.value.hint
    with pytest.raises(InputError, match=r"-30\.0, 10\.0"):
        ShownLayer.of(photo, []).carried([shapely.Point(-30.0, 10.0)])
    hidden = shapely.LineString([(500000.0, 5500000.0), (500250.0, 5500000.0)])
    assert ShownLayer.of(island, [hidden]).shown() == [None]


def test_a_layer_in_another_crs_keeps_its_numbers_and_takes_new_ones() -> None:
    wgs = CRS(4326)
    line = shapely.LineString([(14.1, 50.1), (14.2, 50.2), (14.3, 50.15)])
    chart = MapPicture(wgs, UTM)
    raster = RasterPicture(chart, Affine(0.5, 0.1, 400000.0, 0.1, -0.5, 5600000.0))
    for picture in (chart, raster):
        layer = ShownLayer.of(picture, [line])
        shown = shapely.get_coordinates(layer.shown()[0])
        shown[1] += 10.0
        (made,), _ = layer.carried([shapely.LineString(shown)])
        kept = shapely.get_coordinates(made)
        np.testing.assert_array_equal(kept[[0, 2]], shapely.get_coordinates(line)[[0, 2]])
        np.testing.assert_allclose(picture.shown(kept), shown, atol=1e-5)
    np.testing.assert_allclose(chart.shown(kept)[0], Transform(wgs, UTM)(np.array([[14.1, 50.1]]))[0])


def test_a_vertex_on_a_neighbours_edge_becomes_the_neighbours_and_the_other_way_round() -> None:
    """Two fields on one side of a path, and one that reaches along both on the other."""
    layer = {
        1: shapely.box(0, 0, 10, 10),
        2: shapely.box(10, 0, 20, 10),
        3: shapely.box(4, -10, 16, 0),
        4: shapely.box(50, 50, 60, 60),
    }
    made = with_shared_vertices({3: layer[3]}, layer, 1e-6)
    assert sorted(made) == [1, 2, 3]
    assert (4.0, 0.0) in made[1].exterior.coords[:]
    assert (16.0, 0.0) in made[2].exterior.coords[:]
    assert (10.0, 0.0) in made[3].exterior.coords[:]
    for key, geometry in made.items():
        assert geometry.equals(layer[key])
    assert with_shared_vertices({3: made[3]}, {**layer, **made}, 1e-6) == {}


def test_kinds_of_geometry_stay_what_they_are() -> None:
    holed = shapely.box(0, 0, 10, 10) - shapely.box(2, 2, 4, 4)
    many = [holed, shapely.MultiPolygon([holed, shapely.box(20, 0, 30, 10)]), shapely.MultiPoint([(1, 2), (3, 4)]),
            shapely.MultiLineString([[(0, 0), (1, 1)], [(5, 5), (6, 6)]]), shapely.Point(1, 2)]  # fmt: skip
    layer = ShownLayer.of(MapPicture(UTM, UTM), many)
    carried, _ = layer.carried(layer.shown())
    assert [one.wkb for one in carried] == [one.wkb for one in many]
