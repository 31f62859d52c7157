"""A close-range network with a published adjustment: 115 images, 157 points, a scale bar, an unknown camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from aicon_rig import AiconNetwork, read_aicon

from geomosaic.geo.engineering_crs import local_frame_crs
from geomosaic.orientation.block.adjustment import BlockAdjustment, adjust_block
from geomosaic.orientation.block.frame import BlockFrame
from geomosaic.orientation.block.object_constraints import Distances
from geomosaic.orientation.block.observations import ImagePositions
from geomosaic.orientation.block.problem import BlockProblem
from geomosaic.orientation.block.unknowns import BlockUnknowns
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest

FREE = ("focal_length", "principal_col", "principal_row", "k1", "k2", "p1", "p2")


def adjusted(network: AiconNetwork, disturbed: float) -> tuple[BlockProblem, BlockAdjustment]:
    """Free network in metres; only the scale bar says how large it is."""
    crs, block = local_frame_crs(), network.block
    size = block.cameras["1"]["size"]
    request: dict[str, Any] = {
        "camera": block.cameras["1"], "position": [0.0, 0.0, 0.0], "upwards": True,
        "orientation": {"system": "opk", "omega": 0.0, "phi": 0.0, "kappa": 0.0},
    }  # fmt: skip
    base: Any = registry.build("frame", SensorRequest("any", tuple(size), request, crs))
    points = block.points.xyz / 1000.0
    frame = BlockFrame.at(crs, points)
    random = np.random.default_rng(3)
    ahead = points.mean(axis=0)
    sigmas = np.array([np.inf if name in FREE else 0.0 for name in base.interior.names])
    models = []
    for image in block.images:
        rotation, centre = image.pose
        model = base.posed(centre / 1000.0, rotation, ahead)
        off = disturbed * random.normal(size=6) * [0.01, 0.01, 0.01, 0.2, 0.2, 0.2]
        model = model.with_values(model.parameters.values + off)
        models.append(model.with_interior(replace(model.interior, sigmas=sigmas)))
    seen = block.observations
    order = np.lexsort((seen.point, seen.image))
    root = np.eye(2) / seen.sigma[order][:, None, None]
    views = ImagePositions(seen.image[order], seen.point[order], seen.colrow[order], root)
    start, end, length, sigma = network.distance
    ends = [block.points.ids.index(start), block.points.ids.index(end)]
    bar = Distances(np.array([ends[0]]), np.array([ends[1]]), np.array([length / 1000.0]), np.array([sigma / 1000.0]))
    first = frame.from_ground(points) + disturbed * 0.005 * random.normal(size=points.shape)
    names = [image.name for image in block.images]
    unknowns = BlockUnknowns.of(names, models, np.zeros(len(names), int), (), np.array(ends), first)
    problem = replace(BlockProblem.of(frame, unknowns, [views, bar]), free="congruence")
    return problem, adjust_block(problem, problem.start(models, first, ()), alpha=None)


@pytest.fixture(scope="module")
def network(real_data: Callable[[str], Path]) -> AiconNetwork:
    return read_aicon(real_data("jaicov-bundle"))


def test_the_published_adjustment_comes_out(network: AiconNetwork) -> None:
    """Measured when written: sigma0 0.4054 µm, points within 0.3 µm (RMS), sigmas 0.93 to 1.02 of theirs."""
    problem, found = adjusted(network, 1.0)
    # 19,945 observations, 1,147 unknowns, 6 conditions; the a-priori standard deviation is 0.5 µm.
    assert found.redundancy == 18_804
    assert 0.0005 * found.sigma0 == pytest.approx(0.000405, abs=1.5e-6)
    places = problem.frame.to_ground(found.state.points) * 1000.0
    published = network.block.points.xyz
    there = found.state.moving
    assert there.sum() == 150
    off = best_fit(places[there], published[there])
    assert np.sqrt((off**2).mean()) < 0.001
    cofactors = found.network.point_cofactors()
    at = found.problem.unknowns.kept_columns
    own = found.network.parameter_cofactors()
    for point, columns in at.items():
        cofactors[point] = own[np.ix_(columns, columns)]
    sigmas = np.sqrt(np.diagonal(cofactors, axis1=1, axis2=2)) * found.sigma0 * 1000.0
    ratio = (sigmas / network.point_sigmas)[there]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.03)


def best_fit(places: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Differences after the shift and turn that make them least: a free network has no place of its own."""
    middle, centre = places.mean(axis=0), known.mean(axis=0)
    u, _, vt = np.linalg.svd((places - middle).T @ (known - centre))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    off: np.ndarray = (places - middle) @ rotation - (known - centre)
    return off
