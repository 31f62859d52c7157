"""Blocks of flat photos: known parameters come back, their standard deviations are true, weak blocks are refused."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from planar_rig import CONNECTIONS, GSD, PHOTOS, SIZE, centre, textbook_block

from geomosaic.accuracy.check_points import orientation_verdicts, quality_failure
from geomosaic.errors import GeomosaicWarning, InputError, SolveError
from geomosaic.estimation.statistics import variance_factor
from geomosaic.geo.crs import parse_crs
from geomosaic.inputs.planar_block import model_covariance, place
from geomosaic.inputs.planar_facts import placement_lines
from geomosaic.options.inputs import PlanarInputs, QualityLimits
from geomosaic.orientation.planar import transformations as kinds
from geomosaic.orientation.planar.measurements import Control, PlanarBlock, PlanarPhoto, Tie
from geomosaic.orientation.planar.observation_equations import GROUND, views_of
from geomosaic.orientation.planar.simultaneous import adjust
from geomosaic.orientation.planar.transformations import Frame, PlanarTransform, half
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.registry import build
from geomosaic.sensor.solve.newton import jacobian

KINDS = ("conformal", "affine", "projective")


def true_values(kind: str, matrix: np.ndarray, photo: str, frame: Frame) -> np.ndarray:
    """Parameters in the normalised coordinates of a solution, from a matrix (col, row) → ground less the centre."""
    h = half(SIZE)
    pixels = np.array([[h, 0.0, SIZE[0] / 2], [0.0, -h, SIZE[1] / 2], [0.0, 0.0, 1.0]])
    x, y = (centre(photo) - [frame.x0, frame.y0]) / frame.scale
    ground = np.array([[1 / frame.scale, 0.0, x], [0.0, 1 / frame.scale, y], [0.0, 0.0, 1.0]])
    m = ground @ matrix @ pixels
    m = m / m[2, 2]
    if kind == "conformal":
        return np.array([m[0, 0], m[1, 0], m[0, 2], m[1, 2]])
    return np.array([*m[0], *m[1], *m[2, :2]])[: 6 if kind == "affine" else 8]


@pytest.mark.parametrize("kind", KINDS)
def test_the_sensor_model_of_a_photo_knows_its_positions_as_well_as_the_adjustment(kind: str) -> None:
    """Covariance of the coefficients ground to photo against that of the parameters photo to ground, in positions."""
    solution = adjust(textbook_block(kind, 0.5, 4)[1], kind)
    for photo in ("I", "VII"):
        transform = solution.transforms[photo]
        model = build("planar", SensorRequest(photo, SIZE, transform.options(), parse_crs("EPSG:32633"), "."))
        covariance = model_covariance(model, transform, solution)
        colrow = np.random.default_rng(1).uniform(0, SIZE, (20, 2))
        ground = transform.to_ground(colrow)
        by_values, by_ground = jacobian(model, np.column_stack([ground, np.zeros(20)]))
        on_ground = np.linalg.solve(by_ground[:, :, :2], by_values)
        spread = np.einsum("nip,pq,niq->n", on_ground, covariance, on_ground)
        told = solution.position_sigmas(photo, colrow) * np.sqrt(variance_factor(solution.sigma0, solution.redundancy))
        np.testing.assert_allclose(np.sqrt(spread / 2.0), told, rtol=1e-6)


# --- Equations (9-6) and (9-8) ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_reverse_equations_bring_points_back(kind: str) -> None:
    """(9-6) and (9-8) after (9-1) and (9-7), and the other way round, to 1e-9 pixels and metres.

    That is what the equations say, in the coordinates they are solved in, from the middle of the block. A northing of
    5 500 000 m, read as a number of double precision, has steps of 9e-10 m itself, which are 9e-9 pixels here: a round
    trip through such numbers can be no better than a step, and is no worse than two.
    """
    random = np.random.default_rng(1)
    colrow = random.uniform(-0.2, 1.2, (400, 2)) * SIZE
    frame = Frame(400500.0, 5499700.0, 600.0)
    for photo in PHOTOS:
        truth, block = textbook_block(kind)
        values = true_values(kind, truth[photo], photo, frame)
        local = PlanarTransform(block.photo(photo), kind, Frame(0.0, 0.0, 600.0), values)
        ground = local.to_ground(colrow)
        assert np.abs(local.to_image(ground) - colrow).max() < 1e-9
        assert np.abs(local.to_ground(local.to_image(ground)) - ground).max() < 1e-9
        on_map = PlanarTransform(block.photo(photo), kind, frame, values)
        off = np.abs(on_map.to_image(on_map.to_ground(colrow)) - colrow).max()
        assert off < 2.0 * np.spacing(5.5e6) / GSD
        xy = kinds.reverse(kind, values, kinds.forward(kind, values, colrow / 2500 - 1))
        assert np.abs(xy - (colrow / 2500 - 1)).max() < 1e-13


@pytest.mark.parametrize("kind", KINDS)
def test_the_books_symbols_say_the_same(kind: str) -> None:
    """Parameters by name, put into the equations as they are printed, for x = col and y = height − row."""
    _, block = textbook_block(kind)
    transform = adjust(block, kind).transforms["VII"]
    p, colrow = transform.textbook(), np.array([[1234.5, 987.25], [17.0, 3900.0]])
    x, y = colrow[:, 0], SIZE[1] - colrow[:, 1]
    if kind == "conformal":
        ground = [p["a"] * x - p["b"] * y + p["TX"], p["a"] * y + p["b"] * x + p["TY"]]
    else:
        w = p.get("a3", 0.0) * x + p.get("b3", 0.0) * y + 1.0
        ground = [(p["a1"] * x + p["b1"] * y + p["c1"]) / w, (p["a2"] * x + p["b2"] * y + p["c2"]) / w]
    assert np.allclose(np.column_stack(ground), transform.to_ground(colrow), rtol=0, atol=1e-7)


def test_beyond_the_horizon_there_is_nothing() -> None:
    """A projective transformation is NaN where w ≤ 0, in both directions; its neighbours stay as they are."""
    values = np.array([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.8, 0.0])
    ground = kinds.forward("projective", values, np.array([[-2.0, 0.0], [0.5, 0.5]]))
    assert np.isnan(ground[0]).all()
    assert np.isfinite(ground[1]).all()
    back = kinds.reverse("projective", values, np.array([[2.0, 0.0], ground[1]]))  # seen from x < −1.25 only
    assert np.isnan(back[0]).all()
    assert np.allclose(back[1], 0.5)


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_agree_with_differences(kind: str) -> None:
    """Hand-written derivatives agree with differences."""
    random, step = np.random.default_rng(5), 1e-6
    values = 0.3 * random.normal(size=len(kinds.NAMES[kind]))
    xy = random.uniform(-1, 1, (7, 2))
    for j in range(len(values)):
        change = step * np.eye(len(values))[j]
        slope = (kinds.forward(kind, values + change, xy) - kinds.forward(kind, values - change, xy)) / (2 * step)
        assert np.allclose(kinds.by_parameters(kind, values, xy)[:, :, j], slope, atol=1e-7, equal_nan=True)
    for j in range(2):
        change = step * np.eye(2)[j]
        slope = (kinds.forward(kind, values, xy + change) - kinds.forward(kind, values, xy - change)) / (2 * step)
        assert np.allclose(kinds.by_photo(kind, values, xy)[:, :, j], slope, atol=1e-7, equal_nan=True)


# --- The block of section 9-8 ----------------------------------------------------------------------------------------


def test_the_published_planar_block_comes_back() -> None:
    """33 tie points, 63 connections, 126 equations (9-4), and seven control points, no photo with more than one."""
    _, block = textbook_block("conformal")
    views = views_of(block)
    photos = views.photo[views.pairs]
    between = photos[(photos != GROUND).all(axis=1)]
    assert len(CONNECTIONS) == len(between) == 63
    assert len({tie.id for tie in block.ties}) == 33
    names = {(views.ids[views.point[v]], PHOTOS[a], PHOTOS[b]) for (v, _), (a, b) in zip(views.pairs, photos) if b >= 0}  # noqa: B905
    assert names == set(CONNECTIONS)
    assert len(block.control) == 7 == len({point.photo for point in block.control})
    solution = adjust(block, "conformal")
    assert solution.equations == 126 + 14
    assert solution.redundancy == 90 + 14 - 48  # of the 126, 27 points give 2 and six points in four photos 6 each


@pytest.mark.parametrize("kind", KINDS)
def test_known_parameters_come_back(kind: str) -> None:
    """Without noise, to 1e-9 relative, although no photo could be placed by itself."""
    truth, block = textbook_block(kind)
    solution = adjust(block, kind)
    for photo, values in zip(PHOTOS, solution.values, strict=True):
        true = true_values(kind, truth[photo], photo, solution.frame)
        assert np.abs(values - true).max() < 1e-9 * np.abs(true).max()
    assert max(solution.rms, solution.sigma0) < 1e-9


def normalised_errors(kind: str, seeds: range) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors of all parameters over their computed sigmas, standardised residuals, and sigma0² of trials."""
    errors, residuals, weights = [], [], []
    for seed in seeds:
        truth, block = textbook_block(kind, 0.5, seed)
        solution = adjust(block, kind)
        for photo, values in zip(PHOTOS, solution.values, strict=True):
            errors.append((values - true_values(kind, truth[photo], photo, solution.frame)) / solution.sigmas(photo))
        residuals.append(solution.standardised[~solution.views.is_ground])
        weights.append(solution.sigma0**2)
    return np.array(errors), np.array(residuals), np.array(weights)


@pytest.mark.parametrize(
    ("kind", "trials"),
    [
        pytest.param(kind, trials, marks=() if (kind, trials) == ("affine", 40) else pytest.mark.slow)
        for kind in KINDS
        for trials in (40, 300)
    ],
)
def test_standard_deviations_are_true(kind: str, trials: int) -> None:
    """With 0.5 px noise 99 % of the errors are inside 3 sigma; and the sigmas are not too large either."""
    errors, residuals, weights = normalised_errors(kind, range(trials))
    assert (np.abs(errors) < 3.0).mean() >= 0.99
    # Errors of one trial hang together: the mean square of their own scatters by about 1/√(trials · 8).
    near = 4.0 / np.sqrt(trials * 8)
    assert abs((errors**2).mean() - 1.0) < near
    assert abs(weights.mean() - 1.0) < near
    assert abs(np.nanmean(residuals**2) - 1.0) < near


@pytest.mark.parametrize("kind", ["affine", pytest.param("projective", marks=pytest.mark.slow)])
def test_errors_at_the_corners_are_as_large_as_expected(kind: str) -> None:
    """Actual errors of corners and middles over the expected ones, in many blocks of the same noise."""
    exact = adjust(textbook_block(kind)[1], kind)
    ratios = []
    for seed in range(12):
        found = adjust(textbook_block(kind, 0.5, seed)[1], kind)
        for photo, transform in found.transforms.items():
            places, sigmas = found.expected_errors(photo)
            truth = exact.expected_errors(photo)[0]
            ratios.append(np.hypot(*(places - truth).T) / transform.pixel() / sigmas)
    assert 0.8 < np.sqrt(np.mean(np.square(ratios))) < 1.25


def test_a_block_that_little_holds_says_so() -> None:
    """Twelve photos, tie points and seven control points: projective hardly redundant, with residuals next to none."""
    block = textbook_block("projective", 0.5, 1)[1]
    wanted = PlanarInputs("controlled", ties=Path("ties.csv"), rectify="together")
    facts = place(block, wanted).facts
    assert facts["rms_px"] < 0.15  # of half a pixel of noise in each coordinate
    said = "\n".join(placement_lines(facts))
    assert "of the errors (8 of" in said
    assert "px at the corners of the mosaic" in said
    assert [v["passed"] for v in orientation_verdicts(facts, QualityLimits())] == [False]
    assert "max_corner_sigma_px" in str(
        quality_failure(orientation_verdicts(facts, QualityLimits()), None, "all written")
    )
    sound = place(textbook_block("conformal", 0.5, 1)[1], replace(wanted, kind="semicontrolled", rectify=None)).facts
    assert all(verdict["passed"] for verdict in orientation_verdicts(sound, QualityLimits()))
    assert "of the errors (" not in "\n".join(placement_lines(sound))


def test_equal_weights_for_all_pairs_would_be_wrong() -> None:
    """The same solution as with the points as unknowns: pairs of a point in four photos weigh half of other pairs."""
    _, block = textbook_block("conformal", 0.5, 11)
    solution = adjust(block, "conformal")
    # Written anew: dense, points as unknowns, weights from the scales found.
    ids = list(dict.fromkeys(tie.id for tie in block.ties))
    rows, right, count = [], [], 4 * len(PHOTOS) + 2 * len(ids)
    f = solution.frame
    for measured in (*block.ties, *block.control):
        k = PHOTOS.index(measured.photo)
        a, b = solution.values[k][:2]
        root = half(SIZE) / np.hypot(a, b) / measured.sigma
        # Coefficients at the adjusted place: the measurement less its residual.
        place = np.flatnonzero([solution.views.ids[p] == measured.id for p in solution.views.point])
        view = next(v for v in place if solution.views.photo[v] == k)
        col, row = solution.views.colrow[view] - solution.residuals[view]
        for axis in range(2):
            line = np.zeros(count)
            x, y = (col - SIZE[0] / 2) / half(SIZE), (SIZE[1] / 2 - row) / half(SIZE)
            line[4 * k : 4 * k + 4] = [(x, -y, 1.0, 0.0), (y, x, 0.0, 1.0)][axis]
            misfit = np.array([x, -y, 1, 0]) if axis == 0 else np.array([y, x, 0, 1])
            xm, ym = (measured.col - SIZE[0] / 2) / half(SIZE), (SIZE[1] / 2 - measured.row) / half(SIZE)
            seen = np.array([xm, -ym, 1, 0]) if axis == 0 else np.array([ym, xm, 0, 1])
            target = 0.0
            if isinstance(measured, Control):
                target = ((measured.x, measured.y)[axis] - (f.x0, f.y0)[axis]) / f.scale
            else:
                line[4 * len(PHOTOS) + 2 * ids.index(measured.id) + axis] = -1.0
            rows.append(root * line)
            right.append(root * (target - (seen - misfit) @ solution.values[k]))
    design = np.array(rows)
    unknowns = np.linalg.lstsq(design, np.array(right), rcond=None)[0]
    assert np.allclose(unknowns[:48].reshape(12, 4), solution.values, rtol=0, atol=1e-9)
    cofactors = np.linalg.inv(design.T @ design)
    for k, photo in enumerate(PHOTOS):
        assert np.allclose(np.sqrt(np.diag(cofactors)[4 * k : 4 * k + 4]), solution.sigmas(photo), rtol=1e-6)


def test_uncertain_control_yields() -> None:
    """A control point with a sigma of its own on the ground is left by the photos, one held fixed is not."""
    _, block = textbook_block("affine", 0.0, sigma=0.5)
    moved = [
        Control(c.id, c.x + (3.0 if c.id == "C" else 0.0), c.y, c.photo, c.col, c.row, c.sigma, s)
        for c, s in zip(block.control, [0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 0.0], strict=True)
    ]
    gave = adjust(PlanarBlock(block.photos, block.ties, tuple(moved)), "affine")
    number = gave.views.ids.index("C")
    assert abs(gave.points[number, 0] - moved[2].x) > 1.5
    held = [Control(c.id, c.x, c.y, c.photo, c.col, c.row, c.sigma) for c in moved]
    with pytest.warns(GeomosaicWarning, match="times as large as the standard deviations say"):
        stiff = adjust(PlanarBlock(block.photos, block.ties, tuple(held)), "affine")
    assert stiff.points[number, 0] == pytest.approx(moved[2].x, abs=1e-9)
    worst = int(np.nanargmax(np.abs(stiff.standardised).max(axis=1)))
    assert stiff.views.ids[stiff.views.point[worst]] == "C"  # the blunder has the largest standardised residual


def test_control_measured_in_several_photos_ties_them() -> None:
    """Two photos that share nothing but control points hang together, and the points count once each."""
    truth, block = textbook_block("conformal", 0.0)
    points = [("P", 350.0), ("Q", 150.0)]
    control = []
    for name, up in points:
        place = (centre("I") + centre("II")) / 2 + [0.0, up - 250.0]
        for photo in ("I", "II"):
            h = np.linalg.solve(truth[photo], np.array([*(place - centre(photo)), 1.0]))
            control.append(Control(name, *place, photo, *(h[:2] / h[2]), 0.5, 0.2))
    pair = PlanarBlock(block.photos[:2], (), tuple(control))
    solution = adjust(pair, "conformal")
    assert (solution.redundancy, solution.equations) == (2 * 2 * 2 - 8, 2 * 2 * 3)
    for k, photo in enumerate(("I", "II")):
        assert np.allclose(solution.values[k], true_values("conformal", truth[photo], photo, solution.frame), atol=1e-9)


def test_a_photo_held_fixed_takes_the_part_of_control() -> None:
    """Ties alone, one photo held at its true place: the others come back to theirs."""
    truth, block = textbook_block("affine")
    frame = Frame(400500.0, 5499700.0, 600.0)
    held = PlanarTransform(block.photo("VI"), "affine", frame, true_values("affine", truth["VI"], "VI", frame))
    solution = adjust(PlanarBlock(block.photos, block.ties), "affine", {"VI": held})
    for photo, values in zip(PHOTOS, solution.values, strict=True):
        assert np.allclose(values, true_values("affine", truth[photo], photo, solution.frame), rtol=0, atol=1e-9)
    assert (solution.sigmas("VI") == 0.0).all()
    assert (solution.sigmas("V") > 0.0).all()


# --- Blocks that do not hold their photos ----------------------------------------------------------------------------


def test_what_is_lacking_is_said() -> None:
    """Too little control, photos in pieces, photos with too few points; each with its photo."""
    _, block = textbook_block("conformal")
    with pytest.raises(SolveError, match="1 control point for 12 connected photos"):
        adjust(PlanarBlock(block.photos, block.ties, block.control[:1]), "conformal")
    with pytest.raises(SolveError, match=r"3 control points .* a projective transformation needs 4"):
        adjust(PlanarBlock(block.photos, block.ties, block.control[:3]), "projective")
    apart = tuple(tie for tie in block.ties if tie.photo != "IV" or tie.id == "3")
    with pytest.raises(SolveError, match=r"photo 'IV' shares 2 points .* an affine transformation needs 3"):
        adjust(PlanarBlock(block.photos, apart, block.control), "affine")
    lonely = (*block.photos, PlanarPhoto("XIII", SIZE))
    with pytest.raises(SolveError, match="photo 'XIII' shares 0 points"):
        adjust(PlanarBlock(lonely, block.ties, block.control), "conformal")
    with pytest.raises(SolveError, match="no transformation named 'helmert'"):
        adjust(block, "helmert")


def test_points_on_a_line_are_ill_conditioned() -> None:
    """Ties on one line hold no affine transformation: refused with the condition number and the photo."""
    _, block = textbook_block("conformal")
    line = [Control(f"L{k}", 400000.0 + 100 * k, 5500000.0 + 30 * k, "I", 500.0 + 900 * k, 700.0) for k in range(4)]
    with pytest.raises(SolveError, match=r"affine adjustment is ill-conditioned: condition number .*'I'"):
        adjust(PlanarBlock(block.photos[:1], (), tuple(line)), "affine")


def test_measurements_that_cannot_be_are_refused() -> None:
    """Unknown photos, double measurements, one point at two places, sigmas that are none."""
    photo = PlanarPhoto("a", (100, 100))
    for ties, control, message in (
        ((Tie("1", "b", 1, 1),), (), "not in the block"),
        ((Tie("1", "a", 1, 1), Tie("1", "a", 2, 2)), (), "measured twice"),
        ((Tie("1", "a", np.nan, 1),), (), "not a finite number"),
        ((Tie("1", "a", 1, 1, 0.0),), (), "not positive"),
        ((), (Control("1", 0, 0, "a", 1, 1, 1, -1.0),), "negative"),
    ):
        with pytest.raises(InputError, match=message):
            PlanarBlock((photo,), ties, control)
    two = (photo, PlanarPhoto("c", (100, 100)))
    with pytest.raises(InputError, match="other ground coordinates"):
        PlanarBlock(two, (), (Control("1", 0, 0, "a", 1, 1), Control("1", 0, 9, "c", 1, 1)))
    with pytest.raises(InputError, match="share the name 'a'"):
        PlanarBlock((photo, photo))


# --- Relief ----------------------------------------------------------------------------------------------------------


def frame_photos(relief: float, seed: int) -> PlanarBlock:
    """Fig. 9-6 by a frame camera that is tilted up to 2°: heights of points scatter by a share of the flying height."""
    random = np.random.default_rng(seed)
    focal = 0.65 * SIZE[0]
    above = GSD * focal
    _, level = textbook_block("affine")
    places = adjust(level, "affine")
    ground = {name: (*xy, relief * above * random.uniform(-1, 1)) for name, xy in zip(places.views.ids, places.points)}  # noqa: B905
    turns = {}
    for photo in PHOTOS:
        o, p, k = np.radians(random.uniform(-2, 2, 3))
        rx = np.array([[1, 0, 0], [0, np.cos(o), -np.sin(o)], [0, np.sin(o), np.cos(o)]])
        ry = np.array([[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]])
        rz = np.array([[np.cos(k), -np.sin(k), 0], [np.sin(k), np.cos(k), 0], [0, 0, 1]])
        turns[photo] = rx @ ry @ rz

    def seen(point: str, photo: str) -> tuple[float, float]:
        x, y, z = ground[point]
        u, v, w = turns[photo].T @ np.array([x - centre(photo)[0], y - centre(photo)[1], z - above])
        return SIZE[0] / 2 - focal * u / w, SIZE[1] / 2 + focal * v / w

    ties = tuple(Tie(t.id, t.photo, *seen(t.id, t.photo), 0.5) for t in level.ties)
    known = tuple(Control(c.id, *ground[c.id][:2], c.photo, *seen(c.id, c.photo), 0.5) for c in level.control)
    return PlanarBlock(level.photos, ties, known)


def test_tilted_photos_of_level_ground_are_projective() -> None:
    """Without relief the simultaneous projective adjustment is exact, and the affine one is off by pixels."""
    block = frame_photos(0.0, 0)
    assert adjust(block, "projective").rms < 1e-6
    with pytest.warns(GeomosaicWarning, match="relief or tilt, a wrong measurement, or too small sigmas"):
        assert adjust(block, "affine").rms > 1.0


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
def test_relief_makes_the_projective_adjustment_ill_conditioned(seed: int) -> None:
    """From 2 % of the flying height it is refused, with its condition number, and single rectification advised."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomosaicWarning)
        for relief in (0.02, 0.1, 0.3):
            with pytest.raises(SolveError, match=r"ill-conditioned: condition number \d") as told:
                adjust(frame_photos(relief, seed), "projective")
            assert "rectify each photo singly" in str(told.value.hint)
