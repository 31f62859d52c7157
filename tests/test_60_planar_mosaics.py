"""Uncontrolled, controlled and grown mosaics: what joins photos, what the joins add up to, what is refused."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from planar_rig import GSD, PHOTOS, SIZE, centre, textbook_block, to_pixels

from geomosaic.errors import GeomosaicWarning, SolveError
from geomosaic.inputs import planar_block
from geomosaic.options.inputs import PlanarInputs
from geomosaic.orientation.planar.determinacy import elongation
from geomosaic.orientation.planar.measurements import Control, PlanarBlock, PlanarPhoto, Tie
from geomosaic.orientation.planar.sequential import LONGEST, fit_single, grow
from geomosaic.orientation.planar.simultaneous import adjust
from geomosaic.orientation.planar.solution import joins
from geomosaic.orientation.planar.uncontrolled import chain, compare, middle, rectify_singly, reference


def azimuth_and_scale(transform: object) -> tuple[float, float]:
    """Direction of a photo's top, clockwise from north in degrees, and map units per pixel, by two points."""
    down, up = transform.to_ground(np.array([[100.0, 1100.0], [100.0, 100.0]]))
    east, north = up - down
    return float(np.degrees(np.arctan2(east, north))), float(np.hypot(east, north) / 1000)


# --- Uncontrolled ----------------------------------------------------------------------------------------------------


def test_a_chain_starts_in_the_middle_and_goes_outwards() -> None:
    """Of three rows of four photos it starts in the middle row; no photo comes before one of a nearer ring."""
    _, block = textbook_block("conformal")
    assert middle(block) in ("VI", "VII")
    made = chain(block)
    rings = [made.steps[name] for name in made.transforms]
    assert made.start == next(iter(made.transforms)) == "VI"
    assert rings == sorted(rings)
    assert max(rings) == 2
    assert list(made.transforms) == [one.photo for one in made.attachments]


@pytest.mark.parametrize("azimuth", [0.0, 90.0, -130.0])
def test_scale_and_azimuth_are_those_given(azimuth: float) -> None:
    """The start photo has them, and without noise the whole is the truth, turned and scaled."""
    truth, block = textbook_block("conformal")
    made = chain(block, scale=0.25, azimuth=azimuth)
    assert azimuth_and_scale(made.transforms["VI"]) == pytest.approx((azimuth, 0.25), abs=1e-9)
    assert np.allclose(made.transforms["VI"].centre(), 0.0, atol=1e-9)
    true_scale = np.hypot(*truth["VI"][:2, 0])
    ours = [made.transforms[name].centre() for name in ("I", "XII")]
    assert np.hypot(*(ours[1] - ours[0])) == pytest.approx(
        np.hypot(*(centre("XII") - centre("I"))) * 0.25 / true_scale, rel=1e-9
    )


def line_of_ties(sideways: float, seed: int = 0) -> PlanarBlock:
    """Two photos side by side, ties in a strip along their seam with a standard deviation of `sideways` pixels."""
    random = np.random.default_rng(seed)
    rows = np.linspace(300, 3700, 12)
    cols = 4600 + sideways * random.normal(size=12)
    noise = 0.5 * random.normal(size=(2, 12, 2))
    first = np.column_stack([cols, rows]) + noise[0]
    second = np.column_stack([cols - 4200, rows + 30]) + noise[1]
    ties = [Tie(str(k), "left", *xy, 0.5) for k, xy in enumerate(first)]
    ties += [Tie(str(k), "right", *xy, 0.5) for k, xy in enumerate(second)]
    return PlanarBlock((PlanarPhoto("left", SIZE), PlanarPhoto("right", SIZE)), tuple(ties))


@pytest.mark.parametrize("kind", ["affine", "projective"])
def test_ties_nearly_in_a_line_are_joined_conformally(kind: str) -> None:
    """Affine and projective are refused there with the condition number, and the photo is conformal; it says so."""
    made = chain(line_of_ties(40.0), kind)
    right = made.attachments[1]
    assert right.kind == "conformal"
    assert f"condition number is {right.elongation:.3g}" in right.refused
    assert right.elongation > LONGEST[kind]
    assert azimuth_and_scale(made.transforms["right"]) == pytest.approx((0.0, 1.0), abs=0.05)
    assert chain(line_of_ties(700.0), kind).attachments[1].kind == kind


def test_the_refusal_is_earned() -> None:
    """What is refused would have put the far side of the photo wrong by tens of pixels; the conformal fit does not."""
    far, place = np.array([[4900.0, 2000.0]]), np.array([4900.0 + 4200.0 - 2500.0, 2000.0 - (2000.0 - 30.0)])
    worst: dict[str, list[float]] = {"affine": [], "conformal": []}
    for seed in range(20):
        block = line_of_ties(6.0, seed)
        left = {tie.id: tie for tie in block.ties if tie.photo == "left"}
        points = [
            Control(t.id, left[t.id].col - 2500, 2000 - left[t.id].row, "right", t.col, t.row, 0.5)
            for t in block.ties
            if t.photo == "right"
        ]
        with pytest.raises(SolveError, match=r"nearly on a line: their condition number is \d+") as told:
            fit_single(block.photo("right"), points, "affine")
        assert "choose conformal" in str(told.value.hint)
        for kind, found in worst.items():
            model = fit_single(block.photo("right"), points, kind, {}).transforms["right"]
            found.append(float(np.hypot(*(model.to_ground(far)[0] - place))))
    assert np.sqrt(np.mean(np.square(worst["affine"]))) > 40.0
    assert np.sqrt(np.mean(np.square(worst["conformal"]))) < 1.5


def test_elongation_is_a_condition_number() -> None:
    """Even spread 1, a strip its ratio, a line infinite."""
    square = np.array([[0.0, 0.0], [1000.0, 0.0], [1000.0, 1000.0], [0.0, 1000.0]])
    assert elongation(SIZE, square) == pytest.approx(1.0)
    assert elongation(SIZE, square * [1.0, 0.1]) == pytest.approx(10.0)
    assert elongation(SIZE, square * [1.0, 0.0]) == np.inf


def test_photos_that_do_not_hang_together_are_named() -> None:
    """Pieces without common points, and a photo with one common point only."""
    _, block = textbook_block("conformal")
    without = tuple(tie for tie in block.ties if tie.photo != "XII")
    with pytest.raises(SolveError, match="2 pieces that share no point; one is XII"):
        chain(PlanarBlock(block.photos, without))
    one = (*without, next(tie for tie in block.ties if tie.photo == "XII"))
    with pytest.raises(SolveError, match="photo 'XII' shares 1 point "):
        chain(PlanarBlock(block.photos, one))
    with pytest.raises(SolveError, match="not positive"):
        chain(block, scale=0.0)


# --- What the joins add up to ----------------------------------------------------------------------------------------


def strip(count: int, seed: int) -> PlanarBlock:
    """A strip of photos, eight ties in each overlap, 0.5 px of noise, control in the first and the last photo."""
    random = np.random.default_rng(seed)
    photos = tuple(PlanarPhoto(f"p{k:02}", SIZE) for k in range(count))
    ties, control = [], []

    def measured(k: int, x: float, y: float) -> tuple[float, float]:
        return tuple(np.array([x - 3500.0 * k, y]) + 0.5 * random.normal(size=2))

    for k in range(count - 1):
        for n in range(8):
            x, y = 3500.0 * (k + 1) + random.uniform(100, 1400), 300 + 3400 * (n + random.uniform(0, 1)) / 8
            ties += [Tie(f"{k}-{n}", photos[j].name, *measured(j, x, y), 0.5) for j in (k, k + 1)]
    for k in (0, count - 1):
        for n, (dx, dy) in enumerate(((400.0, 400.0), (4600.0, 3600.0), (400.0, 3600.0), (4600.0, 400.0))):
            x, y = 3500.0 * k + dx, dy
            control.append(Control(f"c{k}-{n}", GSD * x, -GSD * y, photos[k].name, *measured(k, x, y), 0.5))
    return PlanarBlock(photos, tuple(ties), tuple(control))


def test_errors_accumulate_away_from_the_start_and_less_from_the_middle() -> None:
    """Against all photos adjusted together the chain's error grows with the joins; from one end it grows farther."""
    from_middle, from_end, growing = [], [], []
    for seed in range(6):
        block = strip(9, seed)
        made = chain(block, scale=GSD)
        assert made.start == "p04"
        solution, against = reference(block, made, "conformal")
        assert against == "control"
        error = compare(block, made, solution.transforms, against, solution.kind)
        from_middle.append(error.largest)
        growing.append([error.by_step[step] for step in sorted(error.by_step)])
        ended = chain(block, scale=GSD, start="p00")
        from_end.append(compare(block, ended, solution.transforms, against, solution.kind).largest)
        assert error.gaps > 0.0
    rms = np.sqrt(np.mean(np.square(growing), axis=0))
    assert (np.diff(rms) > 0).all()
    assert rms[-1] > 3.0 * rms[1]
    assert np.median(from_end) > 1.5 * np.median(from_middle)


def test_without_control_it_is_held_against_the_ties_alone() -> None:
    """The simultaneous adjustment then holds the start photo; without noise nothing has accumulated."""
    _, noisy = textbook_block("conformal", 0.5, 3)
    free = PlanarBlock(noisy.photos, noisy.ties)
    made = chain(free, scale=GSD)
    solution, against = reference(free, made, "conformal")
    assert (against, solution.kind) == ("ties", "conformal")
    error = compare(free, made, solution.transforms, against, solution.kind)
    assert error.by_photo[made.start] == 0.0
    assert 0.2 < error.best < error.largest
    assert error.gaps_adjusted < error.gaps
    _, exact = textbook_block("conformal")
    made = chain(exact, scale=GSD)
    solution, against = reference(exact, made, "conformal")
    assert compare(exact, made, solution.transforms, against, solution.kind).largest < 1e-6


# --- Controlled ------------------------------------------------------------------------------------------------------


def with_control(kind: str, photos: list[str], noise: float = 0.0) -> PlanarBlock:
    """The block of section 9-8 with five control points more in some photos."""
    truth, block = textbook_block(kind, noise, sigma=0.5)
    random = np.random.default_rng(9)
    more = []
    for photo in photos:
        for k, place in enumerate([(-200, -150), (200, -150), (200, 150), (-200, 150), (20, 10)]):
            colrow = to_pixels(truth[photo], np.array(place)) + noise * random.normal(size=2)
            more.append(Control(f"{photo}-{k}", *(centre(photo) + place), photo, *colrow, 0.5))
    return PlanarBlock(block.photos, block.ties, (*block.control, *more))


def test_photos_rectified_singly_meet_without_ties() -> None:
    """Each by its own control, projective: exact without noise, so that the ties, which took no part, agree."""
    block = with_control("projective", PHOTOS)
    found = rectify_singly(block)
    transforms = {name: solution.transforms[name] for name, solution in found.items()}
    assert max(one.largest for one in joins(block, transforms)) < 1e-6
    together = adjust(block, "projective").transforms
    corners = transforms["V"].corners()
    assert np.allclose(transforms["V"].to_ground(corners), together["V"].to_ground(corners), atol=1e-7)


def test_photos_with_too_little_control_are_all_named() -> None:
    """Four points each for projective transformations."""
    block = with_control("projective", [name for name in PHOTOS if name not in ("II", "X")])
    with pytest.raises(SolveError, match=r"needs 4 control points \(projective\); 'II' has 0, 'X' has 0"):
        rectify_singly(block)


# --- Grown photo by photo --------------------------------------------------------------------------------------------


def test_a_mosaic_grows_from_the_photo_with_the_most_control() -> None:
    """Every photo after the first is held by what is made and by the map; without noise it is the truth."""
    block = with_control("affine", ["XII"])
    grown = grow(block)
    order = list(grown.solutions)
    assert order[0] == "XII"
    assert grown.attachments[0].control == 6
    for one in grown.attachments[1:]:
        assert one.points >= 3
        assert set(one.to) <= set(order[: order.index(one.photo)])
    true = adjust(block, "affine").transforms
    for name, transform in grown.transforms.items():
        assert np.allclose(
            transform.to_ground(transform.corners()), true[name].to_ground(transform.corners()), atol=1e-6
        )
    assert not grown.failed
    checked = {(one.first, one.second) for one in grown.joins}
    assert len(checked) == len(grown.joins) == 29  # every pair of photos with a common point is a join, checked once


def test_a_join_that_does_not_meet_is_reported_with_its_shift_along_the_seam() -> None:
    """Map control that is wrong by 5 pixels along the seam shows in the edge check, in pixels and direction."""
    block = strip(2, 0)
    moved = tuple(
        replace(point, y=point.y + 5 * GSD, sigma=0.02) if point.photo == "p01" else point for point in block.control
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomosaicWarning)
        grown = grow(PlanarBlock(block.photos, block.ties, moved), "conformal", start="p00")
    (join,) = grown.failed
    assert (join.first, join.second, join.points) == ("p00", "p01", 8)
    assert join.along == pytest.approx(5.0, abs=0.7)  # the seam runs north between photos side by side
    assert abs(join.across) < 0.7
    assert not grow(block, "conformal", start="p00").failed


def test_growing_needs_a_photo_to_begin_with() -> None:
    """No photo of the block of section 9-8 has control of its own for it."""
    _, block = textbook_block("affine")
    with pytest.raises(SolveError, match=r"no photo to begin with: '\w+' has 1 control point, the affine .* needs 3"):
        grow(block)


def test_the_textbooks_block_without_its_control_is_adjusted_about_its_start_photo() -> None:
    """Figure 9-6, its 63 connections alone: every photo comes back, in the frame of the one that is held."""
    truth, block = textbook_block("conformal")
    free = PlanarBlock(block.photos, block.ties)
    placed = planar_block.place(free, PlanarInputs("semicontrolled"))
    made = chain(free, "conformal")
    # Two for each connection, of which those of a point in n photos follow from n - 1; four unknowns of each photo but
    # the one that is held.
    independent = 2 * (len(block.ties) - len({tie.id for tie in block.ties}))
    assert (placed.facts["equations"], placed.facts["redundancy"]) == (126, independent - 44)
    corners = np.array([[0.0, 0.0], [5000.0, 0.0], [5000.0, 4000.0], [0.0, 4000.0]])
    homogeneous = np.column_stack([corners, np.ones(4)])
    ours = np.array([placed.transforms[name].to_ground(corners) for name in truth]) @ [1.0, 1j]
    known = np.array([(homogeneous @ truth[name].T)[:, :2] + centre(name) for name in truth]) @ [1.0, 1j]
    held, start = (found[made.start].to_ground(corners) for found in (placed.transforms, made.transforms))
    np.testing.assert_allclose(held, start)
    # One shift, turn and scale lays the whole block on the truth.
    turn, shift = np.polyfit(ours.ravel(), known.ravel(), 1)
    np.testing.assert_allclose(turn * ours + shift, known, atol=1e-6)
