"""Seams and feathers: every place has its image, and weights sum up."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from helpers import examples
from hypothesis import given
from hypothesis import strategies as st

from geomosaic.mosaicking.blending.weights import halo, image_weight, reduction, signed_distance
from geomosaic.mosaicking.seams.voronoi import voronoi_regions

CORNER = np.array([4e5, 5.5e6])


def block(seed: int, number: int) -> tuple[list[shapely.Polygon], list[tuple[float, float]]]:
    """Turned rectangles about random centres; the centre seen best lies off their middle, sometimes outside."""
    rng = np.random.default_rng(seed)
    outlines, centres = [], []
    for _ in range(number):
        x, y = rng.uniform(0, 1000, 2) + CORNER
        box = shapely.box(x - rng.uniform(150, 400), y - rng.uniform(150, 400), x + 300, y + 250)
        outlines.append(shapely.affinity.rotate(box, rng.uniform(0, 90)))
        centres.append((float(x + rng.normal(0, 120)), float(y + rng.normal(0, 120))))
    return outlines, centres


@examples(25)
@given(seed=st.integers(0, 10**6), number=st.integers(2, 9))
def test_regions_partition_the_union(seed: int, number: int) -> None:
    outlines, centres = block(seed, number)
    shares = voronoi_regions(outlines, centres)
    union = shapely.union_all(outlines)
    total = sum(share.area for share in shares)
    assert total == pytest.approx(union.area, rel=1e-9)
    assert union.difference(shapely.union_all(shares)).area < 1e-9 * union.area
    for i, share in enumerate(shares):
        assert share.difference(outlines[i]).area < 1e-9 * union.area
        for other in shares[:i]:
            assert share.intersection(other).area < 1e-9 * union.area


def test_each_place_goes_to_the_nearest_centre_that_shows_it() -> None:
    outlines, centres = block(11, 6)
    shares = voronoi_regions(outlines, centres)
    rng = np.random.default_rng(1)
    places = rng.uniform(-300, 1300, (4000, 2)) + CORNER
    distance = np.hypot(*(places[:, None] - np.array(centres)).transpose(2, 0, 1))
    seen = np.column_stack([shapely.contains_xy(outline, places) for outline in outlines])
    nearest = np.where(seen.any(axis=1), np.where(seen, distance, np.inf).argmin(axis=1), -1)
    given = np.column_stack([shapely.contains_xy(share, places) for share in shares])
    assert (given.sum(axis=1) == seen.any(axis=1)).all()
    assert (given.argmax(axis=1)[seen.any(axis=1)] == nearest[nearest >= 0]).all()
    assert 1000 < seen.any(axis=1).sum() < 4000


def test_equal_centres_go_to_the_first() -> None:
    outlines = [shapely.box(0, 0, 10, 10), shapely.box(5, 0, 15, 10), shapely.box(5, 0, 15, 10)]
    shares = voronoi_regions(outlines, [(5.0, 5.0)] * 3)
    assert [share.area for share in shares] == [100.0, 50.0, 0.0]
    assert shares[2].is_empty


def test_images_that_do_not_meet_keep_everything() -> None:
    outlines = [shapely.box(0, 0, 1, 1), shapely.box(5, 5, 6, 6)]
    shares = voronoi_regions(outlines, [(0.5, 0.5), (5.5, 5.5)])
    assert [share.area for share in shares] == [1.0, 1.0]
    assert voronoi_regions(outlines[:1], [(9.0, 9.0)])[0].equals(outlines[0])


def test_the_signed_distance_counts_from_the_edge_between_cells() -> None:
    mask = np.zeros((5, 9), dtype=bool)
    mask[:, 4:] = True
    # The edge lies between the cells: half a cell from both centres.
    assert signed_distance(mask, 9.0)[2].tolist() == [-3.5, -2.5, -1.5, -0.5, 0.5, 1.5, 2.5, 3.5, 4.5]
    assert np.isposinf(signed_distance(np.ones((2, 2), dtype=bool), 9.0)).all()
    assert np.isneginf(signed_distance(np.zeros((2, 2), dtype=bool), 9.0)).all()


@pytest.mark.parametrize("reach", [1.0, 5.0, 16.0, 60.0])
@pytest.mark.parametrize("share", [0.002, 0.5, 0.999])
def test_distances_are_exact_as_far_as_is_asked(reach: float, share: float) -> None:
    from scipy.ndimage import distance_transform_edt

    mask = np.random.default_rng(7).random((90, 130)) < share
    exact = np.where(mask, distance_transform_edt(mask) - 0.5, 0.5 - distance_transform_edt(~mask))
    found = signed_distance(mask, reach)
    near = np.abs(exact) <= reach
    assert near.sum() > 20
    np.testing.assert_allclose(found[near], exact[near], rtol=1e-12)
    assert (np.abs(found[~near]) > reach).all()
    assert (np.sign(found) == np.sign(exact)).all()


def halves(size: int = 80) -> np.ndarray:
    return np.repeat((np.arange(size) >= size // 2).astype(int)[None], 20, axis=0)


@pytest.mark.parametrize("feather", [8.0, 20.0, 40.0])
def test_a_ramp_is_half_on_the_seam_monotone_and_sums_to_one(feather: float) -> None:
    label, everywhere = halves(), np.ones((20, 80), dtype=bool)
    a, b = (image_weight(label, k, everywhere, feather, 1)[10] for k in (0, 1))
    assert np.allclose(a + b, 1.0, atol=1e-6)
    assert (a[39] + a[40]) / 2 == pytest.approx(0.5, abs=1e-6)  # the seam lies between the two
    assert (np.diff(a) <= 0).all()
    assert (np.diff(b) >= 0).all()
    half = int(feather / 2)
    assert (a[: 40 - half] == 1).all()
    assert (a[40 + half :] == 0).all()
    ramp = np.diff(a[40 - half + 1 : 40 + half - 1])
    assert np.allclose(ramp, -1 / feather, atol=1e-6)  # even steps, as wide as was asked


def test_a_hard_seam() -> None:
    label, everywhere = halves(), np.ones((20, 80), dtype=bool)
    a, b = (image_weight(label, k, everywhere, 0.0, 1) for k in (0, 1))
    assert set(np.unique(a)) == {0.0, 1.0}
    assert (a + b == 1).all()


def test_no_image_ends_in_a_step() -> None:
    """Image 1 ends a few cells beyond the seam: its weight must have gone to almost nothing there."""
    label, own = halves(), np.zeros((20, 80), dtype=bool)
    own[:, 35:] = True
    weight = image_weight(label, 1, own, 40.0, 1)[10]
    assert (weight[:35] == 0).all()
    assert weight[35] < 0.01
    assert (np.diff(weight[35:]) >= 0).all()
    # Where the seams give it a cell that its footprint does not cover, it keeps a whisper, so that the sum is never 0.
    beyond = image_weight(label, 0, own, 8.0, 1)[10]
    assert (beyond[:30] > 0).all()


def test_how_coarse_weights_may_be() -> None:
    for feather in (0.0, 1.0, 7.0, 16.0, 32.0, 64.0, 100.0, 1e4):
        factor = reduction(feather)
        assert factor in (1, 2, 4, 8, 16, 32)
        assert factor == 1 or feather / factor >= 8  # eight steps to a ramp
        assert halo(feather, factor) * factor >= feather + factor


def test_weights_of_overlapping_windows_agree() -> None:
    """With the halo around it, a block's weights are those of the whole picture, and so are those a cell beyond it."""
    rng = np.random.default_rng(2)
    from scipy.ndimage import gaussian_filter

    label = (gaussian_filter(rng.normal(size=(300, 300)), 25) > 0).astype(int)
    own = gaussian_filter(rng.normal(size=(300, 300)), 40) > -0.01
    for feather, factor in ((24.0, 1), (64.0, 4)):
        margin = halo(feather, factor)
        for index in (0, 1):
            whole = image_weight(label, index, own, feather, factor)
            block = slice(99, 181)
            wide = slice(100 - margin, 180 + margin)
            cut = slice(margin - 1, 1 - margin)
            part = image_weight(label[wide, wide], index, own[wide, wide], feather, factor)[cut, cut]
            assert 0 < part.mean() < 1
            assert np.array_equal(part, whole[block, block])


def test_the_ramp_at_a_footprints_edge_is_seen_from_the_next_block() -> None:
    """The edge runs a feather beyond the block; with half the halo the block would not know of it."""
    feather, factor = 32.0, 4
    label, own = np.zeros((60, 60), dtype=int), np.ones((60, 60), dtype=bool)
    own[:, 37:] = False
    margin = halo(feather, factor)
    whole = image_weight(label, 0, own, feather, factor)
    wide = slice(20 - margin, 30 + margin)
    part = image_weight(label[wide, wide], 0, own[wide, wide], feather, factor)[margin:-margin, margin:-margin]
    assert part.min() < 0.95
    assert np.array_equal(part, whole[20:30, 20:30])


def test_what_is_known_need_not_be_given() -> None:
    label, everywhere = halves(), np.ones((20, 80), dtype=bool)
    distance = signed_distance(label == 1, 10.0)
    for index, known in ((1, distance), (0, -distance)):
        plain = image_weight(label, index, everywhere, 20.0, 1)
        assert np.array_equal(image_weight(label, index, None, 20.0, 1), plain)
        assert np.array_equal(image_weight(label, index, None, 20.0, 1, known), plain)
