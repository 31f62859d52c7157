"""Digitizing in the studio: features on the map and in a photo, their files, and what others do to them."""

from __future__ import annotations

import shutil
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
from digitizing_rig import digitizing_project, line, pixels_of, road
from reference_rig import ORIGIN
from starlette.testclient import TestClient
from studio_rig import owner

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
    print("between", apart.max(), "vertices", ends.max(), len(kept))
    assert apart.max() < 0.15
    assert ends.max() < 0.1  # the DEM's own interpolation


def test_a_road_drawn_on_the_map_is_shown_where_the_photo_sees_it(desk: Desk) -> None:
    made = desk.drawn(desk.create(), line(road()))
    pieces = [shapely.geometry.shape(one["geometry"]) for one in made["drawn"] if not one["hidden"]]
    along = shapely.get_coordinates(shapely.LineString(road()).segmentize(2.0))
    apart = shapely.distance(shapely.points(pixels_of(desk.camera, along)), shapely.union_all(pieces))
    print("shown", apart.max())
    assert apart.max() < 0.15
    vertices = shapely.get_coordinates(shapely.geometry.shape(made["image"]))
    assert np.abs(vertices - pixels_of(desk.camera, road())).max() < 0.15
