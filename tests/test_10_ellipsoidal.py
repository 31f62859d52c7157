"""Areas and lengths on the ellipsoid against its closed formulas."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from pyproj import CRS
from scipy.integrate import quad

from geomosaic.geo.crs import parse_crs
from geomosaic.geo.ellipsoidal import areas_and_lengths
from geomosaic.geo.transform import Transform

A, F = 6378137.0, 1.0 / 298.257223563
E2 = F * (2.0 - F)


def zone(south: float, north: float, width: float) -> float:
    """Area between two parallels (Snyder, Map projections, 3-12), square metres; angles in degrees."""
    e = np.sqrt(E2)

    def q(latitude: float) -> float:
        s = np.sin(np.radians(latitude))
        return (1.0 - E2) * (s / (1.0 - E2 * s**2) - np.log((1.0 - e * s) / (1.0 + e * s)) / (2.0 * e))

    return 0.5 * A**2 * np.radians(width) * (q(north) - q(south))


def meridian(south: float, north: float) -> float:
    """Length of a meridian arc, metres."""
    low, high = np.radians([south, north])
    return quad(lambda p: A * (1.0 - E2) / (1.0 - E2 * np.sin(p) ** 2) ** 1.5, low, high, epsabs=1e-9)[0]


def test_a_cell_of_the_graticule_has_the_area_and_sides_of_the_closed_formulas() -> None:
    """Its parallels as edges of the map in degrees, however far from the geodesic between two corners."""
    cell = shapely.box(14.0, 49.0, 15.0, 50.0)
    ((area, length),) = areas_and_lengths([cell], CRS(4326))
    parallels = sum(
        np.radians(1.0) * A * np.cos(np.radians(b)) / np.sqrt(1.0 - E2 * np.sin(np.radians(b)) ** 2)
        for b in (49.0, 50.0)
    )
    assert area == pytest.approx(zone(49.0, 50.0, 1.0), rel=1e-7)
    assert length == pytest.approx(2.0 * meridian(49.0, 50.0) + parallels, rel=1e-7)


def test_the_scale_of_the_map_does_not_count() -> None:
    """A field at the border of a UTM zone, where a map's square metre is 0.8 per mille too large."""
    utm = CRS(32633)
    corners = np.array([[18.0, 50.0], [18.01, 50.0], [18.01, 50.01], [18.0, 50.01]])
    on_map = shapely.Polygon(Transform(CRS(4326), utm)(corners))
    ((area, _),) = areas_and_lengths([on_map], utm)
    ((true, _),) = areas_and_lengths([shapely.Polygon(corners)], CRS(4326))
    assert area == pytest.approx(true, rel=2e-7)
    assert on_map.area / area == pytest.approx(1.0003, abs=3e-4)
    assert abs(on_map.area / area - 1.0) > 1e-4


def test_holes_parts_lines_and_points_have_what_they_have() -> None:
    utm = CRS(32633)
    outer, hole = shapely.box(500000, 5500000, 500400, 5500300), shapely.box(500100, 5500100, 500200, 5500200)
    apart, line = shapely.box(501000, 5500000, 501100, 5500100), shapely.LineString([(5e5, 55e5), (500300, 5500400)])
    made = areas_and_lengths([outer - hole, shapely.MultiPolygon([outer, apart]),
                              line, shapely.Point(500000, 5500000)], utm)  # fmt: skip
    np.testing.assert_allclose(
        made * [0.9996**2, 0.9996], [[110000, 1800], [130000, 1800], [0, 500], [0, 0]], rtol=1e-6
    )


def test_an_outline_that_crosses_itself_has_no_area_and_a_local_frame_is_a_plane() -> None:
    bow = shapely.Polygon([(0, 0), (10, 10), (10, 0), (0, 5)])
    assert np.isnan(areas_and_lengths([bow], CRS(32633))[0, 0])
    np.testing.assert_allclose(areas_and_lengths([shapely.box(0, 0, 3, 4)], parse_crs("local")), [[12.0, 14.0]])
