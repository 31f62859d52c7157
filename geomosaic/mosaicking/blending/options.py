"""How images are blended across their seams, as a value."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import InputError
from geomosaic.geo.grid import Grid
from geomosaic.geo.units import linear_unit

KINDS = ("feather", "overlap", "multiband", "none")
RAMPS = ("linear", "smooth")
PIXELS = 32.0
"""Width unless one is given."""


@dataclass(frozen=True)
class Width:
    """A width on the ground.

    Attributes
    ----------
    value : float
    unit : str
        'px' output pixels, 'm' metres, or 'map' units of the output CRS.
    """

    value: float
    unit: str = "map"

    @classmethod
    def parse(cls, text: str) -> Width:
        """Read '20px', '5m', or a number of map units.

        Raises
        ------
        InputError
        """
        found = re.fullmatch(r"\s*(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+)\s*(px|m)?\s*", text)
        if not found:
            raise InputError(f"'{text}' is not a width", hint="write pixels as 20px, metres as 5m, or map units as 5")
        return cls(float(found[1]), found[2] or "map")

    def pixels(self, grid: Grid) -> float:
        """In pixels of a grid; in degrees a metre is that at the middle of the grid."""
        if self.unit == "px":
            return self.value
        x, y = grid.resolution
        size = x if x == y else math.sqrt(x * y)
        return self.value * (_units_per_metre(grid) if self.unit == "m" else 1.0) / size


def _units_per_metre(grid: Grid) -> float:
    metres = linear_unit(grid.crs)
    if grid.crs.is_geographic:  # the mean of both axes
        bottom, top = grid.bounds[1::2]
        metres *= math.sqrt(max(0.01, float(np.cos(np.radians((bottom + top) / 2)))))
    return 1.0 / (metres or 1.0)


@dataclass(frozen=True)
class Blending:
    """How images are blended.

    Attributes
    ----------
    kind : str
        'feather' across the seam, 'overlap' over all that images share, 'multiband' each band of frequency as wide as
        its wavelength, or 'none'.
    width : Width, optional
        Of the transition. For 'overlap' the distance from an image's edge beyond which it counts fully, without end
        unless given. For 'multiband' the width of the coarsest band, rounded to a power of two.
    ramp : str
        'linear', or 'smooth' with no kink at its ends.
    limit : bool, optional
        Do not blend what the images show differently. Done unless said otherwise.
    """

    kind: str = "feather"
    width: Width | None = None
    ramp: str = "linear"
    limit: bool | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"no blending is named '{self.kind}'", hint=f"one of {', '.join(KINDS)}")
        if self.ramp not in RAMPS:
            raise InputError(f"no ramp is named '{self.ramp}'", hint=f"one of {', '.join(RAMPS)}")

    @property
    def limits(self) -> bool:
        """Whether what images show differently is not blended."""
        return self.kind != "none" and self.limit is not False

    @property
    def plain(self) -> bool:
        """Whether weights across the seam are all that is wanted."""
        return self.kind in ("none", "feather")

    def pixels(self, grid: Grid, given: float | None) -> float:
        """Width in pixels of the output; `given` is one in map units, that counts where there is no other."""
        if self.kind == "none":
            return 0.0
        width = self.width or (None if given is None else Width(given))
        if width is None:
            return math.inf if self.kind == "overlap" else PIXELS
        return width.pixels(grid)
