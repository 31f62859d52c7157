"""Digitizing in the studio: features on the map and in a photo, their files, and what others do to them."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the extra `studio` is not installed")
pytest.importorskip("httpx2", reason="httpx2 is not installed")

import geopandas
import shapely
from digitizing_rig import area, digitizing_project, line, pixels_of, road
from pyproj import CRS, Geod, Transformer
from reference_rig import ORIGIN
from starlette.testclient import TestClient
from studio_rig import owner

import geomosaic as gm
from geomosaic.project.load import load_project
from geomosaic.project.scenes import project_scene
from geomosaic.raster import geopackage
from geomosaic.raster.attributes import Field
from geomosaic.raster.geopackage import create_layer
from geomosaic.studio.digitizing.store import FeatureStore
from geomosaic.testing.synthetic.block import PlainCamera

X, Y = ORIGIN
FIELDS = [
    {"name": "name", "kind": "text"}, {"name": "lanes", "kind": "integer"}, {"name": "paved", "kind": "boolean"},
    {"name": "seen", "kind": "date"}, {"name": "width", "kind": "real"},
]  # fmt: skip


@dataclass(frozen=True)
class Desk:
    """A project that is digitized by requests."""

    client: TestClient
    folder: Path
    camera: PlainCamera

    def ids(self) -> tuple[str, str]:
        """Ids of the photo and of the map."""
        project = self.client.get("/api/project").json()
        return project["images"][0]["id"], next(one["id"] for one in project["layers"] if one["role"] == "reference")

    def create(self, name: str = "roads", kind: str = "LineString", **more: Any) -> str:
        values = {"name": name, "kind": kind, "fields": FIELDS, "map_layer": self.ids()[1], **more}
        answer = self.client.post("/api/features/layers", json=values)
        assert answer.status_code == 200, answer.text
        return answer.json()["id"]

    def layer(self, layer: str) -> dict[str, Any]:
        image, chart = self.ids()
        answer = self.client.get(f"/api/features/layers/{layer}?image={image}&map_layer={chart}")
        assert answer.status_code == 200, answer.text
        return answer.json()

    def edit(self, layer: str, *changes: dict[str, Any], side: str = "map_layer", **more: Any) -> Any:
        where = dict(zip(("image", "map_layer"), self.ids(), strict=True))
        body = {"changes": list(changes), side: where[side], **more}
        return self.client.post(f"/api/features/layers/{layer}/edits", json=body)

    def drawn(self, layer: str, geometry: dict[str, Any], side: str = "map_layer", **more: Any) -> dict[str, Any]:
        """A new feature, as the page is told of it."""
        answer = self.edit(layer, {"id": None, "geometry": geometry}, side=side, **more)
        assert answer.status_code == 200, answer.text
        return next(one for one in self.layer(layer)["features"] if one["id"] == answer.json()["ids"][0])

    def pending(self) -> list[dict[str, Any]]:
        return self.client.get("/api/features").json()["pending"]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, PlainCamera]:
    folder = tmp_path_factory.mktemp("digitizing")
    return folder, digitizing_project(folder)[1]


@pytest.fixture
def folder(written: tuple[Path, PlainCamera], tmp_path: Path) -> Path:
    shutil.copytree(written[0], tmp_path / "own")
    return tmp_path / "own"


@pytest.fixture
def desk(written: tuple[Path, PlainCamera], folder: Path) -> Iterator[Desk]:
    with owner(folder / "project.toml") as client:
        yield Desk(client, folder, written[1])


def places(path: Path) -> np.ndarray:
    """Vertices of the first feature of a file."""
    return shapely.get_coordinates(geopandas.read_file(path).geometry.iloc[0])


def test_a_road_drawn_on_the_photo_lies_on_the_map_where_it_is(desk: Desk) -> None:
    """Vertices, and the ground between them: all within half a pixel of the truth."""
    roads, truth = desk.create(), road()
    made = desk.drawn(roads, line(pixels_of(desk.camera, truth)), side="image")
    kept = places(desk.folder / "roads.gpkg")
    np.testing.assert_array_equal(shapely.get_coordinates(shapely.geometry.shape(made["map"])), kept)
    dense = shapely.get_coordinates(shapely.LineString(kept).segmentize(2.0))
    wanted = shapely.LineString(pixels_of(desk.camera, truth))
    apart = shapely.distance(shapely.points(pixels_of(desk.camera, dense)), wanted)
    ends = np.array([np.hypot(*(kept - place).T).min() for place in truth]) / 1.8
    assert apart.max() < 0.15
    assert ends.max() < 0.1  # the DEM's own interpolation


def test_a_road_drawn_on_the_map_is_shown_where_the_photo_sees_it(desk: Desk) -> None:
    made = desk.drawn(desk.create(), line(road()))
    pieces = [shapely.geometry.shape(one["geometry"]) for one in made["drawn"] if not one["hidden"]]
    along = shapely.get_coordinates(shapely.LineString(road()).segmentize(2.0))
    apart = shapely.distance(shapely.points(pixels_of(desk.camera, along)), shapely.union_all(pieces))
    assert apart.max() < 0.15
    vertices = shapely.get_coordinates(shapely.geometry.shape(made["image"]))
    assert np.abs(vertices - pixels_of(desk.camera, road())).max() < 0.15


def test_areas_and_lengths_are_those_of_the_ellipsoid(desk: Desk) -> None:
    corners = np.array([[X, Y], [X + 300, Y + 20], [X + 280, Y + 250], [X - 30, Y + 240]])
    made = desk.drawn(desk.create("fields", "Polygon"), area(corners))
    ring = np.column_stack(
        Transformer.from_crs(32633, 4326, always_xy=True).transform(*np.vstack([corners, corners[:1]]).T)
    )
    geod = Geod(ellps="WGS84")
    assert made["area"] == pytest.approx(abs(geod.polygon_area_perimeter(*ring.T)[0]), rel=1e-6)
    assert made["length"] == pytest.approx(geod.line_length(*ring.T), rel=1e-7)
    way = desk.drawn(desk.create(), line(corners))
    assert way["length"] == pytest.approx(geod.line_length(*ring[:4].T), rel=1e-7)
    assert way["area"] == 0.0


def test_a_shared_corner_moves_for_both_neighbours_in_one_edit_that_undo_takes_back(desk: Desk) -> None:
    fields = desk.create("fields", "Polygon")
    one = desk.drawn(fields, area([[X, Y], [X + 100, Y], [X + 100, Y + 100], [X, Y + 100]]), shared=True)
    # Its corner lies on the edge of the first: that edge gets it.
    two = desk.drawn(
        fields, area([[X + 100, Y + 50], [X + 200, Y], [X + 200, Y + 200], [X + 100, Y + 100]]), shared=True
    )
    one = next(each for each in desk.layer(fields)["features"] if each["id"] == one["id"])
    assert [X + 100, Y + 50] in one["map"]["coordinates"][0]
    before = geopandas.read_file(desk.folder / "fields.gpkg").geometry.to_wkt().tolist()
    change = [
        {"id": each["id"], "stamp": each["stamp"], "geometry": json.loads(
            json.dumps(each["map"]).replace(json.dumps([X + 100, Y + 50]), json.dumps([X + 120, Y + 60])))}
        for each in (one, two)
    ]  # fmt: skip
    answer = desk.edit(fields, *change, shared=True).json()
    assert answer["title"] == "2 features of fields changed"
    now = {each["id"]: each["stamp"] for each in desk.layer(fields)["features"]}
    assert answer["stamps"] == [[each["id"], each["stamp"], now[each["id"]]] for each in (one, two)]
    first, second = geopandas.read_file(desk.folder / "fields.gpkg").geometry
    assert first.intersection(second).area == 0.0
    assert first.boundary.intersection(second.boundary).length == pytest.approx(np.hypot(20.0, 40.0))
    assert desk.client.post("/api/undo").json()["title"] == "2 features of fields changed"
    assert geopandas.read_file(desk.folder / "fields.gpkg").geometry.to_wkt().tolist() == before
    desk.client.post("/api/redo")
    assert geopandas.read_file(desk.folder / "fields.gpkg").geometry.iloc[0].equals(first)
    for _ in range(3):
        desk.client.post("/api/undo")
    assert len(geopandas.read_file(desk.folder / "fields.gpkg")) == 0


def test_an_outline_that_crosses_itself_is_kept_and_told(desk: Desk) -> None:
    fields = desk.create("fields", "Polygon")
    bow = area([[X, Y], [X + 100, Y + 100], [X + 100, Y], [X, Y + 50]])
    answer = desk.edit(fields, {"id": None, "geometry": bow}).json()
    assert "crosses or touches itself at" in answer["notes"][0]
    (made,) = desk.layer(fields)["features"]
    assert made["area"] is None
    assert "crosses" in made["wrong"]


def test_attributes_have_their_declared_types_and_markup_is_text(desk: Desk) -> None:
    roads = desk.create()
    made = desk.drawn(roads, line(road()))
    script = "<img src=x onerror=alert(1)>'; DROP TABLE roads; --"
    values = {"name": script, "lanes": 2, "paved": True, "seen": "2026-11-24", "width": 6.5}
    answer = desk.edit(roads, {"id": made["id"], "stamp": made["stamp"], "values": values})
    assert answer.status_code == 200
    (made,) = desk.layer(roads)["features"]
    assert made["values"] == values
    assert answer.json()["stamps"][0][2] == made["stamp"]
    kept = geopandas.read_file(desk.folder / "roads.gpkg").iloc[0]
    assert (kept["name"], kept["lanes"], kept["width"]) == (script, 2, 6.5)
    for wrong in (
        {"lanes": "two"},
        {"seen": "yesterday"},
        {"paved": "yes"},
        {"depth": 3},
        {"width": {"a": 1}},
        ["name"],
    ):
        answer = desk.edit(roads, {"id": made["id"], "stamp": made["stamp"], "values": wrong})
        assert answer.status_code == 422
        assert answer.json()["hint"]
    assert desk.layer(roads)["features"][0]["values"] == values


def test_what_another_program_has_changed_is_seen_and_not_written_over(desk: Desk) -> None:
    roads = desk.create()
    seen = desk.drawn(roads, line(road()))
    rename(desk.folder / "roads.gpkg", "theirs")
    mine = {"id": seen["id"], "stamp": seen["stamp"], "values": {"name": "mine"}}
    answer = desk.edit(roads, mine)
    assert answer.status_code == 422
    assert "another program has changed feature 1" in answer.json()["what"]
    assert desk.client.post("/api/undo").status_code == 422
    (now,) = desk.layer(roads)["features"]
    assert now["values"]["name"] == "theirs"
    assert desk.edit(roads, {**mine, "stamp": now["stamp"]}).status_code == 200


def rename(path: Path, name: str) -> None:
    """An edit of the first feature by another program."""
    with sqlite3.connect(path) as database:
        database.create_function("ST_IsEmpty", 1, lambda _: 0)
        for bound in ("ST_MinX", "ST_MaxX", "ST_MinY", "ST_MaxY"):
            database.create_function(bound, 1, lambda _: 0.0)
        database.execute("UPDATE roads SET name = ? WHERE fid = 1", (name,))
    database.close()


def test_an_edit_of_a_file_that_is_held_waits_in_the_journal_and_is_shown(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(geopackage, "_PATIENCE", 0.05)
    roads = desk.create()
    seen = desk.drawn(roads, line(road()))
    other = sqlite3.connect(desk.folder / "roads.gpkg", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    answer = desk.edit(roads, {"id": seen["id"], "stamp": seen["stamp"], "values": {"name": "waits"}}).json()
    assert answer["notes"] == ["saved in the journal; not in the GeoPackage yet"]
    desk.drawn(roads, line(road() + 5.0))
    assert next(one["why"] for one in desk.pending()) == "another program is writing the file (database is locked)"
    assert [one["values"]["name"] for one in desk.layer(roads)["features"]] == ["waits", None]
    assert len(geopandas.read_file(desk.folder / "roads.gpkg")) == 1
    other.execute("ROLLBACK")
    other.close()
    assert desk.client.post("/api/features/pending", json={"act": "again"}).json()["pending"] == []
    assert geopandas.read_file(desk.folder / "roads.gpkg")["name"].fillna("").tolist() == ["waits", ""]


@pytest.mark.parametrize("act", ["over", "drop"])
def test_an_edit_that_waited_too_long_is_settled_by_choice(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, act: str
) -> None:
    monkeypatch.setattr(geopackage, "_PATIENCE", 0.05)
    roads = desk.create()
    seen = desk.drawn(roads, line(road()))
    path = desk.folder / "roads.gpkg"
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    desk.edit(roads, {"id": seen["id"], "stamp": seen["stamp"], "values": {"name": "mine"}})
    other.execute("ROLLBACK")
    other.close()
    rename(path, "theirs")
    (waiting,) = desk.client.post("/api/features/pending", json={"act": "again"}).json()["pending"]
    assert waiting["conflict"]
    assert desk.layer(roads)["features"][0]["values"]["name"] == "theirs"
    desk.client.post("/api/features/pending", json={"act": act, "number": waiting["number"]})
    assert desk.pending() == []
    assert geopandas.read_file(path)["name"].tolist() == ["mine" if act == "over" else "theirs"]


KILLED = """
import os, signal, sys
from pathlib import Path
import shapely
from geomosaic.raster.geopackage import Feature, FeatureChange
from geomosaic.studio.digitizing import store as feature_store
folder = Path(sys.argv[1])
store = feature_store.FeatureStore(folder / "digitizing.jsonl")
for number in range(1, 6):
    store.sketch("page", {"kind": "LineString", "coordinates": [[i, i] for i in range(number)]})
def die(*_):
    os.kill(os.getpid(), signal.SIGKILL)
feature_store.edit_features = die  # after the journal, before the GeoPackage
road = Feature(shapely.LineString([(400000, 5500000), (400100, 5500100)]), {"name": "kept"})
store.save("feature 1 drawn", folder / "roads.gpkg", "roads", [FeatureChange(1, None, road)])
"""


def test_nothing_that_was_answered_is_lost_by_a_kill(tmp_path: Path) -> None:
    """Killed between journal and GeoPackage, with a torn line at the end: the edit is made at the start, once."""
    create_layer(tmp_path / "roads.gpkg", "roads", "LineString", CRS(32633), [Field("name", "text")])
    made = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], capture_output=True, text=True, check=False)
    assert made.returncode == -9, made.stderr
    journal = tmp_path / "digitizing.jsonl"
    with journal.open("a") as file:
        file.write('{"sketch": "page", "drawn": {"kind": "Lin')
    assert len(geopandas.read_file(tmp_path / "roads.gpkg")) == 0
    for _ in range(2):
        store = FeatureStore(journal)
        assert len(store.sketches["page"]["coordinates"]) == 5
        store.flush()
        assert store.pending == []
    assert geopandas.read_file(tmp_path / "roads.gpkg")["name"].tolist() == ["kept"]
    store.sketch("other", {"kind": "Point", "coordinates": []})
    assert sorted(FeatureStore(journal).sketches) == ["other", "page"]
    for page in ("page", "other"):
        store.sketch(page, None)
    assert journal.read_text() == ""


def test_a_new_feature_whose_number_another_program_took_gets_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "roads.gpkg"
    create_layer(path, "roads", "LineString", CRS(32633), [Field("name", "text")])
    shape = shapely.LineString([(400000, 5500000), (400100, 5500100)])
    theirs, mine = (
        geopackage.FeatureChange(1, None, geopackage.Feature(shape, {"name": name})) for name in ("theirs", "mine")
    )
    store = FeatureStore(tmp_path / "digitizing.jsonl")
    monkeypatch.setattr(geopackage, "_PATIENCE", 0.05)
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    store.save("feature 1 drawn", path, "roads", [mine])
    other.execute("ROLLBACK")
    other.close()
    geopackage.edit_features(path, "roads", [theirs])
    store.flush()
    assert store.pending == []
    assert geopandas.read_file(path)["name"].tolist() == ["theirs", "mine"]


def test_a_journal_that_cannot_be_written_refuses_the_edit(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    roads = desk.create()
    desk.drawn(roads, line(road()))
    before = (desk.folder / "roads.gpkg").read_bytes()

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    answer = desk.edit(roads, {"id": None, "geometry": line(road() + 3.0)})
    assert answer.status_code == 422
    assert "No space left" in answer.json()["what"]
    assert "keeps what is drawn" in answer.json()["hint"]
    assert (
        desk.client.put("/api/features/sketch", json={"page": "p", "drawn": {"coordinates": [[1, 2]]}}).status_code
        == 422
    )
    monkeypatch.setattr(os, "fsync", lambda _: None)
    assert (desk.folder / "roads.gpkg").read_bytes() == before
    assert desk.pending() == []
    desk.drawn(roads, line(road() + 3.0))


def test_layers_of_other_crs_and_with_heights_are_shown_and_the_latter_not_redrawn(desk: Desk) -> None:
    degrees = desk.create("degrees", crs="EPSG:4326")
    made = desk.drawn(degrees, line(pixels_of(desk.camera, road())), side="image")
    true = np.column_stack(Transformer.from_crs(32633, 4326, always_xy=True).transform(*road().T))
    kept = places(desk.folder / "degrees.gpkg")
    assert np.abs(kept[[0, -1]] - true[[0, -1]]).max() < 1e-6
    np.testing.assert_allclose(made["map"]["coordinates"][0], road()[0], atol=0.05)
    deep = shapely.LineString(np.column_stack([road(), np.full(9, 400.0)]))
    geopandas.GeoDataFrame({"name": ["a"]}, geometry=[deep], crs=32633).to_file(desk.folder / "deep.gpkg", layer="deep")
    listed = {one["name"]: one["id"] for one in desk.client.get("/api/features").json()["layers"]}
    layer = desk.layer(listed["deep"])
    assert "heights" in layer["fixed"]
    (feature,) = layer["features"]
    change = {"id": feature["id"], "stamp": feature["stamp"]}
    assert desk.edit(listed["deep"], {**change, "geometry": line(road() + 1.0)}).status_code == 422
    assert desk.edit(listed["deep"], {**change, "values": {"name": "b"}}).status_code == 200
    (kept,) = geopandas.read_file(desk.folder / "deep.gpkg").geometry
    assert kept.wkb == deep.wkb


def test_the_place_under_the_pointer_is_that_of_the_library_both_ways(desk: Desk) -> None:
    image, chart = desk.ids()
    ask = f"/api/features/place?image={image}&map_layer={chart}"
    found = desk.client.get(f"{ask}&col=100.5&row=140.25").json()
    scene = project_scene(load_project(desk.folder / "project.toml"), desk.folder / "photo.tif")
    (row,) = gm.locate(scene, [[100.5, 140.25]], sigma_px=0.5).rows()
    np.testing.assert_allclose([*found["xy"], found["z"]], row[3:6], atol=1e-6)
    np.testing.assert_allclose([*found["semi_axes"], found["azimuth"], found["sigma_z"]], row[6:], rtol=1e-6)
    outline = np.array(found["outline"]) - found["xy"]
    lengths = np.hypot(*outline.T)
    np.testing.assert_allclose([lengths.max(), lengths.min()], found["semi_axes"], rtol=1e-2)
    longest = outline[lengths.argmax()]
    off = (np.degrees(np.arctan2(longest[0], longest[1])) - found["azimuth"] + 90.0) % 180.0 - 90.0
    assert abs(off) < 6.0
    back = desk.client.get(f"{ask}&x={found['xy'][0]}&y={found['xy'][1]}").json()
    np.testing.assert_allclose(back["pixel"], [100.5, 140.25], atol=1e-6)
    assert desk.client.get(f"{ask}&col=-50&row=3").json() == {"pixel": None, "xy": None}
    assert desk.client.get(f"{ask}&col=nan&row=3").status_code == 400


def test_what_lies_beyond_the_photo_is_refused_with_its_place(desk: Desk) -> None:
    roads = desk.create()
    answer = desk.edit(roads, {"id": None, "geometry": line([[10.0, 10.0], [-80.0, 10.0]])}, side="image")
    assert answer.status_code == 422
    assert "shows no known ground" in answer.json()["what"]
    assert desk.layer(roads)["features"] == []


@pytest.mark.parametrize(
    "values",
    [
        {"name": "../../etc/x"}, {"name": ""}, {"name": ".hidden"}, {"name": "a/b"}, {"name": "x" * 90},
        {"kind": "Circle"},
        {"fields": [{"name": "geom", "kind": "text"}]}, {"fields": [{"name": "a", "kind": "blob"}]},
        {"fields": [{"name": "a", "kind": "text"}, {"name": "A", "kind": "text"}]}, {"fields": "a"}, {"crs": "EPSG:1"},
    ],
)  # fmt: skip
def test_a_layer_that_cannot_be_is_refused(desk: Desk, values: dict[str, Any]) -> None:
    body = {"name": "roads", "kind": "LineString", "map_layer": desk.ids()[1], **values}
    answer = desk.client.post("/api/features/layers", json=body)
    assert answer.status_code == 422
    assert answer.json()["hint"]
    assert not list(desk.folder.glob("**/*.gpkg"))


@pytest.mark.parametrize(
    "geometry",
    [
        {"type": "Polygon", "coordinates": [[[X, Y], [X + 1, Y], [X, Y]]]},
        {"type": "LineString", "coordinates": [[X, Y]]},
        {"type": "LineString", "coordinates": [[X, Y], [X, None]]},
        {"type": "LineString", "coordinates": [[X, Y], ["a", Y]]},
        {"type": "GeometryCollection", "geometries": []}, {"type": "Point", "coordinates": [X, Y]},
        {"type": "LineString"},
        {"type": "LineString", "coordinates": {"a": 1}}, 7,
        {"type": "LineString", "coordinates": [[X, Y, 3], [X, Y, 4]]},
    ],
)  # fmt: skip
def test_a_geometry_that_is_none_of_the_layers_is_refused(desk: Desk, geometry: Any) -> None:
    roads = desk.create()
    answer = desk.edit(roads, {"id": None, "geometry": geometry})
    assert answer.status_code == 422, answer.text
    assert desk.layer(roads)["features"] == []


def test_files_that_are_no_geopackages_are_told_beside_those_that_are(desk: Desk) -> None:
    roads = desk.create()
    (desk.folder / "broken.gpkg").write_text("no database" * 99)
    state = desk.client.get("/api/features").json()
    assert [one["id"] for one in state["layers"]] == [roads]
    assert state["unreadable"][0]["file"] == "broken.gpkg"
    (desk.folder / "roads.gpkg").unlink()
    assert desk.client.get(f"/api/features/layers/{roads}").status_code == 422
    assert (
        desk.client.post(
            "/api/features/layers", json={"name": "broken", "kind": "Point", "crs": "EPSG:4326"}
        ).status_code
        == 422
    )
