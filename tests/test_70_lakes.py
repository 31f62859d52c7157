"""Water proposed from a mosaic and a DEM: the lake that is there, and nothing where there is none."""

from __future__ import annotations

import json
from pathlib import Path

import geopandas
import mosaic_rig as rig
import numpy as np
import pytest
import shapely
from affine import Affine
from click.testing import CliRunner
from rasterio.features import rasterize

from geomosaic.cli.main import cli
from geomosaic.errors import InputError
from geomosaic.mosaicking.water_proposal import propose_water
from geomosaic.options.mosaic import BlendOptions

SIZE = 400
LEVEL = 112.0


def relief(noise: float, seed: int = 0) -> np.ndarray:
    """Hills of 100 to 150 m with a terrace that is nearly level, at pixel centres 1 m apart."""
    y, x = np.mgrid[0:SIZE, 0:SIZE] + 0.5
    hills = 125 + 18 * np.sin(x / 60) * np.cos(y / 75) + 7 * np.sin((x + y) / 90)
    terrace = np.hypot(x - 320, y - 60) < 45
    hills[terrace] = 140 + 0.002 * (x - 320)[terrace]  # an even field on it is level, but not low
    return hills + np.random.default_rng(seed).normal(0, noise, hills.shape)


def scene(lake: bool, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Picture, heights and where water truly is."""
    rng, heights = np.random.default_rng(7), relief(0.0)
    water = (heights < LEVEL) & lake
    picture = rig.scene(SIZE, SIZE, 5)
    y, x = np.mgrid[0:SIZE, 0:SIZE]
    field = np.hypot(x - 320, y - 60) < 40
    picture[field] = (95, 130, 80)
    asphalt = (np.abs(y - 200 - 20 * np.sin(x / 50)) < 6) & ~water
    picture[asphalt] = (90, 92, 95)
    picture[water] = (45, 60, 55) + 6 * np.sin(x[water] / 40)[:, None]
    if lake:
        r, c = np.argwhere(water).mean(axis=0)
        picture[np.hypot(y - r, x - c) < 7] = 235  # glint
    heights = np.where(water, LEVEL, heights) + rng.normal(0, noise, heights.shape)
    return np.clip(picture + rng.normal(0, 1.5, picture.shape), 1, 255).astype(np.uint8), heights, water


def files(folder: Path, lake: bool, noise: float, step: int = 2) -> tuple[Path, Path, np.ndarray]:
    picture, heights, water = scene(lake, noise)
    nodes = heights.reshape(SIZE // step, step, SIZE // step, step).mean(axis=(1, 3))
    image = rig.write(folder / "image.tif", picture)
    dem = rig.write(folder / "dem.tif", nodes[..., None].astype(np.float32), pixel=float(step))
    return image, dem, water


def proposed(path: Path) -> tuple[geopandas.GeoDataFrame, np.ndarray]:
    frame = geopandas.read_file(path, layer="water")
    place = Affine(1.0, 0.0, rig.LEFT, 0.0, -1.0, rig.TOP)
    burnt = rasterize(list(frame.geometry), (SIZE, SIZE), transform=place) if len(frame) else np.zeros((SIZE, SIZE))
    return frame, burnt > 0


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_the_lakes_that_are_there_and_nothing_else(tmp_path: Path, noise: float) -> None:
    """By area: water that is found, and land that is taken for water."""
    image, dem, water = files(tmp_path, True, noise)
    made = propose_water(image, dem, tmp_path / "water.gpkg", dem_heights="egm96")
    frame, found = proposed(tmp_path / "water.gpkg")
    both, either = (found & water).sum(), (found | water).sum()
    assert both / either > 0.93, f"{both / either:.3f} of the area in common, {len(frame)} pieces"
    r, c = (int(v) for v in np.argwhere(water).mean(axis=0))
    assert not water[r, c] or found[r, c], "glint is a hole"
    assert np.allclose(frame["level"], LEVEL, atol=0.02)
    assert (frame["rise"] > 0.2).all()
    assert made.areas == pytest.approx(shapely.area(frame.geometry))
    assert list(frame["area"]) == sorted(frame["area"], reverse=True)


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_nothing_where_no_water_is(tmp_path: Path, noise: float) -> None:
    """The same hills, with an even field on a terrace and a road, and no lake."""
    image, dem, _ = files(tmp_path, False, noise)
    assert propose_water(image, dem, tmp_path / "water.gpkg", dem_heights="egm96").areas == ()
    frame, _ = proposed(tmp_path / "water.gpkg")
    assert len(frame) == 0
    # An empty proposal can be given back.
    with pytest.warns(UserWarning, match="nothing in this file"):
        rig.run([image], tmp_path / "out.tif", water=tmp_path / "water.gpkg")


def test_what_is_proposed_goes_into_a_mosaic(tmp_path: Path) -> None:
    image, dem, _ = files(tmp_path, True, 0.0)
    out = tmp_path / "water.gpkg"
    wanted = ["water", str(image), "--dem", str(dem), "--dem-heights", "egm96", "-o", str(out), "--json"]
    told = CliRunner().invoke(cli, wanted)
    assert told.exit_code == 0, told.output
    assert json.loads(told.output)["areas_m2"]
    _, found = proposed(out)
    mosaic = tmp_path / "out.tif"
    rig.run([image], mosaic, water=out, water_fill="tone", blending=BlendOptions("none"))
    before, after = rig.read(image)[0], rig.read(mosaic)[0]
    assert before[found].max() > 200
    assert after[found].max() < 130


def test_what_cannot_be_looked_at(tmp_path: Path) -> None:
    image, dem, _ = files(tmp_path, True, 0.0)
    with pytest.raises(InputError, match="GeoPackage"):
        propose_water(image, dem, tmp_path / "water.shp", dem_heights="egm96")
    far = rig.write(tmp_path / "far.tif", np.zeros((50, 50, 1), np.float32), 9000)
    with pytest.raises(InputError, match="no height where the image"):
        propose_water(image, far, tmp_path / "water.gpkg", dem_heights="egm96")
