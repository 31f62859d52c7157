"""The weight of one image in a block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.resample.warp import CELL
from geomosaic.types import AnyArray, ByteArray


@dataclass(frozen=True)
class Share:
    """Weight of one image on a reduced lattice; None is 1 everywhere."""

    index: int
    weight: AnyArray | None
    factor: int
    margin: int

    def need(self, shape: tuple[int, int]) -> ByteArray:
        """Cells of the block in which the image has weight."""
        assert self.weight is not None
        per = CELL // self.factor
        rows, cols = -(-shape[0] // CELL), -(-shape[1] // CELL)
        # Counts over windows from running sums: a window is a cell and what its pixels interpolate between.
        sums = np.pad(np.cumsum(np.cumsum(self.weight > 0, axis=0), axis=1), ((1, 0), (1, 0)))
        top, left = self.margin - 1 + per * np.arange(rows), self.margin - 1 + per * np.arange(cols)
        stop = np.minimum(top + per + 2, self.weight.shape[0])
        end = np.minimum(left + per + 2, self.weight.shape[1])
        count = sums[stop][:, end] - sums[top][:, end] - sums[stop][:, left] + sums[top][:, left]
        need: ByteArray = (count > 0).astype(np.uint8)
        return need
