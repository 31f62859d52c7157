"""Tie points of real images: photos of which nothing is known, and scenes whose RPCs do not meet."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

import geomosaic as gm
from geomosaic.block_adjustment.start import start_block
from geomosaic.cli.main import run
from geomosaic.errors import GeomosaicWarning
from geomosaic.inputs.tie_points import TiePoints
from geomosaic.project.load import load_project
from geomosaic.sensor.plugin import SensorModel
from geomosaic.sensor.solve import jacobian

# Canon EOS Rebel XSi: 22.2 mm across 4272 pixels, 30 mm after EXIF.
CAMERA = gm.Camera(size=(4272, 2848), focal_length_px=30.0 / 22.2 * 4272)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "least"), [(3, 800), (8, 2000)], ids=["three", "all"])
def test_kite_photos_of_unknown_orientation_fit_to_a_fraction_of_a_pixel(
    real_data: Callable[[str], Path], count: int, least: int
) -> None:
    photos = sorted((real_data("odm-copr") / "images").glob("*.jpg"))[:count]
    block = gm.Block(photos, "frame", camera=CAMERA, crs="local")
    matched = gm.match(block)
    assert matched.alone == ()
    assert len(matched.rays) > least
    adjusted = gm.adjust(block, ties=matched.ties, interior=["focal_length=50", "k1", "k2"])
    images = adjusted.facts["observations"][0]
    assert images["rejected"] < 0.08 * images["used"]
    assert images["rms"] < 0.5


def ventoux(base: Path) -> gm.Block:
    """Two crops of Pleiades scenes, whose geotransforms say where in the scenes they lie."""
    images = [base / "image" / "phr_ventoux" / f"{side}_image.tif" for side in ("left", "right")]
    options = {}
    for path in images:
        with rasterio.open(path) as file:
            corner = [file.transform.c, file.transform.f]
        options[path.name] = {"rpc": str(base / "rpc" / "phr_ventoux" / f"{path.stem}.geom"), "offset": corner}
    return gm.Block(images, "rpc", image_options=options)


def some(ties: TiePoints, which: np.ndarray) -> TiePoints:
    rows = np.flatnonzero(which)
    points, images = ([names[row] for row in rows.tolist()] for names in (ties.points, ties.images))
    return TiePoints(points, images, ties.colrow[rows], covariance=ties.covariance[rows])


def missed(models: Mapping[str, SensorModel], ties: TiePoints) -> float:
    """RMS length in pixels of what the rays of points of two images miss each other by."""
    names = list(models)
    image = np.array([names.index(name) for name in ties.images])
    _, point = np.unique(np.asarray(ties.points), return_inverse=True)
    # RPCs count in degrees and metres.
    unit = np.array([1e-5, 1e-5, 1.0])
    places = np.tile(np.array(models[names[0]].seed), (point.max() + 1, 1))
    left = np.empty((len(ties), 2))
    for _ in range(6):
        normal, side = np.zeros((len(places), 3, 3)), np.zeros((len(places), 3))
        for k, model in enumerate(models.values()):
            rows = image == k
            ground = places[point[rows]]
            left[rows] = ties.colrow[rows] - model.ground_to_image(ground)
            slope = jacobian(model, ground)[1] * unit
            np.add.at(normal, point[rows], slope.transpose(0, 2, 1) @ slope)
            np.add.at(side, point[rows], np.einsum("nki,nk->ni", slope, left[rows]))
        places = places + np.linalg.solve(normal, side[:, :, None])[:, :, 0] * unit
    return float(np.sqrt((left**2).sum(axis=1).mean()))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "before"), [("shareloc-phr-ventoux", 2.4), ("s2p-pair", 0.36)])
def test_scenes_with_rpcs_meet_in_tie_points_without_control(
    real_data: Callable[[str], Path], name: str, before: float
) -> None:
    base = real_data(name)
    block = ventoux(base) if name.startswith("shareloc") else gm.Block(base.glob("input_pair/*.tif"), "rpc")
    ties = gm.match(block, features=1500).ties
    _, point = np.unique(np.asarray(ties.points), return_inverse=True)
    start = start_block([block])
    held_out = some(ties, point % 2 == 1)
    assert missed(dict(zip(start.names, start.models, strict=True)), held_out) == pytest.approx(before, rel=0.1)
    adjusted = gm.adjust(block, ties=some(ties, point % 2 == 0))
    assert missed(adjusted.models, held_out) < 0.1
    # Where both lie together no tie point says: they stay near where their files put them.
    for model in adjusted.models.values():
        assert np.abs(model.parameters.values).max() < 20.0


def part(ties: gm.TiePoints, rows: np.ndarray) -> gm.TiePoints:
    """Some of the positions."""
    points, images = (np.asarray(each)[rows].tolist() for each in (ties.points, ties.images))
    return gm.TiePoints(points, images, ties.colrow[rows], ties.sigma[rows])


def misses(models: Mapping[str, Any], ties: gm.TiePoints) -> np.ndarray:
    """Distances in pixels of positions from where their points are, intersected from the rays of all of them."""
    ids, images, found = np.asarray(ties.points), np.asarray(ties.images), []
    for name in np.unique(ids):
        rows = np.flatnonzero(ids == name)
        seen = [models[images[row]] for row in rows]
        rays = [model.rays(ties.colrow[row][None]) for model, row in zip(seen, rows, strict=True)]
        across = [np.eye(3) - np.outer(towards[0], towards[0]) / (towards[0] @ towards[0]) for _, towards in rays]
        sides = [one @ origin[0] for one, (origin, _) in zip(across, rays, strict=True)]
        place = np.linalg.solve(sum(across), sum(sides))
        found += [
            np.linalg.norm(model.ground_to_image(place[None])[0] - ties.colrow[row])
            for model, row in zip(seen, rows, strict=True)
        ]
    return np.array(found)


@pytest.mark.slow
def test_oblique_photos_from_nothing_fit_no_worse_than_another_program_oriented_them(
    real_data: Callable[[str], Path],
) -> None:
    """ODM's own orientation of the same photos, judged like ours by tie points that took no part."""
    folder = real_data("orthority-odm")
    photos = sorted((folder / "images").glob("*.tif"))
    block = gm.Block(photos, "frame", camera=gm.Camera(size=(1368, 912), focal_length_px=912.0), crs="local")
    ties = gm.match(block).ties
    ids = np.asarray(ties.points)
    held_out = np.isin(ids, np.unique(ids)[::5])
    lens = ["focal_length=50", "principal_point", "k1", "k2", "k3", "p1", "p2"]
    found = gm.adjust(block, ties=part(ties, ~held_out), interior=lens)
    table = folder / "opensfm" / "reconstruction.json"
    other = {
        scene.name: scene.model
        for scene in start_block([gm.Block(photos, "frame", exterior=table, angles="opensfm")]).scenes
    }
    mine, given = (misses(models, part(ties, held_out)) for models in (found.models, other))
    assert len(mine) > 60
    assert np.sqrt(np.mean(mine**2)) <= np.sqrt(np.mean(given**2))
    assert np.median(mine) < 0.7 * np.median(given)


@pytest.mark.slow
def test_a_strip_over_flat_ground_with_the_yaw_of_half_its_photos_wrong_is_adjusted(
    real_data: Callable[[str], Path], tmp_path: Path
) -> None:
    """A car park and lawns say little of the focal length; the gimbal's yaw is half a turn off on the way back."""
    folders = [str(real_data(name) / "images") for name in ("drone-brighton-beach", "drone-brighton-block")]
    file = tmp_path / "block.toml"
    assert run(["new", str(file), *folders]) == 0
    project = load_project(file)
    ties = gm.match(project.blocks).ties
    for interior in ([], ["focal_length=85", "principal_point=40", "k1", "k2"]):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always", GeomosaicWarning)
            found = gm.adjust(project.blocks, ties=ties, position_sigma=3.0, attitude_sigma=5.0, interior=interior)
        assert "5 of 11 attitudes were left out" in str(told[0].message)
        images, attitudes = (
            next(each for each in found.facts["observations"] if each["name"] == kind)
            for kind in ("image positions", "attitudes")
        )
        assert images["rms"] < 0.6
        assert images["rejected"] < 0.1 * images["used"]
        assert attitudes["rejected"] == 5
