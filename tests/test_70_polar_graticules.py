"""Graticules around a pole and on sheets wider than half the globe, held against PROJ."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from pyproj import CRS, Transformer

from geomosaic.sheets.grid_lines import map_grid
from geomosaic.sheets.notes import grid_line

DEGREES = CRS("EPSG:4326")
SHEETS = {
    "south pole in the middle": ("EPSG:3031", (-2.6e6, -1.8e6, 2.6e6, 1.8e6), 1.0e6),
    "south pole in a corner": ("EPSG:3031", (-2.6e6, -1.8e6, 0.2e6, 0.3e6), 0.6e6),
    "north pole": ("EPSG:3995", (-3.0e5, -2.0e5, 5.0e5, 4.0e5), 2.5e5),
    "north pole, other projection": ("EPSG:3574", (-9.0e5, -8.0e5, 5.0e5, 4.0e5), 2.5e5),
}


@pytest.mark.parametrize("name", SHEETS)
def test_a_graticule_around_a_pole(name: str) -> None:
    """Every vertex has the longitude or latitude of its line; every meridian is there once, and four reach the pole."""
    code, bounds, spacing = SHEETS[name]
    crs, sign = CRS(code), -1.0 if code == "EPSG:3031" else 1.0
    grid = map_grid(DEGREES, crs, bounds, spacing)
    back = Transformer.from_crs(crs, DEGREES, always_xy=True)
    frame = shapely.box(*bounds)
    assert grid.pole is not None
    assert np.abs(grid.pole).max() < 1e-6
    meridians = [line for line in grid.lines if line.axis == 0]
    parallels = [line for line in grid.lines if line.axis == 1]
    values = [line.value for line in meridians]
    assert len(values) == len(set(values)) >= 4
    assert not {-180.0, 180.0} <= set(values)
    for line in grid.lines:
        for piece in line.pieces:
            lon, lat = back.transform(*piece[1:-1].T)
            off = lat - line.value if line.axis else (lon - line.value + 180.0) % 360.0 - 180.0
            assert np.abs(off[np.abs(lat) < 89.999999]).max(initial=0.0) < 1e-7
            assert frame.buffer(1.0).contains(shapely.LineString(piece))
        for side, x, y in line.ends:
            assert frame.exterior.distance(shapely.Point(x, y)) < 1e-3, side
    nearest = min(abs(line.value - sign * 90.0) for line in parallels)
    assert nearest == pytest.approx(grid.intervals[1])
    for line in meridians:
        reach = 90.0 - max(np.abs(back.transform(*piece.T)[1]).max() for piece in line.pieces)
        assert reach == pytest.approx(0.0 if line.value % 90.0 == 0 else nearest, abs=1e-6) or reach > nearest
    whole = [line for line in parallels if not line.ends]
    for line in whole:  # the circle is closed, and as long as PROJ's
        t = np.linspace(-180, 180, 3601)
        circle = np.column_stack(
            Transformer.from_crs(DEGREES, crs, always_xy=True).transform(t, np.full(3601, line.value))
        )
        length = sum(shapely.LineString(piece).length for piece in line.pieces)
        assert length == pytest.approx(shapely.LineString(circle).length, rel=1e-3)
    words = grid_line(grid)
    assert "meridians every" in words or grid.intervals[0] == grid.intervals[1]


def test_meridians_around_a_pole_are_as_dense_as_asked_for() -> None:
    """A given interval holds for both; the 180th meridian comes once."""
    grid = map_grid(DEGREES, CRS("EPSG:3031"), (-2e6, -2e6, 2e6, 2e6), 1e6, interval=10.0)
    assert grid.intervals == (10.0, 10.0)
    assert sorted(line.value for line in grid.lines if line.axis == 0) == list(range(-170, 181, 10))
    assert sorted(line.value for line in grid.lines if line.axis == 1) == [-80.0, -70.0]
    labels = {line.value: grid.label(line) for line in grid.lines if line.axis == 0}
    assert labels[180.0] == "180°"
    assert labels[0.0] == "0°"
    assert labels[-170.0] == "170°\u202fW"


def test_a_sheet_of_half_the_globe_has_no_pole_on_it() -> None:
    """Mercator from 170° W to 170° E: meridians at whole multiples from side to side, in one piece each."""
    crs = CRS("EPSG:3395")
    east = Transformer.from_crs(DEGREES, crs, always_xy=True).transform(170.0, 0.0)[0]
    grid = map_grid(DEGREES, crs, (-east, -1e7, east, 1e7), 4e6)
    assert grid.pole is None
    assert grid.intervals == (30.0, 30.0) or grid.intervals[0] == grid.intervals[1]
    step = grid.interval
    count = math.floor(170.0 / step)
    assert [line.value for line in grid.lines if line.axis == 0] == [k * step for k in range(-count, count + 1)]
    assert all(len(line.pieces) == 1 and len(line.ends) == 2 for line in grid.lines)


def test_a_sheet_that_is_wider_than_the_globe() -> None:
    """Robinson's corners are no place: the whole graticule is drawn."""
    grid = map_grid(DEGREES, CRS("ESRI:54030"), (-1.75e7, -8.7e6, 1.75e7, 8.7e6), 5e6)
    values = [line.value for line in grid.lines if line.axis == 0]
    assert values[0] == -180.0
    assert values[-1] == 180.0
    assert 0.0 in values


def test_a_projected_grid_must_be_defined_everywhere() -> None:
    from geomosaic.errors import InputError

    with pytest.raises(InputError, match="not defined on this sheet"):
        map_grid(CRS("EPSG:3035"), CRS("ESRI:54030"), (-1.75e7, -8.7e6, 1.75e7, 8.7e6), 5e6)


def test_a_small_sheet_about_a_pole() -> None:
    """An interval longer than the sheet: every meridian leaves it where PROJ says, none on the other side."""
    crs, bounds = CRS("EPSG:3031"), (-5e3, -4e3, 6e3, 4e3)
    back = Transformer.from_crs(crs, DEGREES, always_xy=True)
    for interval in (10.0, 0.5, 0.01):
        grid = map_grid(DEGREES, crs, bounds, 2e3, interval=interval)
        ends = [(line.value, x, y) for line in grid.lines if line.axis == 0 for _, x, y in line.ends]
        assert len(ends) >= 8
        lon = back.transform(*np.array([(x, y) for _, x, y in ends]).T)[0]
        off = (lon - np.array([value for value, _, _ in ends]) + 180.0) % 360.0 - 180.0
        assert np.abs(off).max() < 1e-3


@pytest.mark.parametrize("bounds", [(0.0, 0.0, 1e6, 8e5), (-5e5, 0.0, 5e5, 8e5)])
def test_a_pole_on_the_neatline(bounds: tuple[float, float, float, float]) -> None:
    """In a corner, or on a side: no line runs along the neatline, none ends at the pole, parallels are there."""
    grid = map_grid(DEGREES, CRS("EPSG:3031"), bounds, 2e5)
    assert grid.pole is not None
    assert {line.axis for line in grid.lines} == {0, 1}
    for line in grid.lines:
        assert line.axis == 1 or len(line.ends) <= 2
        assert all(math.hypot(x, y) > 1e3 for _, x, y in line.ends)


@pytest.mark.parametrize(
    ("code", "bounds", "spacing"),
    [
        ("EPSG:3031", (1e5, 1e5, 11e5, 9e5), 2.5e5),
        ("EPSG:32633", (480_000.0, 8_680_000.0, 520_000.0, 8_710_000.0), 1e4),
        ("EPSG:32633", (400_000.0, 5_500_000.0, 460_000.0, 5_501_000.0), 8e3),
    ],
)
def test_lines_of_both_kinds(code: str, bounds: tuple[float, float, float, float], spacing: float) -> None:
    """Near a pole, and on a sheet that is long and low: no sheet without latitudes or northings."""
    for crs in (DEGREES, CRS(code)):
        assert {line.axis for line in map_grid(crs, CRS(code), bounds, spacing).lines} == {0, 1}


def test_a_graticule_of_equal_earth_draws_each_meridian_once() -> None:
    """Its corners come back as places on the other side: the whole graticule is drawn, each meridian once."""
    grid = map_grid(DEGREES, CRS("EPSG:8857"), (-17_243_959.0, -8_392_927.0, 17_243_959.0, 8_392_927.0), 5e6)
    values = [line.value for line in grid.lines if line.axis == 0]
    assert values == sorted(set(values))
    assert values[0] >= -180.0
    assert values[-1] <= 180.0


def test_sheets_about_a_pole() -> None:
    """All sheets that places on the map lie on, the pole among them; none more."""
    from geomosaic.sheets.series.inputs import sheet_scheme as scheme
    from geomosaic.sheets.series.regular import sheets_on

    for code, sign in (("EPSG:3995", 1.0), ("EPSG:3031", -1.0)):
        series, crs = scheme("international", 1_000_000), CRS(code)
        found = set(sheets_on(series, crs, (-1e6, -1e6, 1e6, 1e6)))
        x, y = np.meshgrid(np.linspace(-9.99e5, 9.99e5, 61), np.linspace(-9.99e5, 9.99e5, 61))
        lon, lat = Transformer.from_crs(crs, DEGREES, always_xy=True).transform(x.ravel(), y.ravel())
        inside = np.abs(lat) < 88.0
        wanted = {series.find(a, b) for a, b in zip(lon[inside], lat[inside], strict=True)}
        assert wanted <= found, sign
        assert len(found) <= 1.3 * len(wanted)
