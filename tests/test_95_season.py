"""Photos and references of another season, and clouds that drift: few ties are lost to them, none is wrong."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import reference_rig as rig
from scenery import Scenery
from scenery_rig import GROUND, block_of, camera_of, truth_of
from scipy.ndimage import gaussian_filter
from season_rig import Date, clouds_of, write_dates

import geomosaic as gm
from geomosaic.matching.features import LEAST_CONTRAST
from geomosaic.testing.synthetic import FlightPlan, synthetic_block

SUMMER = Date(1, shadows=0.12, clouds=0.2)
WINTER = Date(2, recoloured=0.8, reversed=0.25, snow=0.15, shadows=0.12, clouds=0.2)


def features_of(path: Path) -> np.ndarray:
    """Places (N, 2) of the features of a photo, pixels."""
    found = cv2.SIFT.create(contrastThreshold=LEAST_CONTRAST).detect(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
    return np.array([feature.pt for feature in found])


@pytest.mark.parametrize(
    ("size", "each", "least"), [((280, 210), 1, 40), pytest.param((600, 450), 4, 700, marks=pytest.mark.slow)]
)
def test_two_dates_are_tied_by_the_ground_and_not_by_clouds(size, each: int, least: int, tmp_path: Path):
    camera, scenery = camera_of(size), Scenery(finest=0.45)
    photos = synthetic_block(GROUND, camera, FlightPlan(2, each, 0.7, 0.6, gsd=0.3, tilt=4.0, shake=5.0), seed=3)
    flights = ((photos[:each], SUMMER), (photos[each:], WINTER))
    write_dates(tmp_path, flights, camera, scenery)
    ties, on_clouds = gm.match(block_of(tmp_path, photos, camera)).ties, 0
    truth = truth_of(ties, photos, camera, scenery)
    assert truth.errors.max() < 1.5
    assert truth.rms < 0.2
    winter = {f"{photo.name}.jpg" for photo in photos[each:]}
    dates = {(point, image in winter) for point, image in zip(ties.points, ties.images, strict=True)}
    assert len(dates) - len(set(ties.points)) > least  # points that both dates show
    for flown, date in flights:
        for number, photo in enumerate(flown):
            col, row = ties.colrow[np.asarray(ties.images) == f"{photo.name}.jpg"].astype(int).T
            cloud = clouds_of(photo, number, date, camera)
            assert not cloud[row, col].any()
            col, row = features_of(tmp_path / f"{photo.name}.jpg").astype(int).T
            on_clouds += int(cloud[row, col].sum())
    # They have what matching could have taken for ground.
    assert on_clouds > 20 * len(photos)


@pytest.mark.slow
def test_control_is_found_in_a_reference_of_winter(tmp_path: Path):
    """A quarter of its contrast is reversed, 15 % snow, 10 % shadows; of 40, 20 and 15 % it is refused."""
    path, camera = rig.photo(tmp_path)
    heights = rig.dem(tmp_path)
    grid = gm.Grid.from_bounds(rig.UTM, (*np.subtract(rig.ORIGIN, 450), *np.add(rig.ORIGIN, 450)), 2.0)
    random = np.random.default_rng(3)

    def share(width: float) -> np.ndarray:
        noise = gaussian_filter(random.normal(size=grid.shape), width)
        return np.searchsorted(np.sort(noise.ravel()), noise) / noise.size

    grey = rig.picture(grid, season=True) / 255.0
    mean = gaussian_filter(grey, 8.0)
    grey = np.where(share(20.0) < 0.25, mean - 0.8 * (grey - mean), grey)
    grey = np.where(share(12.0) < 0.10, 0.5 * grey, grey)
    grey = np.where(share(15.0) < 0.15, 0.9 + random.normal(0.0, 0.01, grey.shape), grey)
    winter = np.clip(np.rint(255.0 * grey), 1, 255).astype(np.uint8)
    reference = rig.write_raster(tmp_path / "winter.tif", winter, grid.transform)
    moved = rig.block(path, heights, (100.0, -60.0, 30.0, 2.0, -2.0, 3.0))
    (points,) = gm.match(moved, reference=reference, search=200.0).control.values()
    off = points.colrow - camera.project(np.asarray(points.ground))
    assert len(points) >= 15
    assert np.sqrt((off**2).mean()) < 0.2
