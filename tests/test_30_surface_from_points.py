"""Surface through scattered points, over ground whose height is a formula."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS
from scipy.spatial import Delaunay
from worker_rig import cluster

from geomosaic.errors import SolveError
from geomosaic.execution.units import unit_map, workers_for
from geomosaic.geo.crs import with_heights
from geomosaic.geo.grid import Grid
from geomosaic.options.render import RunningOptions
from geomosaic.surface.from_points import PointSurface, ScatteredPoints, grid_of_points, surface_from_points
from geomosaic.surface.triangulation import Triangulation

MAP = with_heights(CRS.from_epsg(32633), "egm96")
ORIGIN = np.array([400_000.0, 5_500_000.0])
WIDE, TALL = 1000.0, 700.0


def hills(xy: np.ndarray) -> np.ndarray:
    x, y = (xy - ORIGIN).T
    return 300.0 + 30.0 * np.sin(x / 120.0) * np.cos(y / 90.0) + 0.05 * x


def tilted(xy: np.ndarray) -> np.ndarray:
    return 300.0 + (xy - ORIGIN) @ [0.03, -0.02]


def measured(ground, count: int, sigma: float, shared: float = 0.0, seed: int = 1) -> ScatteredPoints:
    """Points of a ground, with errors of their own and one that all share."""
    random = np.random.default_rng(seed)
    xy = ORIGIN + random.uniform(0.0, 1.0, (count, 2)) * [WIDE, TALL]
    own = sigma * np.exp(random.normal(0.0, 0.4, count))
    z = ground(xy) + own * random.normal(size=count) + shared * random.normal()
    up = np.diag([0.0, 0.0, 1.0])
    return ScatteredPoints(
        np.column_stack([xy, z]), own[:, None, None] ** 2 * up, np.broadcast_to(shared**2 * up, (count, 3, 3))
    )


def made(points: ScatteredPoints, margin: float = 0.05) -> PointSurface:
    low, high = ORIGIN - margin * WIDE, ORIGIN + [WIDE, TALL] + margin * WIDE
    return surface_from_points(points, grid_of_points(points.xyz[:, :2], (*low, *high), MAP))


def errors(surface: PointSurface, ground) -> np.ndarray:
    rows, cols = np.indices(surface.grid.shape) + 0.5
    true = ground(surface.grid.xy(np.column_stack([cols.ravel(), rows.ravel()])))
    return surface.heights - true.reshape(surface.grid.shape)


@pytest.mark.parametrize(("count", "sigma"), [(1000, 1.0), (800, 0.1)])
def test_errors_of_heights_are_those_told_at_the_rim_and_beyond_it_too(count: int, sigma: float):
    inside, beyond = [], []
    for seed in range(3):
        surface = made(measured(hills, count, sigma, seed=seed))
        ratio = np.abs(errors(surface, hills)) / surface.sigma
        inside.append((ratio[~surface.beyond] < 1.0).mean())
        beyond.append((ratio[surface.beyond] < 1.0).mean())
    assert np.mean(inside) == pytest.approx(0.683, abs=0.05)
    # A few stretches of rim are no sample; what counts is that nothing there is taken for better than it is.
    assert np.mean(beyond) > 0.6


def test_an_error_that_all_points_share_is_told():
    surface = made(measured(hills, 1500, 0.05, shared=5.0))
    assert surface.sigma.min() > 5.0
    assert np.median(surface.sigma) < 6.0


def test_blunders_are_not_in_the_surface_and_roofs_are():
    points = measured(hills, 1500, 0.05)
    bad = np.arange(0, 1500, 40)
    points.xyz[bad, 2] += np.where(bad % 80, 40.0, -200.0) + 0.1 * bad
    roof = np.linalg.norm(points.xyz[:, :2] - ORIGIN - [500.0, 350.0], axis=1) < 40.0
    roof[bad] = False
    points.xyz[roof, 2] += 15.0
    surface = made(points)
    assert not surface.kept[bad].any()
    assert surface.kept[roof].all()
    good = np.delete(surface.kept, bad)
    assert good.mean() > 0.99
    assert np.abs(errors(surface, hills)[~surface.beyond]).max() < 30.0


def test_flat_land_is_a_plane_and_rough_land_is_none():
    surface = made(measured(tilted, 300, 0.2))
    assert surface.plane
    assert np.abs(errors(surface, tilted)).max() < 0.1
    assert surface.sigma.max() < 0.1
    assert not made(measured(hills, 300, 0.2)).plane


def test_few_points_make_a_plane_with_what_they_miss_it_by():
    surface = made(measured(hills, 9, 0.2))
    assert surface.plane
    assert surface.sigma.min() > 5.0


@pytest.mark.parametrize("count", [0, 1, 2, 40])
def test_points_that_make_no_surface_are_refused(count: int):
    points = measured(tilted, count, 0.1)
    points.xyz[:, 1] = ORIGIN[1] + points.xyz[:, 0] - ORIGIN[0]
    with pytest.raises(SolveError, match="one line"):
        made(points)


def test_points_at_one_place_and_without_errors_of_their_own_do_no_harm():
    points = measured(hills, 500, 0.0)
    points.xyz[::5] = points.xyz[1::5]
    surface = made(points)
    assert np.isfinite(surface.heights).all()
    assert np.isfinite(surface.sigma).all()


def test_many_points_in_few_clumps_are_few_points():
    points = measured(hills, 300, 0.2)
    clumps = ORIGIN + np.array([[100.0, 100.0], [900.0, 150.0], [400.0, 600.0]])
    points.xyz[:, :2] = clumps[np.arange(300) % 3] + np.random.default_rng(0).normal(0.0, 0.01, (300, 2))
    points.xyz[:, 2] = hills(points.xyz[:, :2])
    points.xyz[:, 2] += np.random.default_rng(1).normal(0.0, 3.0, 300)
    surface = made(points)
    assert surface.plane
    assert np.isfinite(surface.sigma).all()


@pytest.mark.parametrize("stretched", [np.ones(2), np.array([1e5, 1e-3])])
def test_places_are_found_in_the_triangles_that_have_them(stretched: np.ndarray):
    random = np.random.default_rng(5)
    # Clumps, a lattice whose circles have four points each, a point twice, and places on points, edges and far off.
    lattice = np.stack(np.meshgrid(np.arange(12.0), np.arange(9.0)), axis=-1).reshape(-1, 2)
    points = np.concatenate([lattice, 4.0 + 1e-3 * random.normal(size=(40, 2)), lattice[:1]])
    made = Triangulation.of(points)
    places = np.concatenate(
        [random.uniform(-2.0, 13.0, (4000, 2)), points, lattice + np.array([0.5, 0.0]), lattice + 0.5]
    )
    found, weight = made.locate(places)
    true = Delaunay(points).find_simplex(places)
    assert np.array_equal(found < 0, true < 0)
    within = found >= 0
    back = (weight[within, :, None] * points[made.corners[found[within]]]).sum(axis=1)
    assert np.abs((back - places[within]) / stretched).max() < 1e-12
    assert weight.min() > -1e-12


def same_bytes(ground, *everything: dict) -> None:
    points = measured(ground, 3000, 0.2)
    low, high = ORIGIN - 50.0, ORIGIN + np.array([WIDE + 50.0, TALL + 50.0])
    grid = Grid.from_bounds(MAP, (*low, *high), 2.2)  # four units of nodes
    expected = surface_from_points(points, grid)
    for options in everything:
        running = RunningOptions(**options)
        with workers_for(running):
            found = surface_from_points(points, grid, unit_map(running))
        for name in ("heights", "sigma", "kept", "beyond"):
            assert getattr(found, name).tobytes() == getattr(expected, name).tobytes(), (options, name)
        assert found.residual == expected.residual


@pytest.mark.parametrize("ground", [hills, tilted])
def test_threads_make_the_same_bytes(ground):
    same_bytes(ground, {"threads": 1}, {"threads": 2})


@pytest.mark.ci
def test_processes_and_a_cluster_make_the_same_bytes(tmp_path: Path):
    with cluster(tmp_path) as (client, _):
        for ground in (hills, tilted):
            same_bytes(ground, {"workers": 2}, {"workers": client})
