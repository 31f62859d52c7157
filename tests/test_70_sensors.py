"""One mosaic of several sensors: each pixel from the image that a rule names, in its place, in the colours of all.

Photos, a line scanner's scene and an old raster of one analytic land (`sensors_rig`): bands in other orders, pixels of
2, 5 and 2.5 m, of 2024, 2019 and 1985.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import sensors_rig as rig

import geomosaic as gm
from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.jobs.project import run_project

BANDS = ("red", "green", "nir")
PIXEL = 2.5
BOUNDS = (399_650.0, 5_499_600.0, 400_700.0, 5_500_400.0)


@pytest.fixture(scope="module")
def placed(tmp_path_factory: pytest.TempPathFactory) -> rig.Sensors:
    """Pixels that say where they lie: red is east, green north, infrared height."""
    return rig.write_sensors(
        tmp_path_factory.mktemp("placed"), rig.coordinates, dtype="float32", old_bands=("green", "nir", "red")
    )


@pytest.fixture(scope="module")
def coloured(tmp_path_factory: pytest.TempPathFactory) -> rig.Sensors:
    """Colours of the land; the scene at another exposure, the old raster panchromatic."""
    return rig.write_sensors(
        tmp_path_factory.mktemp("coloured"), rig.colours, later=lambda xy: 0.7 * rig.colours(xy) + 25.0
    )


def blocks(of: rig.Sensors, **of_old: Any) -> list[gm.Block]:
    """The three sensors, scene first."""
    given = {"crs": rig.CRS, "heights": "egm96", "band_names": BANDS}
    return [
        gm.Block(of.scene, "pushbroom", band_names=BANDS, cloud_cover=3.0),
        gm.Block(
            of.photos, "frame", camera=of.folder / "camera.toml", exterior=of.folder / "exterior.csv", cloud_cover=20.0,
            **given,
        ),
        gm.Block(of.old, **{"band_names": BANDS, "acquired": "1985-07-12", "cloud_cover": 10.0, **of_old}),
    ]  # fmt: skip


def mosaic(of: rig.Sensors, out: Path, *, images: list[gm.Block] | None = None, **options: Any) -> gm.MosaicResult:
    """Mosaic over the rig's DEM, nothing balanced unless asked."""
    return gm.mosaic(
        images or blocks(of), out, dem=of.folder / "dem.tif", dem_heights="egm96", dst_crs=rig.CRS, resolution=PIXEL,
        bounds=BOUNDS, **{"balance": False, "blend": "none", "stac": False, "overwrite": True, **options},
    )  # fmt: skip


def pixels(out: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values (rows, cols, bands), labels (rows, cols), and places (rows, cols, 2) of the pixels."""
    with rasterio.open(out) as file, rasterio.open(out.with_name(f"{out.stem}-labels.tif")) as labels:
        col, row = np.meshgrid(np.arange(file.width) + 0.5, np.arange(file.height) + 0.5)
        x, y = file.transform @ (col, row)
        return np.moveaxis(file.read(), 0, 2), labels.read(1), np.dstack([x, y])


NAMES = ("IMAGERY.tif", "strip1_01.tif", "strip1_02.tif", "old.tif")
SCENE, PHOTOS, OLD = (0,), (1, 2), (3,)
# Who comes first by each order: the scene is of February 2019, the photos of July 2024, the old raster of July 1985.
ORDERS = [
    ({"order": "sensor"}, (SCENE, PHOTOS, OLD)),
    ({"order": "resolution"}, (PHOTOS, OLD, SCENE)),
    ({"order": "date"}, (PHOTOS, SCENE, OLD)),
    ({"order": "oldest"}, (OLD, SCENE, PHOTOS)),
    ({"order": "day", "day": "2018-01-01"}, (SCENE, PHOTOS, OLD)),
    ({"order": "season", "day": "12-20"}, (SCENE, OLD, PHOTOS)),
    ({"order": "season", "day": "07-11", "seams": "order"}, (OLD, PHOTOS, SCENE)),
    ({"order": "cloud", "seams": "halve"}, (SCENE, OLD, PHOTOS)),
    ({"order": "oldest", "rule": "last", "base": "IMAGERY"}, (PHOTOS, OLD, SCENE)),
]


@pytest.mark.parametrize(("options", "wanted"), ORDERS, ids=lambda value: str(value.get("order", "")) if value else "")
def test_each_pixel_comes_from_the_sensor_that_the_order_names_and_lies_true(
    options: dict[str, str], wanted: tuple[tuple[int, ...], ...], placed: rig.Sensors, tmp_path: Path
) -> None:
    """Truth within a tenth of a pixel of the image; who shows a place follows from cameras and outlines alone."""
    mosaic(placed, tmp_path / "m.tif", **options)
    values, labels, places = pixels(tmp_path / "m.tif")
    xy = places.reshape(-1, 2)
    expected = np.full(len(xy), -1)
    for rank, images in reversed(list(enumerate(wanted))):
        shown = np.any([placed.shows[NAMES[i]](xy) for i in images], axis=0)
        expected = np.where(shown, rank, expected)
    expected = expected.reshape(labels.shape)
    rank_of = np.full(len(NAMES) + 1, -1)
    for rank, images in enumerate(wanted):
        rank_of[[i + 1 for i in images]] = rank
    same = rank_of[labels] == expected
    assert all((expected == rank).sum() > 500 for rank in range(3))
    assert same.mean() > 0.99
    # Only beside the borders: a pixel whose neighbours two away are of the same image.
    inner = expected == np.roll(expected, 2, 0)
    for shift, axis in ((-2, 0), (2, 1), (-2, 1)):
        inner &= expected == np.roll(expected, shift, axis)
    assert same[inner].mean() > 0.9999
    seen = labels > 0
    off = np.hypot(*(values[..., :2] - (places - np.array(rig.GROUND.origin)))[seen].T)
    gsd = np.array([rig.SCENE_GSD, rig.PHOTO_GSD, rig.PHOTO_GSD, rig.OLD_GSD])[labels[seen] - 1]
    # Outermost pixels of an image are held at its edge.
    edge = np.percentile(off / gsd, 99.0)
    assert edge < 0.1
