"""Label positions along lines, straight or letter by letter along a curve."""

from __future__ import annotations

import itertools
import math
import unicodedata
from collections.abc import Sequence

import numpy as np

from geomosaic.sheets.label_placement import LabelPart, LabelPosition
from geomosaic.types import FloatArray

STRAIGHT = 4.0
"""Angle in degrees: a text whose letters all deviate less from its direction is set straight."""
MOST_LEAN = 45.0
"""Largest deviation of a letter from the text's direction, degrees: beyond, a word falls apart."""
MOST_TURN = 20.0
"""Largest angle between neighbouring letters, degrees: beyond, their feet or heads would touch."""


def along_line(
    path: FloatArray, width: float, *, bend: float = 20.0, offset: float = 0.0, ends: float = 0.0
) -> list[LabelPosition]:
    """Positions of a straight text on a line, best first: near the middle, where the line is straight.

    Parameters
    ----------
    path : array (N, 2)
        In mm on the page.
    width : float
        Of the text.
    bend : float
        Largest turn of the line under the text, degrees.
    offset : float
        Distance of the text's middle from the line; upwards on the page where positive, on it where 0.
    ends : float
        Distance from the line's ends.

    Returns
    -------
    list of Spot
        Never upside down; the angles are from -90 (not included) to 90.
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
        up = math.radians(angle + 90.0)
        spot = LabelPosition(float(x) + offset * math.cos(up), float(y) + offset * math.sin(up), angle)
        found.append((round(worst / 5.0), rank, spot))
    return [spot for _, _, spot in sorted(found, key=lambda item: item[:2])]


def along_curve(
    path: FloatArray, letters: Sequence[str], advances: Sequence[float], height: float, *, ends: float = 0.0
) -> list[tuple[LabelPart, ...]]:
    """Positions of a text that follows a line, best first: near the middle, where curvature is small.

    Each letter stands upright on the line as it runs when what is smaller than a letter is smoothed away, within 0.6
    of the text's height of the line itself.

    Parameters
    ----------
    path : array (N, 2)
        In mm on the page.
    letters : sequence of str
        Of the text, in their order; blanks too.
    advances : sequence of float
        How far each letter takes the pen, mm.
    height : float
        Of capitals, mm.
    ends : float
        Distance from the line's ends.

    Returns
    -------
    list of tuple of Piece
        One piece per letter, or a single one where the line is straight.
    """
    steps = np.asarray(advances, dtype=np.float64)
    width = float(steps.sum())
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
    """Pieces of equal length of a line (N, 2): as many as lengths `most` fit in it, at least one."""
    path, at = _measured(path)
    cuts = np.linspace(0.0, at[-1], max(1, int(at[-1] / most)) + 1)
    found = []
    for first, last in itertools.pairwise(cuts):
        inner = (at > first) & (at < last)
        ends = _points(path, at, np.array([first, last]))
        found.append(np.vstack([ends[:1], path[inner], ends[1:]]))
    return found


def letters_of(text: str) -> list[str]:
    """Letters of a text, each with its marks; the text whole where its script runs from right to left."""
    if any(unicodedata.bidirectional(c) in ("R", "AL") for c in text):
        return [text]
    found: list[str] = []
    for c in text:
        if found and (unicodedata.category(c).startswith("M") or c == "\u200d" or found[-1].endswith("\u200d")):
            found[-1] += c
        else:
            found.append(c)
    return found


def upright(angle: float) -> float:
    """Direction in which text along a line can be read: above -90 up to 90 degrees."""
    turned = (angle + 180.0) % 360.0 - 180.0
    return turned - 180.0 if turned > 90.0 else turned + 180.0 if turned <= -90.0 else turned


def _middles(length: float, need: float) -> FloatArray:
    """Distances of text centres along a line, from its middle outwards; none where the line is too short."""
    if length < need:
        return np.empty(0)
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
    """Line smoothed at a scale, distances from its first point, and the displacement of each point.

    A Gaussian mean along the line of standard deviation 0.75 `scale`; the ends stay.
    """
    path, at = _measured(path)
    step = scale / 4
    count = int(at[-1] / step) + 2
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
