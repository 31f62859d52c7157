"""Refinement of RPCs: known corrections are found again, wrong points change nothing, sigmas are what they say."""

from __future__ import annotations

import numpy as np
import pytest
import rpc_rig as rig
from scipy.optimize import least_squares

from geomosaic.errors import GeomosaicWarning, HeightDatumError, InputError, SolveError
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.transform import Transform
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.solve import resect
from geomosaic_rpc import Refinement, Rpc, RpcModel, TieMeasurements, correct_by_ties, refine
from geomosaic_rpc.model import KINDS

TRUTH = {
    "shift": np.array([7.3, -4.1, 0.0, 0.0, 0.0, 0.0]),
    "drift": np.array([7.3, -4.1, 1.2, -0.8, 0.0, 0.0]),
    "affine": np.array([7.3, -4.1, 1.2, -0.8, 0.5, 0.9]),
}


def measured(kind: str, count: int, noise: float = 0.0, seed: int = 2) -> tuple[np.ndarray, np.ndarray]:
    points = rig.ground(count, seed)
    image = rig.model(kind).with_values(TRUTH[kind]).ground_to_image(points)
    return points, image + np.random.default_rng(seed + 100).normal(0.0, 1.0, image.shape) * noise


def corrected(kind: str, points: np.ndarray, image: np.ndarray, **more: float) -> Refinement:
    return refine(rig.model(), points, image, kind, **more)


def test_the_terms_are_those_of_the_page() -> None:
    """Half the longer side right of the middle, col_per_col and row_per_col do what they say, in pixels."""
    model = rig.model("affine")
    middle = np.array([model.seed])
    image = model.ground_to_image(middle)
    off = model.with_values([7.3, -4.1, 1.2, -0.8, 0.5, 0.9]).ground_to_image(middle) - image
    assert np.allclose(off, [[7.3, -4.1]], atol=1e-3)
    points = rig.ground()
    raw = model.ground_to_image(points)
    u, v = (raw[:, 0] - 2000.0) / 2000.0, (raw[:, 1] - 1500.0) / 2000.0
    off = model.with_values(TRUTH["affine"]).ground_to_image(points) - raw
    assert np.allclose(off[:, 0], 7.3 + 1.2 * v + 0.5 * u)
    assert np.allclose(off[:, 1], -4.1 - 0.8 * v + 0.9 * u)


@pytest.mark.parametrize("kind", TRUTH)
def test_exact_points_give_the_truth(kind: str) -> None:
    found = corrected(kind, *measured(kind, 8))
    assert np.abs(found.model.parameters.values - TRUTH[kind]).max() < 1e-9
    assert found.used.all()
    assert found.rms_after < 1e-9
    assert found.rms_before > 5.0


@pytest.mark.parametrize("kind", TRUTH)
@pytest.mark.parametrize("seed", range(5))
def test_three_bad_points_among_ten_change_nothing(kind: str, seed: int) -> None:
    points, image = measured(kind, 10, 0.3, seed)
    bad = np.random.default_rng(seed).permutation(10)[:3]
    spoilt = image.copy()
    spoilt[bad] += np.random.default_rng(seed + 7).choice([-1.0, 1.0], (3, 2)) * [
        [8.0, 12.0],
        [30.0, 5.0],
        [400.0, 90.0],
    ]
    good = np.setdiff1d(np.arange(10), bad)
    alone = corrected(kind, points[good], image[good])
    among = corrected(kind, points, spoilt)
    assert not among.used[bad].any()
    assert np.array_equal(among.used[good], alone.used)
    assert np.abs(among.model.parameters.values - alone.model.parameters.values).max() < 1e-9
    assert np.abs(among.sigmas - alone.sigmas).max() < 1e-9


def test_bad_points_that_agree_with_each_other() -> None:
    """Three points of another place, all shifted alike, are still the minority."""
    points, image = measured("shift", 10, 0.3)
    image[:3] += [25.0, -18.0]
    found = corrected("shift", points, image)
    assert np.flatnonzero(~found.used).tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("kind", "known"),
    [
        pytest.param(kind, known, marks=() if (kind, known) == ("affine", False) else pytest.mark.slow)
        for kind in TRUTH
        for known in (False, True)
    ],
)
def test_sigmas_are_the_scatter(kind: str, known: bool) -> None:
    noise, trials = 0.4, 300
    values, sigmas = [], []
    points, exact = measured(kind, 20)
    for seed in range(trials):  # the same places, other noise
        image = exact + np.random.default_rng(seed).normal(0.0, noise, exact.shape)
        found = resect(rig.model().freed(kind), points, image, noise if known else None)
        values.append(found.model.parameters.values)
        sigmas.append(found.sigmas)
    count = KINDS[kind]
    scatter = np.std(values, axis=0)[:count]
    assert np.abs(np.mean(sigmas, axis=0)[:count] / scatter - 1.0).max() < 0.1
    assert not np.any(np.array(sigmas)[:, count:])


def test_good_points_stay_in() -> None:
    """Of 1000 points with normal errors about 2 lie beyond 3.5 scatters in two dimensions."""
    left = sum(int((~corrected("affine", *measured("affine", 25, 0.5, seed)).used).sum()) for seed in range(40))
    assert left <= 0.01 * 40 * 25


def test_one_point_gives_a_shift_without_sigma() -> None:
    found = corrected("shift", *measured("shift", 1))
    assert np.allclose(found.model.parameters.values, TRUTH["shift"])
    assert corrected("shift", *measured("shift", 1), sigmas_px=0.5).sigmas[:2] == pytest.approx(0.5)


def test_too_few_points() -> None:
    with pytest.raises(SolveError, match="2 control points do not determine 'affine', which needs 3"):
        corrected("affine", *measured("affine", 2))


UTM = with_heights(parse_crs("EPSG:32633"), "ellipsoidal")


def door(points: np.ndarray, image: np.ndarray, tmp_path: object, **more: object) -> RpcModel:
    path = f"{tmp_path}/scene_RPC.TXT"
    with open(path, "w") as file:  # noqa: PTH123
        file.write(rig.rpc_txt())
    crs = more.pop("crs", UTM)
    xyz = Transform(rig.model().crs, UTM)(points)
    table = [
        {"id": f"p{k}", "x": x, "y": y, "z": z, "col": col, "row": row}
        for k, ((x, y, z), (col, row)) in enumerate(zip(xyz.tolist(), image.tolist(), strict=True))
    ]
    options = {"rpc": path, "points": table, **more}
    made = registry.build("rpc", SensorRequest("scene.tif", rig.SIZE, options, crs))
    assert isinstance(made, RpcModel)
    return made


def test_points_given_to_the_plugin(tmp_path: object) -> None:
    points, image = measured("shift", 10, 0.2)
    image[4] += 60.0
    with pytest.warns(GeomosaicWarning, match=r"1 of 10 .* left out: point 'p4' is off by 8\d\.\d px"):
        made = door(points, image, tmp_path)
    assert np.abs(made.parameters.values[:2] - TRUTH["shift"][:2]).max() < 0.3
    with pytest.raises(InputError, match="refine is 'none'"):
        door(points, image, tmp_path, refine="none")
    with pytest.raises(InputError, match="no CRS"):
        door(points, image, tmp_path, crs=None)
    with pytest.raises(HeightDatumError, match="no vertical datum"):
        door(points, image, tmp_path, crs=parse_crs("EPSG:32633"))
    with pytest.raises(SolveError, match=r"(?s)scene.tif.*needs 3"):
        door(points[:2], image[:2], tmp_path, refine="affine")


def stereo() -> list[RpcModel]:
    """Three scenes of one place, seen from the west, from above and from the south."""
    base = rig.rpc()
    scenes = []
    for across, along in ((0.25, 0.0), (0.0, 0.0), (0.02, 0.2)):
        c = base.coefficients.copy()
        c[0, 3], c[2, 3] = across, along
        scenes.append(
            RpcModel.of(Rpc(base.image_offset, base.image_scale, base.ground_offset, base.ground_scale, c), rig.SIZE)
        )
    return scenes


def ties(scenes: list[RpcModel], count: int, noise: float) -> tuple[np.ndarray, TieMeasurements]:
    points = rig.ground(count, 9)
    rng = np.random.default_rng(11)
    image = np.repeat(np.arange(len(scenes)), count)
    colrow = np.vstack([scene.ground_to_image(points) for scene in scenes])
    return points, TieMeasurements(
        image, np.tile(np.arange(count), len(scenes)), colrow + rng.normal(0, 1.0, colrow.shape) * noise
    )


def test_scenes_come_together_without_control() -> None:
    """Corrections of the images are found but for what moves all of them alike: the ground points' common shift."""
    scenes = stereo()
    wrong = [[6.0, -3.0], [-4.0, 5.0], [1.0, 2.0]]
    true = [s.with_values(np.append(w, np.zeros(4))) for s, w in zip(scenes, wrong, strict=True)]
    points, sights = ties(true, 40, 0.0)
    found = correct_by_ties(scenes, sights, sigma_correction=1000.0, sigma_height=1e6)
    assert found.rms_before > 2.0
    assert found.rms_after < 1e-4
    assert found.used.all()
    moved = found.ground - points
    assert np.ptp(moved / [1e-5, 1e-5, 1.0], axis=0).max() < 0.2  # metres: the network has moved as a whole
    held = correct_by_ties([true[0], *scenes[1:]], sights, sigma_correction=1000.0, sigma_height=1e6, fixed=[0])
    assert np.array_equal(held.models[0].parameters.values, true[0].parameters.values)
    assert held.rms_after < 1e-4
    assert not held.sigmas[0].any()


def test_wrong_ties_change_nothing() -> None:
    scenes = stereo()
    true = [scenes[0].with_values([6.0, -3.0, 0, 0, 0, 0]), *scenes[1:]]
    _, sights = ties(true, 30, 0.2)
    bad = np.isin(sights.point, np.arange(8)) & (sights.image == 1)
    spoilt = sights.colrow + bad[:, None] * np.random.default_rng(3).uniform(15.0, 90.0, sights.colrow.shape)
    good = ~np.isin(sights.point, np.arange(8))
    clean = correct_by_ties(
        scenes, TieMeasurements(sights.image[good], sights.point[good] - 8, sights.colrow[good]), sigma_px=0.2
    )
    found = correct_by_ties(scenes, TieMeasurements(sights.image, sights.point, spoilt), sigma_px=0.2)
    assert not found.used[:8].any()
    assert found.used[8:].sum() >= 21
    for one, other in zip(found.models, clean.models, strict=True):
        assert np.abs(one.parameters.values - other.parameters.values).max() < 0.05
    assert 0.05 < found.rms_after < 0.3


@pytest.mark.parametrize("kind", ["shift", "drift", "affine"])
def test_a_tie_correction_is_the_minimum_that_scipy_finds(kind: str) -> None:
    scenes = [scene.freed(kind) for scene in stereo()]
    _, seen = ties([scenes[0].with_values([3.0, -2.0, 0, 0, 0, 0]), *scenes[1:]], 12, 0.2)
    found = correct_by_ties(scenes, seen, kind, sigma_px=0.2)
    part, free = found.used, np.flatnonzero(scenes[0].parameters.sigmas > 0.0)
    rows, unit = part[seen.point], np.array([1e-5, 1e-5, 1.0])
    height = np.mean([scene.seed[2] for scene in scenes])

    def misfit(change: np.ndarray) -> np.ndarray:
        values = np.array([model.parameters.values for model in found.models])
        values[:, free] += change[: len(scenes) * len(free)].reshape(len(scenes), -1)
        ground = found.ground.copy()
        ground[part] += change[values[:, free].size :].reshape(-1, 3) * unit
        image = [s.with_values(v).ground_to_image(ground) for s, v in zip(scenes, values, strict=True)]
        computed = np.array([image[i][p] for i, p in zip(seen.image, seen.point, strict=True)])
        left = (seen.colrow - computed)[rows].ravel() / 0.2
        return np.concatenate([left, values[:, free].ravel() / 20.0, (ground[part, 2] - height) / 1000.0])

    start = np.zeros(len(scenes) * len(free) + 3 * int(part.sum()))
    least = least_squares(misfit, start, jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert np.sum(misfit(start) ** 2) <= 2.0 * least.cost * (1.0 + 1e-10)
    assert np.abs(misfit(start) - misfit(least.x))[: 2 * int(rows.sum())].max() * 0.2 < 1e-7


def test_ties_in_one_image_only() -> None:
    scenes = stereo()
    _, sights = ties(scenes, 5, 0.0)
    alone = sights.image == 0
    with pytest.raises(SolveError, match="no tie point is seen in two scenes"):
        correct_by_ties(scenes, TieMeasurements(sights.image[alone], sights.point[alone], sights.colrow[alone]))
