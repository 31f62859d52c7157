"""Spatial index of windows: which of many meet another, without looking at all."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from geomosaic.geo.grid import Window


class WindowIndex:
    """Index of windows of one grid.

    Parameters
    ----------
    windows : sequence of Window
    """

    def __init__(self, windows: Sequence[Window]) -> None:
        self._windows = windows

    @cached_property
    def _tree(self) -> Any:
        import shapely

        sides = np.array([(w.col, w.row, w.stop_col, w.stop_row) for w in self._windows], dtype=np.float64)
        return shapely.STRtree(shapely.box(*sides.reshape(-1, 4).T))

    def meeting(self, window: Window) -> list[int]:
        """Numbers of the windows that have pixels in common with another, rising.

        Parameters
        ----------
        window : Window
        """
        import shapely

        touched = np.sort(self._tree.query(shapely.box(window.col, window.row, window.stop_col, window.stop_row)))
        return [i for i in touched.tolist() if not self._windows[i].intersection(window).empty]
