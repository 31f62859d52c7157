"""Panoramic scanners and photos over the same hills, adjusted in one block."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import block_rig as rig
import numpy as np
import pytest
from adjust_project_rig import write_photo

import geomosaic as gm
from geomosaic.geo.transform import Transform
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorModel, SensorRequest

SIZE = (1000, 1200)
NOISE, CONTROL = 0.3, 6
PLAN = {
    "kind": "scanner",
    "position": (*rig.MIDDLE, 1800.0),
    "advance": 1.6,
    "field_of_view": 60.0,
    "ground_height": 300.0,
}
PHOTOS = [
    (np.array([*(rig.MIDDLE + away), 1300.0]), angles)
    for away, angles in (
        ((-250, -250), (2.0, -1.0, 3.0)),
        ((250, -250), (-1.5, 2.0, -2.0)),
        ((-250, 250), (1.0, 1.0, 1.0)),
        ((250, 250), (-2.0, -1.0, 0.0)),
    )
]
FLOWN = ({"heading": 0.0, "pitch": 0.5, "roll": -0.5}, {"heading": 90.0, "pitch": -0.4, "roll": 0.8})


def scanner(options: dict[str, Any]) -> SensorModel:
    return registry.build("panoramic", SensorRequest("scan", SIZE, options, rig.GROUND))


@pytest.fixture(scope="module")
def truth() -> dict[str, SensorModel]:
    """Four photos, and two scans that cross."""
    models = {f"photo{k}.tif": rig.photo(f"photo{k}", centre, np.array(a)) for k, (centre, a) in enumerate(PHOTOS)}
    return models | {f"scan{k}.tif": scanner(PLAN | each) for k, each in enumerate(FLOWN)}


def test_scans_come_back_in_one_block_with_photos(truth: dict[str, SensorModel], tmp_path: Path) -> None:
    random = np.random.default_rng(4)
    xy = rig.MIDDLE + random.uniform(-600, 600, (200, 2))
    xyz = np.column_stack([xy, rig.heights(xy)])
    control, seen = ["id,x,y,z,image,col,row,sigma_xy,sigma_z,role"], []
    for name, model in truth.items():
        size = SIZE if name.startswith("scan") else rig.SIZE
        write_photo(tmp_path / name, size)
        colrow = model.ground_to_image(Transform(rig.GROUND, model.crs)(xyz))
        colrow += NOISE * random.normal(size=colrow.shape)
        for i in np.flatnonzero(((colrow > 5) & (colrow < np.array(size) - 5)).all(axis=1)).tolist():
            (col, row), (x, y, z) = colrow[i], xyz[i]
            if i < CONTROL or i >= 180:
                role = "control" if i < CONTROL else "check"
                control.append(f"c{i},{x:.4f},{y:.4f},{z:.4f},{name},{col:.4f},{row:.4f},0.02,0.03,{role}")
            else:
                seen.append((f"t{i}", name, col, row))
    (tmp_path / "control.csv").write_text("\n".join(control) + "\n")
    rays = Counter(point for point, *_ in seen)
    points, images, *places = zip(*(each for each in seen if rays[each[0]] > 1), strict=True)
    exterior = {}
    for k, (centre, angles) in enumerate(PHOTOS):
        x, y, z = centre + 5.0 * random.normal(size=3)
        omega, phi, kappa = np.array(angles) + 0.3 * random.normal(size=3)
        exterior[f"photo{k}.tif"] = gm.Exterior(x, y, z, omega=omega, phi=phi, kappa=kappa, crs="EPSG:32633",
                                                heights="ellipsoidal")  # fmt: skip
    map_of = {"crs": "EPSG:32633", "heights": "ellipsoidal"}
    blocks = [gm.Block([tmp_path / name for name in exterior], "frame", camera=gm.Camera(**rig.CAMERA),
                       exterior=exterior, control=tmp_path / "control.csv", **map_of)]  # fmt: skip
    for k, each in enumerate(FLOWN):
        rough = {"position": (np.array(PLAN["position"]) + 20.0 * random.normal(size=3)).tolist(), "advance": 1.61}
        options = PLAN | rough | {"heading": each["heading"] + 0.5, "pitch": 0.0, "roll": 0.0}
        blocks.append(gm.Block(tmp_path / f"scan{k}.tif", "panoramic", options=options, **map_of))
    ties = gm.TiePoints(np.array(points), np.array(images), np.column_stack(places))
    found = gm.adjust(blocks, ties=ties, sigma_px=NOISE)
    assert found.solution.adjustment.sigma0 == pytest.approx(1.0, abs=0.1)
    off = {}
    for name, model in truth.items():
        at = Transform(rig.GROUND, model.crs)(xyz[180:])
        there, here = found.models[name].ground_to_image(at), model.ground_to_image(at)
        size = np.array(SIZE if name.startswith("scan") else rig.SIZE)
        seen_there = ((here > 0) & (here < size)).all(axis=1)
        off[name] = float(np.sqrt(np.mean((there - here)[seen_there] ** 2)))
    # They began tens of pixels off. A pixel of the scans, which hold the photos together, is several of theirs.
    assert max(size for name, size in off.items() if name.startswith("scan")) < 0.15
    assert max(off.values()) < 0.5
