"""Published bundle adjustments, adjusted again: the cost ends at or below theirs, by their own formula.

Costs are half the sums of squared pixels, the same observations, the same unknowns (f, k1, k2 of each camera).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bundle_rig import Problem, arrays, of_reconstruction, solved

from geomosaic.estimation.solver import Outcome, Stopping, solve
from geomosaic.interchange.formats import read_reconstruction
from geomosaic.interchange.reconstruction import ImagePoints, ObjectPoints, Reconstruction

FREE = ("f", "k1", "k2")
# Of a problem without a single minimum.
SHORT = Stopping(rounds=40, step=0.0, near=np.inf, gain=1e-9)


def cost(problem: dict[str, Any]) -> float:
    """Half the sum of squared pixels, by the formula that Bundler, BAL and OpenSfM share."""
    image = problem["image"]
    seen = problem["xyz"][problem["point"]] - problem["centre"][image]
    x, y, z = np.einsum("nij,nj->ni", problem["rotation"][image], seen).T
    f, cx, cy, k1, k2 = problem["interior"][problem["camera"][image]].T
    u, v = x / z, y / z
    square = u**2 + v**2
    scale = f * (1.0 + k1 * square + k2 * square**2)
    left = problem["colrow"] - np.column_stack([cx + scale * u, cy + scale * v])
    return float((left**2).sum()) / 2.0


def sized(block: Reconstruction, size: tuple[int, int]) -> Reconstruction:
    return block.with_sizes({image.name: size for image in block.images})


def costs(block: Reconstruction, rules: Stopping | None = None) -> tuple[float, float, Outcome]:
    """Cost of a reconstruction as it was published, and after the adjustment, both by `cost`."""
    problem: Problem = of_reconstruction(block, FREE)
    found = solved(problem)[1] if rules is None else solve(*problem, rules)
    return cost(arrays(problem)), cost(arrays((problem[0], found.state))), found.outcome


def test_bundlers_own_result_is_a_minimum_that_the_adjustment_lowers_a_little(
    real_data: Callable[[str], Path],
) -> None:
    """Measured when written: 126.928 before, 125.170 after."""
    block = read_reconstruction(real_data("bundler-bal") / "Balbianello.out")
    before, after, outcome = costs(sized(block, (640, 427)))
    assert outcome is Outcome.CONVERGED
    assert before == pytest.approx(126.928, abs=1e-3)
    assert 0.98 * before < after < before


def test_a_problem_of_bal_with_more_unknowns_than_measurements_is_fitted_all_the_same(
    real_data: Callable[[str], Path],
) -> None:
    """Three cameras with 19 rays: 41 unknowns, 38 observations. Measured when written: 2764.22 before, 0.03 after."""
    block = read_reconstruction(real_data("bundler-bal") / "dubrovnik-3-7-pre.txt")
    before, after, _ = costs(sized(block, (2000, 2000)), SHORT)
    assert before == pytest.approx(2764.22, abs=0.01)
    assert after < 0.1


def test_the_reconstruction_of_opensfm_is_lowered(real_data: Callable[[str], Path]) -> None:
    """Measured when written: 9,361.7 before, 6,303.4 after. OpenSfM held GNSS positions and bent large residuals."""
    block = read_reconstruction(real_data("opensfm-berlin") / "reconstruction_example.json")
    before, after, outcome = costs(placed(block))
    assert outcome is Outcome.CONVERGED
    assert before == pytest.approx(9361.66, abs=0.01)
    assert after < 0.7 * before


def placed(block: Reconstruction) -> Reconstruction:
    """The same with the points alone that the reconstruction has placed."""
    seen, known = block.observations, block.points.known
    keep, number = known[seen.point], np.cumsum(known) - 1
    ids = tuple(name for name, there in zip(block.points.ids, known.tolist(), strict=True) if there)
    points = ObjectPoints(ids, block.points.xyz[known])
    return replace(
        block, points=points, observations=ImagePoints(seen.image[keep], number[seen.point[keep]], seen.colrow[keep])
    )
