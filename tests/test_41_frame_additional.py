"""Additional parameters of Ebner and Grün: orthogonal on their grids, invertible, saved, and found by a block."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from block_rig import CAMERA, MIDDLE, SIZE, adjust_block, grid_block, photo, problem

from geomosaic.errors import InputError
from geomosaic.interchange.reconstruction import pixel_camera
from geomosaic_frame.additional import NAMES, TERMS, AdditionalParameters
from geomosaic_frame.camera import Camera

MODELS = {"ebner": 3, "gruen": 5}
BASE = 1800.0


def additional(model: str, size: float, seed: int = 3) -> AdditionalParameters:
    values = size * np.random.default_rng(seed).normal(size=len(TERMS[model]))
    return AdditionalParameters(model, BASE, tuple(values.tolist()), (SIZE[0] / 2.0, SIZE[1] / 2.0))


def table(model: str, size: float) -> dict[str, Any]:
    return {**CAMERA, "additional": additional(model, size).to_dict()}


@pytest.mark.parametrize("model", MODELS)
def test_columns_are_orthogonal_to_each_other_and_to_the_orientation_of_a_vertical_photo(model: str) -> None:
    steps = np.linspace(-BASE, BASE, MODELS[model])
    x, y = (axis.ravel() for axis in np.meshgrid(steps, steps))
    terms = additional(model, 0.0).by_values(x, y)
    vertical = photo("v", np.array([*MIDDLE, 1300.0]), np.zeros(3))
    # Points of a plane through the axes of the photo itself: the Earth is not flat.
    origins, directions = vertical.rays(np.column_stack([x, y]) + np.array(SIZE) / 2.0)
    depth = directions @ vertical.pose[1][2]
    by_orientation = vertical.jacobian(origins + directions * (1000.0 / depth)[:, None])[0]
    columns = np.concatenate([by_orientation, terms], axis=2).reshape(-1, 6 + terms.shape[2])
    columns /= np.linalg.norm(columns, axis=0)
    products = columns.T @ columns
    assert np.abs(products[6:, 6:] - np.eye(terms.shape[2])).max() < 1e-12
    # kappa turns about the vertical, which the local frame knows to 1e-6 of a degree.
    assert np.abs(products[:6, 6:]).max() < 1e-6


@pytest.mark.parametrize("model", MODELS)
def test_derivatives_are_those_of_differences(model: str) -> None:
    errors, step = additional(model, 2.0), 1e-3
    x, y = np.random.default_rng(1).uniform(-3400.0, 3400.0, (2, 50))
    for axis, (dx, dy) in enumerate(((step, 0.0), (0.0, step))):
        change = np.subtract(errors.shifted(x + dx, y + dy), errors.shifted(x - dx, y - dy)) / (2.0 * step)
        assert np.abs(change.T - errors.slopes(x, y)[:, :, axis]).max() < 1e-8
    values, columns = np.array(errors.values), errors.by_values(x, y)
    for index in range(len(values)):
        moved = errors.with_values(values + np.eye(len(values))[index]).shifted(x, y)
        assert np.abs(np.subtract(moved, errors.shifted(x, y)).T - columns[:, :, index]).max() < 1e-9


@pytest.mark.parametrize("model", MODELS)
def test_the_image_comes_back_and_far_points_do_not_enter_it(model: str) -> None:
    errors = additional(model, 3.0 if model == "ebner" else 1.0)
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-3000.0, 3000.0, 31), np.linspace(-2000.0, 2000.0, 21)))
    back = errors.undone(*errors.shifted(x, y))
    assert np.abs(np.subtract(back, (x, y))).max() < 1e-9
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    for radius in (4000.0, 1e5, 1e12):
        u, v = errors.shifted(radius * np.cos(turn), radius * np.sin(turn))
        assert (np.hypot(u, v) > 3700.0).all()


def test_the_formula_is_the_published_one() -> None:
    values = tuple(np.linspace(-1.0, 2.0, 12).tolist())
    b1, b2, b3, b4, b5, b6, b7, b8, b9, b10, b11, b12 = values
    x, y = 0.7, -0.4
    k, m = x * x - 2.0 / 3.0, y * y - 2.0 / 3.0
    dx = b1 * x + b2 * y - 2 * b3 * k + b4 * x * y + b5 * m + b7 * x * m + b9 * y * k + b11 * k * m
    dy = -b1 * y + b2 * x + b3 * x * y - 2 * b4 * m + b6 * k + b8 * y * k + b10 * x * m + b12 * k * m
    one = AdditionalParameters("ebner", 1.0, values, (9.0, 9.0))
    u, v = one.shifted(np.array([x]), np.array([-y]))
    assert (u[0] - x, -v[0] - y) == pytest.approx((dx, dy), rel=1e-12)


@pytest.mark.parametrize("model", MODELS)
def test_a_camera_keeps_them_in_its_state_and_in_other_resolutions(model: str) -> None:
    camera = Camera.from_table(table(model, 1.0), SIZE, "camera")
    assert Camera.from_dict(camera.to_dict()) == camera
    directions = camera.directions(camera.corners * 0.9)
    half = camera.scaled((3000, 2000), "camera").project(*directions.T)
    assert np.abs(half - camera.corners * 0.45).max() < 1e-8
    assert camera.interior.names[-len(NAMES[model]) :] == NAMES[model]
    plain = Camera.from_table(CAMERA, SIZE, "camera")
    assert plain.having(["focal_length"]) is plain
    assert plain.having([NAMES[model][0]]).interior.values[-1] == 0.0


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"model": "brown"}, "choose from: ebner, gruen"),
        ({"model": "ebner", "b13": 1.0}, "b13"),
        ({"model": "ebner", "b7": 1e4}, "pixels"),
        ({"model": "gruen", "base": 0.0}, "out of range"),
    ],
)
def test_slips_in_the_table_are_told(given: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as error:
        Camera.from_table({**CAMERA, "additional": given}, SIZE, "camera")
    assert words in f"{error.value} {error.value.hint}"


def test_two_sets_and_other_programs_are_refused() -> None:
    camera = Camera.from_table(table("ebner", 1.0), SIZE, "camera")
    with pytest.raises(InputError, match="two sets"):
        camera.having(["gruen_a14"])
    with pytest.raises(InputError, match="other programs have no additional parameters"):
        pixel_camera(camera.to_dict(), "camera")


def test_a_block_finds_the_parameters_its_camera_has() -> None:
    block = grid_block(2, 3, 60, seed=5, camera=table("ebner", 1.5))
    errors = []
    for free in ((), ("ebner",)):
        start = []
        for model in block.start:
            other = photo(
                "start",
                np.array([*MIDDLE, 1300.0]),
                np.zeros(3),
                {**CAMERA, "additional": {"model": "ebner", "base": BASE}},
            )
            own = other.interior
            names = [name for each in free for name in own.groups[each]]
            sigmas = np.where([name in names for name in own.names], np.inf, 0.0)
            other = other.with_values(model.parameters.values).with_interior(replace(own, sigmas=sigmas))
            start.append(replace(other, frame=model.frame, seed=model.seed))
        found = adjust_block(*problem(replace(block, start=start), interior=free), robust=False, alpha=None)
        errors.append(np.sqrt(((found.state.points - block.points)[found.state.moving] ** 2).mean()))
    own, true = found.state.models[0].interior, block.models[0].interior
    which = [own.names.index(name) for name in NAMES["ebner"]]
    columns = found.problem.unknowns.of_camera(0)[which]
    sigmas = np.sqrt(np.diag(found.network.cofactors_between(columns, columns)))
    assert (np.abs(own.values - true.values)[which] < 3.5 * sigmas).all()
    assert 0.9 < found.sigma0 < 1.1
    assert errors[1] < 0.7 * errors[0]
    assert (
        type(found.state.models[0]).from_dict(found.state.models[0].to_dict()).interior.values.tolist()
        == own.values.tolist()
    )
