"""The magnetic model against the test values published with it."""

from __future__ import annotations

import numpy as np
import pytest

from geomosaic.errors import InputError
from geomosaic.geo.local_frames import enu_axes
from geomosaic.geo.magnetic_declination import decimal_year, magnetic_field

# Test values of the World Magnetic Model 2025 (NOAA NCEI, WMM2025_TEST_VALUES): year, height in km, latitude,
# longitude, north, east and down in nT, declination in degrees.
PUBLISHED = (
    (2025.0, 0, 80, 0, 6521.6, 145.9, 54791.5, 1.28),
    (2025.0, 0, 0, 120, 39677.8, -109.6, -10580.2, -0.16),
    (2025.0, 0, -80, -120, 6117.5, 15751.9, -52022.5, 68.78),
    (2025.0, 100, 80, 0, 6216.0, 92.4, 52598.8, 0.85),
    (2025.0, 100, 0, 120, 37688.6, -96.2, -10152.1, -0.15),
    (2025.0, 100, -80, -120, 5907.6, 14780.3, -49540.7, 68.21),
    (2027.5, 0, 80, 0, 6500.8, 294.5, 54869.4, 2.59),
    (2027.5, 0, 0, 120, 39701.6, -167.4, -10381.8, -0.24),
    (2027.5, 0, -80, -120, 6200.7, 15730.3, -51783.7, 68.49),
    (2027.5, 100, 80, 0, 6196.7, 233.8, 52670.5, 2.16),
    (2027.5, 100, 0, 120, 37711.5, -148.7, -9969.8, -0.23),
    (2027.5, 100, -80, -120, 5984.0, 14760.1, -49317.7, 67.93),
)
# Declinations alone, of the longer list WMM2025_TestValues: one degree from the pole, among others.
DECLINATIONS = (
    (2025.0, 28, 89, -121, -99.77),
    (2025.0, 48, 80, -96, -29.91),
    (2025.0, 18, 0, 21, 1.29),
    (2025.5, 6, -36, -137, 20.28),
)


@pytest.mark.parametrize(("year", "height", "latitude", "longitude", "north", "east", "down", "turn"), PUBLISHED)
def test_field_values_are_the_published_ones(
    year: float, height: float, latitude: float, longitude: float, north: float, east: float, down: float, turn: float
) -> None:
    field = magnetic_field(longitude, latitude, 1000.0 * height, year)
    assert (field.north, field.east, field.down) == pytest.approx((north, east, down), abs=0.0501)
    assert field.declination == pytest.approx(turn, abs=0.00501)


@pytest.mark.parametrize(("year", "height", "latitude", "longitude", "turn"), DECLINATIONS)
def test_declinations_are_the_published_ones(
    year: float, height: float, latitude: float, longitude: float, turn: float
) -> None:
    assert magnetic_field(longitude, latitude, 1000.0 * height, year).declination == pytest.approx(turn, abs=0.00501)


def test_the_field_has_no_sources_and_no_whirls() -> None:
    """Flux through a small box and work around its sides vanish, whatever the coefficients are: the maths is right."""
    from pyproj import Transformer

    move = Transformer.from_crs(4979, 4978, always_xy=True)
    back = Transformer.from_crs(4978, 4979, always_xy=True)

    def field(xyz: np.ndarray) -> np.ndarray:
        lon, lat, height = back.transform(*xyz)
        found = magnetic_field(lon, lat, height, 2026.3)
        east, north, up = enu_axes(lon, lat)
        return found.north * north + found.east * east - found.down * up

    for place in ((13.6, 49.6, 500.0), (-70.0, -33.0, 4000.0), (178.0, 71.0, 0.0)):
        middle, step = np.array(move.transform(*place)), 20_000.0
        slope = np.array([(field(middle + step * axis) - field(middle - step * axis)) for axis in np.eye(3)]) / (
            2 * step
        )
        assert abs(np.trace(slope)) < 1e-4 * np.abs(slope).max()
        assert np.abs(slope - slope.T).max() < 1e-4 * np.abs(slope).max()


def test_the_annual_change_is_what_a_year_changes() -> None:
    before, now, after = (magnetic_field(13.6, 49.6, 500.0, year) for year in (2026.0, 2026.5, 2027.0))
    assert after.declination - before.declination == pytest.approx(now.annual_change, abs=1e-4)
    assert 0.3 < now.sigma < 0.45


def test_a_date_is_a_decimal_year() -> None:
    assert decimal_year("2026") == 2026.5
    assert decimal_year("2026-01-01") == pytest.approx(2026 + 0.5 / 365)
    assert decimal_year("2028-12-31") == pytest.approx(2029 - 0.5 / 366)
    assert decimal_year("2026-06") == pytest.approx(2026.45, abs=0.005)
    for wrong in ("summer", "2026-13", "2026-02-30", "26", "2026-6-1-1", ""):
        with pytest.raises(InputError, match="no date"):
            decimal_year(wrong)
