"""Scanner strips whose attitude bends over the scene, in one block with photos over the same hills."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from block_rig import GROUND, Block, adjust_block, photo, problem

from geomosaic.geo.local_frames import map_place
from geomosaic.geo.transform import Transform
from geomosaic.orientation.block.frame import BlockFrame
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest

SCAN, PERIOD, FOCAL, SPEED, UP = (800, 1000), 0.01, 1000.0, 60.0, 1000.0
DEGREE = 5
MIDDLE = np.array([500_000.0, 5_500_000.0])


def heights(xy: np.ndarray) -> np.ndarray:
    x, y = (xy - MIDDLE).T
    return 150.0 + 70.0 * np.sin(x / 130.0) * np.cos(y / 110.0)


def strip(folder: Path, name: str, heading: float, degree: int) -> Any:
    """Airborne scanner over the middle of the hills, as its track tells of it."""
    t = np.arange(-0.5, 10.6, 0.1)
    way = SPEED * (t - 5.0)
    course = np.radians(heading)
    xy = MIDDLE + np.column_stack([way * np.sin(course), way * np.cos(course)])
    true = heading + map_place(GROUND, *MIDDLE).convergence
    rows = [f"{a:.3f},{x:.5f},{y:.5f},{UP},0,0,{true:.9f}" for a, (x, y) in zip(t, xy, strict=True)]
    (folder / f"{name}.csv").write_text("\n".join(["time,x,y,z,roll,pitch,heading", *rows]))
    options = {
        "track": f"{name}.csv", "focal_length_px": FOCAL, "start_time": 0.0, "line_period": PERIOD, "columns": "right",
        "ground_height": 150.0, "attitude_degree": degree,
        "sigmas": {"angles": 0.1, "rates": 0.02} | ({"curve": 0.05} if degree > 1 else {}),
    }  # fmt: skip
    return registry.build("pushbroom", SensorRequest(name, SCAN, options, GROUND, str(folder)))


def mixed(folder: Path, seed: int, degree: int = DEGREE) -> tuple[Block, list[np.ndarray]]:
    """Two crossing strips and four photos; true corrections of the strips are drawn from their a-priori sigmas."""
    random = np.random.default_rng(seed)
    names, models, start = [], [], []
    for name, heading in (("north", 0.0), ("east", 90.0)):
        bent = strip(folder, name, heading, DEGREE)
        values = bent.parameters.values + bent.parameters.sigmas * random.normal(size=len(bent.parameters))
        names.append(name)
        models.append(bent.with_values(values))
        start.append(strip(folder, name, heading, degree))
    for k, (x, y) in enumerate([(-90, -90), (90, -90), (-90, 90), (90, 90)]):
        centre, angles = np.array([MIDDLE[0] + x, MIDDLE[1] + y, 750.0]), random.normal(size=3) * [2.0, 2.0, 20.0]
        off = random.normal(size=6)
        names.append(f"photo_{k}")
        models.append(photo(names[-1], centre, angles))
        start.append(photo(names[-1], centre + 3.0 * off[:3], angles + 0.3 * off[3:]))
    frame = BlockFrame.at(GROUND, np.array([[*MIDDLE, 150.0]]))
    corners = 240.0 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [0, 0]])
    xy = MIDDLE + np.vstack([corners, random.uniform(-260.0, 260.0, (140, 2))])
    xyz = np.column_stack([xy, heights(xy)])
    rows = []
    for i, model in enumerate(models):
        seen = model.ground_to_image(Transform(GROUND, model.crs)(xyz))
        inside = ((seen > 5) & (seen < np.array(model.size if i > 1 else SCAN) - 5)).all(axis=1)
        rows.append(np.column_stack([np.full(inside.sum(), i), np.flatnonzero(inside), seen[inside]]))
    table = np.concatenate(rows)
    image, point = table[:, :2].astype(int).T
    block = Block(
        frame, names, models, start, frame.from_ground(xyz), image, point, table[:, 2:],
        0.2 * random.normal(size=(len(table), 2)), np.arange(5),
    )  # fmt: skip
    return block, [model.parameters.values for model in models[:2]]


def test_polynomials_of_the_attitude_come_back_within_their_sigmas(tmp_path: Path) -> None:
    normalised, points = [], []
    for seed in range(2):
        block, truth = mixed(tmp_path, seed)
        found = adjust_block(*problem(block, sigma_px=0.2), alpha=None, robust=False)
        assert 0.85 < found.sigma0 < 1.15
        unknowns = found.problem.unknowns
        for index, values in enumerate(truth):
            free = unknowns.image_parameters[index].free
            columns = unknowns.of_image(index)[free]
            own = found.network.cofactors_between(columns, columns)
            error = (found.state.models[index].parameters.values - values)[free]
            names = np.array(found.state.models[index].parameters.names)[free]
            bent = np.char.find(names, "_") > 0
            bent &= np.char.find(names, "rate") < 0
            assert bent.sum() == 3 * (DEGREE - 1)
            normalised.append((error / np.sqrt(np.diag(own)))[bent])
            # All of them at once, with their correlations: chi squared of as many degrees of freedom.
            assert error @ np.linalg.solve(own, error) < 2.2 * len(error)
        off = found.state.points - block.points
        points.append(np.sqrt((off**2).mean(axis=0)))
    assert np.abs(np.concatenate(normalised)).max() < 4.0
    assert 0.75 < np.sqrt(np.mean(np.concatenate(normalised) ** 2)) < 1.25
    assert np.max(points) < 0.2


def test_without_them_the_strips_do_not_fit(tmp_path: Path) -> None:
    block, _ = mixed(tmp_path, 1, degree=1)
    found = adjust_block(*problem(block, sigma_px=0.2), alpha=None, robust=False)
    assert found.sigma0 > 1.5
    scans = found.problem.views.image < 2
    left = found.statistics[0].residuals
    assert np.sqrt((left[scans] ** 2).mean()) > 2.0 * np.sqrt((left[~scans] ** 2).mean())
