"""The analytic ground and its photos: exact, band-limited, and independent of the sensors they test."""

from __future__ import annotations

import csv
import hashlib
import json
import tomllib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from affine import Affine
from scenery import PhotoRadiometry, Scenery, mixed_block, photograph, tie_errors, water
from scipy.ndimage import map_coordinates

from geomosaic.errors import InputError, SensorError
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.testing.synthetic import (
    CAMERA,
    AnalyticGround,
    Exposure,
    FlightPlan,
    PlainCamera,
    SyntheticPhoto,
    Vignetting,
    coordinates,
    intersect,
    radiance,
    render,
    synthetic_block,
    trace,
)

ROOT = Path(__file__).resolve().parent.parent
CRS = with_heights(parse_crs("EPSG:32633"), "egm96")
GROUND = AnalyticGround(CRS, origin=(400_000.0, 5_500_000.0))
SMALL = {**CAMERA, "size": [120, 90]}


def one_photo(**angles: float) -> SyntheticPhoto:
    tilts = {"omega": 3.0, "phi": -2.0, "kappa": 171.0} | angles
    return SyntheticPhoto("one", (400_120.0, 5_500_080.0, 1480.0), (tilts["omega"], tilts["phi"], tilts["kappa"]))


def centres(size: tuple[int, int]) -> np.ndarray:
    cols, rows = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    return np.column_stack([cols.ravel(), rows.ravel()])


def centre_of(transform: Affine, col: int, row: int) -> tuple[float, float]:
    """Map place of a pixel's centre in a north-up raster."""
    return transform.a * (col + 0.5) + transform.c, transform.e * (row + 0.5) + transform.f


def random_places(count: int, reach: float = 1500.0, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-reach, reach, (count, 2)) + GROUND.origin


# --- the ground -------------------------------------------------------------------------------------------------


def test_gradient_is_the_derivative_of_the_height() -> None:
    xy, h = random_places(2000), 0.01
    measured = np.column_stack(
        [(GROUND.height(xy + step) - GROUND.height(xy - step)) / (2 * h) for step in h * np.eye(2)]
    )
    assert np.abs(measured - GROUND.gradient(xy)).max() < 1e-8
    height, gradient = GROUND.height_and_gradient(xy)
    np.testing.assert_allclose(height, GROUND.height(xy), atol=1e-10)
    np.testing.assert_array_equal(gradient, GROUND.gradient(xy))


def test_heights_and_slopes_stay_in_their_bounds_and_there_is_relief() -> None:
    xy = random_places(200_000, 3000.0)
    z = GROUND.height(xy)
    low, high = GROUND.range
    assert low <= z.min()
    assert z.max() <= high
    assert np.ptp(GROUND.height(random_places(20_000, 1000.0))) > 100.0
    assert np.hypot(*GROUND.gradient(xy).T).max() <= GROUND.steepest
    assert np.ptp(AnalyticGround(CRS, exaggeration=0.0).height(xy)) == 0.0


def test_patch_has_the_heights_at_its_nodes_and_covers_the_bounds() -> None:
    bounds = (400_001.3, 5_499_990.0, 400_050.0, 5_500_033.7)
    patch = GROUND.patch(bounds)
    rows, cols = patch.heights.shape
    x0, y0 = centre_of(~patch.transform, 0, 0)
    x1, y1 = x0 + (cols - 1) * GROUND.spacing, y0 - (rows - 1) * GROUND.spacing
    assert x0 <= bounds[0] - 2
    assert x1 >= bounds[2] + 2
    assert y1 <= bounds[1] - 2
    assert y0 >= bounds[3] + 2
    nodes = np.array([[x0 + 3 * GROUND.spacing, y0 - 5 * GROUND.spacing], [x1, y1]])
    np.testing.assert_allclose([patch.heights[5, 3], patch.heights[-1, -1]], GROUND.height(nodes), atol=5e-5)


def test_a_ground_needs_a_map_with_heights() -> None:
    with pytest.raises(InputError, match="heights"):
        AnalyticGround(parse_crs("EPSG:32633"))
    with pytest.raises(InputError, match="heights"):
        AnalyticGround(parse_crs("EPSG:4978"))
    with pytest.raises(InputError, match="bands"):
        AnalyticGround(CRS, bands=5)


@pytest.mark.parametrize("wavelength", [2.5, 8.0])
def test_texture_is_band_limited(wavelength: float) -> None:
    """Beyond twice the smallest wavelength's frequency lies 0.2 % of the amplitude; within lies detail."""
    land = AnalyticGround(CRS, GROUND.origin, wavelength=wavelength)
    step, count, power = wavelength / 25.0, 8192, 0.0
    random = np.random.default_rng(2)
    for _ in range(6):
        angle, start = random.uniform(0, 2 * np.pi), random.uniform(-600, 600, 2)
        along = np.arange(count)[:, None] * step
        values = land.texture(start + land.origin + along * [np.cos(angle), np.sin(angle)])[:, 1].astype(float)
        power = power + np.abs(np.fft.rfft((values - values.mean()) * np.hanning(count))) ** 2
    frequency = np.fft.rfftfreq(count, step) * wavelength
    share = {limit: float(np.sqrt(power[frequency > limit].sum() / power.sum())) for limit in (0.25, 1.0, 2.0)}
    assert share[0.25] > 0.03
    assert share[1.0] < 0.02
    assert share[2.0] < 0.003


def test_texture_is_a_function_of_the_place_only() -> None:
    xy = random_places(500)
    whole = GROUND.texture(xy)
    assert whole.dtype == np.float32
    assert whole.shape == (500, 3)
    assert whole.min() >= 0
    assert whole.max() <= 1
    assert whole.std(axis=0).min() > 0.05  # fields, woods and water differ
    np.testing.assert_array_equal(GROUND.texture(xy[::-1])[::-1], whole)
    holed = xy.copy()
    holed[7, 0] = np.nan
    seen = GROUND.texture(holed)
    assert np.isnan(seen[7]).all()
    np.testing.assert_array_equal(np.delete(seen, 7, 0), np.delete(whole, 7, 0))
    assert np.abs(AnalyticGround(CRS, GROUND.origin, seed=8).texture(xy) - whole).max() > 0.1
    four = AnalyticGround(CRS, GROUND.origin, bands=4).texture(xy)
    np.testing.assert_array_equal(four[:, :3], whole)


def test_targets_are_bright_spots_where_they_were_put() -> None:
    place = (400_070.0, 5_500_010.0)
    land = AnalyticGround(CRS, GROUND.origin, targets=(place,))
    around = np.array(place) + np.array([[0.0, 0.0], [3.0, 0.0], [40.0, 0.0]])
    spot, ring, far = land.texture(around)
    assert spot.min() > 0.85
    assert ring.max() < 0.35
    np.testing.assert_array_equal(far, GROUND.texture(around[2:])[0])


# --- photos -----------------------------------------------------------------------------------------------------


def test_rendered_coordinates_project_back_to_their_pixels() -> None:
    seen = one_photo().camera(SMALL, GROUND)
    xyz = render(seen, GROUND, texture=coordinates, dtype=np.float64).reshape(-1, 3) + GROUND.datum
    assert np.abs(seen.project(xyz) - centres(seen.size)).max() < 1e-6
    assert np.abs(GROUND.height(xyz[:, :2]) - xyz[:, 2]).max() < 1e-7
    single = render(seen, GROUND, texture=coordinates, dtype=np.float32).reshape(-1, 3).astype(float) + GROUND.datum
    assert np.abs(seen.project(single) - centres(seen.size)).max() < 1e-4


def test_a_target_on_the_ground_appears_where_it_projects() -> None:
    place = (400_070.0, 5_500_010.0)
    land = AnalyticGround(CRS, GROUND.origin, targets=(place,))
    big = one_photo().camera(CAMERA, land)
    expected = big.project(np.array([[*place, land.height(np.array([place]))[0]]]))[0]
    # A small window of the large photo, through the same door: the camera with its principal point moved.
    left, top = (int(v) - 15 for v in expected)
    pixels = centres((30, 30)) + np.array([left, top])
    values = radiance(land, intersect(big, land, pixels)) - radiance(GROUND, intersect(big, GROUND, pixels))
    weight = np.maximum(values.sum(axis=1), 0)
    weight[np.hypot(*(pixels - expected).T) > 2.5] = 0
    centroid = (pixels * weight[:, None]).sum(axis=0) / weight.sum()
    assert np.hypot(*(centroid - expected)) < 0.1


def test_convergence_and_rotation_by_hand() -> None:
    """A vertical photo over flat country with kappa 0: grid north of the nadir lies straight up in the image."""
    flat = AnalyticGround(CRS, GROUND.origin, exaggeration=0.0)
    ideal = {"size": [1000, 1000], "focal_length": 50.0, "sensor_size": [50.0, 50.0]}
    seen = PlainCamera(ideal, CRS, (400_000.0, 5_500_000.0, 1450.0), (0.0, 0.0, 0.0))
    places = np.array([[0.0, 0.0], [0.0, 100.0], [100.0, 0.0]]) + flat.origin
    nadir, north, east = seen.project(np.column_stack([places, flat.height(places)]))
    np.testing.assert_allclose(nadir, [500.0, 500.0], atol=2e-2)
    # 1000 m above ground and f = 1000 px: 1 px per metre, but for the map's scale (0.9997) there.
    np.testing.assert_allclose(north - nadir, [0.0, -100.0], atol=0.05)
    np.testing.assert_allclose(east - nadir, [100.0, 0.0], atol=0.05)
    turned = PlainCamera(ideal, CRS, seen.position, (0.0, 0.0, 90.0))  # kappa turns the camera left
    np.testing.assert_allclose(turned.project(np.array([[*places[1], 450.0]]))[0] - nadir, [100.0, 0.0], atol=0.05)


def test_convergence_is_that_of_the_projection() -> None:
    from pyproj import Proj, Transformer

    seen = one_photo(omega=0.0, phi=0.0, kappa=0.0).camera(CAMERA, GROUND)
    longitude, latitude = Transformer.from_crs(32633, 4326, always_xy=True).transform(*seen.position[:2])
    lon, lat = np.radians([longitude, latitude])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    north = np.array([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)])
    grid_north = seen.rotation[:, 1]
    azimuth = np.degrees(np.arctan2(grid_north @ east, grid_north @ north))
    assert azimuth == pytest.approx(Proj("EPSG:32633").get_factors(longitude, latitude).meridian_convergence, abs=1e-8)


def test_oblique_rays_meet_the_nearest_slope_and_the_sky_is_nan() -> None:
    steep = AnalyticGround(CRS, GROUND.origin, exaggeration=3.0)
    seen = PlainCamera(SMALL, CRS, (399_000.0, 5_500_500.0, 900.0), (0.0, -72.0, -90.0))
    pixels = centres(seen.size)
    xyz = intersect(seen, steep, pixels)
    hit = np.isfinite(xyz).all(axis=1)
    assert 0.1 < hit.mean() < 0.95
    origins, directions = seen.rays(pixels)
    assert np.abs(seen.project(xyz[hit]) - pixels[hit]).max() < 1e-5
    # Walk a few rays by hand, metre by metre, with pyproj alone: none is below ground before its hit.
    for k in np.flatnonzero(hit)[::97]:
        earth = np.array(seen._to_earth.transform(*xyz[k]))
        reach = np.linalg.norm(earth - origins[k])
        t = np.arange(1.0, reach - 0.5, 1.0)
        walked = origins[k] + t[:, None] * directions[k]
        x, y, z = seen._to_earth.transform(*walked.T, direction="INVERSE")
        assert (z > steep.height(np.column_stack([x, y]))).all()
    assert np.isnan(trace(seen.crs, origins[hit], -directions[hit], steep)).all()  # turned to the sky


def test_exposure_vignetting_noise_and_types() -> None:
    seen = one_photo().camera(SMALL, GROUND)
    plain = render(seen, GROUND, dtype=np.float32)
    np.testing.assert_allclose(plain.reshape(-1, 3), radiance(GROUND, intersect(seen, GROUND, centres(seen.size))))
    changed = render(
        seen, GROUND, vignetting=Vignetting(0.3, 0.1), exposure=Exposure((1.1, 1.0, 0.9), (0.02,)), dtype=np.float32
    )
    np.testing.assert_allclose(changed[0, 0], 0.6 * plain[0, 0] * [1.1, 1.0, 0.9] + 0.02, atol=0.01)
    np.testing.assert_allclose(changed[45, 60], plain[45, 60] * [1.1, 1.0, 0.9] + 0.02, atol=1e-3)
    noisy = render(seen, GROUND, noise=0.02, seed=4, dtype=np.float32)
    assert abs((noisy - plain).std() - 0.02) < 0.0005
    np.testing.assert_array_equal(noisy, render(seen, GROUND, noise=0.02, seed=4, dtype=np.float32))
    np.testing.assert_array_equal(render(seen, GROUND), np.rint(plain.astype(float) * 255))
    assert render(seen, GROUND, dtype=np.uint16).max() > 30_000
    fine = render(seen, GROUND, supersample=2, dtype=np.float32)
    assert 0 < np.abs(fine - plain).mean() < 0.1


def test_blocks_have_their_overlaps() -> None:
    block = synthetic_block(GROUND, CAMERA, FlightPlan(3, 4, 0.6, 0.3, gsd=0.5, tilt=0.0, drift=0.0, shake=0.0), seed=1)
    assert len({photo.name for photo in block}) == 12
    xy = np.array([photo.position[:2] for photo in block]).reshape(3, 4, 2)
    np.testing.assert_allclose(np.abs(np.diff(xy[..., 0], axis=1)), 0.4 * 1200 * 0.5, atol=1e-3)
    np.testing.assert_allclose(np.diff(xy[..., 1], axis=0), -0.7 * 900 * 0.5, atol=1e-3)
    assert [round(abs(photo.angles[2])) for photo in block[::4]] == [0, 180, 0]
    middle = np.array([[599.5, 450.0], [600.5, 450.0]])
    a, b = intersect(block[5].camera(CAMERA, GROUND), AnalyticGround(CRS, GROUND.origin, exaggeration=0.0), middle)
    assert np.hypot(*(a - b)[:2]) == pytest.approx(0.5, rel=0.01)
    assert synthetic_block(GROUND, CAMERA, FlightPlan(2, 3), seed=5) == synthetic_block(
        GROUND, CAMERA, FlightPlan(2, 3), seed=5
    )


def test_frame_plugin_agrees_with_the_independent_camera() -> None:
    """Two implementations of one camera, written by different hands."""
    from geomosaic.geo.transform import Transform
    from geomosaic.sensor import registry
    from geomosaic.sensor.plugin import SensorRequest

    try:
        registry.plugin("frame")
    except SensorError as error:
        pytest.skip(f"the frame sensor is not installed: {error.what}")
    for photo in synthetic_block(GROUND, CAMERA, FlightPlan(2, 2, tilt=8.0, drift=40.0), seed=9):
        omega, phi, kappa = photo.angles
        options = {
            "camera": CAMERA,
            "position": list(photo.position),
            "orientation": {"system": "opk", "omega": omega, "phi": phi, "kappa": kappa},
        }
        model = registry.build("frame", SensorRequest(photo.name, (1200, 900), options, CRS))
        seen = photo.camera(CAMERA, GROUND)
        pixels = np.random.default_rng(3).uniform([0, 0], [1200, 900], (300, 2))
        xyz = intersect(seen, GROUND, pixels)
        projected = model.ground_to_image(Transform(CRS, model.crs)(xyz))
        assert np.abs(projected - pixels).max() < 1e-6


# --- the sample block -------------------------------------------------------------------------------------------


def test_sample_files_are_those_of_the_manifest(sample: Path) -> None:
    lines = (sample / "SHA256SUMS").read_text().split("\n")[:-1]
    assert len(lines) == 18
    for line in lines:
        digest, name = line.split("  ")
        assert hashlib.sha256((sample / name).read_bytes()).hexdigest() == digest, name
    assert sum(f.stat().st_size for f in sample.rglob("*") if f.is_file()) < 15e6


def test_sample_is_what_its_generator_says(sample: Path, generator: ModuleType) -> None:
    land = generator.ground()
    block = generator.photos(land)
    with (sample / "exterior.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["image"] for row in rows] == [generator.photo_name(photo) for photo in block]
    for row, photo in zip(rows, block, strict=True):
        assert tuple(float(row[k]) for k in "xyz") == photo.position
        assert tuple(float(row[k]) for k in ("omega", "phi", "kappa")) == photo.angles
    assert tomllib.loads((sample / "camera.toml").read_text()) == CAMERA
    truth = json.loads((sample / "truth" / "truth.json").read_text())
    assert [e.gain for e in generator.exposures(12)] == [tuple(p["gain"]) for p in truth["photos"].values()]


def test_sample_points_are_measured_where_they_project(sample: Path, generator: ModuleType) -> None:
    land = generator.ground()
    cameras = {generator.photo_name(p): p.camera(CAMERA, land) for p in generator.photos(land)}
    with (sample / "gcps.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["role"] for row in rows} == {"control", "check"}
    errors = []
    for row in rows:
        seen = cameras[row["image"]].project(np.array([[float(row[k]) for k in "xyz"]]))[0]
        errors.append(seen - [float(row["col"]), float(row["row"])])
    # 0.2 px of measuring and about 0.05 px of surveying
    assert 0.1 < np.sqrt(np.mean(np.square(errors))) < 0.3
    assert np.abs(errors).max() < 0.9


def test_sample_rasters_say_what_they_are(sample: Path, generator: ModuleType) -> None:
    import rasterio

    land = generator.ground()
    with rasterio.open(sample / "dem.tif") as dem:
        assert parse_crs(dem.crs.to_wkt()).is_compound
        heights, place = dem.read(1), dem.transform
    for row, col in ((0, 0), (100, 30), (heights.shape[0] - 1, heights.shape[1] - 1)):
        x, y = centre_of(place, col, row)
        assert heights[row, col] == pytest.approx(land.height(np.array([[x, y]]))[0], abs=0.006)
    with rasterio.open(sample / "truth" / "reflectance.tif") as truth:
        x, y = centre_of(truth.transform, 700, 300)
        np.testing.assert_allclose(truth.read()[:, 300, 700], 255 * land.texture(np.array([[x, y]]))[0], atol=1)
    for photo in sorted((sample / "photos").iterdir()):
        with rasterio.open(photo) as file:
            assert (file.width, file.height, file.count, file.dtypes[0]) == (1200, 900, 3, "uint8")
            assert file.crs is None


def test_a_sample_photo_comes_out_the_same_twice(tmp_path: Path, generator: ModuleType) -> None:
    made = []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        made.append(generator.make_photo(tmp_path / name, 5, reduce=6).read_bytes())
    assert made[0] == made[1]


def test_sample_photo_is_the_render_of_its_ground(sample: Path, generator: ModuleType) -> None:
    """A strip of one committed photo against the ground's colour, through camera effects: JPEG and noise remain."""
    import rasterio

    land = generator.ground()
    photo = generator.photos(land)[6]
    pixels = centres((1200, 20)) + np.array([0.0, 440.0])
    seen = photo.camera(CAMERA, land)
    values = radiance(land, intersect(seen, land, pixels)) * generator.VIGNETTING.factor(pixels, seen.size)[:, None]
    effect = generator.exposures(12)[6]
    expected = 255 * (values * np.array(effect.gain) + np.array(effect.offset))
    with rasterio.open(sample / "photos" / generator.photo_name(photo)) as file:
        committed = file.read()[:, 440:460].reshape(3, -1).T
    assert np.sqrt(np.mean((committed - expected) ** 2)) < 3.0


# --- scenery ----------------------------------------------------------------------------------------------------


def flat_photo(x: float, y: float, **look: float) -> np.ndarray:
    """Grey values of a photo that looks straight down on a plain, metres from the origin."""
    plain = AnalyticGround(CRS, origin=GROUND.origin, exaggeration=0.0)
    place = (GROUND.origin[0] + x, GROUND.origin[1] + y, GROUND.base + 120.0)
    camera = PlainCamera({**SMALL, "distortion": {}}, CRS, place, (0.0, 0.0, 0.0))
    return photograph(camera, plain, Scenery(finest=1.0), PhotoRadiometry(noise=0.0, **look)).astype(np.float64)[..., 1]


def test_scenery_repeats_nowhere() -> None:
    here = flat_photo(0.0, 0.0)
    assert np.corrcoef(here.ravel(), flat_photo(0.0, 0.0, gain=0.8).ravel())[0, 1] > 0.999
    for away in (64.0, 128.0, 1024.0, 4096.0):
        assert abs(np.corrcoef(here.ravel(), flat_photo(away, 0.0).ravel())[0, 1]) < 0.5
        assert abs(np.corrcoef(here.ravel(), flat_photo(away, -away).ravel())[0, 1]) < 0.5


def test_photos_of_scenery_show_the_same_ground_where_the_cameras_say() -> None:
    scenery = Scenery(finest=4.0)
    one, other = (photo.camera(SMALL, GROUND) for photo in mixed_block(GROUND, SMALL, ((1, 2),), gsd=2.0, tilt=20.0))
    first, second = (
        photograph(each, GROUND, scenery, PhotoRadiometry(noise=0.0)).astype(float)[..., 1] for each in (one, other)
    )
    there = other.project(intersect(one, GROUND, centres((120, 90))))
    inside = ((there > 2.0) & (there < np.array([118.0, 88.0]))).all(axis=1)
    seen = map_coordinates(second, there[inside][:, ::-1].T - 0.5, order=3)
    assert inside.sum() > 3000
    assert np.std(first) > 20.0
    assert np.sqrt(((seen - first.ravel()[inside]) ** 2).mean()) < 3.0


def test_water_covers_its_share_and_is_another_in_every_photo() -> None:
    scenery = Scenery(finest=4.0, water=1 / 3)
    wet = water(scenery, np.random.default_rng(0).uniform(-2e4, 2e4, (20_000, 2)))
    assert wet.mean() == pytest.approx(1 / 3, abs=0.04)
    camera = one_photo().camera(SMALL, GROUND)
    one, other = (photograph(camera, GROUND, scenery, PhotoRadiometry(noise=0.0, seed=k)) for k in (1, 2))
    place = intersect(camera, GROUND, centres((120, 90)))[:, :2] - GROUND.origin
    differs, wet = (one != other).any(axis=2).ravel(), water(scenery, place)
    assert (differs == wet).mean() > 0.97
    assert 0.05 < differs.mean() < 0.95


def test_true_errors_of_ties_are_those_that_were_made() -> None:
    cameras = [photo.camera(SMALL, GROUND) for photo in mixed_block(GROUND, SMALL, ((1, 4),), gsd=2.0, tilt=1.0)]
    points = intersect(cameras[1], GROUND, np.array([[60.0, 45.0], [70.0, 40.0]]))
    image, point = np.repeat([0, 1, 2], 2), np.tile([0, 1], 3)
    colrow = np.concatenate([camera.project(points) for camera in cameras[:3]])
    off = tie_errors(cameras, GROUND, image, point, colrow)
    assert np.isnan(off).sum() == 2
    assert np.nanmax(off) < 1e-3
    colrow[4] += [3.0, -4.0]
    off = tie_errors(cameras, GROUND, image, point, colrow)
    assert np.nanmax(off) == pytest.approx(5.0, abs=0.7)
    assert np.sort(off[~np.isnan(off)])[-2] < 1e-3
