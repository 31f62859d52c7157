"""Shares divide the footprints exactly: nothing twice, nothing left over, no slivers, buildings whole."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from shapely import box
from shapely.affinity import rotate

from geomosaic.mosaicking.seams.partition import partition, undivided, without_slivers
from geomosaic.mosaicking.seams.voronoi import farthest_inside, inner_edges, voronoi_regions

A, B = box(0, 0, 60, 40), box(40, 0, 100, 40)


def judge(shares: list[shapely.Geometry], outlines: list[shapely.Geometry]) -> None:
    everything = shapely.union_all(outlines)
    assert all(share.is_valid for share in shares)
    assert sum(share.area for share in shares) == pytest.approx(everything.area, rel=1e-9)
    assert shapely.union_all(shares).area == pytest.approx(everything.area, rel=1e-9)
    for share, outline in zip(shares, outlines, strict=True):
        assert share.difference(outline).area < 1e-9 * outline.area


def test_what_rough_shares_leave_and_claim_beyond_is_put_right():
    rng = np.random.default_rng(5)
    outlines = [
        rotate(box(x, y, x + 60, y + 50), float(rng.uniform(-8, 8))) for y in (0, 30, 60) for x in (0, 22, 44, 66)
    ]
    centres = [(outline.centroid.x, outline.centroid.y) for outline in outlines]
    rest = voronoi_regions(outlines, centres)
    cells = [share.buffer(1.5).difference(shapely.union_all(rest[:i])).buffer(-0.7) for i, share in enumerate(rest)]
    taken, rough = shapely.Polygon(), []
    for share in cells:  # of own area, but with gaps and parts beyond the footprints
        rough.append(share.difference(taken))
        taken = taken.union(share)
    judge(partition(rough, outlines, rest, 1.0, 5.0), outlines)


def test_slivers_and_small_parts_go_to_who_shows_them():
    sliver, small, lone = box(20, 0, 20.1, 40), box(70, 10, 72, 12), box(120, 0, 121, 1)
    beyond = box(30, 5, 31, 6)  # image B is the only other one near, and does not show it
    outlines = [A, B, shapely.union(lone, box(90, 0, 100, 40))]
    shares = [box(0, 0, 50, 40).difference(sliver), shapely.union_all([box(50, 0, 90, 40), sliver]), outlines[2]]
    shares = [shares[0], shares[1].difference(small), shapely.union(shares[2], small)]
    found = without_slivers(shares, outlines, 1.0, 5.0)
    assert found[0].equals(box(0, 0, 50, 40))
    assert found[1].equals(box(50, 0, 90, 40))
    assert found[2].equals(outlines[2])  # what no neighbour shows stays
    alone = without_slivers([A.difference(beyond), beyond], [A.difference(beyond), B], 1.0, 5.0)
    assert alone[1].equals(beyond)


def test_a_building_stays_whole_where_one_image_shows_it_all():
    shares = [box(0, 0, 50, 40), box(50, 0, 100, 40)]
    found = undivided(shares, [A, B], [box(46, 10, 52, 20), box(35, 30, 65, 38)])
    assert found[0].covers(box(46, 10, 52, 20))
    # The second is shown whole by neither: it stays as the seam divides it.
    assert found[0].intersection(box(35, 30, 65, 38)).area == pytest.approx(15 * 8)
    assert sum(share.area for share in found) == pytest.approx(4000)
    assert shapely.union_all(found).area == pytest.approx(4000)


def test_an_overlap_is_halved():
    outlines = [A, B, box(40, 100, 100, 140)]
    edges = inner_edges(outlines)
    assert edges[0].length == pytest.approx(40, rel=1e-4)
    assert edges[2].is_empty
    places = np.array([[49.5, 5.0], [50.5, 35.0], [10.0, 10.0], [90.0, 10.0], [70.0, 120.0], [10.0, 120.0]])
    covers = np.array([[o.covers(shapely.Point(p)) for p in places] for o in outlines])
    assert farthest_inside(edges, places, covers).tolist() == [0, 1, 0, 1, 2, -1]


def test_of_two_footprints_turned_against_each_other_each_has_half_of_the_overlap():
    outlines = [box(0, 0, 60, 40), box(30, 20, 90, 60)]  # corner to corner
    common = outlines[0].intersection(outlines[1])
    rng = np.random.default_rng(6)
    places = rng.uniform((30, 20), (60, 40), (4000, 2))
    chosen = farthest_inside(inner_edges(outlines), places, np.ones((2, len(places)), dtype=bool))
    assert common.area == pytest.approx(600)
    assert (chosen == 0).mean() == pytest.approx(0.5, abs=0.03)
