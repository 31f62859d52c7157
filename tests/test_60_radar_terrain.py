"""Layover, shadow and local incidence of radar scenes, held against rays and circles cast over analytic hills."""

from __future__ import annotations

import json

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS
from radar_hills_rig import Land
from sar_rig import Scene

from geomosaic.geo.grid import Grid, Window
from geomosaic.render.radar_terrain import RadarTerrain
from geomosaic.resample.layover_shadow import FORESHORTENING, LAYOVER, SHADOW, UNKNOWN, profile_classes
from geomosaic.surface.dem import Dem
from geomosaic_sar.model import SarModel
from geomosaic_sar.table import read_table


@pytest.fixture(scope="module", params=[1, -1], ids=["right", "left"])
def seen(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Land, RadarTerrain]:
    """Hills, and what a scene of them sees, by a DEM with nodes every 10 m."""
    folder = tmp_path_factory.mktemp("radar")
    scene = Scene(side=request.param)
    land = Land.of(scene)
    surface = Dem.open(land.write_dem(folder), heights="ellipsoidal")
    found = read_table(json.dumps(scene.table()), "scene.radar.json")
    model = SarModel.of(found.geometry, found.size)
    grid = Grid(
        CRS.from_epsg(land.zone),
        Affine(10.0, 0.0, land.middle[0] - 3000.0, 0.0, -10.0, land.middle[1] + 3000.0),
        600,
        600,
    )
    return land, RadarTerrain(grid, surface, model)


def test_classes_are_those_of_rays_and_circles_cast_over_the_hills(seen: tuple[Land, RadarTerrain]) -> None:
    """Independent truth: lines to the exact orbit for shadow, circles of the range about it for layover."""
    land, terrain = seen
    grid = terrain.grid
    classes = np.zeros((grid.height, grid.width), dtype=np.uint8)
    for window in grid.window.split(320, 256):
        part = np.s_[window.row : window.row + window.height, window.col : window.col + window.width]
        classes[part] = terrain.classes(window)
    random = np.random.default_rng(3)
    row, col = random.integers(0, grid.height, 900), random.integers(0, grid.width, 900)
    x, y = grid.xy(np.column_stack([col + 0.5, row + 0.5])).T
    earth = land.earth(x, y, land.height(x, y))
    sensor, flight = land.orbit(earth)
    shadow = land.in_shadow(earth, sensor)
    layover = land.in_layover(earth, sensor, flight) & ~shadow
    found = classes[row, col]
    assert 0.02 < shadow.mean() < 0.3
    assert 0.05 < layover.mean() < 0.5
    assert (((found & SHADOW) > 0) == shadow).mean() >= 0.995
    assert (((found & LAYOVER) > 0) == layover).mean() >= 0.995
    assert 0.01 < ((found & FORESHORTENING) > 0).mean() < 0.5
    assert not (found & UNKNOWN).any()


def test_blocks_of_other_sizes_have_the_same_classes(seen: tuple[Land, RadarTerrain]) -> None:
    _, terrain = seen
    # About the hill of layover and shadow.
    whole = Window(100, 190, 240, 220)
    classes = terrain.classes(whole)
    assert all(((classes & bit) > 0).mean() > 0.02 for bit in (LAYOVER, SHADOW, FORESHORTENING))
    parts = np.vstack(
        [
            np.hstack([terrain.classes(Window(col, row, 80, 110)) for col in range(100, 340, 80)])
            for row in range(190, 410, 110)
        ]
    )
    assert (classes == parts).mean() > 0.995


def test_local_incidence_is_that_of_the_analytic_slope(seen: tuple[Land, RadarTerrain]) -> None:
    land, terrain = seen
    grid = terrain.grid
    angles = terrain.incidence(grid.window)
    random = np.random.default_rng(4)
    row, col = random.integers(0, grid.height, 300), random.integers(0, grid.width, 300)
    x, y = grid.xy(np.column_stack([col + 0.5, row + 0.5])).T
    step = 0.5
    east, north = (
        land.earth(x + dx, y + dy, land.height(x + dx, y + dy))
        - land.earth(x - dx, y - dy, land.height(x - dx, y - dy))
        for dx, dy in ((step, 0.0), (0.0, step))
    )
    earth = land.earth(x, y, land.height(x, y))
    sensor, _ = land.orbit(earth)
    normal, line = np.cross(east, north), sensor - earth
    cosine = np.sum(normal * line, axis=1) / np.linalg.norm(normal, axis=1) / np.linalg.norm(line, axis=1)
    off = angles[row, col] - np.degrees(np.arccos(cosine))
    assert np.abs(off).max() < 0.1


def test_level_ground_has_no_class() -> None:
    ranges = 850_000.0 + 6.0 * np.arange(50.0)[None]
    look = np.linspace(-0.84, -0.83, 50)[None]
    assert not profile_classes(ranges, look, ranges).any()
    ranges[0, 20] = np.nan
    found = profile_classes(ranges, look, ranges)
    assert found[0, 20] == UNKNOWN
    assert not found[0, :19].any()
