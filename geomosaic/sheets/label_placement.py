"""Label placement: boxes that do not overlap, in the order of their weight.

Point labels try the eight places around a symbol in the order of E. Imhof (Positioning names on maps, The American
Cartographer 2, 1975): upper right first, below last. Lengths are millimetres on the page.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from geomosaic.types import FloatArray

Measure = Callable[[str, float], tuple[float, float]]
"""Width and height in mm of a text at a size in points."""


@dataclass(frozen=True)
class LabelPosition:
    """Position of a label: centre in mm, angle of the baseline in degrees, counter-clockwise."""

    x: float
    y: float
    angle: float = 0.0


@dataclass(frozen=True)
class LabelPart:
    """Text, or one letter of it, whose box is centred at a position; width and height in mm."""

    text: str
    spot: LabelPosition
    width: float
    height: float

    def box(self, gap: float = 0.0) -> FloatArray:
        """Corners (4, 2), with a gap around the text."""
        return corners(self.spot, self.width + 2 * gap, self.height + 2 * gap)


@dataclass(frozen=True)
class PlacedLabel:
    """Placed label: one part, or a part for each letter along a curve; `on_line` if it lies on the line it names."""

    text: str
    pieces: tuple[LabelPart, ...]
    on_line: bool = False

    @property
    def spot(self) -> LabelPosition:
        """Position of the text, or of its middle letter."""
        return self.pieces[len(self.pieces) // 2].spot


def corners(spot: LabelPosition, width: float, height: float) -> FloatArray:
    """Corners (4, 2) of a text's box, counter-clockwise."""
    c, s = math.cos(math.radians(spot.angle)), math.sin(math.radians(spot.angle))
    box = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (width / 2, height / 2)
    turned: FloatArray = box @ np.array([[c, s], [-s, c]]) + (spot.x, spot.y)
    return turned


def overlap(first: FloatArray, second: FloatArray) -> bool:
    """Whether two convex quadrangles (4, 2) have area in common: no side of either separates them."""
    for box in (first, second):
        sides = np.roll(box, -1, axis=0) - box
        normals = np.column_stack([sides[:, 1], -sides[:, 0]])
        a, b = first @ normals.T, second @ normals.T
        if ((a.max(axis=0) <= b.min(axis=0) + 1e-9) | (b.max(axis=0) <= a.min(axis=0) + 1e-9)).any():
            return False
    return True


@dataclass
class LabelPlacer:
    """Boxes occupied so far; labels are placed in the order of their weight.

    Attributes
    ----------
    frame : tuple
        Left, bottom, right, top in mm: no text reaches beyond.
    gap : float
        Least distance between texts, mm.
    outline : array (N, 2), optional
        A ring within the frame that no text leaves either, in mm.
    """

    frame: tuple[float, float, float, float]
    gap: float = 0.6
    outline: FloatArray | None = None
    _taken: list[FloatArray] = field(default_factory=list)
    _limits: FloatArray = field(default_factory=lambda: np.empty((256, 4)))  # of those taken, then room for more

    def block(self, x: float, y: float, size: float) -> None:
        """Keep a square around a symbol free."""
        self._take(corners(LabelPosition(x, y), size, size))

    def inside(self, x: float, y: float) -> bool:
        """Whether a point lies in the frame and the outline."""
        left, bottom, right, top = self.frame
        within = left <= x <= right and bottom <= y <= top
        return within and (self.outline is None or _inside(self.outline, x, y))

    def free(self, box: FloatArray) -> bool:
        """Whether a box lies inside the frame and touches no other."""
        left, bottom, right, top = self.frame
        low, high = box.min(axis=0), box.max(axis=0)
        if low[0] < left or low[1] < bottom or high[0] > right or high[1] > top:
            return False
        if self.outline is not None and not all(_inside(self.outline, x, y) for x, y in box.tolist()):
            return False
        if not self._taken:
            return True
        limits = self._limits[: len(self._taken)]
        near = (limits[:, :2] < high).all(axis=1) & (limits[:, 2:] > low).all(axis=1)
        return not any(overlap(box, self._taken[i]) for i in np.flatnonzero(near))

    def place(self, text: str, width: float, height: float, spots: Iterable[LabelPosition]) -> PlacedLabel | None:
        """Put a straight text at the first free spot; None where there is none."""
        return self.place_pieces(text, ((LabelPart(text, spot, width, height),) for spot in spots))

    def place_pieces(
        self, text: str, ways: Iterable[tuple[LabelPart, ...]], on_line: bool = False
    ) -> PlacedLabel | None:
        """Put a text in the first way in which all its pieces are free; None where there is none."""
        for pieces in ways:
            if all(self.free(piece.box(self.gap)) for piece in pieces):
                self.take(pieces)
                return PlacedLabel(text, pieces, on_line)
        return None

    def take(self, pieces: Iterable[LabelPart]) -> None:
        """Keep off texts that stand where they stand."""
        for piece in pieces:
            self._take(piece.box())

    def _take(self, box: FloatArray) -> None:
        count = len(self._taken)
        if count == len(self._limits):
            self._limits = np.concatenate([self._limits, np.empty_like(self._limits)])
        self._limits[count] = *box.min(axis=0), *box.max(axis=0)
        self._taken.append(box)


def _inside(ring: FloatArray, x: float, y: float) -> bool:
    """Whether a point lies in a ring (N, 2): a ray to the right crosses the ring an odd number of times."""
    ahead = np.roll(ring, -1, axis=0)
    cut = (ring[:, 1] <= y) != (ahead[:, 1] <= y)
    a, b = ring[cut], ahead[cut]
    return bool((a[:, 0] + (y - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0]) > x).sum() % 2)


def around_point(x: float, y: float, width: float, height: float, radius: float) -> list[LabelPosition]:
    """Eight positions around a symbol of a radius (mm), best first."""
    across, up = width / 2 + radius, height / 2 + radius
    aside = 0.4 * radius + height / 4
    return [
        LabelPosition(x + across, y + aside),
        LabelPosition(x + across, y - aside),
        LabelPosition(x - across, y + aside),
        LabelPosition(x - across, y - aside),
        LabelPosition(x + across, y),
        LabelPosition(x, y + up),
        LabelPosition(x - across, y),
        LabelPosition(x, y - up),
    ]


def labels_that_fit(values: Sequence[float], widths: Sequence[float], gap: float) -> list[int]:
    """Indices of the labels along one side of the neatline that fit beside each other, from the first on."""
    kept: list[int] = []
    end = -math.inf
    for i in np.argsort(values, kind="stable"):
        if values[i] - widths[i] / 2 >= end + gap:
            kept.append(int(i))
            end = values[i] + widths[i] / 2
    return kept
