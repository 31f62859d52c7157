"""Edge matching: known photos come back, the textbook's equations and an independent solver agree, edges meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from edge_rig import SIZE, Rig, along_the_seam, rig, start, xyz
from scipy.optimize import least_squares

from geomosaic.block import ControlPoint, OrientedImage
from geomosaic.errors import GeomosaicWarning, InputError, SolveError
from geomosaic.orientation.edges import CommonPoint, EdgeMatch, match_edges
from geomosaic.sensor.corrected import Corrected
from geomosaic.sensor.solve import image_to_height

KINDS = ["conformal", "affine", "projective"]


def matched(r: Rig, **options: object) -> EdgeMatch:
    return match_edges(r.photos, r.control, r.common, **options)


@pytest.mark.parametrize("kind", ["affine", "projective"])
@pytest.mark.parametrize("photos", [2, 4])
def test_photos_without_noise_come_back(kind: str, photos: int) -> None:
    exact = rig(photos, kind, control_sigma=0.0, common_sigma=0.0, bend=0.0, tilt=0.0 if kind == "affine" else 4e-6)
    m = matched(exact)
    everywhere = np.random.default_rng(0).uniform([0.0, 0.0], SIZE, (50, 2))
    for truth, model in zip(exact.truths, m.adjusted, strict=True):
        ground = truth.inverse(everywhere)
        np.testing.assert_allclose(model.ground_to_image(xyz(ground)), everywhere, atol=1e-7)
    assert m.after.largest < 1e-7
    assert np.abs(m.residuals).max() < 1e-7


def dense(r: Rig, m: EdgeMatch) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """The same problem with all its unknowns at once, scipy's solver and derivatives by differences."""
    s, models = m.stations, list(m.adjusted)
    counts = [len(model.parameters) for model in models]
    ends = np.cumsum([0, *counts])
    steps = np.concatenate([model.parameters.steps for model in models])
    free = np.flatnonzero(s.sigma > 0.0)
    begin = np.concatenate([photo.model.parameters.values for photo in r.photos])
    ground = s.xyz.copy()
    ground[free, :2] = m.ground[free, :2] + np.random.default_rng(1).normal(0.0, 5.0, (len(free), 2))

    def residuals(unknowns: np.ndarray) -> np.ndarray:
        values = begin + unknowns[: ends[-1]] * steps
        place = ground.copy()
        place[free, :2] += unknowns[ends[-1] :].reshape(-1, 2)
        out = []
        for i, model in enumerate(models):
            mine = s.photo == i
            image = model.with_values(values[ends[i] : ends[i + 1]]).ground_to_image(place[s.station[mine]])
            out.append(((s.colrow[mine] - image) / s.sigma_px[mine, None]).ravel())
        known = (s.sigma > 0.0) & np.isfinite(s.sigma)
        out.append(((place - s.xyz)[known, :2] / s.sigma[known, None]).ravel())
        return np.concatenate(out)

    unknowns = np.zeros(ends[-1] + 2 * len(free))
    found = least_squares(residuals, unknowns, jac="3-point", method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    values = begin + found.x[: ends[-1]] * steps
    cofactors = np.linalg.inv(found.jac.T @ found.jac)[: ends[-1], : ends[-1]] * np.outer(steps, steps)
    place = ground.copy()
    place[free, :2] += found.x[ends[-1] :].reshape(-1, 2)
    redundancy = len(found.fun) - len(found.x)
    assert redundancy == m.redundancy
    return values, cofactors, place, float(np.sqrt(2.0 * found.cost / redundancy))


FOUR = [(kind, 4, sigma_xy) for kind in KINDS for sigma_xy in (0.0, 0.8)]


@pytest.mark.parametrize(
    ("kind", "photos", "sigma_xy"),
    [
        *((kind, 2, 0.8) for kind in KINDS),
        (KINDS[0], 2, 0.0),
        *(pytest.param(kind, 2, 0.0, marks=pytest.mark.slow) for kind in KINDS[1:]),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in FOUR),
    ],
)
def test_against_an_independent_dense_solution(kind: str, photos: int, sigma_xy: float) -> None:
    noisy = rig(photos, kind)
    for k, point in enumerate(noisy.control):
        noisy.control[k] = ControlPoint(
            point.id, point.xyz, point.image, point.colrow, sigma_xy=sigma_xy, sigma_px=0.3 + 0.1 * k
        )
    m = matched(noisy)
    values, cofactors, place, sigma0 = dense(noisy, m)
    steps = np.concatenate([model.parameters.steps for model in m.adjusted])
    mine = np.concatenate([model.parameters.values for model in m.adjusted])
    np.testing.assert_allclose((mine - values) / steps, 0.0, atol=2e-6)
    np.testing.assert_allclose(m.ground, place, atol=2e-6)
    assert m.sigma0 == pytest.approx(sigma0, rel=1e-9)
    scale = np.sqrt(np.outer(np.diag(cofactors), np.diag(cofactors)))
    np.testing.assert_allclose((m.covariance - cofactors) / scale, 0.0, atol=1e-4)


def paper(m: EdgeMatch) -> tuple[np.ndarray, np.ndarray]:
    """Equations (1) to (9) written out: image → ground affines, A v + B Δ = f, N = Bᵀ (A Q Aᵀ)⁻¹ B, repeated.

    With the full x' = x + v in the coefficients, as the adjustment of the exact conditions needs.
    """
    s = m.stations
    middle, ground0 = np.array(SIZE) / 2.0, np.nanmean(s.xyz[:, :2], axis=0)
    observed, variance = (s.colrow - middle) / 1000.0, np.repeat((s.sigma_px / 1000.0) ** 2, 2)
    p = np.tile([1000.0, 0.0, 0.0, 0.0, -1000.0, 0.0], (2, 1))  # a, b, c, d, e, f of each image
    p[:, [2, 5]] = [[np.nanmean(s.xyz[s.station[s.photo == i], k]) - ground0[k] for k in (0, 1)] for i in (0, 1)]
    v = np.zeros(2 * len(observed))
    for _ in range(30):
        x = observed + v.reshape(-1, 2)
        A, B, f = [], [], []
        for station in range(len(s.ids)):
            rows_a, rows_b, misclosure = np.zeros((2, len(v))), np.zeros((2, 12)), np.zeros(2)
            for sign, n in zip((1.0, -1.0), np.flatnonzero(s.station == station), strict=False):
                i = s.photo[n]
                a, b, c, d, e, g = p[i]
                rows_a[:, 2 * n : 2 * n + 2] = sign * np.array([[a, b], [d, e]])
                rows_b[0, 6 * i : 6 * i + 3] = rows_b[1, 6 * i + 3 : 6 * i + 6] = sign * np.array([*x[n], 1.0])
                misclosure += sign * np.array([a * x[n, 0] + b * x[n, 1] + c, d * x[n, 0] + e * x[n, 1] + g])
            target = s.xyz[station, :2] - ground0 if s.held[station] else 0.0
            A, B, f = [*A, rows_a], [*B, rows_b], [*f, target - misclosure]
        A, B = np.vstack(A), np.vstack(B)
        f = np.concatenate(f) + A @ v
        inner = np.linalg.inv(A * variance @ A.T)
        delta = np.linalg.solve(B.T @ inner @ B, B.T @ inner @ f)
        v = variance * (A.T @ (inner @ (f - B @ delta)))
        p = p + delta.reshape(2, 6)
    corners = np.array([[0.0, 0.0], [2000.0, 0.0], [0.0, 1600.0], [2000.0, 1600.0]])
    c, r = ((corners - middle) / 1000.0).T
    places = [np.column_stack([q[0] * c + q[1] * r + q[2], q[3] * c + q[4] * r + q[5]]) + ground0 for q in p]
    return np.array(places), 1000.0 * v.reshape(-1, 2)


def test_against_the_equations_of_the_paper() -> None:
    """Bellman, Deakin and Rollings adjust image → ground, we ground → image: with image residuals it is one."""
    m = matched(rig(2, "affine"))
    places, v = paper(m)
    corners = np.array([[0.0, 0.0], [2000.0, 0.0], [0.0, 1600.0], [2000.0, 1600.0]])
    for model, place in zip(m.adjusted, places, strict=True):
        np.testing.assert_allclose(image_to_height(model, corners, 0.0, m.crs)[:, :2], place, atol=1e-6)
    np.testing.assert_allclose(m.residuals, -v, atol=1e-6)


@pytest.mark.parametrize("trials", [10, pytest.param(300, marks=pytest.mark.slow)])
def test_sigmas_describe_the_errors(trials: int) -> None:
    """Of many noisy affine pairs: errors of parameters in 3 sigma in 99 %, their mean square 1, sigma0 about 1."""
    truth = matched(rig(2, "affine", control_sigma=0.0, common_sigma=0.0, bend=0.0, tilt=0.0))
    squares, inside, sigma0 = [], [], []
    for seed in range(trials):
        noisy = rig(2, "affine", seed=seed, bend=0.0, tilt=0.0)
        m = matched(noisy)
        for mine, true in zip(m.adjusted, truth.adjusted, strict=True):  # both on the same normalisation
            np.testing.assert_array_equal(mine.transformation.centre, true.transformation.centre)
        off = np.concatenate(
            [a.parameters.values - b.parameters.values for a, b in zip(m.adjusted, truth.adjusted, strict=True)]
        )
        share = off / np.sqrt(np.diag(m.covariance))
        squares.append((share**2).mean())
        inside.extend(np.abs(share) < 3.0)
        sigma0.append(m.sigma0)
    assert np.mean(inside) > (0.99 if trials > 100 else 0.98)
    assert np.mean(squares) == pytest.approx(1.0, abs=2.5 / np.sqrt(trials))
    assert np.sqrt(np.mean(np.square(sigma0))) == pytest.approx(1.0, abs=0.6 / np.sqrt(trials))


def no_matching(r: Rig) -> list[object]:
    """Each photo by its own four control points."""
    from geomosaic.sensor.solve import fit

    models = []
    for photo in r.photos:
        mine = [p for p in r.control if p.image == photo.name]
        models.append(fit(photo.model, np.array([p.xyz for p in mine]), np.array([p.colrow for p in mine])).model)
    return models


@pytest.mark.parametrize(
    ("kind", "without", "after", "between"), [("affine", 5.0, 5.5, 1.0), ("projective", 3.0, 2.2, 1.0)]
)
@pytest.mark.parametrize("photos", [2, 4])
def test_misfit_along_the_seam(kind: str, without: float, after: float, between: float, photos: int) -> None:
    """4 control points per photo, 8 noisy common points per seam, photos bent by pixels: the table of the docs."""
    r = rig(photos, kind)
    m = matched(r)
    assert m.before.rms > without * 0.8
    assert m.after.rms < 0.65 * m.before.rms
    assert m.joined.largest <= 1e-6
    for index in range(photos - 1):
        rms = [
            np.sqrt((along_the_seam(r, models, index) ** 2).mean()) for models in (no_matching(r), m.adjusted, m.models)
        ]
        assert rms[0] > without * 0.6
        assert rms[1] < min(after, 0.75 * rms[0])
        assert rms[2] < min(between, 0.5 * rms[1])


def test_the_join_takes_halves_and_fades() -> None:
    r = rig(2)
    m = matched(r)
    # Same sigmas, same scale: each photo gives half of what is left at a common point.
    shared = np.isinf(m.stations.sigma)[m.stations.station]
    left = m.residuals[shared].reshape(-1, 2, 2)
    np.testing.assert_allclose(np.linalg.norm(left[:, 0], axis=1), np.linalg.norm(left[:, 1], axis=1), rtol=0.05)
    np.testing.assert_allclose(left.sum(axis=1), 0.0, atol=0.05 * np.abs(left).max())
    # Far from the edge nothing is moved; on the way there the correction has no jump and no kink.
    grid = m.grids[0]
    assert grid is not None
    far = np.array([[300.0, 800.0], [700.0, 100.0]])
    np.testing.assert_allclose(grid.at(far), 0.0, atol=0.02)
    way = np.column_stack([np.linspace(0.0, 2000.0, 20001), np.full(20001, 700.0)])
    slopes = grid.slopes(way)[:, :, 0]
    assert np.abs(slopes).max() < 0.03
    assert np.abs(np.diff(slopes, axis=0)).max() < 1e-4


def test_a_reference_stays_and_small_sigmas_give_less() -> None:
    """A photo that is georeferenced already is joined to, not moved."""
    r = rig(2)
    fixed = r.photos[0].model
    fixed = type(fixed)(**{**fixed.__dict__, "sigmas": np.zeros(6)})
    photos = [OrientedImage("photo-0", "", "planar", fixed), r.photos[1]]
    common = [CommonPoint(p.id, p.image, p.colrow, 0.001 if p.image == "photo-0" else 0.5) for p in r.common]
    control = [p for p in r.control if p.image != "photo-0"]
    m = match_edges(photos, control, common)
    np.testing.assert_array_equal(m.adjusted[0].parameters.values, fixed.parameters.values)
    assert m.joined.largest <= 1e-6
    moved = np.abs(m.residuals[m.stations.photo == 0]).max()
    assert moved < 1e-4
    assert np.abs(m.residuals[m.stations.photo == 1]).max() > 0.5


def test_a_photo_with_little_control_is_carried_by_its_neighbours() -> None:
    """One control point and two seams determine the middle photo; its start grows out of its neighbours."""
    r = rig(3, common_sigma=0.0, control_sigma=0.0, bend=0.0, tilt=0.0)
    kept = [p for p in r.control if p.image != "photo-1"] + [p for p in r.control if p.image == "photo-1"][:1]
    m = match_edges(r.photos, kept, r.common)
    ground = r.truths[1].inverse(np.array([[1000.0, 800.0], [50.0, 1500.0]]))
    np.testing.assert_allclose(m.adjusted[1].ground_to_image(xyz(ground)), [[1000.0, 800.0], [50.0, 1500.0]], atol=1e-6)
    assert np.isnan(m.before.rms)


def test_frames_over_known_heights() -> None:
    """Any model through its Jacobian: Earth-centred cameras, common points with heights, positions adjusted."""
    from test_42_kit_frame import MAP, frame, request

    from geomosaic.geo.transform import Transform
    from geomosaic.sensor.plugin import SensorRequest
    from geomosaic.sensor.registry import build

    first = frame("opencv")
    base = request("opencv")
    x, y, z = base.options["position"]
    second = build("frame", SensorRequest("b", base.size, {**base.options, "position": [x + 500.0, y, z]}, base.crs))
    rng = np.random.default_rng(5)
    places = np.column_stack(
        [rng.uniform(x - 300.0, x + 800.0, 60), rng.uniform(y - 500.0, y + 500.0, 60), rng.uniform(430.0, 470.0, 60)]
    )
    photos, control, common = [], [], []
    for name, model in (("a", first), ("b", second)):
        image = model.ground_to_image(Transform(MAP, model.crs)(places))
        seen = ((image > 0.0) & (image < np.array(model.size))).all(axis=1)
        for k in np.flatnonzero(seen[:15]):
            control.append(ControlPoint(f"c{k}", tuple(places[k]), name, tuple(image[k])))
        common += [CommonPoint(f"p{k}", name, tuple(image[k]), z=places[k, 2]) for k in range(15, 60) if seen[k]]
        moved = model.with_values(model.parameters.values + 3.0 * model.parameters.steps)
        photos.append(OrientedImage(name, "", "frame", moved))
    twice = {p.id for p in common if p.image == "a"} & {p.id for p in common if p.image == "b"}
    m = match_edges(photos, control, [p for p in common if p.id in twice], crs=MAP)
    assert len(twice) >= 8
    for truth, model in zip((first, second), m.adjusted, strict=True):
        off = (model.parameters.values - truth.parameters.values) / truth.parameters.steps
        np.testing.assert_allclose(off, 0.0, atol=1e-5)
    assert m.joined.largest < 1e-5
    assert all(isinstance(model, Corrected) for model in m.models)


def test_points_of_unknown_photos_are_refused() -> None:
    r = rig(2)
    with pytest.raises(InputError, match="no such photo"):
        match_edges(r.photos, r.control, [CommonPoint("p", "photo-9", (1.0, 1.0))])
    with pytest.raises(InputError, match="in one photo only"):
        match_edges(r.photos, r.control, [*r.common, CommonPoint("q", "photo-0", (1.0, 1.0))])
    with pytest.raises(InputError, match="measured twice"):
        match_edges(r.photos, r.control, [*r.common, r.common[0]])
    with pytest.raises(InputError, match="not a usable number"):
        match_edges(r.photos, r.control, [CommonPoint("p", "photo-0", (np.nan, 1.0))])
    with pytest.raises(SolveError, match=r"do not determine .*photo-1"):
        match_edges(r.photos, [p for p in r.control if p.image == "photo-0"], r.common[:4])
    with pytest.raises(InputError, match="different names"):
        match_edges([r.photos[0], r.photos[0]], r.control, r.common)
    assert start("affine", 0).size == SIZE


@pytest.mark.parametrize(("kind", "common"), [("affine", True), ("projective", True), ("affine", False)])
def test_a_wrong_point_is_named_and_left_out(kind: str, common: bool) -> None:
    """Common point p03 off by 30 px, or control c12 by 25, among bent photos; without it, as if it had not been.

    Control at the corners is told from bending only where the model fits.
    """
    r = rig(2, kind, bend=3.0 if common else 0.0, tilt=4e-6 if common else 0.0)
    clean = matched(r)
    assert not clean.findings.blunders
    bad_common = [replace(p, colrow=(p.colrow[0] + 30.0, p.colrow[1]), where="common.csv, line 4")
                  if common and (p.id, p.image) == ("p03", "photo-1") else p for p in r.common]  # fmt: skip
    bad_control = [replace(p, colrow=(p.colrow[0], p.colrow[1] + 25.0), where="gcps.csv, line 7")
                   if not common and p.id == "c12" else p for p in r.control]  # fmt: skip
    name, where = (
        ("common point 'p03' in photo-0 and photo-1", "common.csv, line 4")
        if common
        else ("control point 'c12' in photo-1", "gcps.csv, line 7")
    )
    with pytest.raises(InputError, match=f"1 of 16 measurements contradicts the others.*{name}.*{where}"):
        match_edges(r.photos, bad_control, bad_common)
    with pytest.warns(GeomosaicWarning, match=f"{name}.*left out"):
        left = match_edges(r.photos, bad_control, bad_common, policy="leave")
    assert left.findings.blunders[0].size == pytest.approx(30.0 if common else 25.0, abs=4.0)
    corners = np.array([[0.0, 0.0], SIZE])
    for a, b in zip(left.adjusted, clean.adjusted, strict=True):
        places = [image_to_height(model, corners, 0.0, clean.crs) for model in (a, b)]
        assert np.abs(places[0] - places[1]).max() < 3.0
