"""Georeferenced images for tests of mosaics."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from affine import Affine

from geomosaic.inputs.declarations import Block
from geomosaic.mosaicking.records import MosaicResult
from geomosaic.options.inputs import Area
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.options.render import RenderOptions
from geomosaic.products.mosaics import make_mosaic

LEFT, TOP = 500_000.37, 5_500_300.11


def write(
    path: Path,
    values: np.ndarray,
    col: float = 0,
    row: float = 0,
    pixel: float = 1.0,
    crs: str = "EPSG:32633",
    descriptions: tuple[str, ...] = (),
    tags: dict[str, str] | None = None,
    corner: tuple[float, float] = (LEFT, TOP),
    **more: Any,
) -> Path:
    """Write an image (rows, cols, bands) at a place counted in its own pixels from the corner."""
    rows, cols, bands = values.shape
    place = Affine(pixel, 0.0, corner[0] + col * pixel, 0.0, -pixel, corner[1] - row * pixel)
    with rasterio.open(
        path, "w", driver="GTiff", width=cols, height=rows, count=bands, dtype=values.dtype, crs=crs, transform=place,
        **more,
    ) as file:  # fmt: skip
        file.write(values.transpose(2, 0, 1))
        for band, text in enumerate(descriptions):
            file.set_band_description(band + 1, text)
        if tags:
            file.update_tags(**tags)
    return path


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Values (rows, cols, bands) and whether they are valid (rows, cols)."""
    with rasterio.open(path) as file:
        return file.read().transpose(1, 2, 0), file.dataset_mask() > 0


def run(
    files: list[Path],
    output: Path,
    area: Area | None = None,
    threads: int = 1,
    tile: int = 2048,
    resampling: str = "bilinear",
    bands: tuple[int, ...] | None = None,
    **options: Any,
) -> MosaicResult:
    """Make a mosaic of georeferenced images."""
    # Uncompressed: what these tests judge is pixels, and a fifth of their time would go into compression.
    creation = {"COMPRESS": "NONE"}
    render = RenderOptions(overwrite=True, threads=threads, tile=tile, resampling=resampling, creation=creation)
    wanted = MosaicOptions.of(render=render, **{"balance": False, "stac": False, **options})
    return make_mosaic(Block(tuple(files), "planar", bands=bands), area or Area(), output, wanted)


def scene(rows: int, cols: int, seed: int = 0, bands: int = 3) -> np.ndarray:
    """A textured ground (rows, cols, bands), float, about 40 to 200."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:rows, 0:cols]
    base = 120 + 25 * np.sin(x / 23.0) * np.cos(y / 31.0) + 15 * np.sin((x + 2 * y) / 7.0)
    return np.clip(base[..., None] + rng.normal(0, 6, (rows, cols, bands)) + 10 * np.arange(bands), 5, 250)
