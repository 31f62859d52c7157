"""Vectors over the edge of a map: seams, poles, and maps that end before them."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from pyproj import CRS, Transformer

from geomosaic.geo.projection_domain import domain
from geomosaic.reprojection import moved

WORLD, PACIFIC, SOUTH = CRS("EPSG:4326"), CRS("EPSG:3832"), CRS("EPSG:3031")
RADIUS = 6378137.0


def one(geometry, own=WORLD, crs=PACIFIC):
    found, cut = moved(np.array([geometry], dtype=object), own, crs)
    return found[0], bool(cut[0])


def test_an_area_across_the_seam_comes_in_two_pieces_at_either_rim() -> None:
    """Mercator about 150 degrees east is torn at 30 degrees west."""
    found, cut = one(shapely.box(-40.0, 0.0, -20.0, 10.0))
    assert cut
    assert found.geom_type == "MultiPolygon"
    ends = sorted(piece.bounds[::2] for piece in found.geoms)
    rim, width = np.pi * RADIUS, np.radians(10.0) * RADIUS
    assert np.allclose(ends, [(-rim, -rim + width), (rim - width, rim)], atol=1e-3)
    height = Transformer.from_crs(WORLD, PACIFIC, always_xy=True).transform(150.0, 10.0)[1]
    assert found.area == pytest.approx(2 * width * height, rel=1e-9)


def test_what_other_maps_tore_is_joined() -> None:
    halves = shapely.MultiPolygon([shapely.box(170, -5, 180, 5), shapely.box(-180, -5, -170, 5)])
    found, _ = one(halves)
    assert found.geom_type == "Polygon"
    assert found.bounds[2] - found.bounds[0] == pytest.approx(np.radians(20.0) * RADIUS, rel=1e-9)


def test_a_line_over_the_date_line_becomes_two_in_degrees() -> None:
    to_map = Transformer.from_crs(WORLD, PACIFIC, always_xy=True)
    line = shapely.LineString(np.column_stack(to_map.transform([170.0, 175.0, -170.0], [1.0, 2.0, 5.0])))
    found, cut = one(line, PACIFIC, WORLD)
    assert cut
    pieces = sorted(shapely.get_coordinates(piece)[:, 0].round(6).tolist() for piece in found.geoms)
    assert [(min(xs), max(xs)) for xs in pieces] == [(-180.0, -170.0), (170.0, 180.0)]
    assert found.length == pytest.approx(np.hypot(5, 1) + np.hypot(15, 3), rel=1e-3)


def test_a_cap_about_the_pole_is_a_disc() -> None:
    lon = np.linspace(-180, 180, 361)
    cap = shapely.Polygon([*zip(lon, np.full(361, -70.0), strict=True), (180, -90), (-180, -90)])
    found, cut = one(cap, WORLD, SOUTH)
    assert not cut
    assert found.geom_type == "Polygon"
    assert found.is_valid
    rho = Transformer.from_crs(WORLD, SOUTH, always_xy=True).transform(0.0, -70.0)[1]
    assert found.area == pytest.approx(np.pi * rho**2, rel=1e-4)
    assert found.contains(shapely.Point(0.0, 0.0))


def test_maps_end_before_what_is_infinitely_far() -> None:
    for code in (3857, 3832, 2154, 3338):
        found, cut = one(shapely.box(0, -90, 10, 80), WORLD, CRS(code))
        assert cut
        assert np.abs(shapely.get_coordinates(found)).max() < 3e7
    assert one(shapely.Point(3.0, -89.0), WORLD, CRS(2154))[0].is_empty


def test_what_lies_within_is_only_transformed() -> None:
    shape = shapely.Point(3.0, 45.0).buffer(0.3)
    for code in (2154, 32631, 3857, 3995, 3035):
        found, cut = one(shape, WORLD, CRS(code))
        x, y = Transformer.from_crs(WORLD, code, always_xy=True).transform(*shapely.get_coordinates(shape).T)
        assert not cut
        assert np.allclose(shapely.get_coordinates(found), np.column_stack([x, y]), rtol=0, atol=1e-6)


def test_a_map_is_centred_on_its_meridian() -> None:
    assert domain(CRS(32631)).centre == 3.0
    assert domain(CRS(27572)).centre == 0.0  # from Paris, as its geographic CRS counts
    assert domain(CRS(3031)).centre is None
    assert (domain(CRS(3031)).south, domain(CRS(3995)).north) == (-90.0, 90.0)
    assert domain(CRS(3832)).centre == 150.0
