"""Magnetic north of a sheet: declared, or by the model at a date; what it says of itself."""

from __future__ import annotations

import warnings

import pytest

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.geo.crs import parse_crs
from geomosaic.geo.local_frames import map_place
from geomosaic.sheets.drawing.scale_and_north import magnetic_text, north_lines
from geomosaic.sheets.grid_lines import map_grid
from geomosaic.sheets.layout import NorthPart, declination

PLACE = map_place(parse_crs("EPSG:32633"), 400_000.0, 5_500_000.0)


def test_without_a_date_there_is_none() -> None:
    assert declination(NorthPart(), PLACE) is None
    assert declination(NorthPart(magnetic_date="2026"), None) is None
    assert declination(NorthPart(show=False, magnetic_date="1999"), PLACE) is None
    assert len(north_lines(-1.0)) == 1


def test_what_is_declared_wins() -> None:
    found = declination(NorthPart(magnetic=-2.5, magnetic_date="summer 1987", annual_change=0.1), PLACE)
    assert found is not None
    assert magnetic_text(found) == "Magnetic declination 2°30′ west (summer 1987), annual change 6.0′ east."


def test_the_model_says_how_sure_it_is() -> None:
    found = declination(NorthPart(magnetic_date="2026-06"), PLACE)
    assert found is not None
    assert found.degrees == pytest.approx(4.9, abs=0.05)
    assert magnetic_text(found) == (
        f"Magnetic declination {found.degrees:.1f}°\u00a0±\u00a00.4° east (WMM2025, 2026-06), "
        f"annual change {60 * found.annual_change:.1f}′ east."
    )


def test_dates_beyond_the_model_are_refused() -> None:
    for date in ("1987", "2024-12-31", "2030-01-02"):
        with pytest.raises(InputError, match="holds from 2025 to 2030") as told:
            declination(NorthPart(magnetic_date=date), PLACE)
        assert "magnetic" in str(told.value.hint)


def test_no_arrow_at_the_magnetic_pole() -> None:
    place = map_place(parse_crs("EPSG:3413"), 100_000.0, 400_000.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert declination(NorthPart(magnetic_date="2026"), PLACE) is not None
    with pytest.warns(GeomosaicWarning, match="compass"):
        assert declination(NorthPart(magnetic_date="2026"), place) is None


def test_a_graticule_near_the_pole_may_be_turned() -> None:
    """Meridians that run across the sheet have their labels at its sides, where they meet the neatline."""
    polar, degrees = parse_crs("EPSG:3413"), parse_crs("EPSG:4326")
    below = map_grid(degrees, polar, (-20e3, -927e3, 16e3, -900e3), 10e3)
    aside = map_grid(degrees, polar, (900e3, 373e3, 936e3, 400e3), 10e3)
    assert (below.turned, aside.turned) == (False, True)
    meridians = [side for line in aside.lines if line.axis == 0 for side, _, _ in line.ends]
    assert sum(side in ("left", "right") for side in meridians) > len(meridians) / 2
    assert not map_grid(polar, polar, (900e3, 373e3, 936e3, 400e3), 10e3).turned
