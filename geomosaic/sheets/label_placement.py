"""Label placement: boxes that do not overlap, in the order of their weight, and positions along lines.

Point labels try the eight places around a symbol in the order of E. Imhof (Positioning names on maps, The American
Cartographer 2, 1975): upper right first, below last. Lengths are millimetres on the page.
"""

from __future__ import annotations

import itertools
import math
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import shapely

from geomosaic.types import FloatArray


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
    """Corners (4, 2) of a text's box, counter-clockwise.

    Parameters
    ----------
    spot : LabelPosition
    width, height : float, mm
    """
    c, s = math.cos(math.radians(spot.angle)), math.sin(math.radians(spot.angle))
    box = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (width / 2, height / 2)
    turned: FloatArray = box @ np.array([[c, s], [-s, c]]) + (spot.x, spot.y)
    return turned


def overlap(first: FloatArray, second: FloatArray) -> bool:
    """Whether two convex quadrangles (4, 2) have area in common: no side of either separates them.

    Parameters
    ----------
    first, second : array (4, 2), corners in order, mm
    """
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
    frame : tuple, left, bottom, right, top in mm: no text reaches beyond
    gap : float, least distance between texts, mm
    outline : shapely Polygon, optional, within the frame, in mm: no text leaves it either
    """

    frame: tuple[float, float, float, float]
    gap: float = 0.6
    outline: Any = None
    _taken: list[FloatArray] = field(default_factory=list)
    # The array grows with the texts: asking numpy once for all boxes is what makes thousands of names bearable.
    _limits: FloatArray = field(default_factory=lambda: np.empty((256, 4)))  # of those taken, then room for more

    def block(self, x: float, y: float, size: float) -> None:
        """Keep a square around a symbol free.

        Parameters
        ----------
        x, y : float
            Millimetres on the page.
        size : float
            Millimetres.
        """
        self._take(corners(LabelPosition(x, y), size, size))

    def reserve(self, box: tuple[float, float, float, float]) -> None:
        """Keep a rectangle free.

        Parameters
        ----------
        box : tuple of float
            Left, bottom, right, top in millimetres on the page.
        """
        left, bottom, right, top = box
        self._take(corners(LabelPosition((left + right) / 2, (bottom + top) / 2), right - left, top - bottom))

    def inside(self, x: float, y: float) -> bool:
        """Whether a point lies in the frame and the outline."""
        left, bottom, right, top = self.frame
        within = left <= x <= right and bottom <= y <= top
        return within and (self.outline is None or bool(shapely.contains_xy(self.outline, x, y)))

    def free(self, box: FloatArray) -> bool:
        """Whether a box lies inside the frame and touches no other."""
        left, bottom, right, top = self.frame
        low, high = box.min(axis=0), box.max(axis=0)
        if low[0] < left or low[1] < bottom or high[0] > right or high[1] > top:
            return False
        if self.outline is not None and not shapely.contains_xy(self.outline, box).all():
            return False
        if not self._taken:
            return True
        # Bounding boxes first: the exact test is for the few that are near.
        limits = self._limits[: len(self._taken)]
        near = (limits[:, :2] < high).all(axis=1) & (limits[:, 2:] > low).all(axis=1)
        return not any(overlap(box, self._taken[i]) for i in np.flatnonzero(near))

    def place(self, text: str, width: float, height: float, spots: Iterable[LabelPosition]) -> PlacedLabel | None:
        """Put a straight text at the first free spot; None where there is none.

        Parameters
        ----------
        text : str
        width, height : float
            Millimetres.
        spots : sequence of LabelPosition
            In order of preference.
        """
        return self.place_pieces(text, ((LabelPart(text, spot, width, height),) for spot in spots))

    def place_pieces(
        self, text: str, ways: Iterable[tuple[LabelPart, ...]], on_line: bool = False
    ) -> PlacedLabel | None:
        """Put a text in the first way in which all its pieces are free; None where there is none.

        Parameters
        ----------
        text : str
        ways : sequence of tuple of LabelPart
            In order of preference.
        on_line : bool
        """
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
        if count == len(self._limits):  # doubled, so that the boxes are copied seldom
            self._limits = np.concatenate([self._limits, np.empty_like(self._limits)])
        self._limits[count] = *box.min(axis=0), *box.max(axis=0)
        self._taken.append(box)


def around_point(x: float, y: float, width: float, height: float, radius: float) -> list[LabelPosition]:
    """Eight positions around a symbol of a radius (mm), best first.

    Parameters
    ----------
    x, y : float, of the symbol, mm
    width, height : float, of the text, mm
    radius : float, mm
    """
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
    """Indices of the labels along one side of the neatline that fit beside each other, from the first on.

    Parameters
    ----------
    values : sequence of float, middles of the labels along the side, mm
    widths : sequence of float, mm
    gap : float, least distance between labels, mm
    """
    kept: list[int] = []
    end = -math.inf
    for i in np.argsort(values, kind="stable"):
        if values[i] - widths[i] / 2 >= end + gap:
            kept.append(int(i))
            end = values[i] + widths[i] / 2
    return kept


# Angle in degrees: a text whose letters all deviate less from its direction is set straight.
STRAIGHT = 4.0
# Largest deviation of a letter from the text's direction, degrees: beyond, a word falls apart.
MOST_LEAN = 45.0
# Largest angle between neighbouring letters, degrees: beyond, their feet or heads would touch.
MOST_TURN = 20.0


def along_line(path: FloatArray, width: float, *, bend: float = 20.0, ends: float = 0.0) -> list[LabelPosition]:
    """Positions of a straight text on a line, best first: near the middle, where the line is straight.

    Parameters
    ----------
    path : array (N, 2), in mm on the page
    width : float, of the text
    bend : float, largest turn of the line under the text, degrees
    ends : float, distance from the line's ends

    Returns
    -------
    list of Spot, never upside down; the angles are from -90 (not included) to 90
    """
    path, at = _measured(path)
    middles = _middles(at[-1], width + 2 * ends)
    found: list[tuple[float, int, LabelPosition]] = []
    for rank, middle in enumerate(middles):
        t = np.linspace(middle - width / 2, middle + width / 2, 7)
        points = _points(path, at, t)
        chord = points[-1] - points[0]
        turns = np.degrees(np.arctan2(*np.diff(points, axis=0).T[::-1])) - math.degrees(math.atan2(chord[1], chord[0]))
        worst = float(np.abs(_wrapped(turns)).max())
        if worst > bend:
            continue
        angle = upright(math.degrees(math.atan2(chord[1], chord[0])))
        x, y = points.mean(axis=0)
        # Classes of 5 degrees: of places about as straight the one nearest to the middle comes first.
        found.append((round(worst / 5.0), rank, LabelPosition(float(x), float(y), angle)))
    return [spot for _, _, spot in sorted(found, key=lambda item: item[:2])]


def along_curve(
    path: FloatArray, letters: Sequence[str], advances: Sequence[float], height: float, *, ends: float = 0.0
) -> list[tuple[LabelPart, ...]]:
    """Positions of a text that follows a line, best first: near the middle, where curvature is small.

    Parameters
    ----------
    path : array (N, 2), in mm on the page
    letters : sequence of str, of the text, in their order; blanks too
    advances : sequence of float, how far each letter takes the pen, mm
    height : float, of capitals, mm
    ends : float, distance from the line's ends

    Returns
    -------
    list of tuple of Piece, one piece per letter, or a single one where the line is straight
    """
    steps = np.asarray(advances, dtype=np.float64)
    width = float(steps.sum())
    # Each letter stands upright on the line as it runs when what is smaller than a letter is smoothed away, within 0.6
    # of the height of the text of the line itself.
    line, at, shift = _smooth(path, height)
    middles = _middles(at[-1], width + 2 * ends)
    if not len(middles):
        return []
    chords = _points(line, at, middles + width / 2) - _points(line, at, middles - width / 2)
    course = _degrees(chords)
    way = np.array([upright(angle) for angle in course.tolist()])
    ahead = np.where(np.abs(_wrapped(course - way)) < 90.0, 1.0, -1.0)  # -1: against the line
    centres = middles[:, None] + ahead[:, None] * (np.cumsum(steps) - steps / 2 - width / 2)
    half = np.maximum(steps, height) / 2
    feet = ahead[:, None, None] * (_points(line, at, centres + half) - _points(line, at, centres - half))
    lean = _wrapped(_degrees(feet) - way[:, None])
    worst = np.abs(lean).max(axis=1)
    turn = np.abs(np.diff(lean, axis=1)).max(axis=1, initial=0.0)
    off = np.interp(centres, at, shift).max(axis=1)
    fits = (worst <= MOST_LEAN) & (turn <= MOST_TURN) & (off <= 0.6 * height)
    # Classes of 10 degrees: of places about as straight the one nearest to the middle comes first.
    order = np.lexsort((np.arange(len(middles)), np.round(worst / 10.0)))
    spots = _points(line, at, centres)
    found: list[tuple[LabelPart, ...]] = []
    for k in order[fits[order]].tolist():
        if worst[k] <= STRAIGHT:
            x, y = _points(line, at, middles[k])
            found.append(
                (LabelPart("".join(letters), LabelPosition(float(x), float(y), float(way[k])), width, height),)
            )
            continue
        angles = (way[k] + lean[k]).tolist()
        found.append(
            tuple(
                LabelPart(letter, LabelPosition(x, y, angle), step, height)
                for letter, (x, y), angle, step in zip(letters, spots[k].tolist(), angles, steps.tolist(), strict=True)
            )
        )
    return found


def cut_evenly(path: FloatArray, most: float) -> list[FloatArray]:
    """Pieces of equal length of a line (N, 2): as many as lengths `most` fit in it, at least one.

    Parameters
    ----------
    path : array (N, 2), mm
    most : float, mm
    """
    path, at = _measured(path)
    cuts = np.linspace(0.0, at[-1], max(1, int(at[-1] / most)) + 1)
    found = []
    for first, last in itertools.pairwise(cuts):
        inner = (at > first) & (at < last)
        ends = _points(path, at, np.array([first, last]))
        found.append(np.vstack([ends[:1], path[inner], ends[1:]]))
    return found


# Scripts whose letters are joined by strokes or by a line above them, by the beginning of their characters' names.
_JOINED = ("DEVANAGARI", "BENGALI", "GURMUKHI", "TIBETAN", "MONGOLIAN", "PHAGS-PA", "SYLOTI", "MODI", "SHARADA")
# Combining class of a sign that joins the consonants at its sides to one (Unicode, virama).
_VIRAMA = 9


def letters_of(text: str) -> list[str]:
    """Letters of a text, each with its marks; the text whole where its letters are joined or run from right to left.

    Parameters
    ----------
    text : str
    """
    joined = any(unicodedata.name(c, "").startswith(_JOINED) for c in text)
    if joined or any(unicodedata.bidirectional(c) in ("R", "AL") for c in text):
        return [text]
    found: list[str] = []
    for c in text:
        mark = unicodedata.category(c).startswith("M") or c == "\u200d"
        if found and (mark or found[-1].endswith("\u200d") or unicodedata.combining(found[-1][-1]) == _VIRAMA):
            found[-1] += c
        else:
            found.append(c)
    return found


def upright(angle: float) -> float:
    """Direction in which text along a line can be read: above -90 up to 90 degrees.

    Parameters
    ----------
    angle : float, degrees, counter-clockwise
    """
    turned = (angle + 180.0) % 360.0 - 180.0
    return turned - 180.0 if turned > 90.0 else turned + 180.0 if turned <= -90.0 else turned


def _middles(length: float, need: float) -> FloatArray:
    """Distances of text centres along a line, from its middle outwards; none where the line is too short."""
    if length < need:
        return np.empty(0)
    # Every 2 mm, about the width of a letter; on longer lines 41 places are as good as all, and much faster.
    middles = np.linspace(need / 2, length - need / 2, max(1, min(41, int((length - need) / 2.0) + 1)))
    return middles[np.argsort(np.abs(middles - length / 2), kind="stable")]


def _measured(path: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Line without repeated points, and the distance of each point from the first along it."""
    steps = np.hypot(*np.diff(path, axis=0).T)
    kept = path[np.concatenate([[True], steps > 1e-9])]
    return kept, np.concatenate([[0.0], np.cumsum(steps[steps > 1e-9])])


def _points(path: FloatArray, at: FloatArray, t: FloatArray) -> FloatArray:
    """Points (..., 2) of a line at distances from its first point."""
    return np.stack([np.interp(t, at, path[:, 0]), np.interp(t, at, path[:, 1])], axis=-1)


def _smooth(path: FloatArray, scale: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Line smoothed at a scale, distances from its first point, and the displacement of each point."""
    path, at = _measured(path)
    step = scale / 4
    count = int(at[-1] / step) + 2
    # A Gaussian mean along the line of standard deviation 0.75 `scale`; reflection at the ends keeps them in place.
    even = _points(path, at, np.linspace(0.0, at[-1], count))
    reach = min(9, count - 1)  # three standard deviations
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / 3.0) ** 2)
    before, after = 2 * even[0] - even[reach:0:-1], 2 * even[-1] - even[-2 : -2 - reach : -1]
    padded = np.concatenate([before, even, after])
    smooth = np.column_stack([np.convolve(padded[:, k], weights / weights.sum(), mode="valid") for k in (0, 1)])
    moved = np.hypot(*(smooth - even).T)
    lengths = np.hypot(*np.diff(smooth, axis=0).T)
    return smooth, np.concatenate([[0.0], np.cumsum(lengths)]), moved


def _degrees(ways: FloatArray) -> FloatArray:
    angles: FloatArray = np.degrees(np.arctan2(ways[..., 1], ways[..., 0]))
    return angles


def _wrapped(angles: FloatArray) -> FloatArray:
    """Differences of directions, from -180 to 180 degrees."""
    wrapped: FloatArray = (angles + 180.0) % 360.0 - 180.0
    return wrapped
