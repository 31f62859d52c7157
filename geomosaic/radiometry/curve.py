"""A rising curve of values, band by band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.types import AnyArray, FloatArray


@dataclass(frozen=True, eq=False)
class Curve:
    """A rising curve per band: straight between its knots, of one slope beyond them.

    Attributes
    ----------
    knots : sequence of (x, y)
        One pair of arrays (K,) per band, x rising.
    slope : float
        Beyond them.
    """

    knots: Sequence[tuple[FloatArray, FloatArray]]
    slope: float = 1.0

    @classmethod
    def identity(cls, bands: int) -> Curve:
        """Leave values as they are."""
        return cls([(np.zeros(1), np.zeros(1))] * bands)

    def __call__(self, values: AnyArray) -> FloatArray:
        """Apply to values (..., bands)."""
        out = np.empty(values.shape, dtype=np.float64)
        for band, (x, y) in enumerate(self.knots):
            plain = np.asarray(values[..., band], dtype=np.float64)
            beyond = np.minimum(plain - x[0], 0.0) + np.maximum(plain - x[-1], 0.0)
            out[..., band] = np.interp(plain, x, y) + self.slope * beyond
        return out

    def line(self) -> tuple[FloatArray, FloatArray]:
        """Gain and offset (bands,) between the quarters of the knots: what the curve does on the whole."""
        gain, offset = np.ones(len(self.knots)), np.zeros(len(self.knots))
        for band, (x, y) in enumerate(self.knots):
            low, high = len(x) // 4, (3 * (len(x) - 1)) // 4 if len(x) > 3 else len(x) - 1
            if x[high] > x[low]:
                gain[band] = (y[high] - y[low]) / (x[high] - x[low])
            offset[band] = np.mean(y) - gain[band] * np.mean(x)
        return gain, offset
