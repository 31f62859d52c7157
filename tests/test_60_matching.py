"""Matching of images: patches, descriptors, pairs and tracks against places that are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from shapely import box

from geomosaic.matching import features, overlaps
from geomosaic.matching.descriptors import FARTHEST, Expected, match_descriptors
from geomosaic.matching.features import Features, detect, spread
from geomosaic.matching.least_squares import match_patches
from geomosaic.matching.overlaps import all_pairs, pairs_of_neighbours, pairs_of_outlines, similar_pairs
from geomosaic.matching.predicted import Predicted, match_predicted
from geomosaic.matching.ray_consistency import agreement_with_neighbours, consistent_rays, off_epipolar_lines
from geomosaic.matching.tracks import PairMatches, Tracks, even_selection, join
from geomosaic.matching.two_view import agreeing, epipolar_lines, match_pair
from geomosaic.tie_points.refinement import Approximations, neighbours_together, template_rays

AFFINE = np.array([[1.05, 0.12], [-0.1, 0.97]])
SHIFT = np.array([3.3, -2.7])


def texture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Sum of waves of random direction and length, at any place: grey values about 128."""
    random = np.random.default_rng(0)
    waves, phase = random.normal(0.0, 0.4, (60, 2)), random.uniform(0.0, 2.0 * np.pi, 60)
    size = 1.0 / np.maximum(np.hypot(*waves.T), 0.05)
    size *= 30.0 / np.sqrt((size**2).sum() / 2.0)
    out = np.full(x.shape, 128.0)
    for (across, down), turn, high in zip(waves, phase, size, strict=True):
        out += high * np.cos(across * x + down * y + turn)
    return out


@pytest.fixture(scope="module")
def images() -> tuple[np.ndarray, np.ndarray]:
    """A texture, and the same under an affine transformation, darker."""
    row, col = np.mgrid[0:240, 0:240].astype(np.float64)
    back = np.stack([col - SHIFT[0], row - SHIFT[1]], axis=-1) @ np.linalg.inv(AFFINE).T
    return texture(col, row), 0.8 * texture(back[..., 0], back[..., 1]) + 20.0


def matched(first: np.ndarray, second: np.ndarray, off: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Errors (K, 2) of matched patches and their covariances, from places that are wrong by up to `off` pixels."""
    random = np.random.default_rng(1)
    pixels = random.integers(40, 200, (800, 2))
    truth = pixels @ AFFINE.T + SHIFT + 0.5
    affine = np.broadcast_to(AFFINE + random.normal(0.0, 0.03, (2, 2)), (len(pixels), 2, 2))
    found = match_patches(first, second, pixels, truth + random.uniform(-off, off, truth.shape), affine)
    assert found.found.mean() > 0.9
    return (found.colrow - truth)[found.found], found.covariance[found.found]


def test_patches_are_found_to_hundredths_of_a_pixel(images):
    error, _ = matched(*images)
    assert np.abs(error).max() < 0.01


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
def test_patches_are_found_in_samples_of_any_type(images, kind):
    error, _ = matched(*(np.rint(image).astype(kind) for image in images))
    assert np.sqrt((error**2).mean()) < 0.01


def test_covariances_of_patches_are_those_of_their_errors(images):
    random = np.random.default_rng(2)
    error, covariance = matched(*(image + random.normal(0.0, 4.0, image.shape) for image in images))
    normalised = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    # Of two components the median is 1.39; neighbouring patches share pixels, so few of them are independent.
    assert 0.7 < np.median(normalised) < 2.5


def test_patches_without_contrast_or_beyond_the_image_are_lost(images):
    first, second = images
    flat = np.full_like(first, 7.0)
    pixels, affine = np.array([[100, 100], [3, 100]]), np.broadcast_to(np.eye(2), (2, 2, 2))
    assert not match_patches(flat, second, pixels, pixels + 0.5, affine).found.any()
    found = match_patches(first, second, np.array([[100, 100]]), np.array([[238.0, 100.0]]), affine[:1])
    assert np.isnan(found.colrow).all()
    assert np.isnan(found.covariance).all()


def some_features(count: int, seed: int) -> Features:
    random = np.random.default_rng(seed)
    values = random.gamma(0.4, 1.0, (count, 128))
    values = np.minimum(np.rint(512 * np.sqrt(values / values.sum(axis=1, keepdims=True))), 255).astype(np.uint8)
    return Features(random.uniform(0.0, 1000.0, (count, 2)), np.full(count, 5.0), np.zeros(count), values)


def like(features: Features, order: np.ndarray, colrow: np.ndarray, seed: int = 5) -> Features:
    """Features that look nearly like others, elsewhere."""
    random = np.random.default_rng(seed)
    noisy = features.descriptors[order].astype(np.float64) + random.normal(0.0, 6.0, (len(order), 128))
    return Features(
        colrow, features.scale[order], features.angle[order], np.clip(np.rint(noisy), 0.0, 255.0).astype(np.uint8)
    )


def test_descriptors_are_matched_as_all_distances_say():
    first = some_features(150, 1)
    order = np.random.default_rng(3).permutation(150)[:120]
    second = like(first, order, np.random.default_rng(4).uniform(0.0, 1000.0, (120, 2)))
    pairs = match_descriptors(first, second)
    one, other = first.descriptors.astype(np.int64), second.descriptors.astype(np.int64)
    apart = ((one[:, None] - other[None]) ** 2).sum(axis=2)
    near, back = np.sort(apart, axis=1), np.sort(apart, axis=0)
    expected = {
        (i, int(apart[i].argmin()))
        for i in range(150)
        if near[i, 0] < min(FARTHEST, 0.64 * near[i, 1])
        and apart[:, apart[i].argmin()].argmin() == i
        and back[0, apart[i].argmin()] < 0.64 * back[1, apart[i].argmin()]
    }
    assert {tuple(pair) for pair in pairs.tolist()} == expected
    assert len(expected) > 100
    assert (order[pairs[:, 1]] == pairs[:, 0]).all()


def test_guided_matching_looks_near_the_expected_place_and_line_alone():
    first = some_features(200, 1)
    second = like(first, np.arange(200), first.colrow + np.array([30.0, 4.0]))
    along = np.column_stack([np.zeros(200), np.ones(200), -first.colrow[:, 1]])  # the row of each
    assert len(match_descriptors(first, second, Expected(first.colrow, along, 40.0, 5.0))) > 180
    assert not len(match_descriptors(first, second, Expected(first.colrow, along, 20.0, 5.0)))
    assert not len(match_descriptors(first, second, Expected(first.colrow, along, 40.0, 3.0)))
    nowhere = Expected(np.full((200, 2), np.nan), along, 40.0, 5.0)
    assert not len(match_descriptors(first, second, nowhere))


def test_of_many_matches_those_of_one_geometry_are_kept():
    random = np.random.default_rng(6)
    ground = np.column_stack([random.uniform(-60, 60, (900, 2)), random.uniform(0, 15, 900)])
    turned = Rotation.from_euler("xyz", [3.0, -4.0, 170.0], degrees=True)
    views = []
    for centre, turn in ((np.array([0.0, 0.0, 100.0]), Rotation.identity()), (np.array([25.0, 5.0, 104.0]), turned)):
        seen = turn.apply(ground - centre)
        views.append(900.0 * seen[:, :2] / -seen[:, 2:] + 800.0)
    first = some_features(900, 7)
    first = Features(views[0], first.scale, first.angle, first.descriptors)
    swapped = np.arange(900)
    swapped[:180] = np.roll(swapped[:180], 7)  # a fifth look like other points
    second = like(first, swapped, views[1])
    pair = match_pair(first, second, 2.0)
    assert pair is not None
    right = swapped[pair.matches[:, 1]] == pair.matches[:, 0]
    assert right.all()
    true = pair.matches[:, 0] == pair.matches[:, 1]
    assert true.sum() > 600
    assert (~true).sum() < 4
    lines = epipolar_lines(pair.fundamental, views[0])
    off = np.abs((lines[:, :2] * views[1]).sum(axis=1) + lines[:, 2])
    assert np.median(off) < 0.1


def test_images_of_flat_ground_are_a_pair():
    """Many epipolar geometries fit them, which estimators may not expect."""
    some = some_features(100, 8)
    for seed in range(20):
        random = np.random.default_rng(seed)
        colrow = random.uniform(0.0, 170.0, (100, 2))
        there = colrow - np.array([60.0, 40.0])
        there[:2] = random.uniform(0.0, 170.0, (2, 2))
        there += random.normal(0.0, 1e-6, there.shape)
        first, second = (Features(at, some.scale, some.angle, some.descriptors) for at in (colrow, there))
        pair = agreeing(first, second, np.tile(np.arange(100)[:, None], (1, 2)), 4.0)
        assert pair is not None
        assert len(pair.matches) > 95


def scanned(random: np.random.Generator) -> tuple[Features, Features, Predicted, np.ndarray]:
    """Features of two images of a scanning sensor, where models expect them, and which of the first repeat themselves.

    Curves are bent, models off by 25 pixels across them, heights move places by up to 60 pixels along.
    """
    count = 700
    one = random.uniform(0.0, 1000.0, (count, 2))
    angle = 0.4 + 0.3 * np.sin(one[:, 1] / 250.0)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    bent = one + np.stack([40.0 * np.sin(one[:, 1] / 120.0), 30.0 * np.cos(one[:, 0] / 150.0)], axis=1)
    height = 60.0 * np.sin(one[:, 0] / 300.0) * np.cos(one[:, 1] / 280.0)
    across = 25.0 + 3.0 * one[:, 0] / 1000.0
    other = bent + height[:, None] * along + across[:, None] * np.stack([-along[:, 1], along[:, 0]], axis=1)
    kinds = random.integers(0, 120, (count, 128)).astype(np.uint8)
    # Two thirds look like three others each: rows of trees, windows, fields.
    twin = np.arange(count) < 480
    kinds[twin] = kinds[np.arange(480) // 4 * 4]
    seen = np.clip(kinds + random.normal(0.0, 3.0, kinds.shape), 0.0, 255.0).astype(np.uint8)
    scale = random.uniform(2.0, 8.0, count)
    features = [Features(at, scale, np.zeros(count), what) for at, what in ((one, kinds), (other, seen))]
    return features[0], features[1], Predicted(bent, along), twin


def test_places_that_models_expect_are_matched_where_one_fundamental_matrix_fails():
    first, second, predicted, twin = scanned(np.random.default_rng(4))
    found = match_predicted(first, second, predicted, 2.0)
    assert (found[:, 0] == found[:, 1]).mean() > 0.98
    assert len(found) > 550
    assert twin[found[:, 0]].sum() > 300
    plain = match_pair(first, second, 2.0)
    right = 0 if plain is None else (plain.matches[:, 0] == plain.matches[:, 1]).sum()
    assert right < 0.5 * len(found)


def test_places_that_models_expect_wrongly_altogether_are_no_matches():
    first, second, predicted, _ = scanned(np.random.default_rng(4))
    shuffled = np.random.default_rng(1).permutation(len(first))
    assert match_predicted(first, second, predicted.select(shuffled), 2.0) is None
    nowhere = Predicted(np.full_like(predicted.colrow, np.nan), predicted.along)
    assert match_predicted(first, second, nowhere, 2.0) is None


def test_images_with_nothing_in_common_are_no_pair():
    assert match_pair(some_features(500, 1), some_features(500, 2), 2.0) is None
    assert match_pair(some_features(3, 1), some_features(0, 2), 2.0) is None


def test_features_are_spread_and_wanted_where_the_mask_says():
    row, col = np.mgrid[0:200, 0:300].astype(np.float64)
    grey = np.clip(texture(col / 2.0, row / 2.0), 0.0, 255.0).astype(np.uint8)
    mask = np.zeros(grey.shape, dtype=bool)
    mask[:, :150] = True
    found = detect(grey, 120, mask)
    assert 40 < len(found) <= 120
    assert (found.colrow[:, 0] < 151.0).all()
    chosen = spread(np.array([[1.0, 1.0], [2.0, 2.0], [50.0, 50.0]]), np.array([3.0, 2.0, 1.0]), 10.0, 2)
    assert sorted(chosen.tolist()) == [0, 2]
    assert not len(detect(np.zeros((1, 500), dtype=np.uint8), 120))


def test_features_of_tiles_are_those_of_the_whole_image(monkeypatch):
    row, col = np.mgrid[0:300, 0:400].astype(np.float64)
    grey = np.clip(np.rint(texture(col, row)), 0, 255).astype(np.uint8)
    mask = np.ones(grey.shape, dtype=bool)
    mask[:, 360:] = False
    whole = detect(grey, 100_000, mask)
    monkeypatch.setattr(features, "WHOLE", 0)
    monkeypatch.setattr(features, "TILE", 128)
    assert features.largest_tile((400, 300)) < grey.size
    tiled = detect(grey, 100_000, mask)
    away, nearest = cKDTree(tiled.colrow).query(whole.colrow)
    same = away < 0.01
    # Blobs as wide as the margin are seen in part.
    small = whole.scale < 25.0
    assert small.mean() > 0.9
    assert same[small].mean() > 0.99
    assert abs(len(tiled) - len(whole)) < 0.02 * len(whole)
    apart = np.abs(whole.descriptors[same].astype(int) - tiled.descriptors[nearest[same]]).max(axis=1)
    assert (apart <= 2).mean() > 0.8  # the others are of another direction at the same place
    few = detect(grey, 60, mask)
    assert len(few) == 60
    assert np.ptp(few.colrow, axis=0).min() > 200.0


def test_a_template_lies_whole_within_its_image():
    tracks = Tracks(*np.array([[0, 0, 1, 1], [0, 1, 0, 1], [0, 0, 1, 1]]))
    # The first point is nearer to the middle of the small image, at its border; the second lies within both.
    colrow = np.array([[100.0, 500.0], [12.0, 8.0], [100.0, 500.0], [12.0, 12.0]])
    approximate = Approximations(colrow, np.tile(np.eye(2), (4, 1, 1)), np.ones(4))
    sizes = np.array([[1000, 1000], [24, 24]])
    assert template_rays(tracks, approximate, sizes).tolist() == [0, 3]


def test_images_of_a_block_are_decoded_once_if_some_strips_across_it_can_be_held():
    number = np.arange(5 * 15)
    strip, along = np.divmod(number, 15)
    near = (np.abs(strip[:, None] - strip) <= 2) & (np.abs(along[:, None] - along) <= 3) & (number[:, None] != number)
    pairs = np.argwhere(near)
    held: list[int] = []
    decoded = 0
    for image in pairs[neighbours_together(pairs)].ravel().tolist():
        decoded += image not in held
        held = [*(k for k in held if k != image), image][-44:]
    assert decoded == 75


def test_tracks_join_pairs_and_split_where_they_contradict():
    pairs = [
        PairMatches(0, 1, np.array([[0, 0], [1, 1]]), np.array([1.0, 1.0])),
        PairMatches(1, 2, np.array([[0, 0], [1, 1]]), np.array([1.0, 5.0])),
        # Place 1 of the last image is claimed by both points: the dearest match goes.
        PairMatches(0, 2, np.array([[0, 1]]), np.array([9.0])),
    ]
    tracks = join(pairs, [2, 2, 2])
    found = {
        frozenset(zip(tracks.image[tracks.point == p].tolist(), tracks.place[tracks.point == p].tolist(), strict=True))
        for p in range(int(tracks.point.max()) + 1)
    }
    assert found == {frozenset({(0, 0), (1, 0), (2, 0)}), frozenset({(0, 1), (1, 1), (2, 1)})}
    assert tracks.pairs(3).tolist() == [[0, 1, 2], [0, 2, 2], [1, 2, 2]]
    assert len(join([], [2, 2])) == 0


def hilly(random: np.random.Generator, count: int) -> np.ndarray:
    """Points in three images (3, count, 2): the places of each differ by an affine transformation and by relief."""
    places = random.uniform(0.0, 1000.0, (count, 2))
    relief = 15.0 * np.sin(places[:, :1] / 150.0) * np.cos(places[:, 1:] / 200.0)
    seen = [places @ (np.eye(2) + k * 0.1 * AFFINE).T + k * relief * [1.0, 0.4] for k in range(3)]
    return np.stack(seen) + random.normal(0.0, 0.05, (3, count, 2))


def test_neighbours_say_where_a_match_along_its_epipolar_line_should_be():
    one, other, _ = hilly(np.random.default_rng(0), 400)
    assert (agreement_with_neighbours(one, other) > 0).mean() > 0.95
    other[[5, 60, 200]] += [[20.0, 8.0], [-40.0, -16.0], [90.0, 36.0]]
    agreement = agreement_with_neighbours(one, other)
    assert (agreement[[5, 60, 200]] == -1).all()
    assert (agreement > 0).mean() > 0.95


def test_neighbours_that_all_lie_on_one_side_bear_no_match_out():
    random = np.random.default_rng(0)
    one, other, _ = hilly(random, 400)
    shore = one[:, 1] < 700.0
    # A wave of the lake beyond the shore, of which two images show the like a few pixels apart.
    alone = np.array([[500.0, 1000.0]])
    one = np.concatenate([one[shore], alone])
    other = np.concatenate([other[shore], alone @ (np.eye(2) + 0.1 * AFFINE).T])
    assert agreement_with_neighbours(one, other)[-1] <= 0
    point, image = np.divmod(np.arange(2 * len(one)), 2)
    colrow = np.stack([one, other])[image, point]
    kept = consistent_rays(Tracks(point, image, np.zeros(len(point), dtype=np.int64)), colrow)
    assert not kept[-2:].any()
    assert kept.mean() > 0.95


def test_neighbours_that_scatter_by_scores_of_pixels_bear_no_match_out():
    random = np.random.default_rng(0)
    one = random.uniform(0.0, 4000.0, (40, 2))
    other = one @ (np.eye(2) + 0.1 * AFFINE).T + random.normal(0.0, 30.0, (40, 2))
    assert (agreement_with_neighbours(one, other) <= 0).all()


def test_trees_as_high_as_their_neighbours_are_no_wrong_matches():
    random = np.random.default_rng(0)
    one, other, _ = hilly(random, 400)
    other += random.uniform(0.0, 12.0, (400, 1)) * [1.0, 0.4]
    assert (agreement_with_neighbours(one, other) > 0).mean() > 0.95


def test_rays_that_the_points_around_contradict_are_left_out():
    places = hilly(np.random.default_rng(1), 300)
    point, image = np.divmod(np.arange(900), 3)
    colrow = places[image, point]
    wrong = [3 * 17 + 2, 3 * 40, 3 * 90 + 1]
    colrow[wrong] += [30.0, 12.0]
    kept = consistent_rays(Tracks(point, image, np.zeros(900, dtype=np.int64)), colrow)
    assert not kept[wrong].any()
    assert kept[[3 * 17, 3 * 17 + 1, 3 * 40 + 1, 3 * 40 + 2, 3 * 90, 3 * 90 + 2]].all()
    assert kept.mean() > 0.95
    # Of two rays nobody knows which is wrong; what has no neighbours is borne out by none.
    two = image < 2
    kept = consistent_rays(Tracks(point[two], image[two], np.zeros(600, dtype=np.int64)), colrow[two])
    assert not kept[[2 * 40, 2 * 40 + 1, 2 * 90, 2 * 90 + 1]].any()
    few = two & (point < 6)
    assert not consistent_rays(Tracks(point[few], image[few], np.zeros(12, dtype=np.int64)), colrow[few]).any()


def photographed(random: np.random.Generator, count: int) -> np.ndarray:
    """Points of relief in three images (3, count, 2) of a lens whose distortion nobody knows, to 0.05 pixels."""
    ground = np.column_stack([random.uniform(-1.0, 1.0, (count, 2)), random.uniform(2.98, 3.02, count)])
    centres, turns = [[0.0, 0.0], [0.6, 0.0], [0.1, 0.7]], [[0.02, 0.05, 0.0], [-0.06, 0.01, 0.0], [0.03, -0.04, 0.6]]
    seen = []
    for centre, turn in zip(centres, turns, strict=True):
        rays = (ground - [*centre, 0.0]) @ Rotation.from_rotvec(turn).as_matrix().T
        plane = rays[:, :2] / rays[:, 2:]
        seen.append(2000.0 + 5000.0 * plane * (1.0 - 0.1 * (plane**2).sum(axis=1, keepdims=True)))
    return np.stack(seen) + random.normal(0.0, 0.05, (3, count, 2))


def test_matches_off_their_epipolar_lines_are_seen_whatever_relief_and_lens():
    random = np.random.default_rng(3)
    one, other, _ = photographed(random, 300)
    assert not off_epipolar_lines(one, other).any()
    # The base runs along the columns: across the lines by 3 pixels, along them by as many.
    other[[5, 60, 200]] += [0.0, 3.0]
    other[[6, 61, 201]] += [3.0, 0.0]
    off = off_epipolar_lines(one, other)
    assert off[[5, 60, 200]].all()
    assert off.sum() == 3


def test_the_ray_of_a_point_that_most_others_contradict_across_their_lines_is_left_out():
    places = photographed(np.random.default_rng(3), 300)
    point, image = np.divmod(np.arange(900), 3)
    colrow = places[image, point]
    # Relief moves neighbours against each other by more than that.
    colrow[3 * 40 + 2] += [3.0, 3.0]
    kept = consistent_rays(Tracks(point, image, np.zeros(900, dtype=np.int64)), colrow)
    assert kept[[3 * 40, 3 * 40 + 1]].all()
    assert not kept[3 * 40 + 2]
    assert kept.mean() > 0.9


def test_selected_points_serve_every_cell_and_those_of_many_images_first():
    # Points 0 and 1 lie in one cell of images 0 and 1; point 1 is in a third one as well.
    pairs = [
        PairMatches(0, 1, np.array([[0, 0], [1, 1], [2, 2]]), np.zeros(3)),
        PairMatches(1, 2, np.array([[1, 0]]), np.zeros(1)),
    ]
    tracks = join(pairs, [3, 3, 1])
    places = np.array([[5.0, 5.0], [6.0, 6.0], [95.0, 5.0]])
    chosen = even_selection(tracks, places[tracks.point] / 10.0, 1)
    many = tracks.rays == 3
    assert chosen[many].all()
    assert chosen.sum() == 2


def test_images_are_paired_with_neighbours_or_with_those_that_look_alike(monkeypatch):
    assert all_pairs(3).tolist() == [[0, 1], [0, 2], [1, 2]]
    line = np.column_stack([np.arange(50.0), np.zeros(50)])
    pairs = pairs_of_neighbours(line, 2)
    assert len(pairs) < 2 * 50
    assert (np.abs(pairs[:, 0] - pairs[:, 1]) <= 2).all()
    places = np.zeros((300, 2))
    groups = [some_features(300, seed) for seed in (1, 2, 3)]
    images = [like(groups[k % 3], np.arange(300), places, seed=k) for k in range(9)]
    alike = similar_pairs(images, 2)
    monkeypatch.setattr(overlaps, "BLOCK", 3)
    assert (similar_pairs(images, 2) == alike).all()
    assert (alike[:, 0] % 3 == alike[:, 1] % 3).all()
    assert len(alike) == 9


@pytest.mark.parametrize("place", [0, 6, 12])
def test_one_more_photo_of_any_name_brings_no_new_pairs_of_the_others_that_look_alike(place):
    images = [some_features(100, seed) for seed in range(13)]
    others = [k for k in range(13) if k != place]
    before = {(others[a], others[b]) for a, b in similar_pairs([images[k] for k in others], 3).tolist()}
    after = {(a, b) for a, b in similar_pairs(images, 3).tolist()}
    assert {pair for pair in after if place not in pair} <= before
    assert any(place in pair for pair in after)


def test_images_are_paired_by_the_overlap_of_their_footprints():
    # Eight images in a row, each over half of the next, and one elsewhere.
    outlines = [box(50.0 * k, 0.0, 50.0 * k + 99.0, 80.0) for k in range(8)] + [box(0.0, 500.0, 100.0, 580.0)]
    expected = [[k, k + 1] for k in range(7)]
    assert pairs_of_outlines(outlines, 24).tolist() == expected
    far = [box(30.0 * k, 0.0, 30.0 * k + 100.0, 80.0) for k in range(200)]
    pairs = pairs_of_outlines(far, 2)
    assert len(pairs) == 200 + 1  # each with the next; the first and last with one farther
    assert pairs_of_outlines(outlines[-1:], 2).shape == (0, 2)


def test_images_without_features_look_like_none():
    empty = Features(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros((0, 128), dtype=np.uint8))
    assert not len(similar_pairs([empty] * 5, 2))
    some = some_features(300, 1)
    assert similar_pairs([some, empty, like(some, np.arange(300), some.colrow), empty], 1).tolist() == [[0, 2]]
