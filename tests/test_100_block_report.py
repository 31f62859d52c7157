"""The facts and the report page of a block adjustment."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from block_rig import adjust_block, grid_block, problem
from html_rig import Page

from geomosaic.orientation.block.facts import block_facts
from geomosaic.orientation.block.residual_pattern import residual_pattern
from geomosaic.orientation.block.solution import BlockSolution
from geomosaic.report.block import render_block, warnings
from geomosaic.report.block_figures import block_figures


@pytest.fixture(scope="module")
def solution() -> BlockSolution:
    """A block with a gross error in an image, a control point of wrong height, and check points."""
    block = grid_block(2, 4, 60, seed=3)
    measured, ids = block.colrow + block.noise, tuple(f"P{k}" for k in range(len(block.points)))
    rays = np.bincount(block.point, minlength=len(ids))
    wrong = np.flatnonzero((rays[block.point] >= 4) & (block.point >= 6))[0]
    measured[wrong] += [40.0, -30.0]
    given = block.points[block.control] + 0.0
    given[2, 2] += 4.0
    known, check = np.full_like(block.points, np.nan), np.zeros(len(ids), dtype=bool)
    check[np.flatnonzero(rays >= 3)[-20:]] = True
    known[block.control] = block.frame.to_ground(given)
    known[check] = block.frame.to_ground(block.points[check])
    return BlockSolution(adjust_block(*problem(block, colrow=measured, given=given)), ids, known, check)


def test_the_facts_of_a_block_add_up(solution: BlockSolution) -> None:
    facts = block_facts(solution)
    json.dumps(facts)
    positions = facts["observations"][0]
    assert positions["used"] == sum(image["points"] for image in facts["images"])
    assert positions["rejected"] == sum(image["rejected"] for image in facts["images"]) == 1
    assert sum(n * int(rays) for rays, n in facts["points"]["rays"].items()) == positions["used"]
    assert sum(group["redundancy"] for group in facts["observations"]) == pytest.approx(facts["redundancy"])
    assert facts["sigma0_as_expected"]
    assert {blunder["cause"].split(" by ")[0] for blunder in facts["blunders"]} == {"", "its height is wrong"}
    assert [point["id"] for point in facts["control"]["points"] if point["rejected"]] == ["P2"]
    assert facts["parts"] == [list(solution.images)]


def test_the_facts_of_a_block_tell_its_reliability(solution: BlockSolution, page: str) -> None:
    facts = block_facts(solution)
    positions, control = facts["observations"][:2]
    assert 4.0 * 0.3 < positions["detectable"]["median"] < positions["detectable"]["worst"]
    assert positions["unchecked"] == np.isinf(solution.reliability[0].detectable).sum() > 0
    of_points = [point["detectable"] for point in facts["control"]["points"] if not point["rejected"]]
    assert control["detectable"]["worst"] == max(of_points)
    shifts = [each["shift"] for each in facts["least_reliable"]]
    assert shifts == sorted(shifts, reverse=True)
    assert facts["least_reliable"][0]["point"] in page.split("Least reliable measurements")[1]


def test_what_check_points_allow_to_say_depends_on_their_number(solution: BlockSolution) -> None:
    said = " ".join(block_facts(solution)["checks"]["statements"])
    assert "horizontal accuracy at 95% confidence level (NSSDA)" in said
    assert "vertical accuracy at 95% confidence level (NSSDA)" in said
    assert "not tested after ASPRS Edition 2: it asks for 30 check points, there are 20" in said
    assert "RMSE_V" not in said


def test_a_lens_error_shows_in_the_mean_residuals_over_the_format_and_noise_does_not() -> None:
    random = np.random.default_rng(1)
    colrow = random.uniform([0, 0], [6000, 4000], (5000, 2))
    noise = 0.3 * random.normal(size=colrow.shape)
    assert not residual_pattern(colrow, noise, (6000, 4000)).systematic
    out = (colrow - [3000, 2000]) / 3600
    pattern = residual_pattern(colrow, noise + 0.1 * out * (out**2).sum(axis=1)[:, None], (6000, 4000))
    assert pattern.systematic
    corners = pattern.mean[[0, 0, -1, -1], [0, -1, 0, -1]]
    assert ((corners * [[-1, -1], [1, -1], [-1, 1], [1, 1]]).sum(axis=1) > 0.0).all()


def test_the_movement_along_the_weakest_direction_is_one_standard_deviation(solution: BlockSolution) -> None:
    """Seen from the dense cofactors: no image moves by more than its own standard deviations say."""
    _, movements = solution.weakest()
    worst, most = movements[0]
    image = solution.images.index(worst)
    steps = solution.models[image].parameters.steps
    sigmas = np.sqrt(np.diagonal(solution.covariance(image)))
    assert 0.3 * np.max(sigmas / steps) < most < np.max(sigmas / steps) * (1 + 1e-6)


@pytest.fixture(scope="module")
def page(solution: BlockSolution) -> str:
    return render_block({**block_facts(solution), "described": "8 frame photos"}, block_figures(solution), "hills")


def test_the_page_of_a_block_shows_what_its_reader_asks_for(solution: BlockSolution, page: str) -> None:
    facts = block_facts(solution)
    assert "script" not in Page(page).tags
    assert "://" not in page
    assert f"{solution.adjustment.sigma0:.3f}" in page
    assert "its height is wrong by +" in page
    assert all(f"<td>{image}</td>" in page for image in solution.images)
    for words in ("8 frame photos", "within the 99 % bounds", "east, m", "NSSDA", "no pattern", "cm"):
        assert words.lower() in page.lower()
    for blunder in facts["blunders"]:
        assert f"<td>{blunder['point']}</td>" in page


def test_check_points_that_contradict_their_standard_deviations_are_noted(solution: BlockSolution) -> None:
    facts = block_facts(solution)
    assert not [note for note in warnings(facts) if "Check points" in note]
    for point in facts["checks"]["points"]:
        point["errors"][2] += 4.0 * point["sigmas"][2]
    (note,) = [note for note in warnings(facts) if "Check points" in note]
    assert "off in height by" in note


def test_check_points_may_be_off_by_as_much_as_they_were_given_to(solution: BlockSolution) -> None:
    """The block knows them in plan to some centimetres, the table to 0.3 m."""
    random = np.random.default_rng(7)
    given = solution.given + np.where(solution.check[:, None], 0.3 * random.normal(size=solution.given.shape), 0.0)
    worse = replace(solution, given=given, sigma_given=np.full_like(given, 0.3))
    assert not [note for note in warnings(block_facts(worse)) if "Check points" in note]
    (note,) = [note for note in warnings(block_facts(replace(solution, given=given))) if "Check points" in note]
    assert "off in plan by" in note


def test_blunders_of_camera_positions_are_listed_in_metres(solution: BlockSolution) -> None:
    facts = block_facts(solution)
    facts["blunders"][0] |= {
        "kind": "camera positions",
        "image": "s1p1",
        "point": "",
        "size": [8.0, 1.0, 0.0],
        "unit": "m",
    }
    page = render_block(facts, block_figures(solution), "block", ())
    assert re.search(r"<td>camera positions</td><td>s1p1</td><td[^>]*>8.00,  1.00,  0.00 m</td>", page)


def test_names_in_a_block_cannot_become_part_of_its_page(solution: BlockSolution) -> None:
    facts, evil = block_facts(solution), "<script>alert(1)</script>"
    facts["blunders"][0] |= {"point": evil, "cause": evil}
    facts["images"][0]["name"] = evil
    text = render_block({**facts, "described": evil}, block_figures(solution), evil, [evil])
    assert "script" not in Page(text).tags


def test_ellipses_and_errors_are_drawn_to_their_stated_scales(solution: BlockSolution) -> None:
    drawn = block_figures(solution).map
    length, words = drawn.bars["errors"]
    metres = float(words.split()[0]) * {"mm": 1e-3, "cm": 1e-2, "m": 1.0}[words.split()[1]]
    error = solution.checks.errors[0, :2]
    mark = next(m for m in drawn.marks if m.name == solution.checks.ids[0])
    # Arrows are in the axes of the block, errors in those of the map: the lengths are the same.
    assert np.hypot(mark.dx, mark.dy) / length == pytest.approx(np.hypot(*error) / metres, rel=1e-3)
    # The ellipse of a point at the edge is flat, and its title has the numbers.
    one = max(drawn.ellipses, key=lambda each: each.a)
    a, b = (float(word) for word in one.title.split(": ")[1].split(" m ")[0].split(" × "))
    assert one.a / one.b == pytest.approx(a / b, rel=0.05)
    sigma = drawn.bars["sigmas"]
    metres = float(sigma[1].split()[0]) * {"mm": 1e-3, "cm": 1e-2, "m": 1.0}[sigma[1].split()[1]]
    assert one.a / sigma[0] == pytest.approx(a / metres, rel=0.02)


def test_a_block_is_drawn_with_east_to_the_right_and_north_up(solution: BlockSolution) -> None:
    drawn = block_figures(solution).map
    by_name = {mark.name: mark for mark in drawn.marks}
    places = {name: solution.ground[solution.ids.index(name)] for name in by_name}
    east, north = max(places, key=lambda n: places[n][0]), max(places, key=lambda n: places[n][1])
    assert by_name[east].x == max(mark.x for mark in drawn.marks)
    assert by_name[north].y == min(mark.y for mark in drawn.marks)


def test_cells_of_a_block_tell_where_heights_are_known_worst(solution: BlockSolution) -> None:
    drawn = block_figures(solution).map
    sigmas = solution.point_sigmas[solution.adjustment.state.moving & (solution.rays >= 2), 2]
    metres = float(drawn.median_height.split()[0]) * {"mm": 1e-3, "cm": 1e-2, "m": 1.0}[drawn.median_height.split()[1]]
    assert metres == pytest.approx(np.median(sigmas), rel=0.01)
    # The worst points stand where few images see them, at the edge.
    path = drawn.sigmas[-1][3]
    worst = np.array([[float(v) for v in place.split()] for place in re.findall(r"M([\d. -]+?)h", path)])
    away = np.abs(worst / [drawn.width, drawn.height] - 0.5).max(axis=1)
    assert np.median(away) > 0.3
