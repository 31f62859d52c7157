"""Blunders without a kind of fit: points against their neighbours, few points against every kind, check points."""

from __future__ import annotations

import numpy as np
import pytest
from adjust_rig import CENTRE, builder, fit_control, names, noisy, places, spoil, truth

from geomosaic.errors import SolveError
from geomosaic.estimation.blunders import neighbour_tests
from geomosaic.estimation.blunders.hypotheses import KINDS, weigh_hypotheses
from geomosaic.estimation.blunders.neighbour_tests import predictions, search_neighbours, without_perspective
from geomosaic.orientation.single.check_points import check_point_outliers


def spread(count: int, seed: int) -> np.ndarray:
    """Places of few points: the corners, the middle, the sides, shaken."""
    share = np.array(
        [[-1, -1], [1, -1], [-1, 1], [1, 1], [0, 0], [0, -1], [-1, 0], [1, 0], [0, 1], [0.5, 0.5], [-0.5, 0.4]]
    )
    return CENTRE + 450.0 * share[:count] + np.random.default_rng([seed, 7]).uniform(-40, 40, (count, 2))


# Against neighbours.


def test_neighbours_found_by_a_tree_and_in_blocks_are_those_of_all_distances(monkeypatch: pytest.MonkeyPatch):
    """Also of points on one place, of which a tree may name any, and not the point itself."""
    xy, colrow = noisy("wavy", 60, 2)
    bad = spoil(colrow, 0.1, 2, low=60.0)
    xy, colrow = np.vstack([xy, xy[:12]]), np.vstack([colrow, colrow[:12]])
    found = {}
    for compared, block in ((1000, 4096), (0, 4096), (1000, 7), (0, 7)):
        monkeypatch.setattr(neighbour_tests, "MOST_COMPARED", compared)
        monkeypatch.setattr(neighbour_tests, "BLOCK", block)
        found[compared, block] = search_neighbours(names(72), xy, colrow)
    whole = found[1000, 4096]
    assert bad <= set(whole.blunders)
    for one in found.values():
        assert one.blunders == whole.blunders
        np.testing.assert_allclose(one.errors, whole.errors, rtol=0.0, atol=1e-9)


def test_errors_of_prediction_are_those_of_the_spline_left_out():
    """Against the plugin's spline, fitted to all points but each: an independent implementation."""
    xy, colrow = noisy("wavy", 25, 0)
    fit = fit_control(builder("tps", xy, colrow), names(25), xy, colrow)
    unit = (xy - xy.mean(axis=0)) / 500.0
    errors, variance = predictions(unit, colrow, np.ones(25, dtype=bool))
    assert errors == pytest.approx(fit.leave_one_out, abs=1e-3)
    assert (variance > 0).all()
    kept = np.arange(25) != 4
    errors, _ = predictions(unit, colrow, kept)
    assert errors[4] == pytest.approx(fit.leave_one_out[4], abs=1e-3)


@pytest.mark.parametrize("kind", ["conformal", "projective", "poly3", "wavy"])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.3])
def test_those_that_contradict_their_neighbours_are_found(kind, share):
    hits = 0
    for seed in range(8):
        xy, colrow = noisy(kind, 60, seed)
        bad = spoil(colrow, share, seed, low=60.0)
        found = search_neighbours(names(60), xy, colrow)
        lengths = dict(zip(found.ids, np.hypot(*found.errors.T).tolist(), strict=True))
        hits += {name for name in found.blunders if lengths[name] > 6 * found.rms} == bad
    # Places at random leave gaps of a wave's length, in which 30 % of blunders are not all told apart.
    assert hits >= (4 if (kind, share) == ("wavy", 0.3) else 7), hits


def test_neighbours_of_many_points_and_of_too_few():
    xy, colrow = noisy("wavy", 1600, 1)
    bad = spoil(colrow, 0.1, 1, low=60.0)
    found = search_neighbours(names(1600), xy, colrow)
    assert bad <= set(found.blunders)
    assert len(set(found.blunders) - bad) < 20
    with pytest.raises(SolveError, match="too few"):
        search_neighbours(names(11), xy[:11], colrow[:11])


def test_a_perspective_is_taken_off_whatever_blunders():
    xy = places(40, 3)
    unit = (xy - CENTRE) / 500.0
    colrow = truth("conformal", xy) / (1.0 + unit @ [0.2, -0.15])[:, None]
    bad = spoil(colrow, 0.3, 3)
    left = np.hypot(*without_perspective(unit, colrow).T)
    good = np.array([name not in bad for name in names(40)])
    assert left[good].max() < 1e-6
    assert left[~good].min() > 10.0


# Few points.


@pytest.mark.parametrize("kind", ["conformal", "affine", "projective", "poly2"])
def test_the_most_probable_choice_is_fitted_as_the_plugin_fits_it(kind):
    xy = spread(10, 2)
    colrow = truth(kind, xy) + np.random.default_rng(3).normal(0.0, 0.3, (10, 2))
    for wrong in ([], [4]):
        colrow[wrong] += [60.0, 45.0]
        found = weigh_hypotheses(names(10), xy, colrow)
        kept = ~np.isin(np.arange(10), wrong)
        own = fit_control(builder(kind, xy[kept], colrow[kept]), names(kept.sum()), xy[kept], colrow[kept])
        assert found.kind == kind
        assert found.errors[kept] == pytest.approx(own.residuals, abs=1e-4)


def test_a_blunder_in_a_small_set_is_named_and_none_in_a_good_one():
    """The more points, the surer: of 8 nearly all, of good ones none is ever held for wrong."""
    least = {("conformal", 6): 0.95, ("affine", 7): 0.9, ("projective", 8): 0.9, ("poly2", 10): 0.9}
    for (kind, count), share in least.items():
        hits = 0
        for seed in range(20):
            xy = spread(count, seed)
            colrow = truth(kind, xy) + np.random.default_rng([seed, 1]).normal(0.0, 0.3, (count, 2))
            good = weigh_hypotheses(names(count), xy, colrow)
            assert not good.blunders
            assert not good.suspicious
            bad = spoil(colrow, 1.0 / count, seed, low=40.0)
            found = weigh_hypotheses(names(count), xy, colrow)
            assert not set(found.blunders) - bad
            hits += set(found.blunders) == bad
        assert hits >= share * 20, (kind, count, hits)


def test_an_undecidable_blunder_is_reported_as_uncertain():
    """Four points, one of them wrong: an affine image or a conformal one with a blunder."""
    xy = spread(4, 0)
    colrow = truth("conformal", xy)
    colrow[2] += [40.0, 5.0]
    found = weigh_hypotheses(names(4), xy, colrow)
    assert not found.blunders
    assert found.probability == pytest.approx(np.clip(found.probability, 0.0, 1.0))
    assert found.fault < 0.9
    assert set(KINDS) >= {found.kind}


# Check points.


def test_a_wrong_check_point_is_found_and_a_shift_is_not():
    false, hits = 0, 0
    for seed in range(300):
        random = np.random.default_rng(seed)
        errors = random.normal([3.0, -2.0], 0.8, (int(random.integers(4, 12)), 2))
        false += check_point_outliers(errors).outliers.any()
        errors[1] += [25.0, 0.0]
        found = check_point_outliers(errors)
        hits += found.outliers.tolist() == [i == 1 for i in range(len(errors))]
    assert false <= 6
    assert hits > 285


def test_one_or_two_check_points_are_judged_by_the_fit():
    errors = np.array([[0.4, 0.1], [9.0, 2.0]])
    assert not check_point_outliers(errors).outliers.any()
    assert check_point_outliers(errors, 0.5).outliers.tolist() == [False, True]
    assert check_point_outliers(errors, 3.0).outliers.tolist() == [False, False]
