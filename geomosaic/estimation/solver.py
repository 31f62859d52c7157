"""Least squares problem and its solver: Gauss-Newton, damped after Levenberg and Marquardt where needed.

    |W^½ (l − f(x))|² + Σ ((x − x₀) / σ₀)²   least

W are the weights of the observations l; the second sum runs over the unknowns with a finite a-priori standard deviation
σ₀ (soft constraints). An unknown of σ₀ = 0 is held, one of σ₀ = ∞ is free.

Steps solve the damped normal equations (AᵀA + λ·L²)·dx = Aᵀw, L being the lengths of the columns of A (Marquardt 1963).
λ starts at 0, so that a well-posed problem takes plain Gauss-Newton steps; a step that raises the sum of squares is
tried again with more damping, faster with each refusal, and the ratio of the decrease to the predicted one says by how
much it falls again (Nielsen 1999, Technical University of Denmark, IMM-REP-1999-05).
Nothing is random: the same problem gives the same digits.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Generic, Protocol, TypeVar

import numpy as np

from geomosaic.errors import InputError, SolveError
from geomosaic.estimation.equations import Equations
from geomosaic.types import BoolArray, FloatArray

State = TypeVar("State")


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Group of unknowns with a-priori values.

    Attributes
    ----------
    names : tuple of str (P,)
        For messages.
    start : array (P,)
        A-priori values x₀, in the units of the parameters.
    steps : array (P,)
        Changes that move an observation by about its own unit (a pixel): they make movements of unlike unknowns
        comparable.
    sigmas : array (P,)
        A-priori standard deviations σ₀: 0 held, inf free.
    """

    names: tuple[str, ...]
    start: FloatArray
    steps: FloatArray
    sigmas: FloatArray

    @classmethod
    def joined(cls, groups: Sequence[Unknowns]) -> Unknowns:
        """Unknowns of several groups as one, in their order."""
        return cls(
            tuple(name for group in groups for name in group.names),
            *(np.concatenate([getattr(group, field) for group in groups]) for field in ("start", "steps", "sigmas")),
        )

    @property
    def free(self) -> BoolArray:
        """Which unknowns (P,) are estimated."""
        return self.sigmas > 0.0

    @property
    def observed(self) -> BoolArray:
        """Which of the free unknowns (U,) have an a-priori value that counts as an observation."""
        return np.isfinite(self.sigmas[self.free])

    def moved(self, values: FloatArray, step: FloatArray) -> FloatArray:
        """Values (P,) after a step (U,) of the free ones."""
        after = values.copy()
        after[self.free] += step
        return after

    def movement(self, step: FloatArray) -> float:
        """Largest change of a step (U,), in `steps`."""
        return float(np.max(np.abs(step) / self.steps[self.free], initial=0.0))

    def a_priori_misclosure(self, values: FloatArray) -> FloatArray:
        """A-priori values less values (P,), over their standard deviations, of the observed ones."""
        return (self.start - values)[self.free][self.observed] / self.sigmas[self.free][self.observed]

    def a_priori(self, values: FloatArray) -> Equations:
        """Equations of the soft constraints at values (P,)."""
        design = np.eye(len(self.observed))[self.observed] / self.sigmas[self.free][self.observed][:, None]
        return Equations(design, self.a_priori_misclosure(values))


class Linearised(Protocol):
    """Observation equations at a state: dense `Equations`, or the `Network` of a block."""

    def step(self, damping: float = 0.0) -> FloatArray:
        """Changes (U,) of the unknowns, damped after Marquardt."""
        ...

    def residuals(self, step: FloatArray) -> FloatArray:
        """Weighted residuals (R,) after a step (U,)."""
        ...


class Problem(ABC, Generic[State]):
    """Nonlinear least squares problem in states of its own: a vector, a body, the models of a block.

    A state is a value: nothing changes it in place. What a step does to it is `moved`; rotations turn, vectors add.
    """

    @abstractmethod
    def linearise(self, state: State) -> Linearised:
        """Weighted observation equations at a state.

        Raises
        ------
        SolveError
            The observations do not determine the unknowns; the message names which.
        """

    @abstractmethod
    def squares(self, state: State) -> float:
        """Weighted sum of squares of a state; not finite where an observation cannot be computed."""

    @abstractmethod
    def moved(self, state: State, step: FloatArray) -> State:
        """State after a step (U,), with the weights and selections of the state before."""

    def movement(self, state: State, trial: State, equations: Linearised, step: FloatArray) -> float:
        """Size of a step in the unit of the stopping rules: by default its largest element.

        Parameters
        ----------
        state : State
        trial : State
            State after the step.
        equations : Linearised
            At `state`.
        step : array (U,)
            Of the unknowns.
        """
        return float(np.max(np.abs(step), initial=0.0))

    def after_inner_iterations(self, state: State) -> State:
        """State in which unknowns that the others determine one by one have followed these; by default unchanged."""
        return state

    def refreshed(self, state: State) -> State:
        """State with weights and selections that follow from it (iterative reweighting); by default it has none."""
        return state


# Columns have length one, so dampings are relative to the eigenvalues of AᵀA, which are near one. Where damping has
# fallen to nothing it begins anew from the least: what a weak direction bears may be far below the first.
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-4, 1e-9, 1e12
# Factor of the damping at the first refusal of a step, which doubles with each further one, and its largest fall.
GROWTH, LARGEST_FALL = 10.0, 0.1
# Sum of squares (in standard deviations) that is rounding: exact observations may leave more after a step.
NOTHING = 1e-20


class Outcome(Enum):
    """End of an iteration; the values are messages."""

    CONVERGED = "the adjustment converged"
    STALLED = "the adjustment does not converge"
    TOO_MANY = "the adjustment did not converge"


@dataclass(frozen=True)
class Stopping:
    """Stopping rules of an iteration.

    Attributes
    ----------
    rounds : int
        Linearisations at most.
    step : float
        Movement (see `Problem.movement`) below which the solution is reached.
    near : float
        Movement below which it is reached as well where a step no longer gains.
    gain : float, optional
        Relative decrease of the sum of squares that counts as none. Without it, where weights change from round to
        round and sums cannot be compared, a step that moves as much as the one before gains nothing.
    rise : float
        Relative rise of the sum of squares that a step may bring: rounding, or more where weights change with it.
    longest : float
        Movement that no step may exceed; it is damped until it does not.
    stalled : float
        Undamped movement below which a step that lowers nothing is rounding, and not a failure.
    """

    rounds: int = 100
    step: float = 1e-10
    near: float = 1e-4
    gain: float | None = 1e-15
    rise: float = 1e-12
    longest: float = float("inf")
    stalled: float = 0.1


@dataclass(frozen=True, eq=False)
class Solution(Generic[State]):
    """State at which an iteration ended.

    Attributes
    ----------
    state : State
    squares : float
        Weighted sum of squares there.
    rounds : int
        Linearisations that were solved.
    outcome : Outcome
    equations : Linearised
        The last of them: apart from those at `state` by one step, which convergence makes negligible.
    """

    state: State
    squares: float
    rounds: int
    outcome: Outcome
    equations: Linearised

    def required(self, hint: str) -> Solution[State]:
        """The solution itself.

        Raises
        ------
        SolveError
            The iteration did not converge.
        """
        if self.outcome is Outcome.CONVERGED:
            return self
        rounds = f" in {self.rounds} rounds" if self.outcome is Outcome.TOO_MANY else ""
        raise SolveError(f"{self.outcome.value}{rounds}", hint=hint)


def solve(problem: Problem[State], start: State, rules: Stopping | None = None) -> Solution[State]:
    """Minimum of a weighted sum of squares.

    Parameters
    ----------
    problem : Problem
    start : State
    rules : Stopping, optional

    Returns
    -------
    Solution
        Whether it converged is in its `outcome`.

    Raises
    ------
    SolveError
        From `Problem.linearise`: the observations do not determine the unknowns.
    """
    rules = rules or Stopping()
    state, damping, growth, before = start, 0.0, GROWTH, np.inf
    squares, least = problem.squares(state), FIRST_DAMPING
    for done in range(1, rules.rounds + 1):
        equations = problem.linearise(state)
        while True:
            step = equations.step(damping)
            # NaN and inf compare false: a step that makes an observation impossible is damped, too.
            trial, movement, after = _tried(problem, state, equations, step, squares * (1.0 + rules.rise) + NOTHING)
            falls = after <= squares * (1.0 + rules.rise) + NOTHING or movement < rules.step
            if falls and movement <= rules.longest:
                break
            damping, growth = max(growth * damping, least), 2.0 * growth
            if damping > MOST_DAMPING:
                undamped = _tried(problem, state, equations, equations.step(), np.inf)[1]
                outcome = Outcome.CONVERGED if undamped < rules.stalled else Outcome.STALLED
                return Solution(state, squares, done, outcome, equations)
        gain = squares - after
        # Near the solution movements are rounding noise and never reach `rules.step`: a gain of nothing ends it too.
        settled = gain <= rules.gain * squares if rules.gain is not None else movement >= before
        spent = False
        if damping > 0.0 or (settled and rules.gain is not None):
            predicted = squares - float(np.sum(equations.residuals(step) ** 2))
            # An undamped step promises all there is to gain: nothing, though weak unknowns may move by many steps.
            spent = damping == 0.0 and rules.gain is not None and abs(predicted) <= rules.gain * squares
            damping, growth, least = _relaxed(damping, gain, predicted), GROWTH, LEAST_DAMPING
        state = problem.refreshed(trial)
        squares = after if state is trial else problem.squares(state)
        before = movement
        if movement < rules.step or (settled and (spent or movement < rules.near)):
            return Solution(state, squares, done, Outcome.CONVERGED, equations)
    return Solution(state, squares, rules.rounds, Outcome.TOO_MANY, equations)


def _relaxed(damping: float, gain: float, predicted: float) -> float:
    """Damping after a step that was taken (Nielsen 1999), by the ratio of its gain to what the equations promised."""
    ratio = gain / predicted if predicted > 0.0 else 1.0
    less = damping * max(LARGEST_FALL, 1.0 - (2.0 * min(ratio, 1.0) - 1.0) ** 3)
    # Below the least damping the step is Gauss-Newton's to all digits that matter.
    return less if less > LEAST_DAMPING else 0.0


def _tried(
    problem: Problem[State], state: State, equations: Linearised, step: FloatArray, before: float
) -> tuple[State, float, float]:
    """State after a step from one of a sum of squares, its movement, and its sum; inf where no model is like that."""
    try:
        trial = problem.moved(state, step)
    except InputError:  # of a lens whose coefficients have grown beyond any lens
        return state, np.inf, np.inf
    after = problem.squares(trial)
    if not after <= before:
        # Along a curved valley (focal length against heights) a step is right for few unknowns, and too straight for
        # the many that follow them: damped alone, it takes hundreds of rounds to the bottom.
        followed = problem.after_inner_iterations(trial)
        if followed is not trial and ((better := problem.squares(followed)) < after or np.isnan(after)):
            trial, after = followed, better
    return trial, problem.movement(state, trial, equations, step), after
