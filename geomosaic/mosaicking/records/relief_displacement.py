"""Relief displacement: how far each pixel's source shows it from its place on level ground.

For a vertical photo that is the textbooks' d = r · h / H: r the distance of the image from the nadir point, h the
height above level ground, H the flying height above it. For a scanner it lies across the flight alone. Both, and
every other sensor's, are the difference of one map: image(x, y, z) − image(x, y, level).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.mosaicking.records.provenance import NODES, TILE, view_raster
from geomosaic.options.render import RenderOptions
from geomosaic.raster.sink import RasterSink
from geomosaic.raster.source import Source
from geomosaic.render.photo import Photo
from geomosaic.render.photos import Photos
from geomosaic.render.workers import in_order
from geomosaic.types import AnyArray, FloatArray

BANDS = ("columns, pixels of the image", "rows, pixels of the image", "on level ground, metres")
# Chebyshev nodes of four heights, and the matrix from values there to the coefficients of a cubic.
_LEVELS = np.cos((2 * np.arange(4) + 1) * np.pi / 8)
_TO_CUBIC = np.linalg.inv(np.vander(_LEVELS, 4, increasing=True))


def write_displacement(path: Path, labels: Path, photos: Photos, level: float, options: RenderOptions) -> None:
    """Raster of the relief displacement of each pixel in its main source; NaN without source or height.

    Parameters
    ----------
    path : Path
        Three bands of float32: columns and rows in pixels of the source, and metres on level ground.
    labels : Path
        Raster of source images.
    photos : Photos
    level : float
        Height of level ground, metres in the surface's datum.
    options : RenderOptions
    """
    grid = photos.grid
    units = grid.window.split(TILE, TILE)

    def one(window: Window) -> AnyArray:
        label = source.read(window)[0][..., 0]
        found = np.full((*label.shape, len(BANDS)), np.nan, dtype=np.float32)
        z = _heights(photos, grid, window)
        for number in np.unique(label[(label > 0) & (label <= len(photos))]).tolist():
            here = label == number
            with photos.using(number - 1) as photo:
                found[here] = displacement(photo, photos, grid, window, z, level)[here]
        return found

    with (
        Source(str(labels)) as source,
        RasterSink(
            path, grid, len(BANDS), "float32", nodata=float("nan"), descriptions=BANDS, driver=options.driver,
            overwrite=options.overwrite, threads=options.threads,
        ) as sink,
    ):  # fmt: skip
        for done, (window, values) in enumerate(in_order(one, units, options.threads)):
            sink.write(window, values, np.isfinite(values[..., 0]).view(np.uint8), blank=False)
            options.report(done + 1, len(units), "displacement")
        sink.finish()


def displacement(
    photo: Photo, photos: Photos, grid: Grid, window: Window, z: FloatArray, level: float, nodes: int = NODES
) -> FloatArray:
    """Relief displacement of one image over a window of a grid.

    At nodes the image position is a cubic in height, and between them its coefficients are interpolated. On the ground
    it is the length of the line of sight between both heights in plan, |z − level| · tan(view angle).

    Parameters
    ----------
    photo : Photo
    photos : Photos
    grid : Grid
    window : Window
        Of the grid.
    z : array (rows, cols)
        Metres in the surface's datum; NaN where unknown.
    level : float
        Height of level ground, metres in the same datum.
    nodes : int
        Along each side of the window.

    Returns
    -------
    array (rows, cols, 3)
        Columns and rows in pixels of the image, and metres on level ground; 0 for a model without heights.
    """
    from scipy.ndimage import map_coordinates

    known = z[np.isfinite(z)]
    shape = window.height, window.width
    if not photo.mapper.uses_heights or not known.size:
        return np.zeros((*shape, 3)) if not photo.mapper.uses_heights else np.full((*shape, 3), np.nan)
    # The cubic must hold at both heights that are subtracted, so its range takes in the level as well.
    low, high = min(float(known.min()), level), max(float(known.max()), level)
    middle, half = (low + high) / 2, max((high - low) / 2, 1.0)
    cols, rows = (np.linspace(0, size, nodes) for size in (window.width, window.height))
    c, r = np.meshgrid(window.col + cols, window.row + rows)
    xy = photo.mapper.surface_xy(grid.xy(np.column_stack([c.ravel(), r.ravel()])))
    heights = np.repeat(middle + half * _LEVELS, len(xy))
    image = photo.mapper.image(np.concatenate([xy] * 4), heights).reshape(4, nodes, nodes, 2)
    cubic = np.einsum("pl,lrca->parc", _TO_CUBIC, image)
    places = np.meshgrid(*((np.arange(size) + 0.5) / size * (nodes - 1) for size in shape), indexing="ij")
    t, zero = (z - middle) / half, (level - middle) / half
    found = np.zeros((*shape, 3))
    for power in (1, 2, 3):
        change = t**power - zero**power
        for axis in (0, 1):
            found[..., axis] += change * map_coordinates(cubic[power, axis], places, order=1, mode="nearest")
    angle = view_raster(photo, photos, grid, window, nodes)[..., 0]
    found[..., 2] = np.abs(z - level) * np.tan(np.radians(angle))
    return found


def _heights(photos: Photos, grid: Grid, window: Window) -> FloatArray:
    """Heights (rows, cols) under a window of the output; 0 where there is no surface."""
    surface = photos.block.surface
    shape = window.height, window.width
    if surface is None:
        return np.zeros(shape)
    c, r = np.meshgrid(window.col + np.arange(shape[1]) + 0.5, window.row + np.arange(shape[0]) + 0.5)
    with photos.using(0) as photo:  # all images transform to the surface's map alike
        xy = photo.mapper.surface_xy(grid.xy(np.column_stack([c.ravel(), r.ravel()])))
    return surface.height(xy).reshape(shape)
