"""The least squares core: every problem with a known minimum, against scipy's own solver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import least_squares

from geomosaic.errors import InputError, SolveError
from geomosaic.estimation.equations import Equations
from geomosaic.estimation.solver import Outcome, Problem, Stopping, Unknowns, solve
from geomosaic.estimation.statistics import deletion_statistic
from geomosaic.types import FloatArray

RNG = np.random.default_rng(20)
T = np.linspace(0.0, 3.0, 25)
SINES = 2.0 * np.exp(-0.7 * T) * np.cos(3.0 * T) + RNG.normal(0.0, 0.02, 25)


@dataclass(frozen=True, eq=False)
class Curve(Problem[FloatArray]):
    """A curve f(x; t) through observations, its Jacobian by central differences."""

    name: str

    def residuals(self, x: FloatArray) -> FloatArray:
        if self.name == "damped oscillation":
            return (SINES - x[0] * np.exp(-x[1] * T) * np.cos(x[2] * T)) / 0.02
        if self.name == "Rosenbrock":
            return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])
        return np.array([x[0] + 10.0 * x[1], np.sqrt(5.0) * (x[2] - x[0]), (x[1] - 2.0 * x[2]) ** 2, x[0] - 3.0])

    def linearise(self, state: FloatArray) -> Equations:
        step = 1e-6 * np.eye(len(state))
        design = -np.column_stack([(self.residuals(state + h) - self.residuals(state - h)) / 2e-6 for h in step])
        return Equations(design, self.residuals(state))

    def squares(self, state: FloatArray) -> float:
        return float((self.residuals(state) ** 2).sum())

    def moved(self, state: FloatArray, step: FloatArray) -> FloatArray:
        return state + step


STARTS = {"damped oscillation": [1.0, 0.2, 2.6], "Rosenbrock": [-1.2, 1.0], "Powell": [3.0, -1.0, 0.0]}


@pytest.mark.parametrize("name", STARTS)
def test_the_minimum_is_that_of_scipy(name: str) -> None:
    problem, start = Curve(name), np.array(STARTS[name])
    found = solve(problem, start, Stopping(step=1e-9))
    other = least_squares(problem.residuals, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert found.outcome is Outcome.CONVERGED
    assert found.squares <= 2.0 * other.cost * (1.0 + 1e-9) + 1e-16
    np.testing.assert_allclose(found.state, other.x, atol=1e-6)


def test_the_same_problem_gives_the_same_digits() -> None:
    first, second = (solve(Curve("Rosenbrock"), np.array([-1.2, 1.0])) for _ in range(2))
    np.testing.assert_array_equal(first.state, second.state)


def test_failure_is_a_value_until_it_is_required_not_to_be() -> None:
    ended = solve(Curve("Rosenbrock"), np.array([-1.2, 1.0]), Stopping(rounds=2))
    assert ended.outcome is Outcome.TOO_MANY
    with pytest.raises(SolveError, match="did not converge in 2 rounds"):
        ended.required("look at the start")


def test_a_step_to_parameters_that_no_model_can_have_is_damped() -> None:
    class Bounded(Curve):
        def moved(self, state: FloatArray, step: FloatArray) -> FloatArray:
            if np.abs(state + step).max() > 1.5:
                raise InputError("the coefficients are too large for any lens", hint="check them")
            return state + step

    found = solve(Bounded("Rosenbrock"), np.array([-1.2, 1.0]), Stopping(step=1e-9))
    assert found.outcome is Outcome.CONVERGED
    np.testing.assert_allclose(found.state, 1.0, atol=1e-6)


def test_no_step_is_longer_than_allowed() -> None:
    seen = []

    class Watched(Curve):
        def linearise(self, state: FloatArray) -> Equations:
            seen.append(state)
            return super().linearise(state)

    found = solve(Watched("Rosenbrock"), np.array([-1.2, 1.0]), Stopping(step=1e-9, longest=0.1))
    assert np.abs(np.diff(seen, axis=0)).max() <= 0.1
    np.testing.assert_allclose(found.state, [1.0, 1.0], atol=1e-8)


@pytest.mark.parametrize("damping", [0.0, 1e-3, 10.0])
def test_steps_are_those_of_the_damped_normal_equations(damping: float) -> None:
    design, right = RNG.normal(size=(40, 6)) * [1.0, 1e3, 1e-3, 1.0, 5.0, 1.0], RNG.normal(size=40)
    length = np.diag(np.linalg.norm(design, axis=0) ** 2)
    expected = np.linalg.solve(design.T @ design + damping * length, design.T @ right)
    np.testing.assert_allclose(Equations(design, right).step(damping), expected, rtol=1e-9)


def test_cofactors_are_the_inverse_of_the_normal_matrix() -> None:
    design = RNG.normal(size=(40, 5)) * [1.0, 1e3, 1e-3, 1.0, 5.0]
    found = Equations(design, np.zeros(40)).parameter_cofactors()
    np.testing.assert_allclose(found, np.linalg.inv(design.T @ design), rtol=1e-9)


def test_redundancy_numbers_are_those_of_the_residual_matrix_in_blocks() -> None:
    design = RNG.normal(size=(12, 4)) * [1.0, 1e3, 1e-3, 1.0]
    matrix = np.eye(12) - design @ np.linalg.inv(design.T @ design) @ design.T
    found = Equations(design, np.zeros(12)).redundancy_numbers(5)
    np.testing.assert_allclose(found, [matrix[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(5)], atol=1e-12)
    held = Equations(np.zeros((12, 0)), np.zeros(12)).redundancy_numbers(6)
    np.testing.assert_array_equal(held, np.tile(np.eye(2), (6, 1, 1)))


def test_unknowns_that_are_nearly_alike_keep_their_digits() -> None:
    # Focal length and flying height over flat ground: normal equations would have lost all of them.
    left, _, turned = np.linalg.svd(RNG.normal(size=(30, 6)), full_matrices=False)
    design = left * np.geomspace(1.0, 1e-9, 6) @ turned
    equations = Equations(design, design @ np.arange(6.0))
    assert equations.determined
    np.testing.assert_allclose(equations.step(), np.arange(6.0), atol=1e-5)


def test_the_sum_of_squares_falls_without_a_measurement_as_foretold() -> None:
    design, right = RNG.normal(size=(12, 3)), RNG.normal(size=12)
    design[10:] = [[1.0, 0.0, 0.0], [0.0, 1e6, 0.0]]  # what the last row says no other row could contradict
    equations = Equations(design, right)
    left = equations.residuals(equations.step())
    fall, freedom = deletion_statistic(left.reshape(-1, 2), equations.redundancy_numbers(6), 1e-7)
    assert freedom.tolist() == [2, 2, 2, 2, 2, 1]
    for k in range(5):
        kept = np.arange(12) // 2 != k
        other = Equations(design[kept], right[kept])
        assert fall[k] == pytest.approx(left @ left - np.sum(other.residuals(other.step()) ** 2), rel=1e-6)


def test_a_rank_defect_is_an_infinite_condition_and_names_its_direction() -> None:
    design = RNG.normal(size=(20, 3))
    design[:, 2] = design[:, 0]
    condition, direction = Equations(design, np.zeros(20)).condition()
    assert condition > 1e6
    assert abs(direction @ [1.0, 0.0, -1.0]) == pytest.approx(np.sqrt(2.0), rel=1e-3)


def test_soft_constraints_are_observations_of_unknowns() -> None:
    unknowns = Unknowns(("a", "b", "c"), np.array([1.0, 2.0, 3.0]), np.ones(3), np.array([0.5, 0.0, np.inf]))
    prior = unknowns.a_priori(np.array([1.5, 2.0, 9.0]))
    np.testing.assert_array_equal(prior.design, [[2.0, 0.0]])
    np.testing.assert_array_equal(prior.misclosure, [-1.0])
    np.testing.assert_array_equal(unknowns.moved(unknowns.start, np.array([1.0, 1.0])), [2.0, 2.0, 4.0])
    both = Unknowns.joined([unknowns, unknowns])
    assert both.names == ("a", "b", "c") * 2
    assert both.free.tolist() == [True, False, True] * 2
