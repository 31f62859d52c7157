"""OpenCV's rational model of distortion; `polynomial` has the formula."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from geomosaic_frame.polynomial import PolynomialLens


@dataclass(frozen=True)
class Rational(PolynomialLens):
    """OpenCV's rational model with thin prism terms; see `geomosaic_frame.polynomial` for the formula.

    Attributes
    ----------
    k1, k2, k3 : float
        Radial numerator, of r², r⁴, r⁶.
    p1, p2 : float
        Tangential; p1 goes with 2xy in u.
    k4, k5, k6 : float
        Radial denominator.
    s1, s2, s3, s4 : float
        Thin prism.
    fold : float
        Ideal radius beyond which the distortion goes on linearly.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    s1: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0
    fold: float = field(init=False, repr=False, compare=False, default=np.inf)

    def __post_init__(self) -> None:
        prism = (self.s1, self.s2, self.s3, self.s4)
        self._prepare((self.k1, self.k2, self.k3), (self.k4, self.k5, self.k6), (self.p1, self.p2), prism)

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        values = asdict(self)
        values.pop("fold")
        return {"model": "opencv", **values}
