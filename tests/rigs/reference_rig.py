"""A photo with a known orientation, and a reference of the same land in another season."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from affine import Affine
from pyproj import CRS
from scipy.ndimage import gaussian_filter, map_coordinates, spline_filter

import geomosaic as gm
from geomosaic.geo.crs import with_heights
from geomosaic.testing.synthetic.block import PlainCamera
from geomosaic.testing.synthetic.ground import AnalyticGround
from geomosaic.testing.synthetic.photo import render

UTM = CRS("EPSG:32633")
ORIGIN = (400_000.0, 5_500_000.0)
GROUND = AnalyticGround(with_heights(UTM, "ellipsoidal"), ORIGIN, wavelength=4.0)
CAMERA = {"size": [320, 240], "focal_length": 100.0, "sensor_size": [48.0, 36.0]}
# Metres of a pixel of the photo at the base height.
PIXEL = 1.8
POSITION = (ORIGIN[0] + 30.0, ORIGIN[1] - 40.0, GROUND.base + PIXEL * 1000.0 * 2 / 3)
ANGLES = (1.5, -2.0, 40.0)


# Grey values of the land, metres apart: coarse patches and fine ones, smooth enough for cubic interpolation.
STEP, SIDE = 3.0, 512
_NOISE = np.random.default_rng(5).normal(size=(SIDE, SIDE))
_GREY = sum(gaussian_filter(_NOISE, s, mode="wrap") * s**1.2 for s in (1.2, 4.0, 12.0))
_GREY = spline_filter(0.5 + 0.16 * _GREY / _GREY.std(), mode="grid-wrap")


def land(xy: np.ndarray) -> np.ndarray:
    """Grey (N,), about 0 to 1."""
    place = (xy - ORIGIN)[:, ::-1].T / STEP + SIDE / 2
    return map_coordinates(_GREY, place, order=3, mode="grid-wrap", prefilter=False)


def write_raster(path: Path, values: np.ndarray, transform: Affine, crs: CRS = UTM, **more: Any) -> Path:
    bands = values[None] if values.ndim == 2 else np.moveaxis(values, -1, 0)
    profile = {
        "driver": "GTiff",
        "dtype": bands.dtype,
        "count": len(bands),
        "transform": transform,
    }
    with rasterio.open(
        path, "w", height=bands.shape[1], width=bands.shape[2], crs=crs.to_wkt(), **profile, **more
    ) as file:
        file.write(bands)
    return path


def picture(grid: gm.Grid, *, season: bool = False, seed: int = 0) -> np.ndarray:
    """The land on a grid, uint8; of another season with other contrast, blurred, noisy and changed in places."""
    rows, cols = grid.shape
    c, r = np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5)
    grey = land(grid.xy(np.column_stack([c.ravel(), r.ravel()]))).reshape(rows, cols).astype(np.float64)
    if season:
        random = np.random.default_rng(seed)
        changed = gaussian_filter(random.normal(size=grey.shape), 25.0)
        grey = np.where(changed > 1.2 * changed.std(), 0.5 + 3.0 * gaussian_filter(changed, 2.0), grey)
        grey = gaussian_filter(0.75 * np.maximum(grey, 0.0) ** 0.7 + 0.1, 0.7) + random.normal(0.0, 0.012, grey.shape)
    return np.clip(np.rint(255.0 * grey), 1, 255).astype(np.uint8)


def reference(folder: Path, *, half: int = 450, pixel: float = 2.0, season: bool = True, shift: float = 0.0) -> Path:
    """Ortho of the land about the origin; `shift` metres off to the east."""
    grid = gm.Grid.from_bounds(UTM, (ORIGIN[0] - half, ORIGIN[1] - half, ORIGIN[0] + half, ORIGIN[1] + half), pixel)
    moved = grid.transform @ Affine.translation(shift / pixel, 0.0)
    return write_raster(folder / f"reference{season}{shift:g}.tif", picture(grid, season=season), moved)


def photo(folder: Path) -> tuple[Path, PlainCamera]:
    """Photo of the land, and its camera."""
    camera = PlainCamera(CAMERA, GROUND.crs, POSITION, ANGLES)
    values = render(camera, GROUND, texture=lambda _, xyz: land(xyz[:, :2])[:, None], noise=1.0 / 255.0)
    path = folder / "photo.tif"
    with rasterio.open(
        path, "w", driver="GTiff", height=values.shape[0], width=values.shape[1], count=1, dtype="uint8"
    ) as file:
        file.write(np.moveaxis(values, -1, 0))
    return path, camera


def dem(folder: Path) -> Path:
    """Heights of the land, every 4 metres."""
    grid = gm.Grid.from_bounds(UTM, (ORIGIN[0] - 900, ORIGIN[1] - 900, ORIGIN[0] + 900, ORIGIN[1] + 900), 4.0)
    c, r = np.meshgrid(np.arange(grid.width) + 0.5, np.arange(grid.height) + 0.5)
    z = GROUND.height(grid.xy(np.column_stack([c.ravel(), r.ravel()]))).reshape(grid.shape)
    return write_raster(folder / "dem.tif", z.astype(np.float32), grid.transform)


def block(path: Path, heights: Path, moved: tuple[float, ...] = (0.0,) * 6) -> gm.Block:
    """Block of the photo, its position (metres) and angles (degrees) moved."""
    position = [a + b for a, b in zip(POSITION, moved[:3], strict=True)]
    names = ("omega", "phi", "kappa")
    angles = {name: a + b for name, a, b in zip(names, ANGLES, moved[3:], strict=True)}
    return gm.Block(
        path, "frame", camera=gm.Camera(**CAMERA), crs="EPSG:32633", heights="ellipsoidal", dem=heights,
        dem_heights="ellipsoidal", options={"position": position, "orientation": {"system": "opk", **angles}},
    )  # fmt: skip
