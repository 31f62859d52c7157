"""Wrong tie and control points of a block: named with photo, size and line, or said to be hidden."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from planar_rig import PHOTOS, textbook_block

from geomosaic.errors import GeomosaicWarning, InputError, SolveError
from geomosaic.estimation.blunders.mean_shift import MeanShifts
from geomosaic.orientation.planar.blunders import (
    adjust_checked,
    mean_shifts_of,
    search_any_adjustment,
    search_block,
    search_each_photo,
    without_measurements,
)
from geomosaic.orientation.planar.measurements import Control, PlanarBlock
from geomosaic.orientation.planar.simultaneous import adjust


def moved(block: PlanarBlock, point: str, photo: str, by: tuple[float, float]) -> PlanarBlock:
    """The block with one measurement shifted by pixels."""

    def here(p):
        there = p.id == point and p.photo == photo
        return replace(p, col=p.col + by[0], row=p.row + by[1], where="points.csv, line 7") if there else p

    return PlanarBlock(block.photos, tuple(map(here, block.ties)), tuple(map(here, block.control)))


def shifts(block: PlanarBlock, kind: str) -> tuple[MeanShifts, list[tuple[str, str | None]]]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomosaicWarning)
        found, _, doubts = mean_shifts_of(block, adjust(block, kind), {})
    return found, doubts


@pytest.mark.parametrize("kind", ["conformal", "affine"])
@pytest.mark.parametrize(("point", "photo"), [("9", "V"), ("2", "II"), ("C", "VI")])
def test_the_statistic_is_what_the_sum_of_squares_falls_by(kind: str, point: str, photo: str) -> None:
    """Against the adjustment made anew without the measurement; and the shift against where the others put it."""
    _, block = textbook_block(kind, 0.5, 4)
    block = moved(block, point, photo, (3.0, -2.0))
    found, doubts = shifts(block, kind)
    at = found.state([])
    assert at is not None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomosaicWarning)
        whole, less = adjust(block, kind), adjust(without_measurements(block, [(point, photo)]), kind)
    assert at.squares == pytest.approx(whole.sigma0**2 * whole.redundancy, rel=1e-3)
    index = doubts.index((point, photo))
    fallen = at.squares - less.sigma0**2 * less.redundancy
    assert at.statistic[index] == pytest.approx(fallen, rel=0.02)
    measured = block.by_photo[photo][point]
    known = {p.id: (p.x, p.y) for p in block.control}
    place = known.get(point) or less.points[less.views.ids.index(point)]
    there = less.transforms[photo].to_image(np.array([place]))[0]
    assert np.allclose(at.shifts[index], np.array([measured.col, measured.row]) - there, atol=0.05)


def test_letting_one_in_is_an_adjustment_without_it() -> None:
    """What is said of all others with one shift in, against the search started anew without the measurement."""
    _, block = textbook_block("affine", 0.5, 8)
    found, doubts = shifts(block, "affine")
    index = doubts.index(("13", "IV"))
    with_it = found.state([index])
    less, others = shifts(without_measurements(block, [("13", "IV")]), "affine")
    alone = less.state([])
    assert with_it is not None
    assert alone is not None
    both = [(doubts.index(one), k) for k, one in enumerate(others) if one in doubts]
    left, right = (np.array(each) for each in zip(*both, strict=True))
    assert np.allclose(with_it.statistic[left], alone.statistic[right], rtol=0.02, atol=0.02, equal_nan=True)
    assert with_it.redundancy == alone.redundancy


@pytest.mark.parametrize("kind", [pytest.param("conformal", marks=pytest.mark.slow), "affine"])
@pytest.mark.parametrize(("point", "photo"), [("9", "VI"), ("33", "XII"), ("D", "VII")])
def test_one_is_named_with_photo_size_and_line(kind: str, point: str, photo: str) -> None:
    """A point in four photos by its photo; one in two by both, since nothing tells which; control by its photo."""
    _, block = textbook_block(kind, 0.5, 2)
    bad = moved(block, point, photo, (24.0, -18.0))
    looked = search_block(bad, kind)
    (wrong,) = looked.findings.blunders
    assert wrong.label.id == point
    assert wrong.label.images == (("XI", "XII") if point == "33" else (photo,))
    assert wrong.size == pytest.approx(30.0, abs=3.0)
    assert wrong.gross
    assert wrong.label.where == ("points.csv, line 7",)
    with pytest.raises(InputError, match=r"1 of \d+ measurements contradicts the others, .*line 7") as told:
        adjust_checked(bad, kind)
    assert "`robust`" in str(told.value.hint)
    with pytest.warns(GeomosaicWarning, match="left out"):
        solution, _ = adjust_checked(bad, kind, policy="leave")
    good = adjust(block, kind)
    corners = [np.abs(solution.transforms[p].to_ground(c) - good.transforms[p].to_ground(c)).max()
               for p in PHOTOS for c in [solution.transforms[p].corners()]]  # fmt: skip
    assert max(corners) < (0.15 if kind == "conformal" else 0.4)  # metres; a pixel is 0.1
    with warnings.catch_warnings(record=True) as told_of:
        warnings.simplefilter("always")
        kept, said = adjust_checked(bad, kind, policy="keep")
    assert "measure it again" in str(told_of[0].message)
    assert (kept.rms, said.policy) == (adjust_quietly(bad, kind).rms, "keep")


def adjust_quietly(block: PlanarBlock, kind: str):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomosaicWarning)
        return adjust(block, kind)


def test_wrong_coordinates_are_distinguished_from_wrong_measurements() -> None:
    """Control in three photos whose coordinates are off by 4 m: not its measurements, its place."""
    truth, block = textbook_block("conformal", 0.5, 3)
    place = {tie.id: tie for tie in block.ties if tie.id == "25"}
    assert place
    solution = adjust(block, "conformal")
    x, y = solution.points[solution.views.ids.index("25")]
    control = [Control("25", x + 3.2, y - 2.4, t.photo, t.col, t.row, t.sigma) for t in block.ties if t.id == "25"]
    bad = PlanarBlock(block.photos, tuple(t for t in block.ties if t.id != "25"), (*block.control, *control))
    assert len(truth) == 12
    (wrong,) = search_block(bad, "conformal").findings.blunders
    assert wrong.label.name == "coordinates of control point '25'"
    assert wrong.size == pytest.approx(40.0, abs=3.0)  # 4 m
    fewer = search_block(bad, "conformal").block
    assert {tie.photo for tie in fewer.ties if tie.id == "25"} == {"VII", "VIII", "XI", "XII"}


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
def test_several_are_named_and_no_others(seed: int) -> None:
    """Four of the 40 points of the block, 40 to 90 px, in different corners of it."""
    _, block = textbook_block("conformal", 0.5, seed)
    bad = [("1", "I", 60.0), ("15", "IV", -40.0), ("28", "IX", 90.0), ("C", "VI", 50.0)]
    spoilt = block
    for point, photo, size in bad:
        spoilt = moved(spoilt, point, photo, (size, 0.5 * size))
    assert {each.label.id for each in search_block(spoilt, "conformal").findings.blunders} == {
        point for point, _, _ in bad
    }


@pytest.mark.parametrize(
    "kind", ["affine", *(pytest.param(k, marks=pytest.mark.slow) for k in ("conformal", "projective"))]
)
def test_nothing_is_named_in_good_blocks(kind: str) -> None:
    """Ten blocks of 0.5 px noise; and with sigmas that are wrong by ten."""
    for seed in range(10):
        _, block = textbook_block(kind, 0.5, seed, sigma=5.0 if seed % 2 else None)
        assert not search_block(block, kind).findings.blunders


def test_what_the_redundancy_hides_is_said() -> None:
    """Projective, redundancy 8: only large errors can be found, and it says how large; without redundancy none."""
    _, block = textbook_block("projective", 0.5, 1)
    found = search_block(block, "projective").findings
    assert found.redundancy == 8
    assert found.minimal_detectable > 10.0
    conformal = search_block(textbook_block("conformal", 0.5, 1)[1], "conformal").findings
    assert conformal.minimal_detectable < 6.0
    four = [(100, 100), (4900, 100), (4900, 3900), (100, 3900)]
    points = tuple(Control(str(k), 0.1 * c, -0.1 * r, "I", c, r) for k, (c, r) in enumerate(four))
    alone = search_each_photo(PlanarBlock(block.photos[:1], (), points), "projective").findings
    assert (alone.redundancy, alone.minimal_detectable, len(alone.unchecked)) == (0, np.inf, 4)


def test_a_blunder_that_breaks_the_projective_adjustment_is_named_all_the_same() -> None:
    """It would be blamed on relief: the affine adjustment shows it."""
    _, block = textbook_block("projective", 0.2, 5)
    bad = moved(block, "C", "VI", (2500.0, 900.0))
    with pytest.raises((SolveError, InputError)) as told:
        adjust_checked(bad, "projective")
    assert "'C' in VI" in str(told.value)


def test_uncontrolled_blocks_are_looked_at_by_their_ties() -> None:
    """Ties alone: the photo in the middle is held."""
    _, block = textbook_block("conformal", 0.5, 6)
    free = PlanarBlock(block.photos, block.ties)
    assert not search_any_adjustment(free, "conformal", True).findings.blunders
    looked = search_any_adjustment(moved(free, "12", "III", (0.0, 45.0)), "conformal", True)
    (wrong,) = looked.findings.blunders
    assert wrong.label.images == ("III", "VII")
    assert len(looked.block.ties) == len(free.ties) - 1


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "least"), [("conformal", (1.0, 1.0, 1.0)), ("affine", (1.0, 0.95, 0.7))])
def test_share_that_is_named(kind: str, least: tuple[float, ...]) -> None:
    """One measurement of the textbook's block moved by 100, 20 and 8 px, 30 blocks each: it is named, and nothing else.

    The table of the docs: `pytest -m slow -rP -k share_that_is_named`.
    """
    for size, wanted in zip((100.0, 20.0, 8.0), least, strict=True):
        named = 0
        for seed in range(30):
            _, block = textbook_block(kind, 0.5, seed)
            random = np.random.default_rng(1000 + seed)
            chosen, angle = random.choice(block.measurements), random.uniform(0.0, 2.0 * np.pi)
            bad = moved(block, chosen.id, chosen.photo, (size * np.cos(angle), size * np.sin(angle)))
            named += [each.label.id for each in search_block(bad, kind).findings.blunders] == [chosen.id]
        print(f"{kind}, {size:g} px: {named / 30:.0%}")
        assert named / 30 >= wanted
