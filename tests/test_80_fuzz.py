"""Damaged text and XML of every kind that is read: a clear error or a value, never a crash, never a hang."""

from __future__ import annotations

import math

import pytest
from helpers import examples
from hypothesis import HealthCheck, example, given
from hypothesis import strategies as st
from reader_rig import KINDS, MORE, outcome, sound

from geomosaic.project.image_metadata import photo_facts
from geomosaic.raster.image_metadata import PhotoTags

SETTINGS = examples(25, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])


@pytest.mark.parametrize("kind", [*KINDS, *MORE])
def test_whole_files_are_read(kind: str) -> None:
    assert outcome(kind, sound(kind)[1]) is None


@pytest.mark.parametrize("kind", KINDS)
@SETTINGS
@given(data=st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(kind: str, data: bytes) -> None:
    error = outcome(kind, data)
    assert error is None or error.what


PIECES = st.one_of(
    st.sampled_from(
        ["", "nan", "inf", "-1", "0", "1e308", "1e-320", "9" * 400, '"', "'", ",", ";", "\t", "\n", "\0", "{}", "[]",
         "null", "true", "<", "&a;", "]", "=", "é", "\ud7ff", "a.jpg", "1_0", "٣"]
    ),
    st.text(max_size=12),
    st.floats().map(repr),
)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@SETTINGS
@given(cuts=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 30), PIECES), min_size=1, max_size=3))
def test_a_replaced_piece_is_read_or_refused(kind: str, cuts: list[tuple[float, int, str]]) -> None:
    text = KINDS[kind][1]
    for place, length, piece in cuts:
        at = math.floor(place * len(text))
        text = text[:at] + piece + text[at + length :]
    error = outcome(kind, text.encode("utf-8", "surrogatepass"))
    assert error is None or error.what


@SETTINGS
@example(exif={"FocalLengthIn35mmFilm": "1e308"}, xmp="")
@example(exif={"FocalLengthIn35mmFilm": "50", "FocalLength": "1e9", "PixelXDimension": "1e-300"}, xmp="")
@given(
    exif=st.dictionaries(
        st.sampled_from(
            ["GPSLatitude", "GPSLatitudeRef", "GPSLongitude", "GPSLongitudeRef", "GPSAltitude", "FocalLength",
             "FocalLengthIn35mmFilm", "FocalPlaneXResolution", "FocalPlaneResolutionUnit", "PixelXDimension"]
        ),
        st.one_of(PIECES, st.floats().map(lambda v: f"({v})")),
    ),
    xmp=st.text(max_size=60).map(lambda text: f'drone-dji:GimbalYawDegree="{text}" drone-dji:GpsLatitude="{text}"'),
)  # fmt: skip
def test_tags_of_photos(exif: dict[str, str], xmp: str) -> None:
    facts = photo_facts(PhotoTags(exif, xmp), (40, 30))
    assert facts.focal is None or math.isfinite(facts.focal)
    assert facts.position is None or (abs(facts.position[0]) <= 180 and abs(facts.position[1]) <= 90)


BOMB = '<!DOCTYPE d [<!ENTITY a "aaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>'


@pytest.mark.parametrize("kind", ["Metashape XML", "IGN"])
@pytest.mark.parametrize("bomb", [BOMB, '<!DOCTYPE d SYSTEM "file:///etc/hostname">', "<a>" * 5000])
def test_xml_entities_are_refused(kind: str, bomb: str) -> None:
    error = outcome(kind, (bomb + KINDS[kind][1]).encode())
    assert error is not None
    assert "document type" in error.what or "nested" in error.what
