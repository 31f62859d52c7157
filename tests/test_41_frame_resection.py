"""Space resection through the door of the frame sensor: known photos, their points, and the same photos again."""

from __future__ import annotations

import warnings
from typing import Any

import film_rig as rig
import numpy as np
import pytest

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.engineering_crs import local_frame_crs
from geomosaic.geo.transform import Transform
from geomosaic.sensor import registry
from geomosaic.sensor.plausibility import centre_dip
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.solve import resect
from geomosaic.types import FloatArray
from geomosaic_frame.model import FrameModel

CRS = with_heights(parse_crs("EPSG:32633"), "egm96")
SIZE = (4000, 3000)
CAMERA = {
    "focal_length": 20.0,
    "sensor_size": [24.0, 18.0],
    "distortion": {"model": "brown", "k1": -0.05, "k2": 0.01, "p1": 3e-4},
}


def build(**options: Any) -> FrameModel:
    model = registry.build("frame", SensorRequest("photo", SIZE, {"camera": CAMERA} | options, CRS))
    assert isinstance(model, FrameModel)
    return model


def case(
    seed: int, count: int, treatment: str = "rigorous", flat: bool = False
) -> tuple[FrameModel, FloatArray, FloatArray]:
    """A photo with any kappa and a tilt up to 60°, control points in the CRS, and where they are in the photo."""
    rng = np.random.default_rng(seed)
    tilt, heading = rng.uniform(0.0, 60.0) * (seed % 2), rng.uniform(0.0, 360.0)
    gimbal = {"system": "dji", "gimbal_yaw": heading, "gimbal_pitch": -90.0 + tilt, "gimbal_roll": rng.uniform(-5, 5)}
    photo = build(
        position=[512_000.0, 5_300_000.0, 1800.0], orientation=gimbal, ground_height=400.0, treatment=treatment
    )
    pixels = rng.uniform(0.04, 0.96, (count, 2)) * SIZE
    if count <= 4:  # spread, as anyone would choose them
        corners = np.array([[0.1, 0.1], [0.85, 0.2], [0.45, 0.9], [0.6, 0.5]])[:count]
        pixels = (corners + rng.uniform(-0.05, 0.05, (count, 2))) * SIZE
    origins, directions = photo.rays(pixels)
    to_map = Transform(photo.crs, CRS)
    aims = 400.0 + (0.0 if flat else 1.0) * rng.uniform(-120.0, 120.0, count)
    reach = np.full(count, 1000.0)
    for _ in range(30):  # along the ray down to the height
        here = to_map(origins + directions * reach[:, None])[:, 2]
        step = to_map(origins + directions * (reach[:, None] + 1.0))[:, 2] - here
        reach += np.clip((aims - here) / step, -0.5 * reach, 2000.0)
    return photo, to_map(origins + directions * reach[:, None]), pixels


def points_of(ground: FloatArray, pixels: FloatArray, **more: Any) -> list[dict[str, float]]:
    names = ("x", "y", "z", "col", "row")
    return [dict(zip(names, map(float, (*g, *p)), strict=True)) | more for g, p in zip(ground, pixels, strict=True)]


def off(found: FrameModel, truth: FrameModel) -> tuple[float, float]:
    """Distance of the centres in metres, and the largest angle between the attitudes in degrees."""
    turn = found.rotation @ found.frame.axes @ (truth.rotation @ truth.frame.axes).T
    return float(np.linalg.norm(found.centre - truth.centre)), float(
        np.degrees(np.linalg.norm(turn - turn.T) / np.sqrt(8))
    )


def recovered(seeds: range) -> None:
    for seed in seeds:
        count = (4, 5, 6, 9, 20)[seed % 5]
        truth, ground, pixels = case(seed, count, ("rigorous", "planar")[seed % 3 == 2], flat=seed % 4 == 0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", GeomosaicWarning)  # some of the random cases are weak
            found = build(
                points=points_of(ground, pixels),
                treatment="planar" if seed % 3 == 2 else "rigorous",
                ground_height=400.0,
            )
        metres, degrees = off(found, truth)
        assert metres < 1e-5, f"case {seed}: {metres} m"
        assert degrees < 1e-6, f"case {seed}: {degrees}°"


def test_twenty_random_photos_come_back() -> None:
    """Each number of points with each treatment and with flat ground and relief."""
    recovered(range(20))


@pytest.mark.slow
def test_three_hundred_random_photos_come_back() -> None:
    recovered(range(300))


def test_the_exterior_orientation_of_a_photo_is_read_back() -> None:
    """Projection centre and angles from grid north, whichever way the photo was oriented and treated."""
    for seed in range(6):
        treatment = ("rigorous", "planar")[seed % 2]
        truth = case(seed, 6, treatment)[0]
        x, y, z, omega, phi, kappa = truth.exterior(CRS).tolist()
        angles = {"system": "opk", "omega": omega, "phi": phi, "kappa": kappa}
        again = build(position=[x, y, z], orientation=angles, ground_height=400.0, treatment=treatment)
        metres, degrees = off(again, truth)
        assert metres < 1e-6
        assert degrees < 1e-9


def test_three_points_give_the_photo_or_all_the_places_it_may_have() -> None:
    unique = several = 0
    for seed in range(20):
        truth, ground, pixels = case(seed, 3)
        error = None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", GeomosaicWarning)
                found = build(points=points_of(ground, pixels))
        except InputError as refused:
            error = str(refused)
        if error is None:
            unique += 1
            assert off(found, truth)[0] < 1e-4
            assert any("from 3 points: fits exactly: 0 redundant" in note for note in found.notes)
            continue
        several += 1
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", GeomosaicWarning)
            found = build(points=points_of(ground, pixels), position=[512_010.0, 5_299_995.0, 1790.0])
        assert off(found, truth)[0] < 1e-4
        assert "three points fit" in error
        assert "give a fourth point" in error
        place = Transform(truth.crs, CRS)(truth.centre[None])[0]
        assert f"({place[0]:.2f}, {place[1]:.2f}, {place[2]:.2f})" in error
    assert unique
    assert several


def test_a_film_with_refraction_comes_back() -> None:
    """All that bends is in the adjustment; the start need not know of it."""
    given: dict[str, Any] = {
        "camera": rig.CERTIFICATE,
        "fiducials": rig.marks(),
        "ground_height": 300.0,
        "refraction": True,
    }
    orientation = {"system": "opk", "omega": 1.0, "phi": -2.0, "kappa": 200.0}
    place = {"position": [500_000.0, 5_500_000.0, 7600.0], "orientation": orientation}
    truth = registry.build("frame", SensorRequest("scan", rig.SIZE, given | place, CRS))
    assert isinstance(truth, FrameModel)
    pixels = np.array([[300.0, 400.0], [4300.0, 350.0], [2300.0, 2200.0], [350.0, 4200.0], [4200.0, 4300.0]])
    origins, directions = truth.rays(pixels)
    ground = Transform(truth.crs, CRS)(origins + directions * np.array([8600, 8500, 7250, 8700, 8550.0])[:, None])
    found = registry.build("frame", SensorRequest("scan", rig.SIZE, given | {"points": points_of(ground, pixels)}, CRS))
    assert isinstance(found, FrameModel)
    assert off(found, truth)[0] < 1e-4
    assert abs(found.ray_correction.refraction - truth.ray_correction.refraction) < 1e-12


def test_reported_sigmas_are_the_scatter_of_many_trials() -> None:
    truth, ground, pixels = case(7, 9)
    rng = np.random.default_rng(0)
    xyz = Transform(CRS, truth.crs)(ground)
    free = truth.with_values(truth.parameters.values)
    solved = [resect(free, xyz, pixels + rng.normal(0.0, 0.4, pixels.shape), 0.4) for _ in range(300)]
    scatter = np.std([one.model.parameters.values for one in solved], axis=0)
    assert scatter == pytest.approx(solved[0].sigmas, rel=0.1)
    # And the door says the same.
    noisy = pixels + rng.normal(0.0, 0.4, pixels.shape)
    notes = build(points=points_of(ground, noisy, sigma=0.4)).notes
    said = next(note for note in notes if note.startswith("sigmas of east"))
    assert "largest correlation" in said
    numbers = [float(word.strip(",;")) for word in said.split() if word.strip(",;").replace(".", "").isdigit()]
    assert len(numbers) == 6
    assert max(numbers[:3]) == pytest.approx(max(scatter[:3]), rel=0.6)  # in other axes, but of the same size


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "count", "treatment"), [(1, 5, "planar")])
def test_sigmas_are_the_scatter_in_an_oblique_photo(seed: int, count: int, treatment: str) -> None:
    """300 trials from the first start on, by points alone: the centre's and the attitude's, within 10 %."""
    truth, ground, pixels = case(seed, count, treatment)
    xyz = ground if treatment == "planar" else Transform(CRS, truth.crs)(ground)
    rng, places, turns, reported = np.random.default_rng(seed), [], [], []
    for _ in range(300):
        noisy = pixels + rng.normal(0.0, 0.2, pixels.shape)
        start = build(points=points_of(ground, noisy), treatment=treatment, ground_height=400.0)
        one = resect(start, xyz, noisy, 0.2)
        turn = one.model.rotation @ one.model.frame.axes @ (truth.rotation @ truth.frame.axes).T
        places.append(one.model.centre - truth.centre)
        turns.append([turn[1, 2] - turn[2, 1], turn[2, 0] - turn[0, 2], turn[0, 1] - turn[1, 0]])
        reported.append(one.sigmas)
    said = np.sqrt((np.array(reported) ** 2).mean(axis=0))
    scatter = float(np.linalg.norm(np.std(places, axis=0)))
    assert float(np.linalg.norm(said[:3])) == pytest.approx(scatter, rel=0.1)
    # omega, phi and kappa are about tilted axes; of the whole turn only its size compares.
    assert float(np.degrees(np.linalg.norm(np.std(turns, axis=0)) / 2.0)) < 1.2 * float(np.linalg.norm(said[3:]))


LEVEL = [(0.0, 0.0), (90.0, 10.0), (180.0, -5.0), (270.0, 35.0), (45.0, 89.0), (123.0, -80.0)]


@pytest.mark.parametrize(("heading", "dip"), LEVEL)
def test_a_photo_in_a_local_frame_comes_back_to_a_billionth(heading: float, dip: float) -> None:
    """Without the large numbers of the Earth: 1e-9 of the distance and 1e-9 of a radian, whichever way it looks."""
    a, b = np.radians([heading, dip])
    ahead = np.array([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)])
    right = np.array([np.sin(a), -np.cos(a), 0.0])
    matrix = np.array([right, np.cross(-ahead, right), -ahead])
    rows = {f"r{i + 1}{j + 1}": float(matrix[i, j]) for i in range(3) for j in range(3)}
    orientation = {"system": "matrix", "matrix": "ground_to_image", **rows}
    centre = np.array([3.0, -7.0, 1.6])

    def local(**options: Any) -> FrameModel:
        request = SensorRequest("photo", SIZE, {"camera": CAMERA} | options, local_frame_crs())
        model = registry.build("frame", request)
        assert isinstance(model, FrameModel)
        return model

    truth = local(position=centre.tolist(), orientation=orientation)
    rng = np.random.default_rng(int(heading))
    pixels = rng.uniform(0.05, 0.95, (7, 2)) * SIZE
    origins, directions = truth.rays(pixels)
    ground = origins + directions * rng.uniform(10.0, 18.0, (7, 1))
    found = local(points=points_of(ground, pixels))
    metres, degrees = off(found, truth)
    assert metres < 1e-9 * 18.0
    assert degrees < np.degrees(1e-9)
    assert np.abs(found.ground_to_image(ground) - pixels).max() < 1e-9 * SIZE[0]
    x, y, z, omega, phi, kappa = found.exterior(local_frame_crs()).tolist()
    exported = local(position=[x, y, z], orientation={"system": "opk", "omega": omega, "phi": phi, "kappa": kappa})
    metres, degrees = off(exported, truth)
    assert metres < 1e-7
    assert degrees < 1e-6


def on_the_cylinder(distance: float, count: int) -> list[dict[str, float]]:
    """Points on a circle about (512000, 5300000) with the camera on its cylinder, or away by a share of the radius."""
    radius, height = 500.0, 400.0
    turn = np.radians(np.array([20.0, 140.0, 260.0, 75.0, 200.0])[:count])
    ground = np.column_stack(
        [512_000 + radius * np.cos(turn), 5_300_000 + radius * np.sin(turn), np.full(count, height)]
    )
    x = 512_000.0 + radius * (1.0 + distance)
    tilt = np.degrees(np.arctan2(x - 512_000.0, 1200.0))
    gimbal = {"system": "dji", "gimbal_yaw": 270.0, "gimbal_pitch": -90.0 + tilt, "gimbal_roll": 0.0}
    photo = build(position=[x, 5_300_000.0, 1600.0], orientation=gimbal, treatment="planar", ground_height=height)
    return points_of(ground, photo.ground_to_image(ground))


def resected(distance: float, count: int) -> tuple[str, ...]:
    radius = 500.0 * (1.0 + distance)
    near = {"position": [512_000.0 + radius, 5_300_000.0, 1600.0]} if count == 3 else {}
    return build(points=on_the_cylinder(distance, count), treatment="planar", **near).notes


def worst_sigma(notes: tuple[str, ...]) -> float:
    said = next(note for note in notes if note.startswith("sigmas"))
    return max(float(v) for v in said.split(":")[1].split(" m;")[0].split(","))


def test_the_dangerous_cylinder_of_three_points_is_reported() -> None:
    """Three points near it fit two places close together, each uncertain; four points of the circle are sound."""
    with pytest.raises(InputError, match="three points fit 4 places"):
        build(points=on_the_cylinder(0.02, 3), treatment="planar")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        far = resected(-0.6, 3)
        resected(0.02, 4)
        resected(0.02, 5)
    with pytest.warns(GeomosaicWarning, match=r"near the dangerous cylinder through them \(2 % of its radius away\)"):
        near = resected(0.02, 3)
    assert worst_sigma(near) > 10.0 * worst_sigma(far)


def test_points_close_together_are_reported() -> None:
    """Four points in a twentieth of the photo: the centre is uncertain by hundreds of pixels."""
    truth, _, _ = case(2, 4, "planar", flat=True)
    pixels = np.array([[2000.0, 1500.0], [2150.0, 1510.0], [2010.0, 1640.0], [2140.0, 1650.0]])
    origins, directions = truth.rays(pixels)
    ground = origins + directions * ((400.0 - origins[:, 2]) / directions[:, 2])[:, None]
    with pytest.warns(GeomosaicWarning, match="hardly determine the photo: they are too few, or too close together"):
        found = build(points=points_of(ground, pixels), treatment="planar")
    assert worst_sigma(found.notes) > 20.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"points": []}, ["0 control points", "give three"]),
        ({"points": "gcps.csv"}, ["not a list of tables"]),
        ({"points": [{"x": 1, "y": 2, "z": 3, "col": 4}] * 3}, ["points[0]", "'row' is missing"]),
        ({"points": [{"x": 1, "y": 2, "z": 3, "col": 4, "row": 5, "sgima": 1}] * 3}, ["did you mean 'sigma'"]),
        ({"position": [1, 2, 3]}, ["leave position out"]),
        ({"orientation": {"system": "opk"}}, ["both 'points' and 'orientation'"]),
        ({"scale_correction": True}, ["leave it out"]),
    ],
)
def test_what_cannot_be_meant_is_refused(changes: dict[str, Any], words: list[str]) -> None:
    _, ground, pixels = case(3, 6)
    with pytest.raises(InputError) as refused:
        build(**({"points": points_of(ground, pixels)} | changes))
    for word in ["photo", *words]:
        assert word in str(refused.value)


def test_points_in_line_or_of_another_place_do_not_place_it() -> None:
    _, ground, pixels = case(3, 4)
    line = ground[0] + np.outer([0.0, 1.0, 2.5, 4.0], [100.0, 50.0, 0.0])
    with pytest.raises(InputError, match=r"do not place the photo|hardly"):
        build(points=points_of(line, pixels), treatment="planar")


def test_it_looks_down() -> None:
    truth, ground, pixels = case(1, 6)
    found = build(points=points_of(ground, pixels))
    assert centre_dip(found) == pytest.approx(centre_dip(truth), abs=1e-6)
