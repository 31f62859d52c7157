"""What a person has drawn, wrong: open and crossing outlines, areas of another block; and images that share nothing."""

from __future__ import annotations

import json
from pathlib import Path

import geopandas
import mosaic_rig as rig
import numpy as np
import pytest
import shapely

from geomosaic.cli.results import mosaic_text
from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.options.mosaic import BlendOptions

L, T = rig.LEFT, rig.TOP
CROSSING = [(L, T), (L + 200, T - 100), (L + 200, T), (L, T - 100)]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder, ground = tmp_path_factory.mktemp("drawn"), rig.scene(100, 200).astype(np.uint8)
    return [rig.write(folder / "a.tif", ground[:, :120]), rig.write(folder / "b.tif", ground[:, 80:], 80)]


def drawn(folder: Path, *shapes: shapely.Geometry) -> Path:
    frame = geopandas.GeoDataFrame({"image": ["a.tif"] * len(shapes)}, geometry=list(shapes), crs="EPSG:32633")
    frame.to_file(folder / "drawn.gpkg")
    return folder / "drawn.gpkg"


WAYS = {
    "mask": {"balance": True},
    "region": {"histogram": "whole"},
    "water": {},
    "cutlines": {},
    "avoid": {"seams": "graph-cut"},
    "follow": {"seams": "graph-cut"},
}


def given(way: str, path: Path) -> dict[str, object]:
    return {**WAYS[way], way: (path,) if way in ("avoid", "follow") else path}


@pytest.mark.parametrize("way", WAYS)
def test_an_outline_that_does_not_close_or_crosses_itself(files: list[Path], tmp_path: Path, way: str) -> None:
    ring = [(L, T), (L + 200, T), (L + 200, T - 100), (L, T - 100)]
    geometries = [[[*ring, ring[0]]], [ring]]
    features = [
        {"type": "Feature", "properties": {"image": "a.tif"}, "geometry": {"type": "Polygon", "coordinates": g}}
        for g in geometries
    ]
    crs = {"type": "name", "properties": {"name": "EPSG:32633"}}
    path = tmp_path / "open.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "crs": crs, "features": features}))
    with pytest.raises(InputError, match="row 2 is no geometry") as told:
        rig.run(files, tmp_path / "out.tif", **given(way, path))
    assert told.value.hint is not None
    assert "close" in told.value.hint
    path = drawn(tmp_path, shapely.box(L, T - 50, L + 50, T), shapely.Polygon(CROSSING))
    with pytest.raises(InputError, match="row 2 is no valid area"):
        rig.run(files, tmp_path / "out.tif", **given(way, path))


@pytest.mark.parametrize("way", WAYS)
def test_areas_of_another_block(files: list[Path], tmp_path: Path, way: str) -> None:
    path = drawn(tmp_path, shapely.box(L + 5000, T - 50, L + 5050, T))
    if way in ("region", "cutlines"):  # without them something else than asked for would come out
        with pytest.raises(InputError, match="another block"):
            rig.run(files, tmp_path / "out.tif", **given(way, path))
    else:
        with pytest.warns(GeomosaicWarning, match="nothing in this file reaches the mosaic"):
            rig.run(files, tmp_path / "out.tif", **given(way, path))


def test_images_that_share_nothing_are_reported(files: list[Path], tmp_path: Path) -> None:
    ground = rig.scene(100, 120, 3).astype(np.uint8)
    apart = rig.write(tmp_path / "apart.tif", ground, 200)
    made = rig.run([files[0], apart], tmp_path / "out.tif", balance=True)
    assert "no colour is changed" in mosaic_text(made)
    made = rig.run([*files, apart], tmp_path / "out.tif", balance=True)
    assert "have its colour compared with theirs: apart.tif" in mosaic_text(made)
    made = rig.run(files, tmp_path / "out.tif", balance=True)
    assert "compared" not in mosaic_text(made)


@pytest.mark.parametrize("way", ["both", "one over the other", "one away from the other"])
def test_a_border_moved_on_one_side_only_is_reported(files: list[Path], tmp_path: Path, way: str) -> None:
    """Layers of shares: a to column 90 and b beyond; b moved over a without a, or away from it."""
    ends = {"both": (110, 110), "one over the other": (90, 85), "one away from the other": (90, 110)}[way]
    a, b = shapely.box(L, T - 100, L + ends[0], T), shapely.box(L + ends[1], T - 100, L + 200, T)
    frame = geopandas.GeoDataFrame({"image": ["a.tif", "b.tif"]}, geometry=[a, b], crs="EPSG:32633")
    frame.to_file(tmp_path / "drawn.gpkg", layer="seams")
    given = {"cutlines": tmp_path / "drawn.gpkg", "blending": BlendOptions("none")}
    if way == "both":
        rig.run(files, tmp_path / "out.tif", **given)
        label = rig.read(tmp_path / "out-labels.tif")[0][..., 0]
        assert (label[:, :110] == 1).all()
        assert (label[:, 110:] == 2).all()
        return
    said = "overlap by 500 square map units, which 'a.tif' shows" if "over" in way else "leave 2000 square map units"
    with pytest.warns(GeomosaicWarning, match=said):
        rig.run(files, tmp_path / "out.tif", **given)
