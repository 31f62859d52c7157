"""Mutated files of every kind, read in child processes: a value or an error with a hint, in bounded time and memory."""

from __future__ import annotations

import copy
import math
import os
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import examples
from hypothesis import example, given
from hypothesis import strategies as st
from readers import FILM, MAP, READERS, STRIP, TRACK, outcome, picture, sound

import geomosaic.cli
import geomosaic_frame
from geomosaic.errors import GeomosaicError, InputError
from geomosaic.project.image_metadata import photo_facts
from geomosaic.raster.image_metadata import PhotoTags
from geomosaic.raster.vector import read_layer
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import HasExample, SensorRequest

MUTATOR = Path(__file__).parent / "mutator.py"
PARTS = 3
FOLDERS = [
    *(str(Path(module.__file__ or "").parents[up]) for module, up in ((geomosaic.cli, 2), (geomosaic_frame, 1))),
    str(Path(__file__).parents[1] / "rigs"),
]


def faults(count: int, kinds: list[str], seconds: float) -> list[str]:
    """What a child process tells of `count` mutations of each kind; also how it ended, if not by itself."""
    path = os.pathsep.join([*FOLDERS, os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, str(MUTATOR), str(count), *kinds],
        check=False, capture_output=True, text=True, timeout=seconds, env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    lines = done.stdout.splitlines()
    found = [line for line in lines if line.startswith("FAULT")]
    if done.returncode != int(bool(found)):
        found.append(f"ended with {done.returncode} after '{lines[-1:]}': {done.stderr[-2000:]}")
    return found


@pytest.mark.parametrize("kind", READERS)
def test_whole_files_are_read(kind: str) -> None:
    assert outcome(kind, sound(kind)[1]) is None


@pytest.mark.parametrize("count", [10, pytest.param(25, marks=pytest.mark.slow)])
@pytest.mark.parametrize("part", range(PARTS))
def test_mutated_files_are_read_or_refused_with_a_hint(part: int, count: int) -> None:
    assert not faults(count, [*READERS][part::PARTS], 200.0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", READERS)
def test_many_mutated_files_are_read_or_refused_with_a_hint(kind: str) -> None:
    assert not faults(5000, [kind], 590.0)


def test_messages_of_gdal_that_quote_damaged_bytes_print_no_traceback(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(picture())
    notes = sound("PAM")[1].replace(b'X="500000"', b'X="\xb500000"')
    (tmp_path / "a.jpg.aux.xml").write_bytes(notes)
    words = [sys.executable, "-m", "geomosaic.cli", "new", str(tmp_path / "p.toml"), str(tmp_path / "a.jpg")]
    done = subprocess.run(words, check=False, capture_output=True, text=True)
    assert done.returncode == 0
    assert "Traceback" not in done.stderr


def test_names_of_columns_that_are_no_text_are_told(tmp_path: Path) -> None:
    file = tmp_path / "a.geojson"
    file.write_bytes(sound("GeoJSON")[1].replace(b'"v"', b'"v\xb9\xa3"'))
    with pytest.raises(InputError, match="not a vector file that can be read"):
        read_layer(file)


@pytest.mark.parametrize("kind", ["project", "camera", "surface", "layout"])
def test_a_number_too_long_to_be_written_is_told(kind: str) -> None:
    said = outcome(kind, sound(kind)[1] + b"x = 0x" + b"f" * 6000 + b"\n")
    assert said is not None
    assert "not valid TOML" in said.what


BY_ROWS = (
    "orientation table", "printed list", "control table", "QGIS points", "ODM points", "tie points", "fiducials",
    "correction grid", "track", "track of a scanner", "tie points of scenes", "Pix4D", "Metashape text",
    "COLMAP images", "COLMAP cameras",
)  # fmt: skip


@pytest.mark.parametrize("kind", [*BY_ROWS, "GeoJSON"])
def test_more_rows_than_the_limit_are_refused_whoever_reads_them(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("geomosaic.whole_files.MOST_ROWS", 40)
    monkeypatch.setattr("geomosaic.whole_files.MOST_TIES", 40)
    monkeypatch.setattr("geomosaic.raster.vector.MOST_ROWS", 40)
    data = sound(kind)[1]
    if kind == "GeoJSON":
        head, feature = data.split(b'"features":[')
        more = head + b'"features":[' + feature.removesuffix(b"]}") + (b"," + feature.removesuffix(b"]}")) * 40 + b"]}"
    else:
        more = data + data.splitlines(keepends=True)[-1] * 60
    said = outcome(kind, more)
    assert said is not None
    assert said.what == "more than 40 rows"
    assert said.hint


ODD: tuple[Any, ...] = ([], {}, [1], [[1]], ["a"], [None], {"a": 1}, "x", "", True, 10**400, -1, 0, 1e300, float("nan"))
SENSORS = ("frame", "panoramic", "planar", "pushbroom", "rpc")


def sound_inputs(folder: Path) -> Iterator[tuple[str, tuple[int, int], dict[str, Any]]]:
    """Sensor, size and sound options of an image: the examples, tracks and a film camera."""
    for name in SENSORS:
        plugin = registry.plugin(name)
        assert isinstance(plugin, HasExample)
        for file, text in plugin.example.files.items():
            (folder / file).write_text(text)
        options = tomllib.loads(plugin.example.project)["sensor"]
        yield name, plugin.example.size, {key: value for key, value in options.items() if key != "name"}
    (folder / "track.csv").write_text(TRACK)
    (folder / "strip.csv").write_text(STRIP)
    timed = {"start_time": 1.0, "line_period": 0.01, "focal_length_px": 900.0, "angle_unit": "deg"}
    yield "pushbroom", (40, 30), {"track": "track.csv", "columns": "left", **timed}
    yield "panoramic", (40, 30), {
        "kind": "scanner", "field_of_view": 60.0, "track": "strip.csv", "start_time": 1.0, "period": 0.01,
    }  # fmt: skip
    marks = {"1": [1.0, 1.0], "2": [39.0, 1.0], "3": [39.0, 29.0], "4": [1.0, 29.0]}
    angles = {"system": "opk", "omega": 0.0, "phi": 0.0, "kappa": 0.0}
    camera = tomllib.loads(FILM)
    yield (
        "frame",
        (40, 30),
        {"camera": camera, "fiducials": marks, "position": [5e5, 5.5e6, 9e2], "orientation": angles},
    )


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths to all values within tables and lists."""
    for key in value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ():
        yield (*path, key)
        yield from places(value[key], (*path, key))


def with_value(options: dict[str, Any], path: tuple[Any, ...], value: Any) -> dict[str, Any]:
    """Copy of options with another value at a path."""
    changed = copy.deepcopy(options)
    holder: Any = changed
    for key in path[:-1]:
        holder = holder[key]
    holder[path[-1]] = value
    return changed


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("share", [4, pytest.param(1, marks=pytest.mark.slow)])
def test_sensor_inputs_of_any_type_are_taken_or_refused_with_a_hint(tmp_path: Path, share: int) -> None:
    """Of all pairs of an input and an odd value one in `share`, spread over both."""
    refused: list[GeomosaicError] = []
    for name, size, options in sound_inputs(tmp_path):
        others = {entry.name for entry in registry.plugin(name).inputs} - set(options)
        pairs = [*product((*places(options), *((other,) for other in sorted(others))), ODD)]
        for index in np.random.default_rng(18).permutation(len(pairs))[::share]:
            path, odd = pairs[index]
            try:
                registry.build(name, SensorRequest("a.jpg", size, with_value(options, path, odd), MAP, str(tmp_path)))
            except GeomosaicError as error:
                refused.append(error)
    assert len(refused) > 500 / share
    assert not [str(error) for error in refused if not error.hint or len(str(error)) > 4000]


PIECES = st.one_of(
    st.sampled_from(
        ["", "nan", "inf", "-1", "0", "1e308", "1e-320", "9" * 400, '"', "'", ",", ";", "\t", "\n", "\0", "{}", "[]",
         "null", "true", "<", "&a;", "]", "=", "é", "\ud7ff", "a.jpg", "1_0", "٣"]
    ),
    st.text(max_size=12),
    st.floats().map(repr),
)  # fmt: skip


@examples(25)
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
    error = outcome(kind, bomb.encode() + sound(kind)[1])
    assert error is not None
    assert "document type" in error.what or "nested" in error.what
