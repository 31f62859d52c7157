"""Surfaces against analytic truth and against SciPy: heights, patches, rays, unknown heights, datums."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS, Transformer
from scipy.interpolate import RegularGridInterpolator

from geomosaic.errors import HeightDatumError, InputError, RasterReadError
from geomosaic.geo.crs import with_heights
from geomosaic.geo.local_frames import LocalFrame
from geomosaic.surface.dem import Dem
from geomosaic.surface.model import HeightPatch, Plane, Surface
from geomosaic.surface.ray_intersection import intersect

UTM = CRS.from_epsg(32633)
UTM3 = with_heights(UTM, "ellipsoidal")
GEOCENTRIC = CRS.from_epsg(4978)
WGS84 = CRS.from_epsg(4979)
NORTH_UP = Affine(10.0, 0.0, 500_000.0, 0.0, -10.0, 5_300_000.0)


def write_dem(path: Path, heights, transform=NORTH_UP, crs="EPSG:32633", nodata=None, unit=None, **profile) -> Path:
    heights = np.asarray(heights)
    with rasterio.open(
        path, "w", driver="GTiff", width=heights.shape[1], height=heights.shape[0], count=1, dtype=heights.dtype,
        transform=transform, crs=crs, nodata=nodata, **profile,
    ) as dataset:  # fmt: skip
        dataset.write(heights, 1)
        if unit:
            dataset.units = (unit,)
    return path


def nodes_of(dem: Dem):
    rows, cols = dem.grid.shape
    c, r = np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5)
    return dem.grid.xy(np.column_stack([c.ravel(), r.ravel()]))


def apply(t, xy):
    return np.column_stack([t.a * xy[:, 0] + t.b * xy[:, 1] + t.c, t.d * xy[:, 0] + t.e * xy[:, 1] + t.f])


def hills(rows=40, cols=60, seed=1):
    return np.random.default_rng(seed).uniform(100, 300, (rows, cols)).astype(np.float32)


# --- heights of a DEM ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "transform",
    [
        NORTH_UP,
        Affine(10.0, 0.0, 500_000.0, 0.0, 10.0, 5_300_000.0),  # south up
        Affine.translation(500_000, 5_300_000) @ Affine.rotation(30) @ Affine.scale(7, -9),
    ],
)
def test_bilinear_as_scipy(tmp_path, transform):
    heights = hills(300, 280)  # more than one block each way
    dem = Dem.open(write_dem(tmp_path / "d.tif", heights, transform), heights="ellipsoidal")
    rng = np.random.default_rng(2)
    colrow = rng.uniform((0.5, 0.5), (279.5, 299.5), (5000, 2))
    truth = RegularGridInterpolator((np.arange(300) + 0.5, np.arange(280) + 0.5), heights.astype(np.float64))
    found = dem.height(dem.grid.xy(colrow))
    np.testing.assert_allclose(found, truth(colrow[:, ::-1]), atol=2e-6)


def test_nodes_edges_and_outside(tmp_path):
    heights = hills()
    dem = Dem.open(write_dem(tmp_path / "d.tif", heights), heights="egm96")
    np.testing.assert_allclose(dem.height(nodes_of(dem)).reshape(heights.shape), heights, atol=1e-5)
    corner = dem.grid.xy(np.array([[0.0, 0.0], [0.49, 0.2], [60.0, 40.0], [-0.01, 5], [5, 40.01], [np.nan, 5]]))
    found = dem.height(corner)
    np.testing.assert_allclose(found[:3], [heights[0, 0], heights[0, 0], heights[-1, -1]])
    assert np.isnan(found[3:]).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1)])
def test_dems_of_one_row_or_column_are_read(tmp_path, shape):
    heights = hills(*shape)
    dem = Dem.open(write_dem(tmp_path / "d.tif", heights), heights="ellipsoidal")
    np.testing.assert_allclose(dem.height(nodes_of(dem)).reshape(shape), heights, atol=1e-5)


@pytest.mark.parametrize("mark", [-9999.0, np.nan, np.inf, 3.4e38, -32767.0])
@pytest.mark.parametrize("declared", [True, False])
def test_unknown_heights_never_bleed(tmp_path, mark, declared):
    heights = hills()
    bad = (11, 23)
    heights[bad] = mark
    dem = Dem.open(write_dem(tmp_path / "d.tif", heights, nodata=mark if declared else None), heights="ellipsoidal")
    known = np.delete(heights.ravel(), bad[0] * 60 + bad[1])
    assert dem.range == (known.min(), known.max())
    rng = np.random.default_rng(3)
    colrow = rng.uniform((20, 8), (28, 16), (4000, 2))
    found = dem.height(dem.grid.xy(colrow))
    touches = (np.abs(colrow - (bad[1] + 0.5, bad[0] + 0.5)) < 1).all(axis=1)
    assert touches.any()
    np.testing.assert_array_equal(np.isnan(found), touches)
    assert np.nanmin(found) >= 100
    assert np.nanmax(found) <= 300
    # A neighbour node itself has weight 1 there and 0 at the unknown one, so it stays known.
    beside = dem.grid.xy(np.array([[22.5, 11.5], [24.5, 11.5], [23.5, 10.5], [23.5, 12.5]]))
    np.testing.assert_allclose(dem.height(beside), [heights[11, 22], heights[11, 24], heights[10, 23], heights[12, 23]])


def test_a_dem_without_a_known_height_is_refused(tmp_path):
    dem = Dem.open(write_dem(tmp_path / "d.tif", np.full((5, 5), -9999.0, np.float32), nodata=-9999), heights="egm96")
    with pytest.raises(InputError, match="no height") as caught:
        _ = dem.range
    assert "d.tif" in str(caught.value)


def test_patch_holds_what_height_says(tmp_path):
    heights = hills(200, 150)
    heights[20:25, 30:34] = np.nan
    dem = Dem.open(write_dem(tmp_path / "d.tif", heights), heights="ellipsoidal")
    bounds = (500_205.0, 5_299_510.0, 500_480.0, 5_299_790.0)
    patch = dem.patch(bounds)
    assert patch.heights.dtype == np.float32
    assert patch.heights.size < 1500
    rng = np.random.default_rng(4)
    xy = rng.uniform(bounds[:2], bounds[2:], (2000, 2))
    place = apply(patch.transform, xy) - 0.5
    rows, cols = patch.heights.shape
    truth = RegularGridInterpolator((np.arange(rows), np.arange(cols)), patch.heights.astype(np.float64))
    expected = truth(place[:, ::-1])
    found = dem.height(xy)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_a_coarse_patch_holds_means(tmp_path, monkeypatch):
    heights = hills(203, 151)
    heights[40:47, 60:75] = np.nan
    dem = Dem.open(write_dem(tmp_path / "d.tif", heights), heights="ellipsoidal", memory_limit=0)
    bounds = dem.grid.bounds
    patch = dem.patch(bounds, 50.0)  # nodes are 10 apart
    assert patch.heights.shape == (41, 31)
    whole = np.full((205, 155), np.nan)
    whole[:203, :151] = heights
    cells = whole.reshape(41, 5, 31, 5).transpose(0, 2, 1, 3).reshape(41, 31, 25)
    known = np.isfinite(cells).sum(axis=2)
    mean = np.nansum(cells, axis=2) / np.maximum(known, 1)
    nodes = np.outer(np.minimum(5, 203 - 5 * np.arange(41)), np.minimum(5, 151 - 5 * np.arange(31)))
    expected = np.where(2 * known >= nodes, mean, np.nan)
    np.testing.assert_allclose(patch.heights, expected, atol=1e-4)
    assert np.isnan(patch.heights).sum() > 0
    # The middle of a mean lies in the middle of what it covers.
    xy = np.array([[bounds[0] + 25.0, bounds[3] - 25.0]])
    np.testing.assert_allclose(apply(patch.transform, xy), [[0.5, 0.5]])
    # However it is read, and whatever part of it.
    monkeypatch.setattr("geomosaic.surface.dem_nodes._STRIP_NODES", 2000)
    again = Dem.open(tmp_path / "d.tif", heights="ellipsoidal").patch(bounds, 59.0)
    np.testing.assert_array_equal(again.heights, patch.heights)
    part = dem.patch((500_205.0, 5_299_010.0, 500_480.0, 5_299_490.0), 50.0)
    first = np.round(apply(patch.transform, apply(~part.transform, np.array([[0.0, 0.0]])))).astype(int)[0]
    rows, cols = part.heights.shape
    np.testing.assert_array_equal(part.heights, patch.heights[first[1] : first[1] + rows, first[0] : first[0] + cols])


def test_patch_outside_is_unknown(tmp_path):
    dem = Dem.open(write_dem(tmp_path / "d.tif", hills()), heights="ellipsoidal")
    patch = dem.patch((0.0, 0.0, 10.0, 10.0))
    assert np.isnan(patch.heights).all()
    assert np.isnan(patch.range[0])
    assert patch.transform.a == pytest.approx(0.1)


def test_threads_read_the_same_heights(tmp_path):
    dem = Dem.open(
        write_dem(tmp_path / "d.tif", hills(900, 900), tiled=True, compress="deflate"), heights="ellipsoidal"
    )
    rng = np.random.default_rng(5)
    sets = [dem.grid.xy(rng.uniform(0, 900, (500, 2))) for _ in range(24)]
    alone = [dem.height(xy) for xy in sets]
    other = Dem.open(tmp_path / "d.tif", heights="ellipsoidal")
    with ThreadPoolExecutor(4) as pool:
        for first, second in zip(alone, pool.map(other.height, sets), strict=True):
            np.testing.assert_array_equal(first, second)


# --- what heights mean ---------------------------------------------------------------------------------------------


def test_undeclared_heights_name_the_shift(tmp_path):
    # 48.14 N 11.58 E, where the geoid is 45.5 m above the ellipsoid
    path = write_dem(tmp_path / "d.tif", hills(), Affine(10, 0, 691_700, 0, -10, 5_335_000), "EPSG:32632")
    with pytest.raises(HeightDatumError) as caught:
        Dem.open(path)
    text = str(caught.value)
    assert "45.5 m" in text
    assert f"{45.53 * math.tan(math.radians(30)):.1f} m" in text
    assert "`dem_heights`" in text
    assert "d.tif" in text


def test_own_and_overridden_datum(tmp_path):
    path = write_dem(tmp_path / "d.tif", hills(), crs="EPSG:32633+5773")
    own = Dem.open(path)
    assert own.crs.is_compound
    assert own.declared is None
    assert own.overridden is None
    other = Dem.open(path, heights="ellipsoidal")
    assert not other.crs.is_compound
    assert (other.declared, other.overridden) == ("ellipsoidal", "EGM96 height")


def test_units_scale_and_offset(tmp_path):
    path = write_dem(tmp_path / "d.tif", np.full((4, 4), 1000, np.int16), unit="ft")
    dem = Dem.open(path, heights="ellipsoidal")
    assert dem.height(nodes_of(dem))[0] == pytest.approx(304.8, abs=1e-4)
    assert "ft" in dem.notes[0]
    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets = (0.1,), (5.0,)
        dataset.units = ("metre",)
    assert Dem.open(path, heights="ellipsoidal").range == pytest.approx((105.0, 105.0))
    with rasterio.open(path, "r+") as dataset:
        dataset.units = ("fathom",)
    with pytest.raises(InputError, match="fathom"):
        Dem.open(path, heights="ellipsoidal")


def test_files_that_are_no_dem(tmp_path):
    with pytest.raises(RasterReadError, match="does not exist"):
        Dem.open(tmp_path / "missing.tif", heights="egm96")
    path = write_dem(tmp_path / "d.tif", hills(), crs=None)
    with pytest.raises(InputError, match="no CRS"):
        Dem.open(path, heights="egm96")
    assert Dem.open(path, heights="egm96", crs="EPSG:32633").crs.is_compound
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RasterReadError):
        _ = Dem.open(path, heights="egm96", crs="EPSG:32633").range


def test_a_plane_refuses_unnamed_heights():
    with pytest.raises(HeightDatumError):
        Plane(UTM, 10.0)
    with pytest.raises(InputError):
        Plane(UTM3, math.nan)


@pytest.mark.parametrize("bounds", [(0.0, 0.0, 100.0, 50.0), (5.0, 5.0, 5.0, 5.0)])
def test_constant_patch_covers(bounds):
    patch = Plane(UTM3, 123.0).patch(bounds)
    for x in (bounds[0], bounds[2]):
        for y in (bounds[1], bounds[3]):
            col, row = apply(patch.transform, np.array([[x, y]]))[0]
            assert 0.5 < col < 2.5
            assert 0.5 < row < 2.5
    assert patch.range == (123.0, 123.0)


# --- rays ----------------------------------------------------------------------------------------------------------


class Hill:
    """A Gaussian hill on a plain, in closed form."""

    crs = UTM3
    range = (0.0, 100.0)
    spacing = 5.0

    def height(self, xy):
        return 100.0 * np.exp(-((xy[:, 0] - 500_000) ** 2 + (xy[:, 1] - 5_300_000) ** 2) / (2 * 50.0**2))

    def patch(self, bounds, spacing=0.0):
        return HeightPatch(np.zeros((2, 2), np.float32), Affine(0.2, 0, 0, 0, -0.2, 0))


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_rays_on_a_plane_are_exact():
    rng = np.random.default_rng(6)
    origins = rng.uniform((4e5, 5e6, 900), (5e5, 5.1e6, 3000), (500, 3))
    directions = unit(rng.normal(size=(500, 3)) - (0, 0, 1.0))
    found = intersect(Plane(UTM3, 250.0), UTM3, origins, directions)
    down = directions[:, 2] < -1e-3
    t = (250.0 - origins[:, 2]) / directions[:, 2]
    np.testing.assert_allclose(found[down], (origins + t[:, None] * directions)[down], atol=1e-6)
    assert np.isnan(found[directions[:, 2] > 0]).all()


@pytest.mark.parametrize("height", [0.0, -50.0, 3000.0])
@pytest.mark.parametrize("altitude", [2_000.0, 800_000.0])
def test_rays_to_the_ellipsoid(height, altitude):
    rng = np.random.default_rng(7)
    frame = LocalFrame.at(WGS84, np.array([11.58, 48.14, height + altitude]))
    looks = unit(np.column_stack([rng.uniform(-0.5, 0.5, (300, 2)), -np.ones(300)]))
    directions, origins = looks @ frame.axes, np.tile(frame.origin, (300, 1))
    found = intersect(Plane(WGS84, height), GEOCENTRIC, origins, directions)
    back = Transformer.from_crs(GEOCENTRIC, WGS84, always_xy=True).transform(*found.T)
    np.testing.assert_allclose(back[2], height, atol=1e-6)
    along = np.cross(found - origins, directions)
    np.testing.assert_allclose(along, 0.0, atol=1e-3 * max(1.0, altitude / 1e5))
    assert ((found - origins) * directions).sum(axis=1).max() < 2 * altitude  # the near side


def test_sky_and_far_side():
    frame = LocalFrame.at(WGS84, np.array([11.58, 48.14, 2000.0]))
    looks = unit(np.array([[0, 0, 1.0], [1, 0, 0.0], [0, 1, 0.2], [0.3, 0, -1.0]]))
    directions, origins = looks @ frame.axes, np.tile(frame.origin, (4, 1))
    found = intersect(Plane(WGS84, 0.0), GEOCENTRIC, origins, directions)
    np.testing.assert_array_equal(np.isnan(found[:, 0]), [True, True, True, False])


def test_first_hit_on_an_analytic_hill():
    """Nearly flat rays from the west: those below the top stop on the near slope, the others pass over it."""
    hill = Hill()
    z = np.linspace(20, 140, 121)
    origins = np.column_stack([np.full(121, 499_500.0), np.full(121, 5_300_000.0), z])
    directions = np.tile(unit(np.array([[1.0, 0.0, -0.02]])), (121, 1))
    found = intersect(hill, UTM3, origins, directions)
    slope = directions[0, 2] / directions[0, 0]
    # A dense march in closed form says where each ray first dives.
    x = np.linspace(0, 12_000, 2_400_001)
    profile = 100.0 * np.exp(-((x - 500.0) ** 2) / (2 * 50.0**2))
    near = 0
    for i in range(0, 121, 5):
        under = np.flatnonzero(z[i] + slope * x <= profile)
        assert found[i, 0] == pytest.approx(499_500 + x[under[0]], abs=0.006)
        near += found[i, 0] < 500_000
    assert 0 < near < 25
    seen = np.isfinite(found[:, 0])
    np.testing.assert_allclose(hill.height(found[seen, :2]), found[seen, 2], atol=1e-6)


def test_rays_on_a_dem_first_hit_and_unknown(tmp_path):
    rows, cols = 200, 200
    c, r = np.meshgrid(np.arange(cols), np.arange(rows))
    heights = (100 + 60 * np.sin(c / 9.0) + 40 * np.cos(r / 7.0)).astype(np.float32)
    heights[90:110, 90:110] = np.nan
    dem = Dem.open(write_dem(tmp_path / "d.tif", heights), heights="ellipsoidal")
    assert isinstance(dem.range, tuple)
    surface: Surface = dem
    rng = np.random.default_rng(8)
    target = rng.uniform((500_010, 5_298_010), (501_990, 5_299_990), (800, 2))
    origins = np.column_stack([target + rng.uniform(-900, 900, (800, 2)), np.full(800, 900.0)])
    directions = unit(np.column_stack([target, np.full(800, 100.0)]) - origins)
    found = intersect(surface, UTM3, origins, directions)
    seen = np.isfinite(found[:, 0])
    assert 0.5 < seen.mean() < 1.0
    np.testing.assert_allclose(dem.height(found[seen, :2]), found[seen, 2], atol=1e-6)
    # Nothing of the way to the meeting is below the surface.
    for share in np.linspace(0.0, 0.999, 200):
        on_way = origins + share * (found - origins)
        clearance = on_way[:, 2] - dem.height(on_way[:, :2])
        assert not (clearance[seen] < -0.05).any()
    outside = intersect(dem, UTM3, np.array([[400_000.0, 5e6, 900.0]]), np.array([[0.0, 0.0, -1.0]]))
    assert np.isnan(outside).all()
    hole = intersect(dem, UTM3, np.array([[501_000.0, 5_299_000.0, 900.0]]), np.array([[0.0, 0.0, -1.0]]))
    assert np.isnan(hole).all()
    below = intersect(dem, UTM3, np.array([[500_500.0, 5_299_500.0, -50.0]]), np.array([[0.0, 0.0, -1.0]]))
    assert np.isnan(below).all()


def test_rays_beside_a_dem_of_tiny_nodes_are_not_searched(tmp_path, monkeypatch):
    """A DEM in degrees that is declared to be in metres has millions of nodes along each ray."""
    heights = np.random.default_rng(1).uniform(400, 500, (40, 40)).astype(np.float32)
    dem = Dem.open(write_dem(tmp_path / "d.tif", heights, Affine(1e-4, 0, 14.5, 0, -1e-4, 49.7)), heights="ellipsoidal")
    asked = []
    height = Dem.height
    monkeypatch.setattr(Dem, "height", lambda self, xy: (asked.append(len(xy)), height(self, xy))[1])
    origins = np.array([[400_000.0, 5_500_000.0, 1500.0], [14.502, 49.698, 1500.0]])
    found = intersect(dem, UTM3, origins, unit(np.array([[0.5, 0.1, -1.0], [0.0, 0.0, -1.0]])))
    assert np.isnan(found[0]).all()
    assert found[1, 2] == pytest.approx(dem.height(origins[1:, :2])[0], abs=1e-6)
    assert sum(asked) < 1000


def test_geocentric_rays_on_a_geoid_dem(tmp_path):
    """Rays through known ground points of a tilted, geoid-based DEM come back to those points."""
    c, r = np.meshgrid(np.arange(300), np.arange(300))
    heights = (400 + 0.8 * c + 0.4 * r).astype(np.float32)
    dem = Dem.open(
        write_dem(tmp_path / "d.tif", heights, Affine(10, 0, 690_000, 0, -10, 5_335_000), "EPSG:32632"), heights="egm96"
    )
    rng = np.random.default_rng(9)
    xy = rng.uniform((690_100, 5_332_100), (692_900, 5_334_900), (400, 2))
    ground = np.column_stack([xy, dem.height(xy)])
    to_geocentric = Transformer.from_crs(dem.crs, GEOCENTRIC, always_xy=True, allow_ballpark=False)
    truth = np.column_stack(to_geocentric.transform(*ground.T))
    eye = np.array(to_geocentric.transform(691_000.0, 5_333_000.0, 5000.0))
    found = intersect(dem, GEOCENTRIC, np.tile(eye, (400, 1)), unit(truth - eye))
    np.testing.assert_allclose(found, truth, atol=2e-5)
