"""Water is shown by the image that glints least."""

from __future__ import annotations

from pathlib import Path

import mosaic_rig as rig
import numpy as np
import pytest
import shapely

from geomosaic.errors import InputError
from geomosaic.geo.crs import parse_crs
from geomosaic.options.mosaic import BlendOptions
from geomosaic.raster.vector import Layer, write_layers


def lake(folder: Path, geometry: object, kind: str = "Polygon") -> Path:
    path = folder / "water.gpkg"
    write_layers(path, {"water": Layer(parse_crs("EPSG:32633"), kind, [geometry], {"id": [1]})}, overwrite=True)
    return path


def test_a_lake_is_shown_by_the_image_without_glint(tmp_path: Path) -> None:
    """Both images show the lake whole, halfway between them; the first has the sun in a third of it."""
    ground = rig.scene(200, 400)
    rows, cols = np.mgrid[0:200, 0:400]
    water = (cols >= 150) & (cols < 250) & (rows >= 60) & (rows < 140)
    ground[water] = 40
    first, second = ground[:, :300].copy(), ground[:, 100:].copy()
    first[(water & (cols < 185))[:, :300]] = 230
    files = [rig.write(tmp_path / f"{i}.tif", v.astype(np.uint8), 100 * i) for i, v in enumerate((first, second))]
    shape = shapely.box(rig.LEFT + 150, rig.TOP - 140, rig.LEFT + 250, rig.TOP - 60)
    out = tmp_path / "out.tif"
    rig.run(files, out, blending=BlendOptions("none"))
    assert rig.read(out)[0][100, 170, 0] == 230
    rig.run(files, out, blending=BlendOptions("none"), water=lake(tmp_path, shape))
    values, labels = rig.read(out)[0], rig.read(tmp_path / "out-labels.tif")[0][..., 0]
    assert (values[water] == 40).all()
    assert (labels[water] == 2).all()
    assert labels[30, 170] == 1
    with pytest.raises(InputError, match="is a Point, not an area"):
        rig.run(files, out, water=lake(tmp_path, shapely.Point(rig.LEFT, rig.TOP), "Point"))


def test_a_tone_fits_the_shores_and_knows_no_glint(tmp_path: Path) -> None:
    """Water gets brighter eastwards, both images have the sun in it at the same place: no image is without glint."""
    ground = rig.scene(200, 400)
    rows, cols = np.mgrid[0:200, 0:400]
    water = (cols >= 150) & (cols < 250) & (rows >= 60) & (rows < 140)
    slope = 40 + 0.3 * (cols - 150)
    ground[water] = np.round(slope)[water][:, None]
    clean = ground.copy()
    sun = water & (np.hypot(cols - 200, rows - 100) < 25)
    ground[sun] = 240
    parts = ground[:, :300], ground[:, 100:]
    files = [rig.write(tmp_path / f"{i}.tif", v.astype(np.uint8), 100 * i) for i, v in enumerate(parts)]
    file = lake(tmp_path, shapely.box(rig.LEFT + 150, rig.TOP - 140, rig.LEFT + 250, rig.TOP - 60))
    out = tmp_path / "out.tif"
    rig.run(files, out, blending=BlendOptions("none"))
    plain = rig.read(out)[0]
    rig.run(files, out, blending=BlendOptions("none"), water=file, water_fill="tone")
    values = rig.read(out)[0].astype(float)
    assert np.abs(values - clean)[water].max() < 4
    np.testing.assert_array_equal(values[~water], plain[~water])
    assert np.abs(np.diff(values[100, 155:245, 0])).max() <= 1  # continuous
    with pytest.raises(InputError, match="would do nothing without"):
        rig.run(files, out, water_fill="tone")
