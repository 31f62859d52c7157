"""Image coordinates as files of points and vectors count them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.types import FloatArray

# Rows count down from the top edge; the same with a minus sign, as QGIS shows images without georeference; or up from
# the bottom edge.
ROWS = ("down", "negative", "up")


@dataclass(frozen=True)
class PixelAxes:
    """How a file counts pixels.

    Attributes
    ----------
    height : int
        Of the image, pixels.
    rows : str
        One of `ROWS`.
    first : float
        What it calls the centre of the first pixel: 0.5, as everywhere in geomosaic, 0 or 1.
    """

    height: int
    rows: str = "down"
    first: float = 0.5

    def colrow(self, xy: FloatArray) -> FloatArray:
        """Coordinates of the file (N, 2) to (col, row)."""
        return self._turned(np.asarray(xy, dtype=np.float64)) + (0.5 - self.first) * np.array([1.0, self._down])

    def xy(self, colrow: FloatArray) -> FloatArray:
        """(col, row) (N, 2) to coordinates of the file."""
        return self._turned(np.asarray(colrow, dtype=np.float64) - (0.5 - self.first) * np.array([1.0, self._down]))

    @property
    def _down(self) -> float:
        """An offset of the count goes with the count: up, where rows count up."""
        return -1.0 if self.rows == "up" else 1.0

    def _turned(self, points: FloatArray) -> FloatArray:
        """Turn the direction of rows; doing it twice undoes it."""
        if self.rows == "down":
            return points[:, :2].copy()
        start = self.height if self.rows == "up" else 0.0
        return np.column_stack([points[:, 0], start - points[:, 1]])
