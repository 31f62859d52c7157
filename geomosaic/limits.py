"""Limits of numbers, with the words of every error about one: of the library, a flag, a key of a file."""

from __future__ import annotations

import math
from dataclasses import dataclass

from geomosaic.errors import InputError

# A whole number of hundreds of digits is finite, and no float.
LARGEST = 10**300


@dataclass(frozen=True)
class Limits:
    """Range of a finite number: more than `above`, from `least` to `most`, less than `below`."""

    above: float = -math.inf
    least: float = -math.inf
    most: float = math.inf
    below: float = math.inf

    def __str__(self) -> str:
        """'above 0', 'from 0 to 24', 'of 1 or more'; empty where any finite number is admissible."""
        words = [f"above {self.above:g}"] if self.above >= self.least and math.isfinite(self.above) else []
        if not words and math.isfinite(self.least):
            if math.isfinite(self.most):
                return f"from {self.least:g} to {self.most:g}"
            words = [f"of {self.least:g} or more"]
        if math.isfinite(self.most):
            words.append(f"at most {self.most:g}")
        if math.isfinite(self.below):
            words.append(f"below {self.below:g}")
        return " and ".join(words)

    def check(self, value: float, where: str | None = None) -> None:
        """Check of a number.

        Parameters
        ----------
        value : float
        where : str, optional
            Named by the error.

        Raises
        ------
        InputError
            The number is not finite, or out of its limits.
        """
        finite = math.isfinite(value) if isinstance(value, float) else abs(value) < LARGEST
        inside = finite and self.above < value < self.below and self.least <= value <= self.most
        if not inside:
            what = f"{value:g} is out of range" if finite else f"{value} is no finite number"
            raise InputError(what, where=where, hint=f"give a number {self}".rstrip())


POSITIVE = Limits(above=0.0)
