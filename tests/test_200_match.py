"""Tie points of real images: photos of which nothing is known, and scenes whose RPCs do not meet."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
import rasterio

import geomosaic as gm
from geomosaic.block_adjustment.start import start_block
from geomosaic.inputs.tie_points import TiePoints
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
