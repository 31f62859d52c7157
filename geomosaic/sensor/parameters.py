"""The adjustable parameters of a sensor model: names, units, values, a-priori sigmas and steps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geomosaic.types import FloatArray


@dataclass(frozen=True, eq=False)
class Parameters:
    """Named parameters.

    Attributes
    ----------
    names, units : tuple of str
        One per parameter, for example 'omega' and 'deg'.
    values : array (P,)
        Current values in their units.
    sigmas : array (P,)
        A-priori standard deviations: 0 holds a parameter fixed, inf leaves it free.
    steps : array (P,)
        A change that moves the image by about one pixel; scales differences and normal equations.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    sigmas: FloatArray
    steps: FloatArray

    def __post_init__(self) -> None:
        for field in ("values", "sigmas", "steps"):
            array = np.array(getattr(self, field), dtype=np.float64)
            if array.shape != (len(self.names),):
                raise ValueError(f"{field} has shape {array.shape} for {len(self.names)} names")
            array.setflags(write=False)
            object.__setattr__(self, field, array)
        if len(self.units) != len(self.names):
            raise ValueError("names and units differ in number")

    def __len__(self) -> int:
        return len(self.names)

    def with_values(self, values: FloatArray) -> Parameters:
        """Return the same parameters with new values (P,)."""
        return replace(self, values=np.asarray(values, dtype=np.float64))
