"""Orthos of photos, SPOT scenes and RPCs that were adjusted together err as much as their covariances say."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mixed_rig
import numpy as np
import pytest
from pyproj import CRS
from spot_rig import SIZE, Satellite

from geomosaic.geo.transform import Transform
from geomosaic.orientation.block.adjustment import adjust_block
from geomosaic.orientation.block.frame import BlockFrame
from geomosaic.orientation.block.observations import GroundControl, ImagePositions, whitening
from geomosaic.orientation.block.problem import BlockProblem
from geomosaic.orientation.block.solution import BlockSolution
from geomosaic.orientation.block.unknowns import BlockUnknowns
from geomosaic.sensor import registry
from geomosaic.sensor.error_propagation import InputUncertainty, ellipses
from geomosaic.sensor.plugin import HasRational, SensorRequest
from geomosaic.sensor.solve import image_to_height
from geomosaic.surface.model import Plane

CAMERA = {"size": [800, 800], "focal_length_px": 600.0, "principal_point_px": [400.0, 400.0]}
CONTROL, FEATURES = np.arange(5), np.arange(40, 70)
SIGMA_PX, SIGMA_CONTROL, SIGMA_HEIGHT = 0.3, 0.1, 5.0


@dataclass(frozen=True, eq=False)
class Truth:
    """Models of a block, its points (S, 3) on the map and in its frame, and where the images show them."""

    names: list[str]
    models: list[Any]
    frame: BlockFrame
    xyz: np.ndarray
    points: np.ndarray
    seen: list[np.ndarray]

    def shown(self, number: int) -> np.ndarray:
        """Points (S,) that fall inside an image."""
        inside: np.ndarray = ((self.seen[number] > 0.0) & (self.seen[number] < self.models[number].size)).all(axis=1)
        return inside


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> Truth:
    return mixed_truth(tmp_path_factory.mktemp("mixed"))


def mixed_truth(folder: Path) -> Truth:
    nadir = Satellite(incidence=0.0).ground(1500, 1500, 0.0)
    middle = Transform(CRS("EPSG:4978"), mixed_rig.GROUND)(nadir[None])[0]
    xy = np.random.default_rng(8).uniform(-3000.0, 3000.0, (70, 2))
    xyz = np.column_stack([middle[:2] + xy, mixed_rig.height(xy)])
    frame = BlockFrame.at(mixed_rig.GROUND, np.array([[*middle[:2], 350.0]]))
    models: dict[str, Any] = {}
    rational = registry.plugin("rpc")
    assert isinstance(rational, HasRational)
    for name, satellite in mixed_rig.SCENES.items():
        (folder / f"{name}.DIM").write_text(mixed_rig.aim(satellite, nadir).dimap())
        request = SensorRequest(name, SIZE, {"metadata": f"{name}.DIM"}, None, str(folder))
        models[name] = registry.build("pushbroom", request)
        if name.startswith("rpc"):
            models[name] = rational.fit_rational(models[name], (-500.0, 1500.0)).model
    for k, (east, north) in enumerate([(-1200, -1200), (1200, -1200), (-1200, 1200), (1200, 1200)]):
        options = {
            "camera": CAMERA, "position": [middle[0] + east, middle[1] + north, 6000.0], "ground_height": 350.0,
            "orientation": {"system": "opk", "omega": 1.0, "phi": -1.0, "kappa": 10.0 * k},
        }  # fmt: skip
        request = SensorRequest(f"photo_{k}", (800, 800), options, mixed_rig.GROUND)
        models[f"photo_{k}"] = registry.build("frame", request)
    points = frame.from_ground(xyz)
    seen = [model.ground_to_image(frame.to_crs(model.crs, points)[0]) for model in models.values()]
    return Truth(list(models), list(models.values()), frame, xyz, points, seen)


def held(truth: Truth, seed: int) -> dict[str, np.ndarray]:
    """Whether errors of features of orthos along x and y are within one standard deviation, (N, 2) by kind of image.

    Image positions, control points, a-priori values and heights are measured anew. Features are no tie points.
    """
    random, start = np.random.default_rng(seed), []
    for model in truth.models:
        sigmas, steps = model.parameters.sigmas, model.parameters.steps
        off = random.normal(size=len(sigmas)) * np.where(np.isfinite(sigmas), sigmas, 3.0 * steps)
        start.append(model.with_values(model.parameters.values + off))
    ties = ~np.isin(np.arange(len(truth.points)), FEATURES)
    rows = [np.flatnonzero(truth.shown(k) & ties) for k in range(len(start))]
    image, point = np.repeat(np.arange(len(start)), [len(own) for own in rows]), np.concatenate(rows)
    exact = np.concatenate([truth.seen[k][own] for k, own in enumerate(rows)])
    measured = exact + SIGMA_PX * random.normal(size=exact.shape)
    given = truth.points[CONTROL] + SIGMA_CONTROL * random.normal(size=(len(CONTROL), 3))
    known = whitening(np.broadcast_to(SIGMA_CONTROL**2 * np.eye(3), (len(CONTROL), 3, 3)))
    first = truth.points + 20.0 * random.normal(size=truth.points.shape)
    unknowns = BlockUnknowns.of(truth.names, start, np.full(len(start), -1), (), np.zeros(0, int), first)
    root = np.broadcast_to(np.eye(2) / SIGMA_PX, (len(exact), 2, 2))
    groups = [ImagePositions(image, point, measured, root), GroundControl(CONTROL, given, known)]
    problem = BlockProblem.of(truth.frame, unknowns, groups)
    ids = tuple(str(k) for k in range(len(first)))
    nothing = np.full_like(first, np.nan), np.zeros(len(first), dtype=bool)
    solution = BlockSolution(adjust_block(problem, problem.start(start, first, ())), ids, *nothing)
    ground = truth.xyz[FEATURES]
    heights = ground[:, 2] + SIGMA_HEIGHT * random.normal(size=len(ground))
    within: dict[str, list[np.ndarray]] = {"spot": [], "rpc": [], "photo": []}
    for number, (name, model) in enumerate(zip(truth.names, solution.models, strict=True)):
        error = image_to_height(model, truth.seen[number][FEATURES], heights, mixed_rig.GROUND)[:, :2] - ground[:, :2]
        told = InputUncertainty(None, SIGMA_HEIGHT, solution.covariance(number))
        covariance = ellipses(model, Plane(mixed_rig.GROUND, 0.0), mixed_rig.GROUND, ground, told).covariance
        inside = np.abs(error) <= np.sqrt(covariance[:, [0, 1], [0, 1]])
        within[name.split("_")[0]].append(inside[truth.shown(number)[FEATURES]])
    return {kind: np.vstack(each) for kind, each in within.items()}


def shares(truth: Truth, runs: int) -> dict[str, np.ndarray]:
    """Shares (2,) of errors within one standard deviation, by kind of image."""
    found = [held(truth, seed) for seed in range(runs)]
    return {kind: np.mean([each[kind].mean(axis=0) for each in found], axis=0) for kind in found[0]}


@pytest.mark.ci
def test_orthos_of_a_mixed_block_err_as_much_as_their_covariances_say(truth: Truth) -> None:
    """Within three standard deviations by chance: shares of single blocks scatter by 8 %, so those of three by 5 %."""
    every = np.mean(list(shares(truth, 3).values()))
    assert abs(every - 0.683) < 0.14


@pytest.mark.slow
def test_orthos_of_two_hundred_mixed_blocks_err_as_much_as_their_covariances_say(truth: Truth) -> None:
    """Measured when written: SPOT 68.9 and 67.0 %, RPC 68.8 and 70.2 %, photos 67.8 and 67.6 %."""
    for kind, share in shares(truth, 200).items():
        # Shares of RPCs, of two parameters each, scatter by 26 % from block to block: by 2 % in 200.
        low, high = (0.62, 0.74) if kind == "rpc" else (0.64, 0.72)
        assert ((share > low) & (share < high)).all()
