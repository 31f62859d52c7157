"""Least squares problem: unknowns with their a-priori values, and what a solver asks of any adjustment.

    |W^½ (l − f(x))|² + Σ ((x − x₀) / σ₀)²   least

W are the weights of the observations l; the second sum runs over the unknowns with a finite a-priori standard deviation
σ₀ (soft constraints). An unknown of σ₀ = 0 is held, one of σ₀ = ∞ is free.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

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
        estimated: BoolArray = self.sigmas > 0.0
        return estimated

    @property
    def observed(self) -> BoolArray:
        """Which of the free unknowns (U,) have an a-priori value that counts as an observation."""
        known: BoolArray = np.isfinite(self.sigmas[self.free])
        return known

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


class Problem(ABC, Generic[State]):
    """Nonlinear least squares problem in states of its own: a vector, a body, the models of a block.

    A state is a value: nothing changes it in place. What a step does to it is `moved`; rotations turn, vectors add.
    """

    @abstractmethod
    def linearise(self, state: State) -> Equations:
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

    def movement(self, state: State, trial: State, equations: Equations, step: FloatArray) -> float:
        """Size of a step in the unit of the stopping rules: by default its largest element."""
        return float(np.max(np.abs(step), initial=0.0))

    def refreshed(self, state: State) -> State:
        """State with weights and selections that follow from it (iterative reweighting); by default it has none."""
        return state
