"""Monoplotting: places on the ground from pixels of one image, and map vectors drawn into it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from geomosaic.api.orthos import on_ground
from geomosaic.errors import InputError
from geomosaic.inputs.declarations import Block
from geomosaic.monoplotting.run import DrawnVectors, Located, MonoplotInputs, locate_pixels
from geomosaic.monoplotting.run import draw_vectors as draw_map_vectors
from geomosaic.surface.dem import Dem
from geomosaic.types import FloatArray, PathLike
from geomosaic.whole_files import path_of


def locate(
    scene: Block,
    pixels: FloatArray | PathLike,
    *,
    dem: PathLike | Dem | float | None = None,
    dem_heights: str | None = None,
    layer: str | None = None,
    rows: str | None = None,
    first_pixel: float = 0.5,
    step: float | None = None,
    sigmas: Mapping[str, float] | None = None,
    sigma_px: float | None = None,
    sigma_dem: float | None = None,
    dst_crs: str | None = None,
    dst_heights: str | None = None,
    output: PathLike | None = None,
    overwrite: bool = False,
) -> Located:
    """Places on the ground of pixels of one image, with their error ellipses.

    Parameters
    ----------
    scene : Scene
    pixels : array (N, 2) or path
        Columns and rows, or a table (id, col, row), or vectors digitized on the raw image.
    dem, dem_heights
        See `ortho`.
    layer : str, optional
        Of the vectors; the first unless given.
    rows : str, optional
        How pixel coordinates count rows: 'down', 'negative' or 'up'.
    first_pixel : float
        What they call the centre of the first pixel: 0.5, 0 or 1.
    step : float, optional
        Most pixels between vertices of digitized lines.
    sigmas : mapping of str to float, optional
        Standard deviations of parameters of the sensor, in their units.
    sigma_px : float, optional
        Standard deviation of the pixels.
    sigma_dem : float, optional
        Standard deviation of the heights, metres.
    dst_crs, dst_heights : str, optional
        CRS and vertical datum of the places; those of the ground unless given.
    output : path, optional
        GeoPackage, GeoJSON, FlatGeobuf or CSV to write; vectors need it.
    overwrite : bool
        Replace an existing file.

    Returns
    -------
    Located

    Raises
    ------
    InputError, SolveError, OutputError
    """
    source = Path(pixels) if isinstance(pixels, str | Path) else None
    points = None if source is not None else _points(pixels)
    return locate_pixels(
        MonoplotInputs(
            on_ground(scene, dem, dem_heights),
            source=source,
            layer=layer,
            pixels=points,
            rows=rows,
            first=first_pixel,
            step=step,
            crs=dst_crs,
            heights=dst_heights,
            sigmas=dict(sigmas or {}),
            sigma_px=sigma_px,
            sigma_dem=sigma_dem,
            output=None if output is None else path_of(output, "output"),
            overwrite=overwrite,
        )
    )


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
    layer: str | None = None,
    src_crs: str | None = None,
    rows: str | None = None,
    first_pixel: float = 0.5,
    sigmas: Mapping[str, float] | None = None,
    mark_hidden: bool = False,
    overwrite: bool = False,
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
    layer : str, optional
        Of the vectors; the first unless given.
    src_crs : str, optional
        Of the vectors, instead of what they say.
    rows, first_pixel
        How the output counts pixels, see `locate`.
    sigmas : mapping of str to float, optional
        Standard deviations of parameters of the sensor, which control points adjust.
    mark_hidden : bool
        Keep hidden parts, marked; left out otherwise.
    overwrite : bool
        Replace an existing file.

    Returns
    -------
    Drawn

    Raises
    ------
    InputError, SolveError, OutputError
    """
    return draw_map_vectors(
        MonoplotInputs(
            on_ground(scene, dem, dem_heights),
            source=path_of(vectors, "vectors"),
            layer=layer,
            rows=rows,
            first=first_pixel,
            crs=src_crs,
            sigmas=dict(sigmas or {}),
            hidden=mark_hidden,
            output=path_of(output, "output"),
            overwrite=overwrite,
        )
    )
