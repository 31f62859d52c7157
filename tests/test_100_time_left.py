"""Time left of the stages of matching, told while they run."""

from __future__ import annotations

import pytest

from geomosaic.cli.time_left import CHAINS, TimeLeft, clock_text


def run(left: TimeLeft, stage: str, begin: float, each: float, count: int, done: int) -> float:
    """Tell `done` of `count` pieces of a stage, each of which takes as long; the time after the last."""
    for k in range(1, done + 1):
        left.tell(k, count, stage, begin + k * each)
    return begin + done * each


def test_a_stage_takes_as_long_as_its_pieces_lately_did() -> None:
    left = TimeLeft()
    now = run(left, "orthos", 0.0, 2.0, 10, 4)
    assert left.of_stage("orthos", now) == pytest.approx(12.0)
    assert left.of_stage("orthos", now + 5.0) == pytest.approx(7.0)
    # Longer than it seemed: nothing is told rather than an end that does not come.
    assert left.of_stage("orthos", now + 20.0) is None
    assert left.in_all("orthos", now) is None


def test_what_came_from_a_cache_does_not_promise_a_quick_end() -> None:
    left = TimeLeft()
    now = run(left, "features", 0.0, 0.001, 200, 100)
    for k in range(101, 161):
        now += 1.0
        left.tell(k, 200, "features", now)
    assert left.of_stage("features", now) == pytest.approx(40.0, rel=0.05)


def test_stages_that_follow_are_counted_in_their_measured_proportion() -> None:
    left, (chain,) = TimeLeft(), CHAINS
    now = run(left, "features", 0.0, 1.0, 100, 50)
    assert left.in_all("features", now) == pytest.approx(50.0 + 100.0 * (sum(chain.values()) - 1.0), rel=0.02)
    now = run(left, "features", 0.0, 1.0, 100, 100)
    now = run(left, "pairs", now, 0.25, 100, 50)
    assert left.of_stage("pairs", now) == pytest.approx(12.5)
    assert left.in_all("pairs", now) == pytest.approx(12.5 + 100.0 * chain["least squares matching"], rel=0.05)


def test_nothing_is_told_of_work_of_unknown_length() -> None:
    left = TimeLeft()
    now = run(left, "iterations", 0.0, 1.0, 0, 7)
    assert left.of_stage("iterations", now) is None


def test_hours_are_told_in_full() -> None:
    assert clock_text(3 * 3600 + 65.4) == "3:01:05"
