"""Edits of seams keep the coverage: no gap, no overlap, the same vertices on both sides of each border."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from geomosaic.errors import InputError
from geomosaic.mosaicking.seams.partition import canonical
from geomosaic.mosaicking.seams.seam_edits import beyond_outlines, cut, dragged, given, redrawn

STEP = 1e-6


def wavy(x: float, amplitude: float = 0.8) -> list[tuple[float, float]]:
    """A border from bottom to top with many vertices, as least-cost seams have them."""
    y = np.linspace(0.0, 60.0, 121)
    return list(zip(x + amplitude * np.sin(y), y, strict=True))


@pytest.fixture
def shares() -> list[shapely.Polygon]:
    """Three columns; the third is divided at half height, so that three shares meet on its left border."""
    first, second = wavy(30.0), wavy(60.0)
    second.insert(60, second[60])
    lower, upper = second[:61], second[61:]
    drawn = [
        shapely.Polygon([(0, 0), *first, (0, 60)]),
        shapely.Polygon([*first, *second[::-1]]),
        shapely.Polygon([*lower, (90, 30), (90, 0)]),
        shapely.Polygon([*upper, (90, 60), (90, 30)]),
    ]
    return [canonical(share, STEP) for share in drawn]


def covers(before: list[shapely.Polygon], after: list[shapely.Polygon]) -> bool:
    """Whether both cover the same ground once, with common vertices along all borders."""
    assert shapely.coverage_is_valid(np.array([share for share in after if not share.is_empty]))
    assert sum(share.area for share in after) == pytest.approx(shapely.union_all(before).area, rel=1e-10)
    return bool(shapely.symmetric_difference(shapely.union_all(before), shapely.union_all(after)).area < 1e-3)


def test_an_area_given_to_an_image_is_taken_from_all_others(shares: list[shapely.Polygon]) -> None:
    area = shapely.box(20, 20, 70, 40)
    after = given(shares, area, 0, STEP)
    assert covers(shares, after)
    np.testing.assert_allclose(
        [share.area for share in after],
        [share.difference(area).area if i else share.union(area).area for i, share in enumerate(shares)],
        rtol=1e-9,
    )
    far = given(shares, shapely.box(5, 5, 35, 10), 1, STEP)
    assert far[2] is shares[2]
    assert far[3] is shares[3]
    with pytest.raises(InputError, match="already"):
        given(shares, shapely.box(5, 5, 10, 10), 0, STEP)
    with pytest.raises(InputError, match="crosses itself"):
        given(shares, shapely.Polygon([(20, 20), (40, 40), (40, 20), (20, 40)]), 0, STEP)


def test_an_image_may_lose_all_its_ground_or_show_an_island(shares: list[shapely.Polygon]) -> None:
    all_of_it = given(shares, shapely.box(59, -1, 91, 31), 1, STEP)
    assert all_of_it[2].area < 1e-3
    island = given(shares, shapely.box(5, 5, 10, 10), 3, STEP)
    assert covers(shares, island)
    assert island[3].geom_type == "MultiPolygon"
    assert len(island[0].interiors) == 1


def test_a_seam_follows_a_line_drawn_across_it(shares: list[shapely.Polygon]) -> None:
    line = shapely.LineString([(28, 10), (36, 14), (36, 20), (24, 26), (24, 32), (33, 40)])
    after = redrawn(shares, line, STEP)
    assert covers(shares, after)
    border = shapely.intersection(after[0].boundary, after[1].boundary)
    crossings = shapely.intersection(line, shapely.LineString(wavy(30.0)))
    first, last = (line.project(point) for point in (crossings.geoms[0], crossings.geoms[-1]))
    for along in np.linspace(min(first, last) + 0.01, max(first, last) - 0.01, 50):
        assert border.distance(line.interpolate(along)) < 1e-3
    assert [share is old for share, old in zip(after, shares, strict=True)] == [False, False, True, True]
    with pytest.raises(InputError, match="encloses nothing"):
        redrawn(shares, shapely.LineString([(10, 10), (20, 20)]), STEP)
    with pytest.raises(InputError, match="encloses nothing"):
        redrawn(shares, shapely.LineString([(10, 10), (50, 20)]), STEP)


def test_a_line_cuts_a_share_in_pieces(shares: list[shapely.Polygon]) -> None:
    pieces = cut(shares, shapely.LineString([(-1, 20), (45, 25)]), STEP)
    assert [image for image, _ in pieces] == [0, 0]
    assert sum(piece.area for _, piece in pieces) == pytest.approx(shares[0].area)
    assert pieces[0][1].area < pieces[1][1].area
    with pytest.raises(InputError, match="divides"):
        cut(shares, shapely.LineString([(35, 20), (45, 25)]), STEP)


def test_dragging_moves_the_border_for_both_images(shares: list[shapely.Polygon]) -> None:
    after = dragged(shares, np.array([30.0, 12.0]), np.array([38.0, 13.0]), 4.0, STEP)
    assert covers(shares, after)
    assert shapely.Point(38.0, 13.0).distance(after[0].boundary) < 2 * STEP
    assert after[2] is shares[2]
    changed = shapely.symmetric_difference(after[0], shares[0])
    assert changed.bounds[1] > 6.0
    assert changed.bounds[3] < 19.0
    with pytest.raises(InputError, match="no seam"):
        dragged(shares, np.array([45.0, 45.0]), np.array([50.0, 45.0]), 4.0, STEP)


def test_dragging_moves_a_straight_seam_within_reach_only() -> None:
    shares = [shapely.box(0, 0, 1000, 50), shapely.box(0, 50, 1000, 100)]
    after = dragged(shares, np.array([333.3, 50.2]), np.array([340.1, 30.7]), 40.0, STEP)
    assert covers(shares, after)
    assert after[0].symmetric_difference(shares[0]).area == pytest.approx(80 * 19.3 / 2, rel=1e-6)
    assert after[1].area == pytest.approx(50_000 + 80 * 19.3 / 2)


def test_a_junction_is_dragged_with_all_seams_that_meet_there(shares: list[shapely.Polygon]) -> None:
    junction = np.array([60.0 + 0.8 * np.sin(30.0), 30.0])
    after = dragged(shares, junction + 0.1, np.array([52.0, 33.0]), 5.0, STEP)
    assert covers(shares, after)
    for image in (1, 2, 3):
        assert shapely.Point(52.0, 33.0).distance(after[image].boundary) < 2 * STEP
    assert after[0] is shares[0]


def test_a_seam_dragged_near_a_junction_takes_the_ground_of_a_third_image(shares: list[shapely.Polygon]) -> None:
    place, to = np.array([60.0, 25.0]), np.array([70.0, 36.0])
    after = dragged(shares, place, to, 4.0, STEP)
    assert covers(shares, after)
    gained = [after[image].difference(shares[image]).area for image in range(4)]
    lost = [shares[image].difference(after[image]).area for image in range(4)]
    assert lost[2] > 20.0
    assert lost[3] > 5.0
    assert gained[1] == pytest.approx(lost[2] + lost[3], abs=0.5)  # but for the waves beyond the straight line
    assert gained[0] == gained[3] == 0.0
    old = shapely.intersection(shares[1].boundary, shares[2].boundary)
    swept = shapely.union_all([old, shapely.Point(to)]).convex_hull.buffer(1e-3)
    for one, other in zip(shares, after, strict=True):
        assert shapely.symmetric_difference(one, other).difference(swept).area < 1e-3
    back = dragged(shares, place, np.array([20.0, 26.0]), 4.0, STEP)  # over the whole of image 1, and into image 0
    assert covers(shares, back)
    assert back[2].covers(shapely.Point(21.0, 26.0))
    assert back[0].area < shares[0].area
    island = given(shares, shapely.box(62.6, 28.0, 63.2, 28.8), 0, STEP)  # neither line touches it
    assert dragged(island, place, to, 4.0, STEP)[0].area == pytest.approx(shares[0].area, abs=1e-3)


@pytest.mark.parametrize(
    ("line", "image", "area"),
    [
        # From a seam of image 1 round the junction to its other one: it goes round the corners of both others.
        ([(60, 22), (70, 22), (70, 38), (60, 38)], 1, [(60, 22), (70, 22), (70, 38), (60, 38)]),
        # Across the corner of image 2: it goes to image 1, at whose seam the line begins, or to image 3.
        ([(60, 20), (72, 30)], 1, [(60, 20), (72, 30), (60, 30)]),
        ([(72, 30), (60, 20)], 3, [(60, 20), (72, 30), (60, 30)]),
    ],
)
def test_a_line_between_two_seams_gives_what_it_cuts_off_to_the_image_where_it_begins(
    line: list[tuple[float, float]], image: int, area: list[tuple[float, float]]
) -> None:
    whole = shapely.box(0, 0, 60, 60), shapely.box(60, 0, 90, 30), shapely.box(60, 30, 90, 60)
    shares = [shapely.Polygon(), *(canonical(share, STEP) for share in whole)]
    after = redrawn(shares, shapely.LineString(line), STEP)
    assert covers(shares, after)
    cut_off = shapely.Polygon(area)
    for number, (before, share) in enumerate(zip(shares, after, strict=True)):
        expected = before.union(cut_off) if number == image else before.difference(cut_off)
        assert shapely.symmetric_difference(share, expected).area < 1e-3


def test_a_line_between_seams_that_no_further_seam_joins_is_refused(shares: list[shapely.Polygon]) -> None:
    above = [shapely.box(30 * i, 0, 30 * i + 30, 40) for i in range(3)] + [shapely.box(0, 40, 90, 60)]
    after = redrawn(above, shapely.LineString([(30, 20), (60, 20)]), STEP)  # joined by the seam above
    assert [share.area for share in after] == pytest.approx([1800, 600, 1200, 1800])
    with pytest.raises(InputError, match="encloses nothing"):
        redrawn(shares, shapely.LineString([(30, 10), (60, 10)]), STEP)


def test_a_line_between_two_seams_leaves_no_slivers_where_it_crosses_them_often(shares: list[shapely.Polygon]) -> None:
    line = shapely.LineString([(60, 20), (67, 20), (67, 40), (60.2, 40), (60.2, 46)])  # ends along a wavy seam
    after = redrawn(shares, line, STEP)
    assert covers(shares, after)
    assert all(share.geom_type == "Polygon" for share in after)
    assert after[1].covers(shapely.box(61, 21, 66, 39))
    assert after[2].disjoint(shapely.box(0, 30.1, 90, 60))  # what it cuts off image 1 goes to image 3 across it


@pytest.mark.parametrize("seed", range(3))
def test_any_sequence_of_edits_keeps_the_coverage(shares: list[shapely.Polygon], seed: int) -> None:
    chance, now = np.random.default_rng(seed), shares
    for _ in range(12):
        x, y = chance.uniform((5, 5), (85, 55))
        act = chance.integers(3)
        try:
            if act == 0:
                place = shapely.Point(x, y).buffer(chance.uniform(1, 12), quad_segs=3)
                now = given(now, place.intersection(shapely.box(0, 0, 90, 60)), int(chance.integers(4)), STEP)
            elif act == 1:
                now = redrawn(now, shapely.LineString(chance.uniform((0, 0), (90, 60), (5, 2))), STEP)
            else:
                now = dragged(now, np.array([x, y]), np.array([x, y]) + chance.uniform(-6, 6, 2), 6.0, STEP)
        except InputError:
            continue
        assert covers(shares, now)


def test_ground_that_an_image_does_not_show_is_found(shares: list[shapely.Polygon]) -> None:
    outlines = [share.buffer(5.0) for share in shares]
    after = given(shares, shapely.box(20, 20, 40, 40), 0, STEP)
    lost = beyond_outlines(shares, after, outlines)
    assert list(lost) == [0]
    assert lost[0].bounds[0] > 34.0
    assert beyond_outlines(shares, given(shares, shapely.box(28, 20, 33, 40), 0, STEP), outlines) == {}
