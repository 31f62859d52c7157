"""Oriented photos tied by points on their ground, whose image positions are computed, and one of which is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from geomosaic.block import footprint
from geomosaic.geo.crs import horizontal
from geomosaic.geo.transform import Transform
from geomosaic.jobs.steps.orient import restore_block
from geomosaic.project.load import load_project

ADJUST = """
[adjust]
ties = "ties.csv"
sigma_px = 0.2
position_sigma = 0.3
attitude_sigma = 0.02
"""
WRONG = 25.0


def tie(path: Path, count: int = 160, sigma: float = 0.2) -> tuple[str, str]:
    """Write tie points and a section [adjust] for a project that was run; point and image of the wrong one."""
    block = restore_block(load_project(path), 8 << 20)
    surface, random = block.surface, np.random.default_rng(11)
    assert surface is not None
    crs = horizontal(surface.crs)
    rings = [footprint(scene, surface, crs).ring for scene in block.scenes]
    low, high = np.vstack(rings).min(axis=0), np.vstack(rings).max(axis=0)
    xy = random.uniform(low, high, (count, 2))
    xyz = np.column_stack([xy, surface.height(xy)])
    rows = []
    for scene in block.scenes:
        colrow = scene.model.ground_to_image(Transform(surface.crs, scene.model.crs)(xyz))
        seen = np.flatnonzero(((colrow > 5.0) & (colrow < np.array(scene.model.size) - 5.0)).all(axis=1))
        noise = random.normal(0.0, sigma, (len(seen), 2))
        rows += [(f"t{i}", scene.name, *(colrow[i] + off)) for i, off in zip(seen.tolist(), noise, strict=True)]
    rays = {name: sum(row[0] == name for row in rows) for name, *_ in rows}
    wrong = next(i for i, row in enumerate(rows) if rays[row[0]] == max(rays.values()))
    point, image, col, line = rows[wrong]
    rows[wrong] = (point, image, col + WRONG, line)
    text = [f"{name},{photo},{col:.3f},{line:.3f}" for name, photo, col, line in rows if rays[name] > 1]
    (path.parent / "ties.csv").write_text("\n".join(["id,image,col,row", *text]) + "\n")
    path.write_text(path.read_text() + ADJUST)
    return point, image
