"""Monoplotting: places on the ground from pixels of one image, and map vectors drawn into it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.api.orthos import on_ground
from geomosaic.errors import InputError
from geomosaic.inputs.declarations import Block, block_of
from geomosaic.monoplotting.run import DrawnVectors, Located, MonoplotInputs, locate_pixels
from geomosaic.monoplotting.run import draw_vectors as draw_map_vectors
from geomosaic.options.control import DrawOptions, LocateOptions
from geomosaic.options.declaration import compose
from geomosaic.surface.dem import Dem
from geomosaic.types import FloatArray, PathLike
from geomosaic.whole_files import path_of


def locate(
    scene: Block,
    pixels: FloatArray | PathLike,
    *,
    dem: PathLike | Dem | float | None = None,
    dem_heights: str | None = None,
    output: PathLike | None = None,
    overwrite: bool = False,
    **options: Any,
) -> Located:
    """Places on the ground of pixels of one image, with their error ellipses.

    Parameters
    ----------
    scene : Scene
    pixels : array (N, 2) or path
        Columns and rows, or a table (id, col, row), or vectors digitized on the raw image.
    dem, dem_heights
        See `ortho`.
    output : path, optional
        GeoPackage, GeoJSON, FlatGeobuf or CSV to write; vectors need it.
    overwrite : bool
        Replace an existing file.
    **options
        Of `LocateOptions`: `dst_crs`, `sigma_px`, `sigma_dem`, `sigmas`, `rows`, ...

    Returns
    -------
    Located

    Raises
    ------
    InputError, SolveError, OutputError
    """
    source = Path(pixels) if isinstance(pixels, str | Path) else None
    points = None if source is not None else _points(pixels)
    file = None if output is None else path_of(output, "output")
    inputs = MonoplotInputs(on_ground(block_of(scene, "scene"), dem, dem_heights), source, points, file, overwrite)
    return locate_pixels(inputs, compose(LocateOptions, options))


def _points(given: object) -> FloatArray:
    """Image points (N, 2); one point may be given as a pair."""
    try:
        points = np.atleast_2d(np.asarray(given, dtype=np.float64))
    except (TypeError, ValueError):
        points = np.empty(0)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError("these are no image points", where="`pixels`", hint="give an array (N, 2) of column and row")
    return points


def draw_vectors(
    scene: Block,
    vectors: PathLike,
    output: PathLike,
    *,
    dem: PathLike | Dem | float | None = None,
    dem_heights: str | None = None,
    overwrite: bool = False,
    **options: Any,
) -> DrawnVectors:
    """Map vectors drawn into the pixels of one image.

    Parameters
    ----------
    scene : Scene
    vectors : path
        In any CRS; draped over the ground.
    output : path
        GeoPackage, GeoJSON, FlatGeobuf or CSV to write, in pixels.
    dem, dem_heights
        See `ortho`.
    overwrite : bool
        Replace an existing file.
    **options
        Of `DrawOptions`: `src_crs`, `layer`, `rows`, `mark_hidden`, ...

    Returns
    -------
    DrawnVectors

    Raises
    ------
    InputError, SolveError, OutputError
    """
    inputs = MonoplotInputs(
        on_ground(block_of(scene, "scene"), dem, dem_heights),
        path_of(vectors, "vectors"),
        output=path_of(output, "output"),
        overwrite=overwrite,
    )
    return draw_map_vectors(inputs, compose(DrawOptions, options))
