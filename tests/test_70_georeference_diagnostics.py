"""What a fit says of control that looked well beforehand: every case run, and the table of the docs made of them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from test_50_control_findings import table_rows

from geomosaic.block import OrientedImage, footprint
from geomosaic.cli.output import translated
from geomosaic.control.coordinate_diagnostics import Diagnostic
from geomosaic.control.parsing import Reading
from geomosaic.control.points import ControlPoints, Origin
from geomosaic.errors import GeomosaicError, SolveError
from geomosaic.geo.crs import parse_crs
from geomosaic.georeferencing import model_trial
from geomosaic.georeferencing.fit_diagnostics import BadControlError, fold_diagnostics
from geomosaic.georeferencing.solution import Solution, solve
from geomosaic.options.control import FitOptions
from geomosaic.render.extent import output_grid
from geomosaic.types import FloatArray

SIZE = (4000, 3000)
CRS = parse_crs("EPSG:32633")


def ground(colrow: FloatArray, bend: float = 0.0) -> FloatArray:
    """Map of a photo with pixels of 0.5 m, turned by 20°; `bend` pixels of paper distortion."""
    c, r = ((colrow - np.array(SIZE) / 2) * 0.5).T
    u, v = (colrow / SIZE - 0.5).T
    angle = np.radians(20.0)
    x, y = c * np.cos(angle) + r * np.sin(angle), c * np.sin(angle) - r * np.cos(angle)
    wave = 0.5 * bend * np.column_stack([np.sin(5 * u) * v, np.cos(4 * v + u)])
    return np.column_stack([612_000 + x, 5_412_000 + y]) + wave


def control(across: int, down: int, part: float = 0.95, bend: float = 0.0, noise: float = 0.3) -> ControlPoints:
    """Points in rows over a part of the image, shaken, measured within `noise` pixels."""
    random = np.random.default_rng(5)
    t, u = np.linspace(-0.5, 0.5, across) * part, np.linspace(-0.5, 0.5, down) * part
    c, r = np.meshgrid(t, u)
    colrow = (np.column_stack([c.ravel(), r.ravel()]) + 0.5) * SIZE
    colrow += random.uniform(-60, 60, colrow.shape) * part
    count = len(colrow)
    return ControlPoints(
        tuple(f"P{i}" for i in range(count)),
        colrow + random.normal(0.0, noise, colrow.shape),
        ground(colrow, bend),
        CRS,
        np.ones(count),
        ("control",) * count,
        np.ones(count, dtype=bool),
        tuple(Origin("points.csv", i + 2) for i in range(count)),
    )


def moved(points: ControlPoints, which: list[int], by: float = 150.0) -> ControlPoints:
    """Points that were measured elsewhere."""
    colrow = points.colrow.copy()
    colrow[which] += np.random.default_rng(2).uniform(0.3, 1.0, (len(which), 2)) * by
    return replace(points, colrow=np.clip(colrow, 0, SIZE))


def on_a_line() -> ControlPoints:
    points = control(6, 1)
    colrow = np.column_stack([np.linspace(200, 3800, 6), np.linspace(300, 2700, 6)])
    return replace(points, colrow=colrow, ground=ground(colrow))


def on_a_slope(points: ControlPoints) -> ControlPoints:
    """Those in the right half stand on a slope that displaces them."""
    share = np.maximum(points.colrow[:, 0] / SIZE[0] - 0.52, 0.0)
    return replace(points, colrow=points.colrow + np.column_stack([-60.0 * share, 25.0 * share]))


def few(count: int, wrong: dict[int, tuple[float, float]], tilt: float = 2e-5) -> ControlPoints:
    """The corners, the middle and the sides of an oblique photo; some points measured elsewhere."""
    share = [[0.06, 0.06], [0.94, 0.08], [0.05, 0.95], [0.94, 0.93], [0.5, 0.48], [0.52, 0.07], [0.07, 0.5], [0.9, 0.5]]
    colrow = np.array(share[:count]) * SIZE
    flat = ground(colrow) - (612_000, 5_412_000)
    places = flat / (1.0 + tilt * flat[:, :1] - 1.5 * tilt * flat[:, 1:]) + (612_000, 5_412_000)
    colrow += np.random.default_rng(6).normal(0.0, 0.3, colrow.shape)
    for index, shift in wrong.items():
        colrow[index] += shift
    points = control(count, 1)
    return replace(points, colrow=colrow, ground=places)


def exchanged() -> ControlPoints:
    points = few(4, {})
    return replace(points, colrow=points.colrow[[1, 0, 2, 3]])


def lens(across: int, down: int, barrel: float, power: int) -> ControlPoints:
    """Points to the very corners of a photo under lens distortion; measured within 0.3 px."""
    colrow = np.stack(np.meshgrid(np.linspace(20, 3980, across), np.linspace(20, 2980, down)), axis=2).reshape(-1, 2)
    flat = colrow - np.array(SIZE) / 2
    bent = flat * (1.0 + barrel * (np.hypot(*flat.T) / 2500.0)[:, None] ** power)
    measured = colrow + np.random.default_rng(4).normal(0.0, 0.3, colrow.shape)
    return replace(control(across, down), colrow=measured, ground=ground(bent + np.array(SIZE) / 2))


def scattered() -> ControlPoints:
    points = control(4, 3)
    return replace(points, colrow=points.colrow + np.random.default_rng(3).normal(0.0, 120.0, points.colrow.shape))


def with_checks(points: ControlPoints, judges: list[int], wrong: list[int], by: float = 60.0) -> ControlPoints:
    """Some of the points judge, and some of these were measured elsewhere."""
    roles = tuple("check" if i in judges else "control" for i in range(len(points)))
    return moved(replace(points, roles=roles), wrong, by)


CASES: dict[str, tuple[str, ControlPoints, str, dict[str, float]]] = {
    "one blunder of 12": ("`blunder` (error)", moved(control(4, 3), [7]), "affine", {}),
    "30 % of 20": ("`blunder` (error)", moved(control(5, 4), [1, 4, 8, 10, 15, 19]), "affine", {}),
    "one of 30 that a spline would follow": ("`blunder` (error)", moved(control(6, 5, bend=30.0), [13]), "tps", {}),
    "30 % of 30 that a spline would follow": (
        "`blunder` (error)",
        moved(control(6, 5, bend=30.0), [0, 4, 9, 11, 14, 18, 21, 26, 29]),
        "tps",
        {},
    ),
    "one that a rich polynomial would follow": ("`blunder` (error)", moved(control(6, 5), [8]), "poly5", {}),
    "one of 7 in an oblique photo": ("`blunder` (error)", few(7, {5: (60.0, 10.0)}), "auto", {}),
    "one of 6 in an oblique photo": ("`contradiction` (error)", few(6, {1: (12.0, -90.0)}), "auto", {}),
    "one of 5": ("`blunder` (error)", few(5, {3: (60.0, 10.0)}, tilt=0.0), "auto", {}),
    "one of 4": ("`blunder` (error)", few(4, {3: (60.0, 10.0)}, tilt=0.0), "auto", {}),
    "four of an oblique photo": ("`no-redundancy` (warning)", few(4, {}), "auto", {}),
    "two of 4 exchanged": ("`large-errors` (error)", exchanged(), "auto", {}),
    "good points of a strongly distorted photo": ("`bent` (warning)", lens(12, 9, 0.12, 4), "auto", {}),
    "points of nothing": ("`large-errors` (error)", scattered(), "affine", {}),
    "a wrong check point": (
        "`check-point` (warning)",
        with_checks(control(5, 4), [2, 6, 9, 13, 17], [9]),
        "affine",
        {},
    ),
    "one check point, and that wrong": (
        "`check-point` (warning)",
        with_checks(control(5, 4), [9], [9]),
        "affine",
        {},
    ),
    "a small one": ("`blunder` (warning)", moved(control(5, 4), [8], by=5.0), "affine", {}),
    "too poor a fit": ("`poor-fit` (warning)", control(6, 5, bend=30.0), "affine", {}),
    "too rich a fit": ("`poor-fit` (warning)", control(6, 5), "poly5", {}),
    "half of them on a slope": ("`misfit` (warning)", on_a_slope(control(6, 5)), "affine", {}),
    "turned over where no points are": ("`folded` (error)", control(6, 5, part=0.3, noise=1.5), "poly5", {}),
    "a threshold out of reach": ("`threshold-not-reached` (warning)", control(4, 3), "affine", {"threshold": 0.02}),
    "on a line, insisted": ("refused", on_a_line(), "affine", {}),
}
"""What it is called, the finding looked for, points, model and what else is asked."""


@cache
def findings(name: str) -> list[Diagnostic]:
    """Findings of a case."""
    _, points, model, more = CASES[name]
    return found(points, model, more)


def found(points: ControlPoints, model: str, more: dict[str, float]) -> list[Diagnostic]:
    """Findings of a fit and its picture."""
    request = FitOptions(model, insist=True, **more)
    solved = solve(Reading(points, "csv"), "photo.tif", SIZE, CRS, request, None, "m", 1 << 30)
    outline = footprint(OrientedImage("photo", "photo.tif", "planar", solved.fit.model), None, CRS)
    return [*solved.diagnostics, *fold_diagnostics(solved.fit.model, solved.fit.xyz, output_grid(CRS, [outline], 5.0))]


def row(name: str) -> str:
    """Line of the table of the docs."""
    wanted = CASES[name][0]
    try:
        diagnostics = findings(name)
    except GeomosaicError as error:
        cells = ("refused", error.what, error.hint or "")
    else:
        seen = {f"`{a.code}` ({a.severity})": a for a in diagnostics}
        assert wanted in seen, (name, list(seen))
        cells = (wanted, seen[wanted].what, seen[wanted].hint)
    assert cells[0] == wanted, name
    finding, what, hint = cells
    return " | ".join(["| " + name, finding, *(translated(text, "georeference") for text in (what, hint))]) + " |"


@pytest.mark.ci
def test_every_case_is_found_and_the_docs_show_what_is_said():
    """All bad control in one table: what is found before a fit, and what the fit shows."""
    table = "\n".join(["| control | finding | message | hint |", "|---|---|---|---|", *table_rows(), *map(row, CASES)])
    page = (Path(__file__).resolve().parent.parent / "docs" / "control.md").read_text(encoding="utf-8")
    assert table in page, f"docs/control.md should have this table:\n{table}"


def test_the_blunders_named_are_those_made():
    for name, wrong in (
        ("one blunder of 12", [7]),
        ("30 % of 20", [1, 4, 8, 10, 15, 19]),
        ("one of 30 that a spline would follow", [13]),
        ("30 % of 30 that a spline would follow", [0, 4, 9, 11, 14, 18, 21, 26, 29]),
        ("one that a rich polynomial would follow", [8]),
        ("one of 7 in an oblique photo", [5]),
        ("one of 5", [3]),
        ("a small one", [8]),
    ):
        named = next(a.points for a in findings(name) if a.code == "blunder")
        assert named == tuple(f"P{i}" for i in wrong), name


@pytest.mark.parametrize("model", ["conformal", "affine", "projective", "poly2"])
def test_of_good_control_nothing_is_said(model):
    assert found(control(6, 5), model, {}) == []


def solved(points: ControlPoints, **options: object) -> Solution:
    """What a request makes of control."""
    request = FitOptions(**{"model": "auto", **options})
    return solve(Reading(points, "csv", ()), "scan.tif", SIZE, CRS, request, None, "m", 1 << 30)


def bent_control() -> ControlPoints:
    """Twenty points of a map bent by an order of 2, the eighth of them 25 px off."""
    points = control(5, 4, noise=0.3)
    u, v = (points.colrow / SIZE - 0.5).T
    bend = 60.0 * np.column_stack([u * v, u**2])
    bend[7] += [25.0, 0.0]
    return replace(points, colrow=points.colrow + bend)


def test_a_blunder_that_a_spline_would_follow_is_named() -> None:
    points = bent_control()
    with pytest.raises(BadControlError) as caught:
        solved(points)
    assert {name for found in caught.value.diagnostics if found.severity == "error" for name in found.points} == {"P7"}
    fit = solved(points, robust=True).fit
    assert set(points.names) - set(fit.ids) == {"P7"}


def test_deletion_with_a_chosen_model_takes_only_the_blunder() -> None:
    done = solved(bent_control(), threshold=1.0)
    assert done.deletion is not None
    assert [row.id for row in done.deletion.deleted] == ["P7"]
    assert done.model == "poly2"


def test_errors_that_are_large_for_the_image_are_reported() -> None:
    points = control(4, 3)
    random = np.random.default_rng(3)
    points = replace(points, colrow=points.colrow + random.normal(0.0, 120.0, points.colrow.shape))
    assert "large-errors" in [found.code for found in solved(points, model="affine", insist=True).diagnostics]
    assert "large-errors" not in [found.code for found in solved(control(4, 3), model="affine").diagnostics]


def test_many_points_are_fitted_without_a_spline_and_it_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_trial, "MOST_SPLINED", 24)
    points = control(5, 5, bend=30.0)
    found = solved(points)
    assert "no-spline" in {each.code for each in found.diagnostics}
    assert found.choice is not None
    assert "tps" not in {row.name for row in found.choice.table}
    assert solved(points, model="tps").model == "tps"


def test_a_spline_that_the_memory_does_not_hold_is_refused_with_what_else_serves() -> None:
    points = control(5, 5, bend=30.0)
    reading, memory = Reading(points, "csv", ()), model_trial.SPLINE_BYTES * 24**2
    with pytest.raises(SolveError, match="25 points") as raised:
        solve(reading, "scan.tif", SIZE, CRS, FitOptions("tps"), None, "m", memory)
    assert all(word in str(raised.value.hint) for word in ("thin out", "model=poly3", "memory_limit"))
    found = solve(reading, "scan.tif", SIZE, CRS, FitOptions(), None, "m", memory)
    assert "no-spline" in {each.code for each in found.diagnostics}


def test_a_spline_leaves_blunders_out_where_asked_to() -> None:
    """One, and 30 % of 30, in an image bent by 30 px: left out with --robust; the rest is the same spline."""
    for wrong in ([13], [0, 4, 9, 11, 14, 18, 21, 26, 29]):
        points = moved(control(6, 5, bend=30.0), wrong)
        names = {f"P{i}" for i in wrong}
        done = solved(points, model="tps", robust=True)
        assert {name for name, state in zip(points.names, done.states, strict=True) if state == "suspect"} == names
        assert not [found for found in done.diagnostics if found.severity == "error"]
        assert "contradict" in done.blunder_summary
        clean = solved(points.without(sorted(names)), model="tps")
        assert done.fit.model.parameters.values == pytest.approx(clean.fit.model.parameters.values)


def test_auto_chooses_as_if_blunders_were_not_there() -> None:
    for wrong in ([7], [1, 4, 8, 10, 15, 19]):
        points = control(5, 4)
        clean = solved(points.without([f"P{i}" for i in wrong]))
        assert solved(moved(points, wrong), robust=True).model == clean.model
        with pytest.raises(BadControlError) as caught:
            solved(moved(points, wrong))
        named = {name for found in caught.value.diagnostics if found.severity == "error" for name in found.points}
        assert named == {f"P{i}" for i in wrong}


@pytest.mark.parametrize("count", [4, 5, 6, *(pytest.param(count, marks=pytest.mark.slow) for count in (7, 8))])
def test_no_blunder_is_named_in_a_small_set_of_good_points(count: int) -> None:
    for tilt in (0.0, 1e-6, 2e-5, 1e-4):
        for model in ("auto", "conformal", "affine")[: 1 + 2 * (tilt == 0.0)]:
            told = solved(few(count, {}, tilt), model=model).diagnostics
            assert not [found for found in told if found.severity == "error"], (tilt, model, told)
            assert not {"blunder", "contradiction"} & {found.code for found in told}, (tilt, model, told)


def test_a_shift_of_all_check_points_makes_none_of_them_wrong() -> None:
    points = with_checks(control(5, 4), [2, 6, 9, 13, 17], [])
    shift = np.array([6.0 if role == "check" else 0.0 for role in points.roles])
    done = solved(replace(points, ground=points.ground + shift[:, None]), model="affine")
    assert "check-point" not in [found.code for found in done.diagnostics]
    assert done.check is not None
    assert done.check.shifted


def test_a_corner_that_only_the_spline_misses_is_no_blunder() -> None:
    """Lens distortion of 125 px, points to the very corners: a spline misses them, a polynomial does not."""
    colrow = np.stack(np.meshgrid(np.linspace(20, 3980, 12), np.linspace(20, 2980, 9)), axis=2).reshape(-1, 2)
    flat = colrow - np.array(SIZE) / 2
    bent = flat * (1.0 + 0.05 * (np.hypot(*flat.T) / 2500.0)[:, None] ** 4)
    points = control(12, 9)
    measured = colrow + np.random.default_rng(4).normal(0.0, 0.3, colrow.shape)
    told = solved(replace(points, colrow=measured, ground=ground(bent + np.array(SIZE) / 2)), model="tps").diagnostics
    assert "error" not in [found.severity for found in told]
