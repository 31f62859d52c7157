"""Overview of files that lie side by side: one small raster of them all, from their own overviews.

A program that shows the whole would open each file. The virtual raster over them names this one in their place.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import rasterio
from rasterio.enums import ColorInterp, Resampling
from rasterio.errors import RasterioError
from rasterio.windows import Window as Part

from geomosaic.geo.grid import Grid, Window
from geomosaic.raster.cog.codec import OVERVIEWS
from geomosaic.raster.environment import environment
from geomosaic.raster.info import open_raster
from geomosaic.types import AnyArray
from geomosaic.whole_files import under_construction

# The longer side of an overview is shorter than this, in pixels, as far as the tiles' own overviews reach.
_LARGEST = 4096
_BLOCK = 512


def overview_factor(grid: Grid, files: Mapping[Path, Window], most: int) -> int:
    """Pixels of a whole along one of its overview: a power of 2 that its files have overviews of; 1 for none.

    Parameters
    ----------
    grid : Grid
        Of the whole.
    files : mapping of Path to Window
        By their place, whose columns and rows begin at multiples of `most`.
    most : int
        The largest factor.
    """
    largest = max(files, key=lambda path: files[path].width * files[path].height)
    with environment(), open_raster(largest) as tile:
        levels = [level for level in tile.overviews(1) if level & (level - 1) == 0 and level <= most]
    enough = [level for level in levels if max(grid.width, grid.height) <= level * _LARGEST]
    return min(enough, default=max(levels, default=1))


def write_overview(
    path: Path, grid: Grid, files: Mapping[Path, Window], factor: int, *, categorical: bool = False
) -> None:
    """Overview of the whole (GeoTIFF with overviews of its own); where files have masks its last band is alpha.

    Parameters
    ----------
    path : Path
        An existing file is replaced.
    grid : Grid
        Of the whole.
    files : mapping of Path to Window
        By their place, of one form; their columns and rows begin at multiples of `factor`.
    factor : int
        See `overview_factor`.
    categorical : bool
        Values are labels: they are picked, not averaged.

    Raises
    ------
    OutputError
        The disk is full.
    """
    small = grid.coarser(factor)
    with environment(), open_raster(next(iter(files))) as first:
        form = {"dtype": first.dtypes[0], "count": first.count + (first.nodata is None), "nodata": first.nodata}
        colours, names = list(first.colorinterp), list(first.descriptions)
        mean = Resampling.rms if first.tags().get(OVERVIEWS) == "RMS" else Resampling.average
    alpha = form["nodata"] is None
    profile = {
        **form, "driver": "GTiff", "width": small.width, "height": small.height, "crs": grid.crs.to_wkt(),
        "transform": small.transform, "tiled": True, "blockxsize": _BLOCK, "blockysize": _BLOCK, "compress": "deflate",
    }  # fmt: skip
    method = Resampling.nearest if categorical else mean
    with (
        environment(),
        under_construction(path, ".tif", (RasterioError,)) as unfinished,
        rasterio.open(unfinished, "w", **profile) as raster,
    ):
        raster.colorinterp = [*colours, *[ColorInterp.alpha] * alpha]
        for number, name in enumerate(names, start=1):
            raster.set_band_description(number, name or "")
        for file, window in files.items():
            values = _reduced(file, window, factor, method)
            col, row = window.col // factor, window.row // factor
            raster.write(values, window=Part(col, row, values.shape[2], values.shape[1]))
        sides = max(small.width, small.height)
        levels = [level for level in (2, 4, 8, 16, 32, 64) if sides > _BLOCK * level // 2]
        if levels:
            raster.build_overviews(levels, method)


def _reduced(path: Path, window: Window, factor: int, method: Resampling) -> AnyArray:
    """Bands of a file at a factor, and behind them whether they are valid where the file has a mask."""
    with open_raster(path) as whole:
        levels = whole.overviews(1)
    # Level n is what GDAL counts from 0. A file at the edge may be too small to have it.
    own = levels.index(factor) if factor in levels else None
    shape = -(-window.height // factor), -(-window.width // factor)
    with open_raster(path, overview=own) as tile:
        values = tile.read(out_shape=(tile.count, *shape), resampling=method)
        if tile.nodata is not None:
            return np.asarray(values)
        valid = tile.dataset_mask(out_shape=shape)
    full = np.iinfo(values.dtype).max if values.dtype.kind in "iu" else 1.0
    return np.concatenate([values, np.where(valid != 0, full, 0).astype(values.dtype)[None]])
