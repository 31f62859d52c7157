"""Damaged metadata of rasters and vectors: an error that names the file, and nothing that is no number goes further."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from PIL import Image

from geomosaic.errors import InputError, RasterReadError
from geomosaic.geo.crs import parse_crs
from geomosaic.raster.info import inspect
from geomosaic.raster.vector import Layer, read_layer, write_layers

CRS = parse_crs("EPSG:32633")


@pytest.mark.parametrize(
    "text",
    ["1e308\n0\n0\n-1e308\n1e308\n1e308\n", "nan\n0\n0\n-1\n5\n5\n", f"{'1' * 4000}\n0\n0\n-1\n5\n5\n"],
    ids=["too large", "no number", "too long"],
)
def test_a_world_file_of_no_place_is_refused(tmp_path: Path, text: str) -> None:
    image = tmp_path / "a.jpg"
    Image.new("L", (20, 20)).save(image)
    image.with_suffix(".jgw").write_text(text)
    with pytest.raises(RasterReadError) as caught:
        inspect(image)
    assert caught.value.where == str(image)
    assert "world file" in str(caught.value.hint)


def test_a_crs_of_bytes_that_are_no_text_is_refused(tmp_path: Path) -> None:
    import rasterio

    image = tmp_path / "a.tif"
    with rasterio.open(
        image, "w", driver="GTiff", width=20, height=20, count=1, dtype="uint8",
        crs='LOCAL_CS["hall of a museum",UNIT["metre",1]]', transform=rasterio.Affine(1, 0, 5, 0, -1, 5),
    ) as target:  # fmt: skip
        target.write(np.ones((1, 20, 20), np.uint8))
    data = image.read_bytes()
    assert b"hall of a museum" in data
    image.write_bytes(data.replace(b"hall of", b"h\xe4ll \xff\xfe"))
    with pytest.raises(RasterReadError, match="utf-8") as caught:
        inspect(image)
    assert caught.value.where == str(image)


@pytest.mark.parametrize("lost", [np.nan, np.inf])
def test_a_vector_with_a_coordinate_that_is_not_finite_is_refused_by_row(tmp_path: Path, lost: float) -> None:
    sound = shapely.box(0, 0, 1, 1)
    with np.errstate(invalid="ignore"):
        damaged = shapely.linestrings([[0.0, 0.0], [lost, 1.0], [2.0, 2.0]])
    file = write_layers(tmp_path / "a.gpkg", {"l": Layer(CRS, "LineString", [sound.exterior, damaged], {})})
    with pytest.raises(InputError, match="row 2 has a coordinate that is not finite") as caught:
        read_layer(file)
    assert caught.value.where == f"{file}, layer l"
