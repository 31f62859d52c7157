"""Drawn shares win, and the seams laid before fill what they leave."""

from __future__ import annotations

import pytest
import shapely
from shapely import box

from geomosaic.mosaicking.seams.cutlines import cover_everything, with_cutlines

SHARES = [box(0, 0, 10, 10), box(10, 0, 20, 10), box(20, 0, 30, 10)]


def areas(shares: list[shapely.Polygon]) -> list[float]:
    return [share.area for share in shares]


def test_a_drawn_share_takes_from_its_neighbours() -> None:
    shares = with_cutlines(SHARES, {0: box(0, 0, 13, 10)})
    assert areas(shares) == pytest.approx([130, 70, 100])
    assert shapely.union_all(shares).area == pytest.approx(300)


def test_what_is_given_away_goes_to_who_had_it_by_the_seams() -> None:
    shares = with_cutlines(SHARES, {0: box(0, 0, 7, 10)})
    assert areas(shares) == pytest.approx([100, 100, 100])  # no one else claims it
    shares = with_cutlines(SHARES, {0: box(0, 0, 7, 10), 1: box(7, 0, 20, 10)})
    assert areas(shares) == pytest.approx([70, 130, 100])


def test_of_two_claims_the_first_image_has_it() -> None:
    shares = with_cutlines(SHARES, {1: box(8, 0, 20, 10), 0: box(0, 0, 12, 10)})
    assert areas(shares) == pytest.approx([120, 80, 100])
    assert sum(areas(shares)) == pytest.approx(shapely.union_all(shares).area)


def test_nothing_drawn_changes_nothing() -> None:
    assert all(a.equals(b) for a, b in zip(with_cutlines(SHARES, {}), SHARES, strict=True))


def test_whether_everything_is_drawn() -> None:
    drawn = dict(enumerate(SHARES))
    assert cover_everything(drawn, SHARES)
    assert not cover_everything({0: SHARES[0], 1: SHARES[1]}, SHARES)
    assert not cover_everything({}, SHARES)
