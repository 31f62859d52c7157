"""Sensors over developed surfaces: any sensor, in a local frame or on the Earth, with rays or without."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import developed_rig as rig
import numpy as np
import pytest
from helpers import PinholeOverMap
from pyproj import CRS, Transformer

from geomosaic.block import OrientedImage
from geomosaic.developed.develop import developed_footprint
from geomosaic.errors import InputError
from geomosaic.geo.crs import is_local, parse_crs, with_heights
from geomosaic.geo.engineering_crs import local_frame_crs
from geomosaic.geo.local_frames import LocalFrame
from geomosaic.sensor import registry
from geomosaic.sensor.developed import DevelopedModel
from geomosaic.sensor.plugin import HasRays, SensorModel, SensorRequest
from geomosaic.surface.developed.placement import Developed
from geomosaic.surface.developed.primitives import Axes, Cylinder
from geomosaic.testing import SensorModelTests
from geomosaic.types import FloatArray

UTM = with_heights(parse_crs("EPSG:32633"), "ellipsoidal")
FOOT = np.array([512_345.0, 5_400_100.0, 310.0])
Z = np.array([0.0, 0.0, 1.0])
CAMERA = {"focal_length_px": 336.0, "principal_point_px": [160.0, 128.0], "size": [320, 256]}


def tower(frame: LocalFrame | None = None, origin: FloatArray | None = None) -> Developed:
    """A tower of 4 m with a lean."""
    place = np.zeros(3) if origin is None else origin
    return Developed(Cylinder(4.0), Axes.about(place, np.array([0.02, 0.01, 1.0]), None, "tower"), frame=frame)


def camera(direction: float = 0.0) -> rig.Pinhole:
    """From the ground, looking up, `direction` degrees round the tower from the x axis."""
    turn = np.radians(direction)
    return rig.Pinhole(np.array([15.0 * np.cos(turn), 15.0 * np.sin(turn), 1.6]), np.array([0.0, 0.0, 6.0]), Z)


def build(crs: CRS, position: FloatArray, matrix: FloatArray, **more: Any) -> SensorModel:
    names = [f"r{i}{j}" for i in "123" for j in "123"]
    rows = dict(zip(names, map(float, matrix.ravel()), strict=True))
    orientation = {"system": "matrix", "matrix": "ground_to_image", **rows, **more.pop("orientation", {})}
    options = {"camera": CAMERA, "position": position.tolist(), "orientation": orientation, **more}
    return registry.build("frame", SensorRequest("photo", rig.SIZE, options, crs))


def on_earth() -> tuple[DevelopedModel, rig.Pinhole]:
    """The tower in UTM, the photo in the rigorous treatment: east, north, up at the foot by PROJ alone."""
    frame, eye = LocalFrame.at(UTM, FOOT), camera()
    to_earth = Transformer.from_crs(UTM, frame.crs, always_xy=True)
    foot = np.array(to_earth.transform(*FOOT))
    longitude, latitude = np.radians(Transformer.from_crs(UTM, "EPSG:4979", always_xy=True).transform(*FOOT)[:2])
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    up = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    enu = np.array([east, np.cross(up, east), up])
    there = foot + eye.centre @ enu
    position = np.array(to_earth.transform(*there, direction="INVERSE"))
    # True north 15 m away turns by nothing that counts.
    model = build(UTM, position, eye.matrix, upwards=True, orientation={"frame": "local"})
    return DevelopedModel(model, tower(frame), "frame"), eye


def net() -> FloatArray:
    u, v = np.meshgrid(np.linspace(-12.5, 12.5, 61), np.linspace(-2.0, 14.0, 33))
    return np.column_stack([u.ravel(), v.ravel(), 0.0 * u.ravel()])


@pytest.mark.parametrize("direction", [0.0, 37.0, 90.0, 180.0, 270.0])
def test_a_photo_in_a_local_frame_whatever_way_it_looks(direction: float) -> None:
    """Level and upwards along either axis, where omega, phi and kappa have no value; hidden is what faces away."""
    eye = camera(direction)
    model = DevelopedModel(build(local_frame_crs(), eye.centre, eye.matrix), tower(), "frame")
    image = model.ground_to_image(net())
    points = model.surface.point(net())
    normal = model.surface.normal(points)
    sight = (points - eye.centre) / np.linalg.norm(points - eye.centre, axis=1)[:, None]
    drawn = -(normal * sight).sum(axis=1) > np.cos(np.radians(80.0))
    assert np.array_equal(np.isfinite(image).all(axis=1), drawn)
    assert 500 < drawn.sum() < 1000
    assert np.abs(image - eye.project(points))[drawn].max() < 1e-9
    assert model.origin() == pytest.approx(eye.centre)
    seed = model.ground_to_image(np.array([model.seed]))[0]
    assert np.hypot(*(seed - np.array(rig.SIZE) / 2)) < 10.0


def test_a_tower_on_the_earth() -> None:
    """Through geoid-free UTM heights and geocentric coordinates: the same image as in its own frame."""
    model, eye = on_earth()
    assert model.model.crs.is_geocentric
    image = model.ground_to_image(net())
    drawn = np.isfinite(image).all(axis=1)
    assert drawn.sum() > 500
    assert np.abs(image - eye.project(model.surface.point(net())))[drawn].max() < 0.01
    assert is_local(model.crs)


@dataclass(frozen=True)
class WithoutRays:
    """A model that gives the members of the contract only."""

    inner: Any

    crs = property(lambda self: self.inner.crs)
    size = property(lambda self: self.inner.size)
    parameters = property(lambda self: self.inner.parameters)
    seed = property(lambda self: self.inner.seed)

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        image: FloatArray = self.inner.ground_to_image(xyz)
        return image

    def with_values(self, values: FloatArray) -> WithoutRays:
        return replace(self, inner=self.inner.with_values(values))

    def to_dict(self) -> dict[str, Any]:
        return {}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> WithoutRays:
        raise NotImplementedError


def test_a_sensor_without_rays_sees_and_hides_the_same() -> None:
    """What faces away is found from the image's own derivatives; the outline from lines of sight between heights."""
    high = rig.Pinhole(np.array([30.0, 5.0, 60.0]), np.array([0.0, 0.0, 6.0]), Z)
    frame = LocalFrame.at(UTM, FOOT)
    place = Transformer.from_crs(UTM, frame.crs, always_xy=True).transform(
        *frame.to_geocentric(high.centre[None])[0], direction="INVERSE"
    )
    inner = build(UTM, np.array(place), high.matrix, orientation={"frame": "local"})
    with_rays = DevelopedModel(inner, tower(frame), "frame")
    without = DevelopedModel(WithoutRays(inner), tower(frame), "frame")
    assert isinstance(inner, HasRays)
    assert not isinstance(without.model, HasRays)
    assert without.origin() is None
    first, second = with_rays.ground_to_image(net()), without.ground_to_image(net())
    assert np.array_equal(np.isnan(first), np.isnan(second))
    assert np.nanmax(np.abs(first - second)) == 0.0
    outlines = [developed_footprint(OrientedImage("photo", "photo.tif", "frame", m), m) for m in (with_rays, without)]
    assert outlines[0].polygon.symmetric_difference(outlines[1].polygon).area < 1e-2 * outlines[0].polygon.area


def test_an_outline_over_the_cut_has_two_parts() -> None:
    """Seen from behind, the development is cut in the middle of the picture."""
    front, back = (
        developed_footprint(OrientedImage("photo", "photo.tif", "frame", model), model)
        for model in (
            DevelopedModel(build(local_frame_crs(), eye.centre, eye.matrix), tower(), "frame")
            for eye in (camera(0.0), camera(180.0))
        )
    )
    assert front.polygon.geom_type == "Polygon"
    assert back.polygon.geom_type == "MultiPolygon"
    assert len(back.polygon.geoms) == 2
    assert back.polygon.area == pytest.approx(front.polygon.area, rel=0.03)
    assert back.bounds[0] == pytest.approx(-4.0 * np.pi)
    assert back.bounds[2] == pytest.approx(4.0 * np.pi)
    assert abs(front.centre[0]) < 0.3


class TestOverACylinder(SensorModelTests):
    """The public kit: a developed surface that fills the image is a sensor model like any other."""

    @pytest.fixture
    def model(self) -> DevelopedModel:
        eye = camera(20.0)
        wide = replace(tower(origin=np.array([-34.0, 0.0, 0.0])), body=Cylinder(40.0))
        return DevelopedModel(build(local_frame_crs(), eye.centre, eye.matrix), wide, "frame")

    @pytest.fixture
    def ground(self, model: DevelopedModel) -> FloatArray:
        points = net()[::7] * [0.3, 0.5, 1.0] + [5.0, 1.0, 0.02]
        image = model.ground_to_image(points)
        return points[((image > 5.0) & (image < np.array(rig.SIZE) - 5.0)).all(axis=1)]


def test_frames_that_do_not_meet() -> None:
    eye = camera()
    free = build(local_frame_crs(), eye.centre, eye.matrix)
    with pytest.raises(InputError, match="the camera in a local frame that is nowhere on Earth"):
        DevelopedModel(free, tower(LocalFrame.at(UTM, FOOT)), "frame")
    with pytest.raises(InputError, match="the surface stands in a local frame, the camera in"):
        DevelopedModel(PinholeOverMap(), tower(), "test")
    with pytest.raises(InputError, match="`oblique`: 90 is out of range"):
        DevelopedModel(free, tower(), "frame", 90.0)
    with pytest.raises(InputError, match="looks at the sky"):
        build(UTM, FOOT, eye.matrix)


def test_a_camera_inside_and_one_behind() -> None:
    eye = rig.Pinhole(np.array([1.0, 0.5, 1.6]), np.array([0.0, 3.0, 6.0]), Z)
    model = DevelopedModel(build(local_frame_crs(), eye.centre, eye.matrix), tower(), "frame")
    scene = OrientedImage("photo", "photo.tif", "frame", model)
    with pytest.raises(InputError, match=r"stands inside the cylinder, 2\.9\d\d m from its surface"):
        developed_footprint(scene, model)
    within = DevelopedModel(model.model, replace(tower(), inside=True), "frame")
    assert developed_footprint(scene, within).polygon.area > 10.0
    outside = DevelopedModel(build(local_frame_crs(), camera().centre, camera().matrix), within.surface, "frame")
    with pytest.raises(InputError, match="stands outside the cylinder"):
        developed_footprint(scene, outside)
