"""Grids, CRSs, datums, transforms, local frames and rotations against algebra, pyproj, PROJ's factors and SciPy."""

from __future__ import annotations

import math
import pickle
import shutil
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pyproj
import pytest
from affine import Affine
from hypothesis import assume, given
from hypothesis import strategies as st
from pyproj import CRS
from scipy.spatial.transform import Rotation

from geomosaic.errors import HeightDatumError, InputError
from geomosaic.geo.crs import (
    DATA,
    geocentric,
    geographic,
    has_heights,
    height_name,
    horizontal,
    parse_crs,
    parse_map,
    with_heights,
    with_local_heights,
)
from geomosaic.geo.engineering_crs import local_frame_crs
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.local_frames import (
    LocalFrame,
    angle_axis,
    angles_of,
    enu_axes,
    map_place,
    omega_phi_kappa,
    r1,
    r2,
    r3,
)
from geomosaic.geo.transform import Transform

UTM32 = CRS.from_epsg(25832)
WGS84 = CRS.from_epsg(4979)
MUNICH = (11.58, 48.14)
EGM96_MUNICH = 45.53  # NGA's EGM96 calculator, 15' grid

windows = st.builds(Window, *[st.integers(-50, 50)] * 2, *[st.integers(1, 60)] * 2)
affines = st.builds(
    lambda x, y, angle, sx, sy, flip: (
        Affine.translation(x, y) @ Affine.rotation(angle) @ Affine.scale(sx, sy if flip else -sy)
    ),
    st.floats(-1e6, 1e6), st.floats(-1e7, 1e7), st.floats(-180, 180), st.floats(0.01, 100), st.floats(0.01, 100),
    st.booleans(),
)  # fmt: skip


def grids():
    return st.builds(lambda t, w, h: Grid(UTM32, t, w, h), affines, st.integers(1, 5000), st.integers(1, 5000))


def pixels(window: Window) -> set[tuple[int, int]]:
    return {(c, r) for c in range(window.col, window.stop_col) for r in range(window.row, window.stop_row)}


# --- windows and grids ---------------------------------------------------------------------------------------------


@given(windows, windows)
def test_window_intersection_is_that_of_pixels(a, b):
    common = a.intersection(b)
    assert (set() if common.empty else pixels(common)) == pixels(a) & pixels(b)
    assert a.intersection(b) == b.intersection(a)


@given(windows, st.data())
def test_window_within_another_finds_its_pixels_in_that_ones_array(outer, data):
    col = data.draw(st.integers(outer.col, outer.stop_col - 1))
    row = data.draw(st.integers(outer.row, outer.stop_row - 1))
    part = Window(col, row, outer.width, outer.height).intersection(outer)
    rows, cols = np.mgrid[outer.row : outer.stop_row, outer.col : outer.stop_col]
    place = part.slices_in(outer)
    assert set(zip(cols[place].flat, rows[place].flat, strict=True)) == pixels(part)


@given(windows, st.integers(1, 20), st.integers(1, 20))
def test_window_split_covers_once_in_order(window, width, height):
    parts = window.split(width, height)
    assert sum(len(pixels(part)) for part in parts) == len(pixels(window))
    assert set().union(*map(pixels, parts)) == pixels(window)
    assert [(p.row, p.col) for p in parts] == sorted((p.row, p.col) for p in parts)
    assert all(p.width <= width and p.height <= height for p in parts)


@given(grids(), st.floats(-100, 6000), st.floats(-100, 6000))
def test_grid_there_and_back(grid, col, row):
    colrow = np.array([[col, row]])
    tolerance = 1e-8 * (1 + 1e7 / min(grid.resolution))
    np.testing.assert_allclose(grid.colrow(grid.xy(colrow)), colrow, atol=tolerance)


def test_pixel_centres_and_bounds():
    grid = Grid(UTM32, Affine(2, 0, 100, 0, -2, 50), 10, 5)
    np.testing.assert_array_equal(grid.xy(np.array([[0.5, 0.5], [0, 0], [10, 5]])), [[101, 49], [100, 50], [120, 40]])
    assert grid.bounds == (100, 40, 120, 50)
    assert grid.resolution == (2, 2)
    assert grid.shape == (5, 10)


@given(grids(), st.integers(0, 3000), st.integers(0, 3000), st.integers(1, 900), st.integers(1, 900))
def test_crop_shows_the_same_places(grid, col, row, width, height):
    part = grid.crop(Window(col, row, width, height))
    assert (part.width, part.height) == (width, height)
    local = np.array([[0.5, 0.5], [width, height]])
    np.testing.assert_allclose(part.xy(local), grid.xy(local + np.array([col, row])), rtol=1e-12, atol=1e-6)


@given(grids(), st.integers(1, 32))
def test_coarser_covers_with_larger_pixels(grid, factor):
    coarse = grid.coarser(factor)
    assert (coarse.width - 1) * factor < grid.width <= coarse.width * factor
    assert (coarse.height - 1) * factor < grid.height <= coarse.height * factor
    place = np.array([[3.25, 1.5]])
    np.testing.assert_allclose(coarse.xy(place), grid.xy(place * factor), rtol=1e-12, atol=1e-6)
    np.testing.assert_allclose(coarse.resolution, np.array(grid.resolution) * factor, rtol=1e-9)


@given(
    st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.floats(0.5, 5000), st.floats(0.5, 5000),
    st.sampled_from([0.05, 0.1, 0.25, 1.0, 2.5, 30.0]), st.booleans(),
)  # fmt: skip
def test_from_bounds_covers_tightly_and_snaps(left, bottom, width, height, resolution, snap):
    assume(width / resolution < 1e5 and height / resolution < 1e5)
    bounds = (left, bottom, left + width, bottom + height)
    grid = Grid.from_bounds(UTM32, bounds, resolution, snap=snap)
    got = np.array(grid.bounds)
    hair = 2e-6 * resolution + 1e-9 * 1e6
    assert (got[:2] <= np.array(bounds[:2]) + hair).all()
    assert (got[2:] >= np.array(bounds[2:]) - hair).all()
    spare = 2 if snap else 1
    assert grid.width <= math.ceil(width / resolution) + spare
    assert grid.height <= math.ceil(height / resolution) + spare
    if snap:
        edges = np.array([grid.transform.c, grid.transform.f]) / resolution
        np.testing.assert_allclose(edges, np.round(edges), atol=1e-6)


def test_from_bounds_makes_no_column_of_rounding():
    assert Grid.from_bounds(UTM32, (0.1 + 0.2, 0, 0.9, 0.6), 0.3).width == 2
    assert Grid.from_bounds(UTM32, (0, 0, 10.0000000001, 10), 1).shape == (10, 10)


@given(grids(), st.integers(0, 4000), st.integers(0, 4000), st.integers(1, 300), st.integers(1, 300))
def test_window_of_holds_the_bounds(grid, col, row, width, height):
    inside = Window(col, row, width, height).intersection(grid.window)
    assume(not inside.empty)
    found = grid.window_of(grid.crop(inside).bounds)
    assert inside.intersection(found) == inside or min(grid.resolution) < 1e-2
    if grid.transform.b == 0 and grid.transform.d == 0:
        assert found.width <= inside.width + 2


def test_grids_that_are_none():
    for grid in (
        (Affine(1, 0, 0, 0, -1, 0), 0, 5),
        (Affine(1, 0, 0, 0, -1, 0), 5, -1),
        (Affine(0, 0, 0, 0, 0, 0), 5, 5),
    ):
        with pytest.raises(InputError):
            Grid(UTM32, *grid)
    for bounds, resolution in (((0, 0, 0, 5), 1), ((0, 0, 5, math.nan), 1), ((0, 0, 5, 5), 0), ((0, 0, 5, 5), -1)):
        with pytest.raises(InputError):
            Grid.from_bounds(UTM32, bounds, resolution)
    assert Grid(UTM32, Affine(1, 0, 0, 0, -1, 0), 5, 5).window_of((100, 100, 110, 110)).empty


# --- CRSs and heights ----------------------------------------------------------------------------------------------


def test_a_crs_is_read_in_all_its_spellings(tmp_path):
    assert parse_crs("EPSG:25832").equals(UTM32)
    (tmp_path / "a.prj").write_text(UTM32.to_wkt("WKT1_ESRI"))
    assert parse_crs(str(tmp_path / "a.prj")).is_projected
    for text in ("", "  ", "EPSG:99999999", "nonsense", str(tmp_path / "none.prj")):
        with pytest.raises(InputError) as caught:
            parse_crs(text, "--dst-crs")
        assert "--dst-crs" in str(caught.value)
        assert "EPSG" in str(caught.value)


@pytest.mark.parametrize("code", [25832, 4326, 4258, 2193, 3006, 27572, 3031])
def test_declared_heights_become_a_three_dimensional_crs(code):
    flat = CRS.from_epsg(code)
    assert not has_heights(flat)
    assert height_name(flat) == "undeclared"
    ellipsoidal, geoid = with_heights(flat, "ellipsoidal"), with_heights(flat, "egm96")
    assert height_name(ellipsoidal) == "ellipsoidal"
    assert height_name(geoid) == "EGM96 height"
    for crs in (ellipsoidal, geoid):
        assert has_heights(crs)
        assert horizontal(crs).equals(flat, ignore_axis_order=True)
        assert len(horizontal(crs).axis_info) == 2
    assert height_name(with_heights(geoid, "ellipsoidal")) == "ellipsoidal"
    with pytest.raises(HeightDatumError, match="not a vertical"):
        with_heights(flat, "EPSG:25832")
    with pytest.raises(HeightDatumError, match="geoid grid"):
        with_heights(flat, "sealevel")
    with pytest.raises(HeightDatumError, match="does not exist"):
        with_heights(flat, "/none/geoid.tif")


def test_a_geoid_comes_along():
    to_ellipsoid = Transform(with_heights(CRS.from_epsg(4326), "egm96"), WGS84)
    found = to_ellipsoid(np.array([[*MUNICH, 0.0], [*MUNICH, 500.0]]))
    np.testing.assert_allclose(found[:, :2], [MUNICH, MUNICH], atol=1e-9)
    np.testing.assert_allclose(found[:, 2], [EGM96_MUNICH, 500 + EGM96_MUNICH], atol=0.02)
    np.testing.assert_allclose(to_ellipsoid.inverse()(found)[:, 2], [0, 500], atol=1e-6)


def test_a_geoid_grid_by_path():
    """The shipped grid given as a user's file does what 'egm96' does."""
    own = with_heights(CRS.from_epsg(32632), str(DATA / "us_nga_egm96_15.tif"))
    named = with_heights(CRS.from_epsg(32632), "egm96")
    points = np.array([[691_900.0, 5_334_900.0, 500.0], [500_000.0, 100_000.0, -3.0]])
    np.testing.assert_allclose(Transform(own, WGS84)(points), Transform(named, WGS84)(points), atol=1e-9)
    assert has_heights(own)


@pytest.mark.parametrize("name", ['my "best" geoid.tif', "O'Neill [2020] (m) & co %20 $x\\y.tif", "Höhe 高.tif"])
def test_a_geoid_grid_under_any_name(tmp_path, name):
    folder = tmp_path / name.removesuffix(".tif")
    folder.mkdir()
    shutil.copy(DATA / "us_nga_egm96_15.tif", folder / name)
    flat = CRS.from_epsg(32632)
    point = np.array([[690_000.0, 5_335_000.0, 500.0]])
    by_path, by_code = (
        Transform(with_heights(flat, datum), with_heights(flat, "ellipsoidal"))(point)
        for datum in (str(folder / name), "egm96")
    )
    np.testing.assert_array_equal(by_path, by_code)
    assert height_name(with_heights(flat, str(folder / name))) == f"geoid {name.removesuffix('.tif')}"


@pytest.mark.parametrize("mark", list("#,;{=\t\n"))
def test_a_geoid_grid_whose_name_proj_cannot_read(tmp_path, mark):
    file = tmp_path / f"a {mark}b" / "grid.tif"
    file.parent.mkdir()
    shutil.copy(DATA / "us_nga_egm96_15.tif", file)
    with pytest.raises(HeightDatumError, match="cannot open a geoid grid") as caught:
        with_heights(CRS.from_epsg(32632), str(file), "exterior.csv")
    assert caught.value.where == "exterior.csv"
    assert "rename" in str(caught.value.hint)


@pytest.mark.parametrize("text", ["EPSG:4978", "EPSG:5773"])
def test_no_map_without_two_axes(text):
    assert parse_map("EPSG:32632+5773") == CRS.from_epsg(32632)
    assert parse_map("EPSG:4979") == CRS.from_epsg(4979).to_2d()
    with pytest.raises(InputError, match="has not two axes"):
        parse_map(text)


def test_a_missing_grid_is_named():
    dhhn = with_heights(UTM32, "EPSG:7837")  # DHHN2016, whose grid is not installed
    with pytest.raises(HeightDatumError) as caught:
        Transform(dhhn, WGS84)
    text = str(caught.value)
    assert "GCG" in text or "gcg" in text
    assert "DHHN2016" in text
    assert "geoid grid" in text


def test_undeclared_heights_do_not_meet_the_earth():
    with pytest.raises(HeightDatumError, match="no vertical datum"):
        Transform(UTM32, CRS.from_epsg(4978))
    with pytest.raises(HeightDatumError, match="no vertical datum"):
        Transform(CRS.from_epsg(4978), UTM32)
    # Between maps heights pass through, unless both sides say what they are.
    found = Transform(UTM32, CRS.from_epsg(4326))(np.array([[691_900.0, 5_334_900.0, 123.0]]))
    assert found[0, 2] == 123.0


@pytest.mark.parametrize("code", [25832, 4326, 2193, 3006, 3031, 27572])
def test_transforms_are_east_first_and_come_back(code):
    crs = CRS.from_epsg(code)
    place = {2193: (174.8, -41.3), 3031: (40.0, -80.0), 3006: (15.0, 60.0), 27572: (2.5, 46.5)}.get(code, MUNICH)
    there = Transform(CRS.from_epsg(4326), crs)
    xy = there(np.array([place]))
    truth = pyproj.Transformer.from_crs(4326, crs, always_xy=True).transform(*place)
    np.testing.assert_allclose(xy[0], truth, rtol=1e-10)
    np.testing.assert_allclose(there.inverse()(xy)[0], place, atol=1e-8)


def test_bad_points_are_nan_and_spoil_no_others():
    points = np.array([[*MUNICH, 0.0], [np.nan, 48, 0], [11, 95, 0], [11, 48, np.inf], [*MUNICH, 0.0]])
    found = Transform(WGS84, CRS.from_epsg(4978))(points)
    np.testing.assert_array_equal(np.isnan(found).all(axis=1), [False, True, True, True, False])
    np.testing.assert_array_equal(found[0], found[4])
    assert Transform(WGS84, UTM32)(np.zeros((0, 3))).shape == (0, 3)


def test_transforms_in_threads_and_pickled():
    transform = Transform(with_heights(UTM32, "egm96"), CRS.from_epsg(4978))
    points = np.random.default_rng(0).uniform((5e5, 5.2e6, 0), (6e5, 5.4e6, 900), (2000, 3))
    alone = transform(points)
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(transform, [points] * 16):
            np.testing.assert_array_equal(found, alone)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(transform))(points), alone)


@pytest.mark.parametrize("code", [25832, 4326, 27572, 2193])
def test_geocentric_on_the_same_datum(code):
    """By the closed formula of the ellipsoid; no datum shift between a map and its own geocentric frame.

    Longitudes count from the datum's own prime meridian (Paris for 27572), and so does the X axis.
    """
    flat = CRS.from_epsg(code)
    ecef, lonlat = geocentric(flat), geographic(flat)
    assert ecef.is_geocentric
    place = {27572: (2.5, 46.5), 2193: (174.8, -41.3)}.get(code, MUNICH)
    found = Transform(lonlat, ecef)(np.array([[*place, 700.0]]))[0]
    a, b = flat.ellipsoid.semi_major_metre, flat.ellipsoid.semi_minor_metre
    e2 = 1 - (b / a) ** 2
    lon, lat = np.radians(place)
    n = a / math.sqrt(1 - e2 * math.sin(lat) ** 2)
    truth = [
        (n + 700) * math.cos(lat) * math.cos(lon),
        (n + 700) * math.cos(lat) * math.sin(lon),
        (n * (1 - e2) + 700) * math.sin(lat),
    ]
    np.testing.assert_allclose(found, truth, atol=1e-4)


# --- local frames, convergence, scale ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "lon", "lat"),
    [
        (25832, 6.5, 48), (25832, 9, 50), (25832, 11.9, 54), (32733, 17.5, -33), (2154, 0.2, 44), (3035, 25, 60),
        (2193, 177, -38), (27572, 0.2, 44),
    ],
)  # fmt: skip
def test_convergence_and_scale_as_proj(code, lon, lat):
    crs = CRS.from_epsg(code)
    x, y = Transform(CRS.from_epsg(4326), crs)(np.array([[lon, lat]]))[0]
    place = map_place(crs, x, y)
    factors = pyproj.Proj(crs).get_factors(place.longitude, place.latitude)
    # A projection that is not conformal turns other directions than the meridian's by other angles.
    conformal = code != 3035
    assert place.convergence == pytest.approx(factors.meridian_convergence, abs=1e-5 if conformal else 0.01)
    # By geometry: the azimuth, on the ellipsoid, of a short way to grid north.
    ends = Transform(crs, horizontal(geographic(crs)))(np.array([[x, y - 50], [x, y + 50]]))
    forward, backward, length = crs.get_geod().inv(*ends[0], *ends[1])
    azimuth = (forward + backward - 180) / 2 if backward > 0 else (forward + backward + 180) / 2
    assert place.convergence == pytest.approx(azimuth, abs=1e-4)
    if conformal:
        assert place.scale == pytest.approx(100 / length, abs=1e-6)
    else:  # equal area: the mean of the scales of both axes is that of areas
        assert place.scale == pytest.approx(1.0, abs=1e-6)


def test_utm_convergence_by_formula():
    """tan γ = tan(λ − λ0) sin φ on the sphere; the ellipsoid changes it by some seconds of arc."""
    x, y = Transform(CRS.from_epsg(4326), UTM32)(np.array([MUNICH]))[0]
    gamma = math.degrees(math.atan(math.tan(math.radians(MUNICH[0] - 9)) * math.sin(math.radians(MUNICH[1]))))
    assert map_place(UTM32, x, y).convergence == pytest.approx(gamma, abs=0.002)
    assert map_place(CRS.from_epsg(4326), *MUNICH).scale == 1.0


@pytest.mark.parametrize("code", [25832, 2154, 27572, 2263, 5514, 3035])  # metres, grads from Paris, feet, y south
def test_heights_do_not_change_a_place_on_the_map(code):
    crs = CRS.from_epsg(code)
    west, south, east, north = crs.area_of_use.bounds
    middle = np.array([[(west + east) / 2, (south + north) / 2]])
    x, y = Transform(CRS.from_epsg(4326), crs)(middle)[0]
    flat, solid = map_place(crs, x, y), map_place(with_heights(crs, "ellipsoidal"), x, y)
    assert (solid.longitude, solid.latitude) == pytest.approx((flat.longitude, flat.latitude), abs=1e-9)
    assert (solid.convergence, solid.scale) == pytest.approx((flat.convergence, flat.scale), abs=1e-8)


@pytest.mark.parametrize("code", [32631, 2154, 27572, 2263, 5514, 4807, 2193])
def test_on_one_datum_the_registry_has_nothing_to_add(code):
    """The short way gives the operation that PROJ finds after a look through its registry."""
    crs = CRS.from_epsg(code)
    for source, target in [(crs.to_3d(), geocentric(crs)), (geocentric(crs), geographic(crs))]:
        ours = Transform(source, target)._operation
        way = (target, source) if ours.backwards else (source, target)
        looked_up = pyproj.Transformer.from_crs(*way, always_xy=True, allow_ballpark=False)
        assert ours.transformer.definition == looked_up.definition


@pytest.mark.parametrize("codes", [(32633, 4326), (2154, 4978), (27700, 4258)])
def test_a_way_is_the_same_to_the_last_bit_whether_or_not_the_way_back_was_asked_for_before(codes, monkeypatch):
    one, other = map(CRS.from_epsg, codes)
    west, south, east, north = one.area_of_use.bounds
    at = np.random.default_rng(1).uniform([west, south, 0], [east, north, 100], (300, 3))
    places = Transform(CRS.from_epsg(4326), one)(at[:, :2])
    places = np.column_stack([places, at[:, 2]]) if len(other.axis_info) > 2 else places
    ends = (with_heights(one, "ellipsoidal"), other) if len(other.axis_info) > 2 else (one, other)
    found = []
    for before in (ends, ends[::-1]):
        monkeypatch.setattr("geomosaic.geo.transform._made", {})
        Transform(*before)
        found.append(Transform(*ends)(places))
    assert np.isfinite(found[0]).all()
    assert np.array_equal(*found)


@given(st.floats(-180, 180), st.floats(-90, 90))
def test_enu_axes_are_right_handed(lon, lat):
    axes = enu_axes(lon, lat)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(axes) == pytest.approx(1.0)


def test_a_local_frame_measures_metres_east_north_and_up():
    ground = np.array([*MUNICH, 500.0])
    frame = LocalFrame.at(WGS84, ground)
    to_ecef = Transform(WGS84, frame.crs)
    np.testing.assert_allclose(frame.to_enu(to_ecef(ground[None])), 0.0, atol=1e-6)
    np.testing.assert_allclose(frame.to_enu(to_ecef(ground[None] + (0, 0, 100)))[0], [0, 0, 100], atol=1e-6)
    # A step to the north and one to the east, as long as the ellipsoid says.
    lon, lat, _ = pyproj.Geod(ellps="WGS84").fwd(*MUNICH, 0, 100)
    north = frame.to_enu(to_ecef(np.array([[lon, lat, 500.0]])))[0]
    assert north[0] == pytest.approx(0, abs=1e-6)
    assert north[1] == pytest.approx(100 * (1 + 500 / 6.37e6), abs=1e-3)
    assert north[2] < 0
    points = np.random.default_rng(0).normal(0, 1e4, (50, 3))
    np.testing.assert_allclose(frame.to_enu(frame.to_geocentric(points)), points, atol=1e-7)


# --- rotations -----------------------------------------------------------------------------------------------------

angles = st.floats(-math.pi, math.pi)


@given(angles, st.floats(-1.55, 1.55), angles)
def test_omega_phi_kappa_as_scipy(omega, phi, kappa):
    rotation = omega_phi_kappa(omega, phi, kappa)
    # SciPy turns vectors, the textbook turns axes: the camera→world matrix Rx·Ry·Rz is the transpose.
    truth = Rotation.from_euler("XYZ", [omega, phi, kappa]).as_matrix().T
    np.testing.assert_allclose(rotation, truth, atol=1e-12)
    np.testing.assert_allclose(rotation, r3(kappa) @ r2(phi) @ r1(omega), atol=1e-15)
    np.testing.assert_allclose(omega_phi_kappa(*angles_of(rotation)), rotation, atol=1e-9)
    back = np.array(angles_of(rotation)) - (omega, phi, kappa)
    np.testing.assert_allclose((back + math.pi) % (2 * math.pi) - math.pi, 0.0, atol=1e-7)


@pytest.mark.parametrize("phi", [math.pi / 2, -math.pi / 2])
@given(omega=angles, kappa=angles)
def test_gimbal_lock_keeps_the_rotation(phi, omega, kappa):
    rotation = omega_phi_kappa(omega, phi, kappa)
    found = angles_of(rotation)
    assert found[2] == 0.0
    np.testing.assert_allclose(omega_phi_kappa(*found), rotation, atol=1e-7)


@given(st.floats(-4, 4), st.floats(-4, 4), st.floats(-4, 4))
def test_angle_axis_as_scipy(x, y, z):
    np.testing.assert_allclose(angle_axis(np.array([x, y, z])), Rotation.from_rotvec([x, y, z]).as_matrix(), atol=1e-12)


def test_local_frames_of_two_names_are_never_one_whatever_was_met_before():
    """From GeoTIFF, which keeps the name and the unit, PROJ would call them equal."""
    whole = horizontal(local_frame_crs())
    read = [CRS.from_wkt(f'LOCAL_CS["{name}",UNIT["metre",1]]') for name in ("Site 7", whole.name)]
    assert read[0].equals(read[1])
    points = np.array([[3.0, 4.0]])
    np.testing.assert_array_equal(Transform(read[1], whole)(points), points)
    with pytest.raises(InputError):
        Transform(read[0], whole)


@pytest.mark.parametrize("text", ["local", " Local "])
def test_a_frame_that_lies_nowhere_is_named_by_a_word(text: str):
    assert parse_crs(text) == local_frame_crs()
    assert parse_map(text) == horizontal(local_frame_crs())


def test_a_local_frame_is_known_by_its_name_and_unit_and_has_heights_of_its_own():
    """A raster file keeps no more of it, and no datum on the Earth belongs to its heights."""
    written = CRS.from_wkt('LOCAL_CS["Site",LOCAL_DATUM["Peg 1",0],UNIT["metre",1]]')
    stored = CRS.from_wkt('LOCAL_CS["site",UNIT["metre",1],AXIS["Easting",EAST],AXIS["Northing",NORTH]]')
    three = CRS.from_wkt('LOCAL_CS["site",UNIT["metre",1],AXIS["X",EAST],AXIS["Y",NORTH],AXIS["Z",UP]]')
    frames = [with_local_heights(crs) for crs in (written, stored, three)]
    assert [has_heights(crs) for crs in (written, *frames)] == [False, True, True, True]
    assert Transform(frames[0], frames[1]).identical
    assert Transform(frames[0], frames[2]).identical
    assert len(horizontal(frames[2]).axis_info) == 2
    for other in ('LOCAL_CS["other",UNIT["metre",1]]', 'LOCAL_CS["site",UNIT["foot",0.3048]]'):
        with pytest.raises(InputError, match="no trustworthy") as caught:
            Transform(frames[0], with_local_heights(CRS.from_wkt(other)))
        assert "nothing relates a local frame" in (caught.value.hint or "")
