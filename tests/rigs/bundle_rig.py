"""Blocks of photos with image positions alone, as other programs of bundle adjustment have them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import block_rig
import numpy as np

from geomosaic.estimation.solver import Solution, Stopping, solve
from geomosaic.geo.engineering_crs import local_frame_crs
from geomosaic.interchange.reconstruction import Reconstruction
from geomosaic.orientation.block.frame import BlockFrame
from geomosaic.orientation.block.observations import ImagePositions
from geomosaic.orientation.block.poses import pose_of
from geomosaic.orientation.block.problem import BlockProblem
from geomosaic.orientation.block.unknowns import BlockState, BlockUnknowns
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest

# One rule, the same for all programs: the relative decrease of the sum of squares.
RULES = Stopping(rounds=200, step=0.0, near=np.inf, gain=1e-9)
NAMES = {"f": "focal_length", "k1": "k1", "k2": "k2"}

Problem = tuple[BlockProblem, BlockState]


def of_reconstruction(block: Reconstruction, free: tuple[str, ...] = ()) -> Problem:
    """Free block of a reconstruction, in pixels of weight 1, each of its cameras with the same unknowns."""
    crs, places = local_frame_crs(), block.points.xyz
    frame = BlockFrame.at(crs, places)
    keys = list(dict.fromkeys(image.camera for image in block.images))
    models = []
    for image in block.images:
        rotation, centre = image.pose
        table = {**block.camera_of(image)}
        request: dict[str, Any] = {
            "camera": table, "position": [0.0, 0.0, 0.0], "upwards": True,
            "orientation": {"system": "opk", "omega": 0.0, "phi": 0.0, "kappa": 0.0},
        }  # fmt: skip
        base: Any = registry.build("frame", SensorRequest(image.name, tuple(table["size"]), request, crs))
        models.append(base.posed(centre, rotation, places.mean(axis=0)))
    seen = block.observations
    order = np.lexsort((seen.point, seen.image))
    return free_block(
        frame, models, np.array([keys.index(image.camera) for image in block.images]), frame.from_ground(places),
        (seen.image[order], seen.point[order], seen.colrow[order]), free,
    )  # fmt: skip


def free_block(
    frame: BlockFrame, models: list[Any], camera: np.ndarray, places: np.ndarray,
    seen: tuple[np.ndarray, np.ndarray, np.ndarray], free: tuple[str, ...],
) -> Problem:  # fmt: skip
    """Free block of models, first places of points and their image positions (image, point, colrow)."""
    wanted = [NAMES[name] for name in free]
    own = []
    for model in models:
        inner = model.interior
        model = model.with_interior(replace(inner, sigmas=np.array([np.inf * (n in wanted) for n in inner.names])
                                            if wanted else np.zeros(len(inner.names))))  # fmt: skip
        own.append(replace(model, parameters=replace(model.parameters, sigmas=np.full(6, np.inf))))
    image, point, colrow = seen
    views = ImagePositions(image, point, colrow, np.broadcast_to(np.eye(2), (len(colrow), 2, 2)).copy())
    names = [str(index) for index in range(len(own))]
    camera = camera if free else np.full(len(own), -1)
    unknowns = BlockUnknowns.of(names, own, camera, (), np.zeros(0, int), places)
    problem = replace(BlockProblem.of(frame, unknowns, [views]), free="similarity")
    return problem, problem.start(own, places, ())


def synthetic(strips: int, photos: int, per: int, free: tuple[str, ...] = (), **how: Any) -> Problem:
    """Free block of disturbed photos over hills; its points lie a metre or two from where they are."""
    block = block_rig.grid_block(strips, photos, per, control=0, **how)
    used, point = np.unique(block.point, return_inverse=True)
    places = block.points[used] + 2.0 * np.random.default_rng(1).normal(size=(len(used), 3))
    seen = (block.image, point, block.colrow + block.noise)
    return free_block(block.frame, list(block.start), np.zeros(len(block.start), int), places, seen, free)


def solved(problem: Problem, rules: Stopping = RULES) -> tuple[float, Solution[BlockState]]:
    """Cost at the minimum, half the sum of squares, and the solution."""
    found = solve(*problem, rules)
    return found.squares / 2.0, found


def arrays(problem: Problem, free: tuple[str, ...] = ()) -> dict[str, Any]:
    """A problem as `colmap_rig` takes it."""
    block, state = problem
    views, models = block.views, cast(list[Any], list(state.models))
    poses = [pose_of(model, block.frame) for model in models]
    keys = ("focal_length", "principal_col", "principal_row", "k1", "k2")
    own = [dict(zip(model.interior.names, model.interior.values, strict=True)) for model in models]
    rows = np.array([[row.get(key, 0.0) for key in keys] for row in own])
    interior, camera = np.unique(rows, axis=0, return_inverse=True)
    return {
        "rotation": np.array([pose.rotation for pose in poses]),
        "centre": np.array([pose.centre for pose in poses]),
        "camera": camera,
        "interior": interior,
        "size": np.array(models[0].size),
        "xyz": state.points,
        "image": views.image,
        "point": views.points,
        "colrow": views.colrow,
        "free": np.array(free, dtype=str),
    }


__all__ = ["arrays", "free_block", "of_reconstruction", "solved", "synthetic"]
