"""Angles in a wrong unit are found by the flight they would make."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS

from geomosaic.sensor.plausibility import unit_suspicion
from geomosaic.types import FloatArray


def flight(heading: float, strips: int = 3, photos: int = 5) -> tuple[FloatArray, FloatArray]:
    """Angles in degrees and positions of a block flown to and fro; heading counter-clockwise from x."""
    rng = np.random.default_rng(1)
    along = np.array([np.cos(np.radians(heading)), np.sin(np.radians(heading))])
    across = np.array([-along[1], along[0]])
    places, angles = [], []
    for strip in range(strips):
        for photo in range(photos):
            places.append([*(300.0 * photo * along + 900.0 * strip * across + rng.normal(0, 5, 2)), 2000.0])
            turn = heading + 180.0 * (strip % 2)
            angles.append([*rng.normal(0, 1, 2), (turn + rng.normal(0, 2) + 180.0) % 360.0 - 180.0])
    return np.array(angles), np.array(places)


@pytest.mark.parametrize("heading", [0.0, 25.0, 90.0, 140.0])
def test_degrees_are_not_suspected(heading: float) -> None:
    assert unit_suspicion(*flight(heading)) is None


@pytest.mark.parametrize("heading", [25.0, 60.0, 140.0])
def test_radians_are_found(heading: float) -> None:
    angles, places = flight(heading)
    text = unit_suspicion(np.radians(angles), places)
    assert text is not None
    assert "angle_unit = 'rad'" in text


def test_gons_are_found() -> None:
    angles, places = flight(140.0)
    text = unit_suspicion(angles / 0.9, places)
    assert text is not None
    assert "angle_unit = 'gon'" in text


def test_nothing_is_said_without_evidence() -> None:
    angles, places = flight(25.0)
    assert unit_suspicion(np.radians(angles[:1]), places[:1]) is None
    assert unit_suspicion(np.radians(angles), np.zeros_like(places)) is None
    assert unit_suspicion(np.full_like(angles, np.nan), places) is None
    assert unit_suspicion(np.empty((0, 3)), np.empty((0, 3))) is None
    angles[:, 2] = np.random.default_rng(2).uniform(-180, 180, len(angles))  # hand-held: kappa follows nothing
    assert unit_suspicion(angles, places) is None


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:4979", "EPSG:4326+5773", "EPSG:4807"])
@pytest.mark.parametrize("heading", [40.0, 140.0])
def test_a_map_in_degrees_is_not_taken_for_a_square_one(crs: str, heading: float) -> None:
    """At 65° north a degree of longitude is 0.42 of one of latitude: a heading of 40° would be read as 63°."""
    angles, places = flight(heading)
    named = CRS(crs)
    degree = np.degrees(named.axis_info[0].unit_conversion_factor)
    y = (65.0 + places[:, 1] / 111_200) / degree
    x = (15.0 + places[:, 0] / (111_200 * np.cos(np.radians(65.0)))) / degree
    places = np.column_stack([x, y, places[:, 2]])
    assert unit_suspicion(angles, places, named) is None
    text = unit_suspicion(np.radians(angles), places, named)
    assert text is not None
    assert "angle_unit = 'rad'" in text
    assert unit_suspicion(np.radians(angles), places) is None  # the same numbers on a square map tell nothing


@pytest.mark.parametrize("turn", [0.0, 20.0, 45.0, 70.0])
def test_few_photos_of_several_strips_are_not_doubted(sample: Path, turn: float) -> None:
    """The nearest photo of such a choice is often one of another strip: its direction is not that of flight.

    Nor is the order of names always that of flight.
    """
    rows = np.loadtxt(sample / "exterior.csv", delimiter=",", skiprows=1, usecols=range(1, 7))
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    places, angles = rows[:, :3].copy(), rows[:, 3:] + (0.0, 0.0, turn)
    places[:, :2] = places[:, :2] @ np.array([[c, s], [-s, c]])
    for several in (list(which) for count in (2, 3, 4) for which in combinations(range(len(rows)), count)):
        for order in (several, several[::-1], several[1::2] + several[::2]):
            assert unit_suspicion(angles[order], places[order]) is None, order
    assert "'gon'" in (unit_suspicion(angles / 0.9, places) or "")
