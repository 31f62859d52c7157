"""Metadata that is damaged: a clear error or a model, never a crash, never a hang."""

from __future__ import annotations

import re
from functools import cache

import numpy as np
import pytest
from helpers import examples
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from spot_rig import SIZE, Satellite

from geomosaic.errors import InputError
from geomosaic.sensor.plugin import SensorRequest
from geomosaic_pushbroom.build import of_scene
from geomosaic_pushbroom.metadata import read_bytes

SETTINGS = examples(60, suppress_health_check=[HealthCheck.too_slow])
NUMBER = re.compile(r"(?<=>)-?\d[\d.e+-]*(?=<)")


@cache
def whole(speeds: bool) -> str:
    return Satellite().dimap(speeds=speeds)


def told(data: bytes) -> str:
    """What is said of bad metadata; empty where a model comes of it, whose pixels meet the ground or NaN."""
    try:
        reported = read_bytes(data, "scene.tif")
    except InputError as error:
        return str(error)
    request = SensorRequest("scene.tif", SIZE)
    try:
        model = of_scene(reported, request)
    except InputError as error:
        return str(error)
    image = np.array([[0.0, 0.0], [1500.0, 1500.0], [3000.0, 10.0]])
    origins, directions = model.rays(image)
    model.ground_to_image(origins + 9e5 * directions)
    return ""


def outcome(data: bytes) -> None:
    words = told(data)
    assert not words or "scene.tif" in words


@SETTINGS
@given(st.binary(max_size=400))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    outcome(data)


@SETTINGS
@given(st.booleans(), st.integers(0, 10_000), st.integers(0, 400), st.binary(max_size=20))
def test_a_piece_replaced(speeds: bool, start: int, length: int, piece: bytes) -> None:
    data = whole(speeds).encode()
    start %= len(data)
    outcome(data[:start] + piece + data[start + length :])


@SETTINGS
@given(
    st.booleans(), st.integers(0, 10_000), st.sampled_from(["", "nan", "inf", "-1", "0", "1e300", "-1e9", "x", "1 2"])
)
def test_a_number_replaced(speeds: bool, which: int, word: str) -> None:
    text = whole(speeds)
    places = list(NUMBER.finditer(text))
    place = places[which % len(places)]
    outcome((text[: place.start()] + word + text[place.end() :]).encode())


@cache
def keywords() -> tuple[tuple[str, ...], ...]:
    """Words of each line of a keyword list."""
    lines = Satellite().keyword_list().splitlines()
    return tuple(tuple(line.split(" ")) for line in lines)


@SETTINGS
@given(
    st.integers(0, 20), st.integers(0, 50), st.sampled_from(["", "nan", "inf", "-1", "0", "1e300", "-1e9", "x", "1 2"])
)
def test_a_word_of_a_keyword_list_replaced(line: int, which: int, word: str) -> None:
    lines = [list(words) for words in keywords()]
    chosen = lines[line % len(lines)]
    chosen[which % len(chosen)] = word
    outcome("\n".join(" ".join(words) for words in lines).encode())


@SETTINGS
@given(st.text(alphabet="abc:\n .0123456789-_", max_size=300))
def test_any_keyword_list_is_read_or_refused(text: str) -> None:
    outcome(f"type: ossimSpot5Model\n{text}".encode())


@pytest.mark.parametrize(
    "text",
    [
        '<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]><Dimap_Document>&b;</Dimap_Document>',
        '<!DOCTYPE a [<!ENTITY b "bb"><!ENTITY c "&b;&b;&b;">]><Dimap_Document>&c;</Dimap_Document>',
    ],
)
def test_entities_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="document type"):
        read_bytes(text.encode(), "scene.tif")
