"""Control points far off beside camera positions: the point or the datum is named, and no image position is blamed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import geomosaic as gm
from geomosaic.block_adjustment.result import AdjustedBlock
from geomosaic.block_adjustment.start import start_block
from geomosaic.errors import GeomosaicWarning
from geomosaic.geo.transform import Transform
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.tie_points import TiePoints
from geomosaic.project.load import load_project
from geomosaic.sensor.solve import image_to_ground

SAMPLE = Path(__file__).parent.parent / "data" / "sample"
SHIFT = np.array([111.2, -78.2])
SIGMA = 0.1


@pytest.fixture(scope="module")
def given() -> Block:
    return load_project(SAMPLE / "project.toml").blocks[0]


@pytest.fixture(scope="module")
def ties(given: Block) -> TiePoints:
    """Places of the land that two or more photos show, with errors of 0.1 px."""
    start, random = start_block([given]), np.random.default_rng(1)
    assert start.surface is not None
    points, images, places = [], [], []
    for index, model in enumerate(start.models):
        shares = random.uniform(0.05, 0.95, (25, 2))
        ground = image_to_ground(model, shares * model.size, start.surface)
        for name, other in zip(start.names, start.models, strict=True):
            colrow = other.ground_to_image(Transform(start.ground, other.crs)(ground))
            for k in np.flatnonzero(((colrow > 5.0) & (colrow < np.array(other.size) - 5.0)).all(axis=1)):
                points.append(f"t{index}-{k}")
                images.append(name)
                places.append(colrow[k])
    colrow = np.array(places) + random.normal(0.0, SIGMA, (len(places), 2))
    return TiePoints(points, images, colrow, np.full(len(places), SIGMA))


def adjusted(given: Block, ties: TiePoints, folder: Path, moved: str) -> AdjustedBlock:
    """Block whose control points of a name are shifted by 136 m; camera positions are known to 0.3 m."""
    head, *lines = (SAMPLE / "gcps.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines]
    for row in rows:
        if row[0].startswith(moved):
            row[1:3] = (f"{value:.3f}" for value in np.array(row[1:3], dtype=float) + SHIFT)
    (folder / "gcps.csv").write_text("\n".join([head, *map(",".join, rows)]) + "\n")
    with pytest.warns(GeomosaicWarning):  # check points that one photo shows
        return gm.adjust(replace(given, control=folder / "gcps.csv"), ties=ties, position_sigma=0.3)


def test_control_on_another_datum_than_the_camera_positions_is_told_as_a_whole(
    given: Block, ties: TiePoints, tmp_path: Path
) -> None:
    found = adjusted(given, ties, tmp_path, "")
    assert "All 12 camera positions are left out" in found.summary
    assert "(unless control is wrong instead): another datum or CRS" in found.summary
    assert found.facts["observations"][0]["rejected"] == 0
    assert not found.blunders


def test_one_control_point_that_lies_elsewhere_is_named_and_its_rays_stay(
    given: Block, ties: TiePoints, tmp_path: Path
) -> None:
    found = adjusted(given, ties, tmp_path, "control01")
    assert "point 'control01' is off by 136 m" in found.summary
    assert len(found.blunders) == 1
    assert found.facts["observations"][0]["rejected"] == 0
