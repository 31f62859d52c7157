"""Features of a GeoPackage edited in place: all or nothing, with all else in the file as it was."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pyogrio
import pytest
import shapely
from pyproj import CRS

from geomosaic.errors import InputError, OutputError
from geomosaic.raster import geopackage
from geomosaic.raster.attributes import KINDS, Field, checked_value
from geomosaic.raster.geopackage import (
    Feature,
    FeatureChange,
    FeatureConflict,
    create_layer,
    edit_features,
    feature_layers,
    next_ids,
    read_features,
)

VALUES = {
    "text": "<b>ü 1</b>", "integer": 2**53 + 1, "real": 0.1, "boolean": True, "date": "2026-11-24",
    "datetime": "2026-11-24T12:30:00.000Z",
}  # fmt: skip
SQUARE = shapely.box(400000, 5500000, 400100, 5500100)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "areas.gpkg"
    create_layer(file, "areas", "Polygon", CRS(32633), [Field(kind, kind) for kind in KINDS])
    return file


def added(path: Path, number: int = 1, shape: object = SQUARE, **values: object) -> Feature:
    feature = Feature(shape, {**VALUES, **values})
    edit_features(path, "areas", [FeatureChange(number, None, feature)])
    return feature


def opened(path: Path) -> sqlite3.Connection:
    """Another program's connection; it knows the functions that the triggers of the index call."""
    database = sqlite3.connect(path, isolation_level=None)
    database.create_function("ST_IsEmpty", 1, lambda _: 0)
    for name in ("ST_MinX", "ST_MaxX", "ST_MinY", "ST_MaxY"):
        database.create_function(name, 1, lambda _: 0.0)
    return database


def test_what_is_written_is_what_gdal_and_we_read(path: Path) -> None:
    added(path)
    table = read_features(path, "areas", 10)
    assert (table.kind, table.heights, table.crs) == ("POLYGON", False, CRS(32633))
    assert [field.kind for field in table.fields] == list(KINDS)
    assert table.features[1].values == VALUES
    assert table.features[1].geometry.wkb == SQUARE.wkb
    frame = pyogrio.read_dataframe(path, fid_as_index=True)
    assert frame.index.tolist() == [1]
    assert frame.geometry.iloc[0].equals_exact(SQUARE, 0.0)
    assert frame.loc[1, ["text", "integer", "real", "boolean"]].tolist() == ["<b>ü 1</b>", 2**53 + 1, 0.1, True]
    assert str(frame["date"].dtype).startswith("datetime64")
    assert tuple(pyogrio.read_info(path)["total_bounds"]) == SQUARE.bounds


def test_the_spatial_index_follows_edits(path: Path) -> None:
    before = added(path)
    there, away = (400050, 5500050, 400060, 5500060), (500050, 5500050, 500060, 5500060)
    moved = Feature(shapely.transform(SQUARE, lambda xy: np.add(xy, (100000, 0))), before.values)
    change = FeatureChange(1, before, moved)
    edit_features(path, "areas", [change])
    assert [len(pyogrio.read_dataframe(path, bbox=box)) for box in (there, away)] == [0, 1]
    edit_features(path, "areas", [change.reverse])
    assert [len(pyogrio.read_dataframe(path, bbox=box)) for box in (there, away)] == [1, 0]
    with sqlite3.connect(path) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_columns_layers_and_styles_that_are_not_edited_stay(path: Path) -> None:
    added(path)
    with opened(path) as database:
        database.execute("ALTER TABLE areas ADD COLUMN picture BLOB")
        database.execute("UPDATE areas SET picture = x'0102'")
        database.execute("CREATE TABLE layer_styles (styleQML TEXT)")
        database.execute("INSERT INTO layer_styles VALUES ('<qgis/>')")
    pyogrio.write_dataframe(pyogrio.read_dataframe(path, layer="areas"), path, layer="more", append=True)
    assert feature_layers(path) == ["areas", "more"]
    feature = read_features(path, "areas", 10).features[1]
    assert "picture" not in feature.values
    edit_features(
        path, "areas", [FeatureChange(1, feature, Feature(feature.geometry, {**feature.values, "real": 7.0}))]
    )
    with sqlite3.connect(path) as database:
        assert database.execute("SELECT picture, real FROM areas").fetchall() == [(b"\x01\x02", 7.0)]
        assert database.execute("SELECT styleQML FROM layer_styles").fetchall() == [("<qgis/>",)]
    assert len(read_features(path, "more", 10).features) == 1


def test_an_edit_is_made_once_and_one_that_contradicts_the_file_not_at_all(path: Path) -> None:
    before = added(path)
    after = Feature(before.geometry, {**VALUES, "text": "mine"})
    new = FeatureChange(2, None, before)
    edit_features(path, "areas", [FeatureChange(1, before, after), new])
    edit_features(path, "areas", [FeatureChange(1, before, after), new])
    assert len(read_features(path, "areas", 10).features) == 2
    other = Feature(before.geometry, {**VALUES, "text": "other"})
    with pytest.raises(FeatureConflict) as raised:
        edit_features(path, "areas", [FeatureChange(3, None, before), FeatureChange(1, before, other)])
    assert raised.value.ids == (1,)
    kept = read_features(path, "areas", 10).features
    assert sorted(kept) == [1, 2]
    assert kept[1].values["text"] == "mine"


def test_numbers_of_deleted_features_are_not_given_again(path: Path) -> None:
    feature = added(path, 7)
    edit_features(path, "areas", [FeatureChange(7, feature, None)])
    assert next_ids(path, "areas", 2) == [8, 9]


def test_a_file_that_another_program_holds_open_is_edited_through_its_journal(path: Path) -> None:
    """As QGIS does: what it has saved stands in a write-ahead journal beside the file, and stays there."""
    added(path)
    with opened(path) as other:
        other.execute("PRAGMA journal_mode = WAL")
        other.execute("UPDATE areas SET text = 'theirs'")
        feature = read_features(path, "areas", 10).features[1]
        assert feature.values["text"] == "theirs"
        edit_features(path, "areas", [FeatureChange(1, feature, Feature(SQUARE, {**feature.values, "real": 5.0}))])
        assert other.execute("SELECT text, real FROM areas").fetchall() == [("theirs", 5.0)]


def test_a_file_that_another_program_writes_is_told_and_left(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = added(path)
    monkeypatch.setattr(geopackage, "_PATIENCE", 0.05)
    with sqlite3.connect(path, isolation_level=None) as other:
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(OutputError, match="another program is writing"):
            edit_features(path, "areas", [FeatureChange(1, before, None)])
        other.execute("ROLLBACK")
    assert len(read_features(path, "areas", 10).features) == 1


def test_a_full_disk_leaves_the_file_as_it_was(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = added(path)
    connect = sqlite3.connect

    def full(*words: object, **more: object) -> sqlite3.Connection:
        database = connect(*words, **more)  # type: ignore[call-overload]
        database.execute("PRAGMA max_page_count = 1")  # SQLite then says what it says of a full disk
        return database

    monkeypatch.setattr(geopackage.sqlite3, "connect", full)
    long = shapely.Point(400000, 5500000).buffer(100.0, quad_segs=5000)
    with pytest.raises(OutputError, match="full"):
        edit_features(path, "areas", [FeatureChange(1, before, None), FeatureChange(2, None, Feature(long, VALUES))])
    monkeypatch.undo()
    assert sorted(read_features(path, "areas", 10).features) == [1]


def test_files_that_are_none_layers_that_are_gone_and_too_many_features_are_told(path: Path, tmp_path: Path) -> None:
    added(path)
    with pytest.raises(InputError, match="no layer 'roads'"):
        read_features(path, "roads", 10)
    with pytest.raises(InputError, match="more than 0 features"):
        read_features(path, "areas", 0)
    wrong = tmp_path / "text.gpkg"
    wrong.write_text("no database, but long enough for one" * 40)
    with pytest.raises(InputError, match="cannot be read"):
        feature_layers(wrong)
    with pytest.raises(InputError, match="gone"):
        feature_layers(tmp_path / "none.gpkg")
    with opened(path) as database:
        database.execute("UPDATE areas SET geom = x'00'")
    with pytest.raises(InputError, match="geometry cannot be read"):
        read_features(path, "areas", 10)


@pytest.mark.parametrize(
    ("kind", "value"),
    [("integer", 1.5), ("integer", True), ("integer", 2**70), ("real", "x"), ("real", float("inf")), ("boolean", 1),
     ("date", "24.11.2026"), ("datetime", 5), ("text", 5), ("text", "a\0b"), ("text", "\ud800")],
)  # fmt: skip
def test_attributes_of_another_kind_are_refused(kind: str, value: object) -> None:
    with pytest.raises(InputError, match=f"is no {kind}"):
        checked_value(value, Field("f", kind))


def test_attributes_are_kept_as_the_standard_has_them() -> None:
    assert checked_value("2026-11-24T12:30:00+02:00", Field("f", "datetime")) == "2026-11-24T10:30:00.000Z"
    assert checked_value("7", Field("f", "integer")) == 7
    assert checked_value("", Field("f", "text")) is None
    assert np.isclose(checked_value("2.5", Field("f", "real")), 2.5)
