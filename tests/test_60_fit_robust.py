"""Blunders: one, and 30 % of them, found by data snooping and by the M-estimator; good control left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from adjust_rig import CENTRE, SIZE, builder, control, noisy, places, spoil, truth

from geomosaic.errors import SolveError
from geomosaic.estimation.blunders import data_snooping, least_trimmed_squares
from geomosaic.estimation.blunders.data_snooping import search_blunders, snoop
from geomosaic.estimation.blunders.least_trimmed_squares import RobustStart

COUNTS = {"conformal": 12, "affine": 16, "projective": 20, "poly2": 25, "poly3": 40}


@pytest.mark.parametrize(
    "kind", [k if k in ("affine", "projective") else pytest.param(k, marks=pytest.mark.slow) for k in COUNTS]
)
def test_one_blunder_is_found(kind: str) -> None:
    """A blunder of 12 sigma at a random point, whatever its leverage leaves of it."""
    for seed in range(1 if kind == "poly3" else 2):
        xy, colrow = noisy(kind, COUNTS[kind], seed)
        bad = spoil(colrow, 1.0 / COUNTS[kind], seed, low=25.0, high=60.0)
        found = search_blunders(control(kind, xy, colrow))
        assert set(found.snooping.blunders) == set(found.estimate.blunders) == bad
        assert found.agree
        assert found.blunders == tuple(bad)
        assert found.snooping.fit.rms_total < 1.2


@pytest.mark.parametrize("kind", list(COUNTS))
def test_thirty_percent_are_found(kind: str) -> None:
    for seed in range(1 if kind == "poly3" else 2):
        xy, colrow = noisy(kind, COUNTS[kind], seed)
        bad = spoil(colrow, 0.3, seed)
        found = search_blunders(control(kind, xy, colrow))
        assert set(found.snooping.blunders) == bad
        assert set(found.estimate.blunders) == bad
        assert "both methods find" in found.summary
        at = np.column_stack([xy, np.zeros(len(xy))])
        errors = np.hypot(*(found.estimate.fit.model.ground_to_image(at) - truth(kind, xy)).T)
        assert np.median(errors) < 0.6


def test_of_many_points_some_are_tried_and_blunders_leave_several_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Counted by fits and their points: neither grows with the square of the points."""
    xy, colrow = noisy("affine", 200, 3)
    bad = spoil(colrow, 0.3, 3)
    problem = control("affine", xy, colrow)
    sizes, build = [], problem.build
    problem = replace(problem, build=lambda chosen, sigma: [sizes.append(len(chosen)), build(chosen, sigma)][1])
    whole, one_by_one = search_blunders(problem), len(sizes)
    assert sum(size > 60 for size in sizes) > 100
    sizes.clear()
    monkeypatch.setattr(least_trimmed_squares, "POOL", 60)
    monkeypatch.setattr(data_snooping, "ONE_OF", 20)
    found = search_blunders(problem)
    assert set(found.blunders) == set(whole.blunders) == bad
    assert sum(size > 60 for size in sizes) < 40
    assert len(sizes) < one_by_one - 40


@pytest.mark.parametrize("kind", ["affine", "poly3"])
def test_trials_of_a_linear_kind_find_the_same_without_a_model_for_each(kind: str) -> None:
    xy, colrow = noisy(kind, COUNTS[kind], 4)
    bad = spoil(colrow, 0.2, 4)
    problem, found, built = control(kind, xy, colrow), [], []
    some = np.random.default_rng(4).choice(COUNTS[kind], 14, replace=False)
    errors = replace(problem, linear=True).errors_under(some)
    np.testing.assert_allclose(errors, problem.errors(problem.model(some)), rtol=0.0, atol=1e-7)
    for linear in (True, False):
        made: list[int] = []
        counted = replace(
            problem, build=lambda *chosen, made=made: [made.append(1), problem.build(*chosen)][1], linear=linear
        )
        search = search_blunders(counted)
        assert set(search.blunders) == bad
        found.append((search.blunders, search.suspected, search.summary))
        built.append(len(made))
    assert found[0] == found[1]
    assert built[0] < 0.4 * built[1]


def test_trials_of_a_linear_kind_go_on_where_all_points_together_place_nothing() -> None:
    xy, colrow = noisy("poly2", 30, 5)
    problem = replace(control("poly2", xy, colrow), linear=True)

    def build(chosen: np.ndarray, sigma: np.ndarray) -> object:
        if len(chosen) == 30:
            raise SolveError("no ground at the middle of the image", hint="")
        return problem.build(chosen, sigma)

    some = np.arange(3, 15)
    found = replace(problem, build=build).errors_under(some)
    assert np.array_equal(found, problem.errors(problem.model(some)))


def trials(kind: str, share: float, count: int) -> tuple[float, float, float]:
    """Share of trials in which each method finds exactly the blunders, and in which they agree."""
    hits = []
    for seed in range(count):
        xy, colrow = noisy(kind, COUNTS[kind], seed)
        bad = spoil(colrow, share, seed)
        found = search_blunders(control(kind, xy, colrow))
        hits.append((set(found.snooping.blunders) == bad, set(found.estimate.blunders) == bad, found.agree))
    snooping, estimate, agree = np.mean(hits, axis=0)
    return float(snooping), float(estimate), float(agree)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("kind", list(COUNTS))
def test_blunders_are_found_in_nine_trials_of_ten(kind: str, share: float) -> None:
    snooping, estimate, agree = trials(kind, share, 60)
    assert min(snooping, estimate, agree) >= 0.9, (snooping, estimate, agree)


def test_blunders_all_the_same_way() -> None:
    """A third of the points shifted together (a neighbouring house): they agree with each other, but are fewer."""
    xy, colrow = noisy("conformal", 18, 5)
    colrow[:6] += [35.0, -20.0]
    found = search_blunders(control("conformal", xy, colrow))
    assert set(found.estimate.blunders) == {f"P{i}" for i in range(6)}


def test_mirrored_control_with_blunders() -> None:
    xy, colrow = noisy("conformal", 16, 6)
    colrow[:, 1] = SIZE[1] - colrow[:, 1]
    bad = spoil(colrow, 0.25, 6)
    found = search_blunders(control("conformal", xy, colrow))
    assert set(found.blunders) == bad
    assert found.estimate.fit.mirrored


def test_points_on_both_sides_of_the_horizon() -> None:
    """Blunders for which no projective fit to all points exists at all."""
    xy, colrow = noisy("projective", 16, 3)
    for index, other in ((0, 9), (3, 12), (5, 14)):
        colrow[[index, other]] = colrow[[other, index]] * 3.0 - 2000.0
    with pytest.raises(SolveError):
        builder("projective", xy, colrow)(np.arange(16), np.ones(16))
    found = search_blunders(control("projective", xy, colrow))
    bad = {"P0", "P3", "P5", "P9", "P12", "P14"}
    assert set(found.snooping.blunders) == bad
    assert set(found.estimate.blunders) == bad


def test_an_error_of_many_sigmas_is_a_blunder() -> None:
    """A 6-pixel error in noise of half a pixel."""
    xy, colrow = noisy("affine", 14, 4)
    colrow[3] += [4.0, -5.0]
    assert search_blunders(control("affine", xy, colrow)).blunders == ("P3",)


def test_sigmas_of_points_are_taken_as_true() -> None:
    """The same error in a point said to be ten times worse than the others is no blunder."""
    xy, colrow = noisy("affine", 14, 4)
    colrow[3] += [4.0, -5.0]
    sigma = np.full(14, 0.5)
    sigma[3] = 5.0
    assert search_blunders(control("affine", xy, colrow, sigma)).blunders == ()


def test_false_alarms_are_as_rare_as_said() -> None:
    """60 clean sets of 12 points, alpha 1 %: about 7 of 720 points are put out."""
    out, start = 0, RobustStart(np.ones(12, dtype=bool), scale=0.5, freedom=10**9, needed=2, breakdown_point=0.0)
    for seed in range(60):
        xy, colrow = noisy("conformal", 12, seed)
        out += len(snoop(control("conformal", xy, colrow), start, alpha=0.01).blunders)
    assert 0 < out < 18


def test_exact_points_with_one_blunder() -> None:
    xy = places(10)
    colrow = truth("affine", xy)
    colrow[7] += [0.0, 0.5]
    found = search_blunders(control("affine", xy, colrow))
    assert found.blunders == ("P7",)
    clean = truth("affine", xy)
    assert search_blunders(control("affine", xy, clean)).blunders == ()


def test_points_exact_but_for_rounding_have_no_blunders() -> None:
    xy = places(24)
    colrow = truth("affine", xy) + 1e-4 * np.random.default_rng(3).normal(size=(24, 2))
    colrow[7] += [0.02, 0.03]
    assert search_blunders(control("affine", xy, colrow)).suspected == ()


def test_the_same_every_time() -> None:
    xy, colrow = noisy("poly2", 25, 2)
    spoil(colrow, 0.3, 2)
    problem = control("poly2", xy, colrow)
    first, second = (search_blunders(problem) for _ in range(2))
    assert first.summary == second.summary
    np.testing.assert_array_equal(first.estimate.weights, second.estimate.weights)


def test_what_cannot_be_searched_is_refused() -> None:
    xy, colrow = noisy("affine", 12, 1)
    with pytest.raises(SolveError, match="passes through all"):
        search_blunders(control("tps", xy, colrow))
    with pytest.raises(SolveError, match="4 points are too few"):
        search_blunders(control("affine", xy[:4], colrow[:4]))
    line = np.linspace(0.0, 400.0, 9)[:, None] * [1.0, 0.5] + CENTRE
    with pytest.raises(SolveError, match="no sample"):
        search_blunders(control("affine", line, truth("affine", line)))


def test_signed_ranks_as_an_independent_implementation_has_them() -> None:
    from scipy.stats import wilcoxon

    from geomosaic.estimation.statistics import signed_rank_probability

    random = np.random.default_rng(5)
    for count in (6, 7, 20, 50, 51, 200):
        for shift in (-0.2, 0.0, 0.4):
            told = random.normal(shift, 1.0, count)
            assert signed_rank_probability(told) == pytest.approx(
                wilcoxon(told, alternative="greater").pvalue, rel=1e-9
            )
    tied = np.array([1.0, -1.0, 2.0, 2.0, 0.0, 3.0, -2.0, 4.0, 1.0])
    expected = wilcoxon(tied, alternative="greater", method="asymptotic").pvalue
    assert signed_rank_probability(tied) == pytest.approx(expected, rel=1e-9)


def test_tails_as_an_independent_implementation_has_them() -> None:
    from scipy.stats import chi2, f

    from geomosaic.estimation.statistics import tail_probability

    told = np.array([0.0, 0.5, 3.0, 20.0, 400.0, np.inf])
    assert tail_probability(told, 1.3, 17.0) == pytest.approx(f.sf(told / 1.3**2 / 2.0, 2, 17), rel=1e-9)
    assert tail_probability(told, 1.3, np.inf) == pytest.approx(chi2.sf(told / 1.3**2, 2), rel=1e-9)
