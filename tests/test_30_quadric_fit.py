"""Fit of quadrics: primitives of known parameters give points, which give them back, with sigmas as the scatter."""

from __future__ import annotations

import numpy as np
import pytest
from quadric_rig import CASES, LEANING, ORIGIN, UPRIGHT, on_body, turned

from geomosaic.errors import SolveError
from geomosaic.surface.developed.fit import LEAST, FittedPrimitive, Shape, fit_primitive
from geomosaic.types import FloatArray


def same_axis(found: FittedPrimitive, axis: FloatArray) -> float:
    """Sine of the angle between axes, either way round."""
    return float(np.linalg.norm(np.cross(found.shape.rotation[2], axis / np.linalg.norm(axis))))


def beside(point: FloatArray, along: FloatArray) -> FloatArray:
    """Part of a vector across a direction."""
    direction = along / np.linalg.norm(along)
    return point - (point @ direction) * direction


@pytest.mark.parametrize("count", ["least", 12, 200])
@pytest.mark.parametrize("name", CASES)
def test_known_quadrics_come_back(name: str, count: int | str) -> None:
    """Noise-free, with no initial values, from few points and many: to a nanometre of metres."""
    kind, axis, sizes = CASES[name]
    number = LEAST[kind] + 1 if count == "least" else int(count)  # one more: several bodies may pass through the least
    found = fit_primitive(kind, on_body(kind, axis, sizes, number, 3))
    assert np.abs(found.residuals).max() < 1e-10
    if count == "least" and kind in ("cone", "ellipsoid", "cylinder"):
        return  # another one may pass through seven points as well
    assert np.abs(np.array(sizes) - found.shape.sizes).max(initial=0.0) < 1e-9
    if kind != "sphere":
        assert same_axis(found, axis) < 1e-9
    apart = found.shape.origin - ORIGIN
    if kind == "plane":
        assert abs(apart @ axis) < 1e-9
    else:
        assert np.abs(beside(apart, axis) if kind == "cylinder" else apart).max() < 1e-9
    if kind == "cone":
        assert found.shape.rotation[2] @ axis > 0.0  # towards the apex


@pytest.mark.parametrize("name", ["tower", "spire", "flat dome"])
def test_a_known_axis_is_held(name: str) -> None:
    kind, axis, sizes = CASES[name]
    points = on_body(kind, axis, sizes, LEAST[kind] + 3, 5, turn=1.2)
    found = fit_primitive(kind, points, -axis)
    assert same_axis(found, axis) < 1e-15
    assert not any(name.startswith("about") for name in found.names)
    assert np.abs(np.array(sizes) - found.shape.sizes).max() < 1e-9


@pytest.mark.parametrize("kind", LEAST)
def test_derivatives_against_differences(kind: str) -> None:
    rng = np.random.default_rng(1)
    sizes = {"plane": [], "sphere": [3.0], "cylinder": [3.0], "cone": [0.4], "ellipsoid": [4.0, 2.5]}[kind]
    shape = Shape(kind, np.array([0.3, -0.2, 0.5]), turned(LEANING), np.array(sizes))
    around = rng.normal(size=(40, 3))  # about the body's size away from its middle, below the apex of the cone
    around = around / np.linalg.norm(around, axis=1)[:, None] * rng.uniform(3.0, 5.0, (40, 1))
    points = shape.origin + around - 6.0 * (kind == "cone") * shape.rotation[2]
    names, h = shape.names(axis_known=False), 1e-6
    closed = shape.distances(points, names)[1]
    for i in range(len(names)):
        step = h * np.eye(len(names))[i]
        plus, minus = (shape.moved(names, sign * step).distances(points, names)[0] for sign in (1.0, -1.0))
        assert np.abs(closed[:, i] - (plus - minus) / (2 * h)).max() < 1e-7, names[i]


def scattered(name: str, trials: int, noise: float = 0.004) -> tuple[FloatArray, FloatArray]:
    """Scatter and reported sigmas of sizes, place and axis over many trials with noise of `noise` m."""
    kind, axis, sizes = CASES[name]
    clean = on_body(kind, axis, sizes, 80, 7)
    reference = turned(axis)
    found, reported, rng = [], [], np.random.default_rng(99)
    for _ in range(trials):
        one = fit_primitive(kind, clean + rng.normal(0.0, noise, clean.shape))
        along = one.shape.rotation[2] * np.sign(one.shape.rotation[2] @ axis)
        tilts = reference[:2] @ along if kind != "sphere" else np.array([])
        middle = clean.mean(axis=0) - ORIGIN
        place = one.shape.origin - ORIGIN
        if kind == "cylinder":  # where its axis passes the same height
            place = place + ((middle - place) @ axis) / (along @ axis) * along
        place = reference[2:] @ (place - middle) if kind == "plane" else place
        if kind == "plane":
            place = place + tilts @ (reference[:2] @ (one.shape.origin - clean.mean(axis=0)))
        found.append([*one.shape.sizes, *tilts, *place])
        spread = one.sigmas
        turns = np.hypot(spread.get("about x'", 0.0), spread.get("about y'", 0.0))
        reported.append([*(spread[n] for n in one.names if "'" not in n), turns, np.linalg.norm(one.sigma_origin)])
    values, mean = np.array(found), np.sqrt((np.array(reported) ** 2).mean(axis=0))
    scatter = values.std(axis=0)
    n = len(sizes)
    tilt = np.linalg.norm(scatter[n : n + 2]) if kind != "sphere" else 0.0
    return np.array([*scatter[:n], tilt, np.linalg.norm(scatter[n + 2 * (kind != "sphere") :])]), mean


@pytest.mark.parametrize("name", ["plane", "sphere", "spire"])
def test_sigmas_are_about_the_scatter(name: str) -> None:
    scatter, reported = scattered(name, 25)
    assert reported == pytest.approx(scatter, rel=0.4, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["plane", "sphere", "tower", "pipe", "spire", "roof", "flat dome", "onion"])
def test_sigmas_are_the_scatter_of_many_trials(name: str) -> None:
    """The scatter of 500 trials is itself known to 3 %."""
    scatter, reported = scattered(name, 500)
    assert reported == pytest.approx(scatter, rel=0.1, abs=1e-12)


def test_the_sigma_of_unit_weight_is_the_noise() -> None:
    clean = on_body("cylinder", LEANING, (3.1,), 400, 1)
    found = fit_primitive("cylinder", clean + np.random.default_rng(0).normal(0.0, 0.01, clean.shape))
    assert found.sigma0 == pytest.approx(0.01, rel=0.1)
    assert np.isnan(fit_primitive("sphere", on_body("sphere", UPRIGHT, (2.0,), 4, 1)).sigma0)


@pytest.mark.parametrize("kind", LEAST)
def test_too_few_points(kind: str) -> None:
    points = np.random.default_rng(0).normal(size=(LEAST[kind] - 1, 3))
    with pytest.raises(SolveError, match=rf"{LEAST[kind] - 1} points do not determine a {kind}") as refused:
        fit_primitive(kind, points)
    assert f"measure {LEAST[kind]} at least" in str(refused.value)


def test_points_that_determine_nothing() -> None:
    line = np.outer(np.arange(12.0), [1.0, 2.0, 3.0])
    for kind in ("plane", "sphere", "cylinder"):
        with pytest.raises(SolveError, match=rf"do not determine the {kind}|show no {kind}"):
            fit_primitive(kind, line)
    with pytest.raises(SolveError, match="all points of the plane are one"):
        fit_primitive("plane", np.ones((5, 3)))
    ring = on_body("cylinder", UPRIGHT, (3.0,), 40, 2) * [1.0, 1.0, 0.0]
    with pytest.raises(SolveError, match=r"do not determine|show no"):
        fit_primitive("cone", ring)
    with pytest.raises(SolveError, match="no number"):
        fit_primitive("plane", np.array([[0.0, 0, 0], [1, 0, 0], [0, np.nan, 0]]))
