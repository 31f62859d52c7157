"""Sensor contract: one pure map from ground to image, with its adjustable parameters and its state."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np
from pyproj import CRS

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
        """Same parameters with new values (P,)."""
        return replace(self, values=np.asarray(values, dtype=np.float64))


@runtime_checkable
class SensorModel(Protocol):
    """Sensor model: a frozen map ground → image.

    Image coordinates are (col, row), (0.5, 0.5) being the centre of the upper-left pixel. A point that the model cannot
    see in principle (behind the camera) is NaN, never an exception; one bad point never spoils the others. Points that
    merely fall outside the image keep smooth, finite coordinates outside it: the lattice interpolates across the edge.
    """

    @property
    def crs(self) -> CRS:
        """Frame of xyz: geocentric or another 3-D CRS; a 2-D projected CRS where heights play no part."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image in pixels."""

    @property
    def parameters(self) -> Parameters:
        """Parameters that an adjustment may change."""

    @property
    def seed(self) -> tuple[float, float, float]:
        """A ground point near the middle of what the image shows, in `crs`; inverses start there."""

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Ground (N, 3) in `crs` to image (N, 2) in pixels."""

    def with_values(self, values: FloatArray) -> Self:
        """New model with other parameter values (P,)."""

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values; `from_dict` of the same class gives the model back."""

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Model of a state, as `to_dict` gives it."""


@runtime_checkable
class HasRays(Protocol):
    """Optional power: lines of sight in closed form."""

    def rays(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image (N, 2) to origins (N, 3) and unit directions (N, 3) to the ground, in the model's Cartesian `crs`."""


@runtime_checkable
class HasJacobian(Protocol):
    """Optional power: derivatives in closed form."""

    def jacobian(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of (col, row) by parameters (N, 2, P) and by ground coordinates (N, 2, 3)."""
