"""Blocks of frame photos with known orientations over hills, and what would be measured in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.orientation.block.adjustment import adjust_block
from geomosaic.orientation.block.frame import BlockFrame
from geomosaic.orientation.block.observations import GroundControl, Group, ImagePositions, whitening
from geomosaic.orientation.block.poses import pose_of
from geomosaic.orientation.block.problem import BlockProblem
from geomosaic.orientation.block.unknowns import BlockState, BlockUnknowns
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest

GROUND = CRS("EPSG:32633").to_3d()
SIZE = (6000, 4000)
CAMERA = {"size": list(SIZE), "focal_length_px": 5000.0, "principal_point_px": [3000.0, 2000.0]}
FLYING_HEIGHT = 1000.0
MIDDLE = np.array([500_000.0, 5_500_000.0])


def heights(xy: np.ndarray) -> np.ndarray:
    x, y = (xy - MIDDLE).T
    return 300.0 + 60.0 * np.sin(x / 310.0) * np.cos(y / 270.0) + 25.0 * np.sin(x / 97.0 + y / 130.0)


def photo(name: str, centre: np.ndarray, angles: np.ndarray, camera: dict[str, Any] | None = None) -> Any:
    turned = dict(zip(("omega", "phi", "kappa"), angles.tolist(), strict=True))
    options = {
        "camera": camera or CAMERA, "position": centre.tolist(), "ground_height": 300.0,
        "orientation": {"system": "opk", **turned},
    }  # fmt: skip
    return registry.build("frame", SensorRequest(name, SIZE, options, GROUND))


@dataclass
class Block:
    """Truth, and measurements with errors of a given size."""

    frame: BlockFrame
    names: list[str]
    models: list[Any]  # true
    start: list[Any]  # disturbed
    points: np.ndarray  # true, in the frame
    image: np.ndarray
    point: np.ndarray
    colrow: np.ndarray  # true
    noise: np.ndarray
    control: np.ndarray  # numbers of points


def grid_block(
    strips: int = 3, photos: int = 5, per_photo: int = 60, *, seed: int = 1, sigma_px: float = 0.3, shift: float = 20.0,
    turn: float = 0.5, camera: dict[str, Any] | None = None, control: int = 6,
    overlap: tuple[float, float] = (0.6, 0.4),
) -> Block:  # fmt: skip
    """Strips of vertical photos, points at random, control spread over the block."""
    random = np.random.default_rng(seed)
    scale = FLYING_HEIGHT / 5000.0
    forward, side = ((1.0 - share) * px * scale for share, px in zip(overlap, (SIZE[1], SIZE[0]), strict=True))
    names, models, start, centres = [], [], [], []
    for s in range(strips):
        for p in range(photos):
            xy = MIDDLE + np.array([(s - (strips - 1) / 2) * side, (p - (photos - 1) / 2) * forward])
            centre = np.array([*xy, 300.0 + FLYING_HEIGHT]) + random.normal(size=3) * [5, 5, 5]
            angles = random.normal(size=3) * [2.0, 2.0, 3.0]
            name = f"s{s + 1}p{p + 1}"
            names.append(name)
            centres.append(centre)
            models.append(photo(name, centre, angles, camera))
            off = random.normal(size=6)
            start.append(photo(name, centre + shift * off[:3], angles + turn * off[3:], camera))
    frame = BlockFrame.at(GROUND, np.array(centres) * [1, 1, 0] + [0, 0, 300.0])
    margin = np.array([550, 350])
    low, high = np.min(centres, axis=0)[:2] - margin, np.max(centres, axis=0)[:2] + margin
    area = np.prod(high - low)
    count = int(per_photo * area / (SIZE[0] * SIZE[1] * scale**2))
    ring = np.array([[x, y] for x in (0.2, 0.8, 0.5) for y in (0.2, 0.8, 0.5)])[:control]
    xy = np.vstack([low + ring * (high - low), random.uniform(low, high, (count, 2))])
    xyz = np.column_stack([xy, heights(xy)])
    points = frame.from_ground(xyz)
    rows = []
    for i, model in enumerate(models):
        # Farther off no photo sees anything; without this, a block of a thousand photos takes minutes.
        near = np.flatnonzero((np.abs(xy - centres[i][:2]) < 1.4 * FLYING_HEIGHT).all(axis=1))
        seen = model.ground_to_image(frame.to_crs(model.crs, points[near])[0])
        inside = (seen >= 5).all(axis=1) & (seen <= np.array(SIZE) - 5).all(axis=1)
        rows.append(np.column_stack([np.full(inside.sum(), i), near[inside], seen[inside]]))
    table = np.concatenate(rows)
    image, point = table[:, 0].astype(int), table[:, 1].astype(int)
    many = (np.bincount(point, minlength=len(points))[point] >= 2) | (point < len(ring))
    image, point, colrow = image[many], point[many], table[many, 2:]
    return Block(
        frame, names, models, start, points, image, point, colrow, sigma_px * random.normal(size=colrow.shape),
        np.arange(len(ring)),
    )  # fmt: skip


def problem(
    block: Block, *more: Group, sigma_px: float = 0.3, sigma_control: float = 0.02, seed: int = 5, shared: bool = False,
    interior: tuple[str, ...] = (), colrow: np.ndarray | None = None, given: np.ndarray | None = None,
) -> tuple[BlockProblem, BlockState]:  # fmt: skip
    """Block with its image positions, control points and whatever else was observed."""
    random = np.random.default_rng(seed)
    measured = block.colrow + block.noise if colrow is None else colrow
    count = len(measured)
    views = ImagePositions(
        block.image, block.point, measured, np.broadcast_to(np.eye(2) / sigma_px, (count, 2, 2)).copy()
    )
    known = block.points[block.control]
    if given is None:
        given = known + sigma_control * random.normal(size=known.shape)
    groups: list[Group] = [views]
    if len(known):
        root = whitening(np.broadcast_to(np.eye(3) * sigma_control**2, (len(known), 3, 3)))
        groups.append(GroundControl(block.control, given, root))
    camera = np.zeros(len(block.names), int) if interior else np.full(len(block.names), -1)
    unknowns = BlockUnknowns.of(block.names, block.start, camera, (), np.zeros(0, int), block.points)
    built = BlockProblem.of(block.frame, unknowns, [*groups, *more])
    start = block.points + random.normal(size=block.points.shape) * 10.0
    return built, built.start(block.start, start, ())


__all__ = ["Block", "adjust_block", "grid_block", "photo", "pose_of", "problem"]
