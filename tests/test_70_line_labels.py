"""Texts along lines: where the letters stand, held against circles, and read back from a PDF."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

from geomosaic.sheets.label_placement import (
    MOST_LEAN,
    MOST_TURN,
    LabelPart,
    LabelPlacer,
    along_curve,
    along_line,
    cut_evenly,
    letters_of,
    upright,
)

LETTERS = list("La Garonne")
ADVANCES = [1.3, 1.4, 0.8, 1.9, 1.5, 1.0, 1.5, 1.5, 1.5, 1.5]
HEIGHT = 1.8


def circle(radius: float, first: float, last: float) -> NDArray[np.float64]:
    """An arc about the origin, from one direction in degrees to another."""
    t = np.radians(np.linspace(first, last, 400))
    return radius * np.column_stack([np.cos(t), np.sin(t)])


def text(pieces: tuple[LabelPart, ...]) -> str:
    return "".join(piece.text for piece in pieces)


def test_names_along_lines() -> None:
    """On the line, where it is straight, never upside down; nowhere on a line that is too short or too bent."""
    bent = np.array([(0, 0), (5, 0), (5, 5), (45, 25), (45, 60)], dtype=float)
    for path in (bent, bent[::-1]):
        spots = along_line(path, 15.0)
        assert spots[0].angle == pytest.approx(math.degrees(math.atan2(20, 40)), abs=0.01)
        assert shapely.LineString(path).distance(shapely.Point(spots[0].x, spots[0].y)) < 1e-9
        assert all(-90 < spot.angle <= 90 for spot in spots)
    assert along_line(bent[:2], 15.0) == []
    turns = np.radians(np.arange(0, 720, 20.0))
    assert along_line(np.column_stack([3 * np.cos(turns), 3 * np.sin(turns)]), 15.0) == []
    assert [upright(a) for a in (0, 90, 91, 180, -90, -45, 270)] == [0, 90, -89, 0, 90, -45, 90]


@pytest.mark.parametrize("radius", [15.0, 30.0, 80.0])
@pytest.mark.parametrize(("first", "last"), [(150.0, 30.0), (30.0, 150.0), (210.0, 330.0), (100.0, 240.0)])
def test_letters_stand_on_a_circle(radius: float, first: float, last: float) -> None:
    """Each on the arc, along its tangent, in reading order, as far from the next as their advances say."""
    arc = circle(radius, first, last)
    ways = along_curve(arc, LETTERS, ADVANCES, HEIGHT, ends=1.0)
    assert ways
    for pieces in ways:
        assert text(pieces) == "La Garonne"
        assert len(pieces) == len(LETTERS)
        xy = np.array([(p.spot.x, p.spot.y) for p in pieces])
        angles = np.array([p.spot.angle for p in pieces])
        assert np.hypot(*xy.T) == pytest.approx(radius, abs=0.07)
        radial = np.degrees(np.arctan2(xy[:, 1], xy[:, 0])) - 90.0 - angles
        assert np.abs((radial + 90.0) % 180.0 - 90.0).max() < 1.0
        between = np.hypot(*np.diff(xy, axis=0).T)
        assert between == pytest.approx((np.array(ADVANCES)[1:] + ADVANCES[:-1]) / 2, abs=0.05)
        chord = xy[-1] - xy[0]
        assert -90.0 - 1e-6 < math.degrees(math.atan2(chord[1], chord[0])) <= 90.0 + 1e-6  # read from left to right
        lean = (angles - math.degrees(math.atan2(chord[1], chord[0])) + 180.0) % 360.0 - 180.0
        assert np.abs(lean).max() < MOST_LEAN + 2.0
        assert np.abs(np.diff(angles)).max() < MOST_TURN
    middle = np.array([(p.spot.x, p.spot.y) for p in ways[0]]).mean(axis=0)
    wanted = math.radians((first + last) / 2)
    assert middle / np.hypot(*middle) == pytest.approx((math.cos(wanted), math.sin(wanted)), abs=0.15)


def test_straight_lines_have_whole_texts() -> None:
    """One piece, whatever the direction; also where the line only trembles less than a letter."""
    rng = np.random.default_rng(2)
    for angle in range(0, 360, 15):
        c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        path = np.outer(np.linspace(0.0, 40.0, 150), (c, s)) + rng.normal(0, 0.05, (150, 2))
        (piece,) = along_curve(path, LETTERS, ADVANCES, HEIGHT)[0]
        assert piece.text == "La Garonne"
        assert abs(upright(piece.spot.angle - angle)) < 4.0 or abs(upright(piece.spot.angle - angle)) > 176.0
        assert abs(c * piece.spot.y - s * piece.spot.x) < 0.1
        assert -90.0 < piece.spot.angle <= 90.0


def test_no_text_where_it_could_not_be_read() -> None:
    """Lines too short, circles too small, hairpins; the bends of a longer line are left for its straighter parts."""
    assert along_curve(np.array([(0.0, 0.0), (12.0, 0.0)]), LETTERS, ADVANCES, HEIGHT) == []
    assert along_curve(circle(4.0, 0, 359), LETTERS, ADVANCES, HEIGHT) == []
    assert along_curve(np.zeros((1, 2)), LETTERS, ADVANCES, HEIGHT) == []
    hairpins = np.array([(0.0, 0.0), (9.0, 0.3), (0.0, 0.6), (9.0, 0.9), (0.0, 1.2), (9.0, 1.5)])
    assert along_curve(hairpins, LETTERS, ADVANCES, HEIGHT) == []
    corner = np.array([(0.0, 0.0), (0.0, 30.0), (60.0, 30.0)])
    for pieces in along_curve(corner, LETTERS, ADVANCES, HEIGHT):
        on = shapely.LineString(corner)
        assert all(on.distance(shapely.Point(p.spot.x, p.spot.y)) <= 0.6 * HEIGHT for p in pieces)
    assert along_curve(corner, LETTERS, ADVANCES, HEIGHT)[0][0].text == "La Garonne"


def test_bent_texts_keep_off_what_is_there() -> None:
    """The box of no letter meets a symbol on the line; the first way that is free is taken, or none."""
    arc = circle(60.0, 160.0, 20.0)
    ways = along_curve(arc, LETTERS, ADVANCES, HEIGHT, ends=1.0)
    placer = LabelPlacer((-100.0, -100.0, 100.0, 100.0))
    placer.block(0.0, 60.0, 2.0)
    placed = placer.place_pieces("La Garonne", ways, on_line=True)
    assert placed is not None
    assert placed.on_line
    assert text(placed.pieces) == "La Garonne"
    symbol = shapely.box(-1.0, 59.0, 1.0, 61.0)
    assert all(shapely.Polygon(p.box()).distance(symbol) > 0.5 for p in placed.pieces)
    again = placer.place_pieces("La Garonne", ways)
    assert again is not None
    first, second = (shapely.union_all([shapely.Polygon(p.box()) for p in found.pieces]) for found in (placed, again))
    assert first.distance(second) > 0.5
    for x in range(-60, 61):
        placer.block(float(x), math.sqrt(3600.0 - x * x), 2.0)
    assert placer.place_pieces("La Garonne", ways) is None


def test_letters_keep_their_marks() -> None:
    """Combining marks stay with their letter; texts that run from right to left, or join letters, stay whole."""
    assert letters_of("Ge\u0301o") == ["G", "e\u0301", "o"]
    assert letters_of("La 2") == ["L", "a", " ", "2"]
    assert letters_of("\u0646\u0647\u0631") == ["\u0646\u0647\u0631"]
    # Devanagari has a line above its letters; Telugu has none, but ka, virama and ssa are one sign.
    assert letters_of("\u0939\u093f\u0928\u094d\u0926\u0940") == ["\u0939\u093f\u0928\u094d\u0926\u0940"]
    assert letters_of("\u0c05\u0c15\u0c4d\u0c37") == ["\u0c05", "\u0c15\u0c4d\u0c37"]
    assert letters_of("") == []


def test_lines_are_cut_evenly() -> None:
    """Pieces of one length, whatever their vertices; together the line."""
    path = np.array([(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (2.0, 0.0), (100.0, 0.0), (100.0, 50.0)])
    pieces = cut_evenly(path, 40.0)
    assert [shapely.LineString(p).length for p in pieces] == pytest.approx([50.0] * 3)
    assert shapely.union_all([shapely.LineString(p) for p in pieces]).equals(shapely.LineString(path))
    assert len(cut_evenly(path, 500.0)) == 1
