"""Look directions of detectors, and the choice among those of several bands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import FloatArray

# Line lengths beyond each end of the line within which directions are extrapolated.
REACH = 5.0
_ROUNDS = 12


@dataclass(frozen=True, eq=False)
class LookDirections:
    """Look directions of a line, u = (across, along, −1) in the scanner's axes.

    Attributes
    ----------
    cols : array (K,)
        Image columns of the nodes, increasing; 0.5 is the first pixel's centre.
    across, along : array (K,)
        Slopes of the look direction at the nodes, without unit, or their angles in radians; `across` is monotonic.
    angular : bool
        Whether it is angles that grow linearly between nodes. SPOT 1 to 4 tell those of the first and the last
        detector only; were it their tangents, the line would be wrong by 55 pixels at 27° of incidence.
    """

    cols: FloatArray
    across: FloatArray
    along: FloatArray
    angular: bool = False

    def __post_init__(self) -> None:
        for name in ("cols", "across", "along"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @classmethod
    def of(cls, cols: FloatArray, across: FloatArray, along: FloatArray, where: str, angular: bool = False) -> Self:
        """Look directions of nodes, checked to be smooth and finite.

        Raises
        ------
        InputError
            Fewer than two nodes, or neighbours that look in the same direction or the other way round.
        """
        order = np.argsort(cols)
        c, a, b = (np.asarray(v, dtype=np.float64)[order] for v in (cols, across, along))
        # Only a monotonic line can be inverted, from a direction to the column that looks there.
        steps = np.diff(a)
        monotonic = len(a) >= 2 and bool((np.diff(c) > 0).all() and ((steps > 0).all() or (steps < 0).all()))
        if not monotonic or not np.isfinite([c, a, b]).all():
            raise InputError(
                "the look angles of the line do not go one way from detector to detector",
                where=where,
                hint="two or more detectors are needed, each looking further across than the one before",
            )
        return cls(c, a, b, angular)

    @cached_property
    def _table(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Nodes with one more beyond each end, on the mean slope of the last hundredth of the line."""
        count = len(self.cols)
        back = min(count - 1, max(1, count // 100))
        columns = []
        reach = REACH * (self.cols[-1] - self.cols[0])
        for values in (self.cols, self.across, self.along):
            first = values[0] - (values[back] - values[0]) * reach / (self.cols[back] - self.cols[0])
            last = values[-1] + (values[-1] - values[-1 - back]) * reach / (self.cols[-1] - self.cols[-1 - back])
            columns.append(np.concatenate([[first], values, [last]]))
        return columns[0], columns[1], columns[2]

    @cached_property
    def _by_across(self) -> tuple[FloatArray, FloatArray]:
        cols, across, _ = self._table
        # `np.interp` needs nodes that increase.
        return (across, cols) if across[0] < across[-1] else (across[::-1], cols[::-1])

    @cached_property
    def _span(self) -> tuple[float, float]:
        """Middle and half length of the line, in columns."""
        return 0.5 * float(self.cols[0] + self.cols[-1]), 0.5 * float(self.cols[-1] - self.cols[0])

    def _curve(self, cols: FloatArray) -> FloatArray:
        """Second Legendre polynomial over the line: 1 at both ends, −0.5 in the middle."""
        middle, half = self._span
        along = (cols - middle) / half
        curve: FloatArray = 1.5 * along * along - 0.5
        return curve

    def slopes(self, cols: FloatArray, stretch: float = 0.0, bend: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Slopes (N,) across and along of columns (N,); NaN more than five line lengths beyond an end.

        `stretch` and `bend` add that multiple of the second Legendre polynomial over the line to the slopes.
        """
        nodes, across, along = self._table
        a = np.interp(cols, nodes, across, np.nan, np.nan)
        b = np.interp(cols, nodes, along)
        if self.angular:
            a, b = np.tan(a), np.tan(b)
        if stretch or bend:
            curve = self._curve(cols)
            a, b = a + stretch * curve, b + bend * curve
        return a, b

    def columns(self, across: FloatArray, stretch: float = 0.0) -> FloatArray:
        """Columns (N,) that look along slopes across (N,); NaN more than five line lengths beyond an end."""
        known, nodes = self._by_across
        cols: FloatArray = np.interp(self._as_known(across), known, nodes, np.nan, np.nan)
        if stretch:
            # The stretch is some pixels in thousands, so each round gains three digits or more.
            for _ in range(_ROUNDS):
                cols = np.interp(self._as_known(across - stretch * self._curve(cols)), known, nodes, np.nan, np.nan)
        return cols

    def _as_known(self, slopes: FloatArray) -> FloatArray:
        """Slopes in the form the nodes are stored in: angles where `angular`."""
        known: FloatArray = np.arctan(slopes) if self.angular else slopes
        return known

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        nodes = {"cols": self.cols.tolist(), "across": self.across.tolist(), "along": self.along.tolist()}
        return {**nodes, "angular": self.angular}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        return cls(np.array(state["cols"]), np.array(state["across"]), np.array(state["along"]), state["angular"])


_SAME = 0.1  # pixels


def choose_band(
    looks: Mapping[str, LookDirections], band: str | None, where: str
) -> tuple[LookDirections, tuple[str, ...]]:
    """Look directions of the band asked for, or of all bands where they are the same.

    Parameters
    ----------
    looks : mapping of str to LookDirections
        By band, one at least.
    band : str, optional
    where : str
        Named in errors.

    Returns
    -------
    look : LookDirections
    notes : tuple of str
        What is to be noted of the choice.

    Raises
    ------
    InputError
        There is no such band, or the bands look apart by more than a tenth of a pixel and none is named.
    """
    if band is not None:
        if band not in looks:
            raise InputError(
                f"there are no look angles of band {band}", where=where, hint=f"known bands are: {', '.join(looks)}"
            )
        return looks[band], (f"look angles of band {band}",)
    first = next(iter(looks.values()))
    apart = max(_apart(first, look) for look in looks.values())
    if apart > _SAME:
        raise InputError(
            f"the bands look apart by up to {apart:.2f} pixels, and nothing says which one is meant",
            where=where,
            hint=f"give band = {' or '.join(looks)}, and rectify each band by itself",
        )
    return first, ()


def _apart(one: LookDirections, other: LookDirections) -> float:
    """Largest distance in pixels between the directions of two bands."""
    cols = np.linspace(one.cols[0], one.cols[-1], 101)
    pixel = abs(one.across[-1] - one.across[0]) / (one.cols[-1] - one.cols[0])
    pairs = zip(one.slopes(cols), other.slopes(cols), strict=True)
    return float(max(np.nanmax(np.abs(a - b)) for a, b in pairs) / pixel)
