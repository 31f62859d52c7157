"""Vector layers written and read."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from pyproj import CRS
from raster_rig import digest

from geomosaic.errors import InputError, OutputExistsError


def test_vector_layers_come_back_as_written(tmp_path, monkeypatch):
    import shapely

    from geomosaic.raster.vector import Layer, read_layer, write_layers

    box, crs = shapely.box(0, 0, 1, 1), CRS.from_epsg(32633)
    columns = {"name": ["é", "b"], "number": [1, 2], "size": [0.5, np.nan], "whole": [True, False]}
    layers = {
        "first": Layer(crs, "Polygon", [box, box], columns),
        "second": Layer(crs, "MultiPolygon", [box], {"name": ["é"]}),
        "none": Layer(crs, "MultiLineString", [], {"name": []}),
    }
    one = write_layers(tmp_path / "one.gpkg", layers)
    two = write_layers(tmp_path / "two.gpkg", layers)
    assert digest(one) == digest(two)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["one.gpkg", "two.gpkg"]
    frame = read_layer(one)
    assert len(frame) == 2
    assert frame["name"].tolist() == ["é", "b"]
    assert frame["number"].tolist() == [1, 2]
    assert frame["whole"].tolist() == [True, False]
    assert frame.geometry[0].equals(box)
    assert read_layer(one, "second").crs.to_epsg() == 32633
    assert read_layer(one, "second").geom_type[0] == "MultiPolygon"
    assert len(read_layer(one, "none")) == 0
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    assert digest(write_layers(two, layers, overwrite=True)) != digest(one)
    with pytest.raises(OutputExistsError):
        write_layers(one, layers)
    with pytest.raises(InputError, match="first, second, none"):
        read_layer(one, "third")
    with pytest.raises(InputError, match="does not exist"):
        read_layer(tmp_path / "none.gpkg")
    (tmp_path / "bad.gpkg").write_text("nothing")
    with pytest.raises(InputError, match="not a vector file"):
        read_layer(tmp_path / "bad.gpkg")


def test_a_small_layer_takes_no_room_for_the_most_rows_that_are_read(tmp_path):
    import shapely

    from geomosaic.raster.vector import Layer, read_layer, write_layers

    layer = Layer(CRS.from_epsg(32633), "Polygon", [shapely.box(0, 0, 1, 1)] * 2, {"name": ["a", "b"]})
    path = write_layers(tmp_path / "two.gpkg", {"areas": layer})
    read_layer(path)  # imports count elsewhere
    tracemalloc.start()
    try:
        assert len(read_layer(path, "areas")) == 2
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()
