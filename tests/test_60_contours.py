"""Contours against ground that is a formula: a cone, a paraboloid, noise; smoothing inside its tolerance."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from affine import Affine

from geomosaic.errors import InputError
from geomosaic.relief.contour_smoothing import Heights, bilinear_at, smooth
from geomosaic.relief.contours import Contour, nice_interval, trace
from geomosaic.sheets.drawing.labels import uphill
from geomosaic.sheets.label_placement import along_line

CELL = 2.0
PLACE = Affine(CELL, 0.0, 1000.0, 0.0, -CELL, 2000.0)


def heights(formula: object, size: int = 101) -> Heights:
    """Nodes of a formula z(x, y), metres from the middle of the grid."""
    middle = CELL * (size - 1) / 2
    col, row = np.meshgrid(np.arange(size), np.arange(size))
    return Heights(formula(col * CELL - middle, middle - row * CELL), PLACE)


def from_middle(xy: np.ndarray, size: int = 101) -> np.ndarray:
    """Map places to metres from the middle node."""
    return xy - PLACE @ (size / 2, size / 2)


@pytest.mark.parametrize("tolerance", [0.0, 0.2])
def test_a_cone_has_circles(tolerance: float) -> None:
    """z = 100 − r: the contour of height h is the circle of radius 100 − h, half a pixel of the raster minded."""
    cone = heights(lambda x, y: 100.0 - np.hypot(x, y))
    found = trace(cone, 10.0, tolerance=tolerance)
    rings = [c for c in found if c.closed]
    assert {c.height for c in rings} >= {10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0}
    for ring in (c for c in rings if c.height > 0):
        radius = np.hypot(*from_middle(ring.xy).T)
        # Chords of a circle lie inside it by the sagitta of a cell.
        assert np.abs(radius - (100.0 - ring.height)).max() < CELL**2 / 8 / radius.min() + tolerance + 0.02
        assert shapely.LinearRing(ring.xy).is_ccw  # the ground rises to the left
        assert ring.index == (ring.height % 50 == 0)


def test_a_pit_runs_the_other_way() -> None:
    pit = heights(lambda x, y: np.hypot(x, y))
    assert all(not shapely.LinearRing(c.xy).is_ccw for c in trace(pit, 10.0) if c.closed)


def noise(seed: int = 1, size: int = 101) -> np.ndarray:
    """Rolling ground with noise of 0.3 m: contours of it are rough."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:size, 0:size] * 0.08
    return 20 * np.sin(x) * np.cos(0.7 * y) + rng.normal(0, 0.3, (size, size))


def turning(contours: list[Contour]) -> float:
    """Mean turn of contours from vertex to vertex, degrees per metre."""
    turn = length = 0.0
    for c in contours:
        steps = np.diff(c.xy, axis=0)
        course = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
        turn += float(np.abs(np.diff(course)).sum())
        length += float(np.hypot(*steps.T).sum())
    return math.degrees(turn) / length


@pytest.mark.parametrize("tolerance", [0.2, 0.5, 1.0])
def test_smoothing_keeps_its_tolerance(tolerance: float) -> None:
    """Everywhere along a smoothed contour, not only at its vertices, the surface is within the tolerance of its height.

    The deviation told is the one that a denser sampling finds.
    """
    rough = Heights(noise(), PLACE)
    plain, smoothed = trace(rough, 5.0, tolerance=0.0), trace(rough, 5.0, tolerance=tolerance)
    assert abs(len(plain) - len(smoothed)) <= 2  # ends of a cell that is crossed twice may have changed partners
    worst = 0.0
    for c in smoothed:
        t = np.linspace(0, 1, 22)[:, None]
        dense = np.concatenate([a + t * (b - a) for a, b in zip(c.xy[:-1], c.xy[1:], strict=True)])
        worst = max(worst, float(np.nanmax(np.abs(rough.at(dense) - c.height))))
    assert worst <= 1.02 * tolerance
    assert max(c.deviation for c in smoothed) <= tolerance
    assert turning(smoothed) < 0.7 * turning(plain)


def test_smoothed_contours_do_not_cross() -> None:
    """Lines of different heights have no point in common."""
    found = trace(Heights(noise(2), PLACE), 2.0, tolerance=0.9)
    lines = [shapely.LineString(c.xy) for c in found]
    tree = shapely.STRtree(lines)
    pairs = tree.query(lines, predicate="intersects").T
    assert all(found[i].height == found[j].height for i, j in pairs)


def test_ends_stay_and_rings_stay_closed() -> None:
    values = noise(3)
    open_line = np.column_stack([np.arange(0, 50, 1.0), 20 + 3 * np.sin(np.arange(50))])
    level = float(np.nanmean(bilinear_at(values, *open_line.T)))
    (moved,) = smooth(values, [open_line], [level], 50.0)
    assert moved[0].tolist() == open_line[0].tolist()
    assert moved[-1].tolist() == open_line[-1].tolist()
    for c in trace(Heights(values, PLACE), 5.0):
        on_edge = np.abs(from_middle(c.xy[[0, -1]])).max(axis=1) > 100.0 - 1e-6
        assert c.closed or on_edge.all()


def test_unknown_heights_are_left_out() -> None:
    """No contour enters a hole; one that meets it ends there."""
    cone = heights(lambda x, y: 100.0 - np.hypot(x, y))
    values = cone.values.copy()
    values[40:60, 60:80] = np.nan
    found = trace(Heights(values, PLACE), 10.0)
    hole = shapely.box(*(PLACE @ (60, 60)), *(PLACE @ (80, 40))).buffer(-0.5 * CELL)
    assert not any(shapely.LineString(c.xy).intersects(hole) for c in found)
    assert any(not c.closed for c in found)


def test_figures_look_uphill() -> None:
    """The top of each figure points to higher ground."""
    hill = Heights(noise(4), PLACE)
    checked = 0
    for c in trace(hill, 5.0, shortest=60.0):
        path = c.xy  # a page on which a millimetre is a metre
        for spot in along_line(path, 12.0, bend=15.0)[:3]:
            turned = uphill(spot, path)
            up = math.radians(turned.angle + 90.0)
            aside = 3.0 * np.array([[math.cos(up), math.sin(up)]])
            here = np.array([[turned.x, turned.y]])
            rise = hill.at(here + aside) - hill.at(here - aside)
            if abs(rise[0]) > 1.0:  # the noise turns gentler slopes about
                assert rise[0] > 0
                checked += 1
    assert checked > 10


def test_intervals_and_tolerances_that_make_no_contours_are_refused() -> None:
    flat = heights(lambda x, y: 100.0 - np.hypot(x, y))
    for interval, tolerance, words in (
        (0.0, None, "no interval"),
        (10.0, 5.0, "could cross"),
        (0.01, None, "contours"),
    ):
        with pytest.raises(InputError, match=words):
            trace(flat, interval, tolerance=tolerance)
    with pytest.raises(InputError, match="no heights"):
        trace(Heights(np.full((5, 5), np.nan), PLACE), 10.0)
    assert [nice_interval(*r) for r in ((0, 100), (250, 2900), (10, 11))] == pytest.approx([5, 200, 0.05])


def test_short_rings_are_left_out() -> None:
    bump = heights(lambda x, y: 12.0 * np.exp(-(x**2 + y**2) / 30.0))
    assert len(trace(bump, 10.0)) == 1
    assert trace(bump, 10.0, shortest=50.0) == []


@pytest.mark.parametrize("kind", [pytest.param("noise", marks=pytest.mark.slow), "steps", "gaps"])
def test_rough_ground_keeps_the_tolerance_too(kind: str) -> None:
    """Straight lines through the cells of such ground miss its surface by many metres; SciPy looks along the lines."""
    from scipy.ndimage import map_coordinates

    seeds = np.random.default_rng(5)
    values = seeds.normal(0.0, 20.0, (24, 24))
    if kind == "steps":
        values = np.kron(seeds.integers(0, 50, (8, 8)), np.ones((3, 3)))
    values = values.astype(np.float32).astype(np.float64)
    holes = seeds.random(values.shape) < (0.05 if kind == "gaps" else 0.0)
    known = np.where(holes, np.nan, values)
    place = Affine(5.0, 0.0, 0.0, 0.0, -5.0, 0.0)
    found = trace(Heights(known, place), 5.0, tolerance=0.5)
    assert len(found) > 50
    assert max(line.deviation for line in found) <= 0.5
    worst = 0.0
    for line in found:
        node = np.column_stack([line.xy[:, 0] / 5.0 - 0.5, -line.xy[:, 1] / 5.0 - 0.5])
        t = np.linspace(0.0, 1.0, 33)[:, None, None]
        dense = (node[:-1] + t * np.diff(node, axis=0)).reshape(-1, 2).T[::-1]
        heights = map_coordinates(values, dense, order=1, mode="nearest")
        near_hole = map_coordinates(holes.astype(float), dense, order=1, mode="nearest") > 0
        worst = max(worst, float(np.abs(heights - line.height)[~near_hole].max(initial=0.0)))
    assert 0.1 < worst <= 0.52


@pytest.mark.parametrize(
    ("level", "apart"), [(2.2, {(0, 0), (1, 1)}), (2.3, {(0, 0), (1, 1)}), (2.4, {(1, 0), (0, 1)})]
)
def test_a_cell_that_is_crossed_twice_joins_the_ends_of_each_branch(level: float, apart: set[object]) -> None:
    """Which corners a contour cuts off is for the saddle to say, at 14/6 m, not for the mean of the corners, 2.25 m."""
    values = np.array([[0.0, 4.0], [3.5, 1.5]]) - level
    found = trace(Heights(values, Affine(1.0, 0.0, 0.0, 0.0, -1.0, 0.0)), 10.0, tolerance=0.01)
    cut = set()
    for line in found:
        ends = np.column_stack([line.xy[[0, -1], 0] - 0.5, -line.xy[[0, -1], 1] - 0.5])  # (col, row) of the nodes
        sides = [{(i, j) for i in (0, 1) for j in (0, 1) if min(abs(u - i), abs(v - j)) < 1e-9} for u, v in ends]
        cut |= sides[0] & sides[1]
    assert len(found) == 2
    assert cut == apart
    assert max(line.deviation for line in found) <= 0.01
