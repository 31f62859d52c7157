"""Developed surfaces: lengths, areas and places against what they are in space."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad

from geomosaic.errors import InputError
from geomosaic.surface.developed.ellipsoid import Ellipsoid, Triaxial, arc, area, latitude_of_arc, sine_of_area
from geomosaic.surface.developed.placement import Developed
from geomosaic.surface.developed.primitives import Axes, Cone, Cylinder, Flat, Primitive
from geomosaic.types import FloatArray

AXES = Axes.about(np.array([120.0, -40.0, 7.0]), np.array([0.1, -0.2, 1.0]), np.array([1.0, 1.0, 0.0]), "test")
DEVELOPABLE: dict[str, tuple[Primitive, tuple[float, float, float, float]]] = {
    "plane": (Flat(), (-5.0, -4.0, 6.0, 3.0)),
    "cylinder": (Cylinder(3.0), (-9.0, -4.0, 9.0, 12.0)),
    "spire": (Cone(np.radians(12.0)), (-1.5, -20.0, 1.5, -4.0)),
    "flat roof": (Cone(np.radians(75.0)), (-5.0, -6.0, 5.0, -1.5)),
}
PROJECTED: dict[str, tuple[Primitive, tuple[float, float, float, float]]] = {
    f"{shape} {projection}": (Ellipsoid(a, c, projection), bounds)
    for shape, a, c in (("sphere", 4.0, 4.0), ("flat", 5.0, 3.0), ("long", 3.0, 5.0))
    for projection, bounds in (
        ("equidistant", (-9.0, -4.0, 9.0, 4.0)),
        ("equal-area", (-9.0, -2.5, 9.0, 2.5)),
        ("dome-equidistant", (-4.0, -4.0, 4.0, 4.0)),
        ("dome-equal-area", (-3.0, -3.0, 3.0, 3.0)),
        ("dome-plan", (-2.0, -2.0, 2.0, 2.0)),
    )
}
PLANS: dict[str, tuple[Primitive, tuple[float, float, float, float]]] = {
    "oval dome": (Triaxial((5.0, 3.0, 2.0)), (-3.5, -1.8, 3.5, 1.8)),
    "tall oval dome": (Triaxial((2.5, 3.0, 6.0)), (-1.6, -1.8, 1.6, 1.8)),
}
ALL = DEVELOPABLE | PROJECTED | PLANS


def places(bounds: tuple[float, float, float, float], count: int = 300, offset: float = 0.3) -> FloatArray:
    rng = np.random.default_rng(3)
    left, low, right, high = bounds
    u, v, h = rng.uniform(left, right, count), rng.uniform(low, high, count), rng.uniform(-offset, offset, count)
    return np.column_stack([u, v, h])


@pytest.mark.parametrize("inside", [False, True])
@pytest.mark.parametrize("name", ALL)
def test_there_and_back(name: str, inside: bool) -> None:
    body, bounds = ALL[name]
    surface = Developed(body, AXES, inside)
    uvh = places(bounds)
    xyz = surface.point(uvh)
    known = np.isfinite(xyz).all(axis=1)
    assert known.sum() > 200
    assert np.abs(surface.coordinates(xyz) - uvh)[known].max() < 1e-9
    again = Developed.from_dict(surface.to_dict())
    assert np.array_equal(again.point(uvh), xyz, equal_nan=True)


@pytest.mark.parametrize("inside", [False, True])
@pytest.mark.parametrize("name", ALL)
def test_the_normal_stands_on_both_directions_and_no_picture_is_a_mirror_image(name: str, inside: bool) -> None:
    """∂u × ∂v points along the drawn normal: u to the right, v up, as one looks at it. And h is metres along it."""
    body, bounds = ALL[name]
    surface = Developed(body, AXES, inside)
    uvh = places(bounds) * [1.0, 1.0, 0.0]
    xyz, step = surface.point(uvh), 1e-5
    by_u, by_v, by_h = (
        (surface.point(uvh + step * axis) - surface.point(uvh - step * axis)) / (2 * step) for axis in np.eye(3)
    )
    normal = surface.normal(xyz)
    known = np.isfinite(by_u).all(axis=1) & np.isfinite(by_v).all(axis=1)
    assert known.sum() > 200
    assert np.abs((by_u * normal).sum(axis=1))[known].max() < 1e-7
    assert np.abs((by_v * normal).sum(axis=1))[known].max() < 1e-7
    assert ((np.cross(by_u, by_v) * normal).sum(axis=1))[known].min() > 0.0
    assert np.abs(by_h - normal)[known].max() < 1e-8


@pytest.mark.parametrize("name", DEVELOPABLE)
def test_lengths_on_a_development_are_lengths_on_the_thing(name: str) -> None:
    """Straight lines and wild curves on (u, v), as long in space: the sum of 20,000 chords, to its own error."""
    body, (left, low, right, high) = DEVELOPABLE[name]
    surface, t = Developed(body, AXES), np.linspace(0.0, 1.0, 20_001)
    curves: list[Callable[[FloatArray], FloatArray]] = [
        lambda t: np.column_stack([left + (right - left) * (0.2 + 0.6 * t), low + (high - low) * (0.1 + 0.3 * t)]),
        lambda t: np.column_stack(
            [left + (right - left) * (0.5 + 0.3 * np.sin(7 * t)), low + (high - low) * (0.2 + 0.4 * t * t)]
        ),
    ]
    for curve in curves:
        flat = curve(t)
        there = surface.point(np.column_stack([flat, np.zeros(len(t))]))
        lengths = [float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum()) for line in (flat, there)]
        assert lengths[1] == pytest.approx(lengths[0], rel=2e-8)


def test_lengths_by_hand() -> None:
    """Round a tower of 3 m: 6π. Round a spire at the distance s from its apex: 2π·s·sin α, on an arc of that length."""
    tower = Developed(Cylinder(3.0), AXES)
    around = tower.point(np.array([[-3.0 * np.pi, 1.0, 0.0], [3.0 * np.pi, 1.0, 0.0]]))
    assert np.abs(around[0] - around[1]).max() < 1e-12
    half, slant = np.radians(30.0), 4.0
    spire = Developed(Cone(half), AXES)
    edge = np.pi * np.sin(half)  # of the sector, on either side
    ends = slant * np.array([[np.sin(s), -np.cos(s), 0.0] for s in (-edge, edge)])
    both = spire.point(ends)
    assert np.abs(both[0] - both[1]).max() < 1e-12
    assert np.isnan(spire.point(slant * np.array([[np.sin(1.01 * edge), -np.cos(1.01 * edge), 0.0]]))).all()


@pytest.mark.parametrize("name", PROJECTED | PLANS)
def test_what_each_projection_keeps(name: str) -> None:
    body, bounds = ALL[name]
    surface, uvh = Developed(body, AXES), places(bounds) * [1.0, 1.0, 0.0]
    step = 1e-5
    by_u, by_v = (
        (surface.point(uvh + step * axis) - surface.point(uvh - step * axis)) / (2 * step) for axis in np.eye(3)[:2]
    )
    known = np.isfinite(by_u).all(axis=1) & np.isfinite(by_v).all(axis=1)
    if "equal-area" in name:
        assert np.linalg.norm(np.cross(by_u, by_v), axis=1)[known] == pytest.approx(1.0, abs=1e-6)
    elif "dome-equidistant" in name:  # along lines from the middle
        out = uvh[:, :2] / np.hypot(*uvh[:, :2].T)[:, None]
        along = by_u * out[:, :1] + by_v * out[:, 1:]
        assert np.linalg.norm(along, axis=1)[known] == pytest.approx(1.0, abs=1e-6)
    elif "equidistant" in name:
        assert np.linalg.norm(by_v, axis=1)[known] == pytest.approx(1.0, abs=1e-6)
        equator = surface.point(np.array([[1.0, 0.0, 0.0], [1.0 + step, 0.0, 0.0]]))
        assert np.linalg.norm(equator[1] - equator[0]) == pytest.approx(step, rel=1e-6)
    else:  # the plan, in the body's own axes
        assert np.abs(AXES.to_body(surface.point(uvh))[known, :2] - uvh[known, :2]).max() < 1e-12


@pytest.mark.parametrize(("a", "c"), [(4.0, 4.0), (5.0, 3.0), (3.0, 5.0), (4.0, 4.0 + 1e-7)])
def test_meridian_against_integrals(a: float, c: float) -> None:
    def speed(t: float) -> float:
        return float(np.hypot(a * np.sin(t), c * np.cos(t)))

    for latitude in (-1.2, -0.3, 0.0, 0.7, 1.5):
        assert arc(np.array(latitude), a, c) == pytest.approx(quad(speed, 0.0, latitude)[0], abs=1e-10)
        weighted = quad(lambda t: speed(t) * np.cos(t), 0.0, latitude)[0]
        assert area(np.array(np.sin(latitude)), a, c) == pytest.approx(weighted, abs=1e-9)
    latitudes = np.linspace(-np.pi / 2, np.pi / 2, 101)
    assert np.abs(latitude_of_arc(arc(latitudes, a, c), a, c) - latitudes).max() < 1e-12
    assert np.abs(sine_of_area(area(np.sin(latitudes), a, c), a, c) - np.sin(latitudes)).max() < 1e-12
    most = float(arc(np.array(np.pi / 2), a, c))
    assert np.isnan(latitude_of_arc(np.array([1.001 * most]), a, c)).all()


@pytest.mark.parametrize("inside", [False, True])
@pytest.mark.parametrize("name", ALL)
def test_rays_meet_the_drawn_side_first(name: str, inside: bool) -> None:
    """From a point above the surface: the meeting lies on the surface and on the ray, and no nearer one faces it."""
    body, bounds = ALL[name]
    surface = Developed(body, AXES, inside)
    height = 0.5 if inside else 20.0
    middle = np.array([[(bounds[0] + bounds[2]) / 2 + 0.1, (bounds[1] + bounds[3]) / 2, 0.0]])
    if inside and body.kind == "plane":
        return
    eye = surface.point(middle) + height * surface.normal(surface.point(middle))
    targets = surface.point(places(bounds) * [1.0, 1.0, 0.0])
    targets = targets[np.isfinite(targets).all(axis=1)]
    directions = (targets - eye) / np.linalg.norm(targets - eye, axis=1)[:, None]
    met = surface.meeting(np.tile(eye, (len(targets), 1)), directions)
    faces = (surface.normal(targets) * directions).sum(axis=1) < -1e-6
    assert faces.sum() > 20
    assert np.abs(met - targets)[faces].max() < 1e-8  # a convex body hides none of its own front
    hidden = (surface.normal(targets) * directions).sum(axis=1) > 1e-6
    if name in ("cylinder", "sphere equidistant", "long equidistant") and not inside:
        assert hidden.sum() > 20
    if hidden.any():
        back = np.linalg.norm(met[hidden] - targets[hidden], axis=1)
        assert (np.isnan(back) | (back > 1e-6)).all()


def test_limits_are_heights_along_the_axis() -> None:
    cone = Developed(Cone(0.3), AXES, bottom=-8.0, top=-2.0)
    s = np.array([1.0, 2.2, 5.0, 8.3, 9.0])
    xyz = cone.point(np.column_stack([0 * s, -s, 0 * s]))
    assert np.isfinite(xyz).all(axis=1).tolist() == [bool(2.0 <= d * np.cos(0.3) <= 8.0) for d in s]
    tower = Developed(Cylinder(2.0), AXES, bottom=-1.0, top=5.0)
    assert tower.domain == (-2.0 * np.pi, -1.0, 2.0 * np.pi, 5.0)
    assert tower.within(tower.point(np.array([[0.0, -1.5, 0.0], [0.0, 4.9, 0.0]]))).tolist() == [False, True]


def test_axes_that_cannot_be_meant() -> None:
    for axis, zero in (([0.0, 0.0, 0.0], None), ([0.0, 0.0, 1.0], [0.0, 0.0, 2.0]), ([0.0, np.nan, 1.0], None)):
        with pytest.raises(InputError):
            Axes.about(np.zeros(3), np.array(axis), None if zero is None else np.array(zero), "thing.toml")
    floor = Axes.facing(np.zeros(3), np.array([0.0, 0.0, 2.0]), None, "floor.toml")
    assert np.abs(floor.rotation - np.eye(3)).max() == 0.0  # a floor is drawn as a map
    west = Axes.about(np.zeros(3), np.array([1.0, 0.0, 0.0]), None, "pipe.toml")
    assert west.rotation[0].tolist() == [0.0, 1.0, 0.0]
