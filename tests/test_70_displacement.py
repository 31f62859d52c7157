"""Relief displacement against the textbooks' d = r · h / H, of two vertical photos over an inclined plane."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from city_rig import CORNER, FOCAL, SIZE, write_image

from geomosaic.errors import InputError
from geomosaic.inputs.declarations import Block
from geomosaic.options.inputs import Area
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.products.mosaics import make_mosaic

CENTRES = np.array([[120.0, 160.0, 420.0], [220.0, 160.0, 420.0]])
LEVEL, PIXEL = 5.0, 2.0
BOUNDS = (CORNER[0], CORNER[1], CORNER[0] + 320.0, CORNER[1] + 320.0)


def height(x, y):
    """Metres over the datum, places from the corner."""
    return 12.0 + 0.05 * x - 0.03 * y


@pytest.fixture
def block(tmp_path: Path) -> Block:
    rows = ["image,x,y,z,omega,phi,kappa"]
    for number, (x, y, z) in enumerate(CENTRES):
        write_image(tmp_path / f"p{number}.tif", np.full(SIZE[::-1], 100.0))
        rows.append(f"p{number},{CORNER[0] + x},{CORNER[1] + y},{z},0,0,0")
    (tmp_path / "exterior.csv").write_text("\n".join(rows))
    c = (np.arange(100) + 0.5) * 4.0 - 40.0
    x, y = np.meshgrid(c, c[::-1])
    profile = {"driver": "GTiff", "width": 100, "height": 100, "count": 1, "dtype": "float32", "crs": "EPSG:32633"}
    place = Affine(4.0, 0.0, CORNER[0] - 40.0, 0.0, -4.0, CORNER[1] + 360.0)
    with rasterio.open(tmp_path / "dem.tif", "w", **profile, transform=place) as dem:
        dem.write(height(x, y).astype(np.float32), 1)
    options = {"camera": {"focal_length_px": FOCAL}, "treatment": "planar"}
    return Block(
        tuple(tmp_path / f"p{i}.tif" for i in range(2)), "frame", options=options, exterior=tmp_path / "exterior.csv",
        crs="EPSG:32633", heights="ellipsoidal", dem=tmp_path / "dem.tif", dem_heights="ellipsoidal",
    )  # fmt: skip


def test_displacement_is_that_of_the_textbooks(block: Block, tmp_path: Path) -> None:
    options = MosaicOptions.of(balance=False, displacement=LEVEL)
    make_mosaic(block, Area(None, PIXEL, BOUNDS), tmp_path / "m.tif", options)
    assets = json.loads((tmp_path / "m.stac.json").read_text())["assets"]
    assert assets["displacement"]["href"] == "./m-displacement.tif"
    with (
        rasterio.open(tmp_path / "m-displacement.tif") as raster,
        rasterio.open(tmp_path / "m-labels.tif") as labels,
    ):
        col, row, metres = raster.read()
        label = labels.read(1)
        assert raster.descriptions[2] == "on level ground, metres"
    centres = (np.arange(160) + 0.5) * PIXEL
    x, y = np.meshgrid(centres, centres[::-1])
    seen = 0
    for number, (cx, cy, cz) in enumerate(CENTRES, start=1):
        here = label == number
        h, over = height(x, y)[here] - LEVEL, cz - LEVEL
        # r of the image as it is; away from the nadir point where h > 0.
        image = np.stack([x[here] - cx, cy - y[here]]) * FOCAL / (over - h)
        np.testing.assert_allclose(np.stack([col[here], row[here]]), image * h / over, atol=2e-3)
        ground = np.hypot(x[here] - cx, y[here] - cy)
        np.testing.assert_allclose(metres[here], ground * np.abs(h) / (over - h), atol=2e-3)
        seen += int(here.sum())
        assert np.hypot(col[here], row[here]).max() > 5
    assert seen == label.size
    assert np.isfinite(metres).all()


def test_displacement_needs_labels() -> None:
    with pytest.raises(InputError, match="without `labels`"):
        MosaicOptions.of(labels=False, displacement=0.0)
