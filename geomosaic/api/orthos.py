"""Orthos: one image onto a DEM or a height; a raster in another CRS; a strip without control."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pyproj import CRS

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.geo.crs import horizontal, parse_map
from geomosaic.geo.grid import Bounds, Grid
from geomosaic.geo.transform import crs_defect, operation_between
from geomosaic.inputs.declarations import Block, Scene
from geomosaic.inputs.images import check_placed
from geomosaic.options.declaration import compose
from geomosaic.options.inputs import Area
from geomosaic.options.render import RenderOptions
from geomosaic.products import make_ortho, refuse_existing
from geomosaic.raster.info import inspect
from geomosaic.render.extent import grid_of
from geomosaic.render.ortho import OrthoResult
from geomosaic.reprojection import VectorResult, is_vector, operation_words, reproject_vectors
from geomosaic.sensor.registry import relative_sensor
from geomosaic.surface.dem import Dem
from geomosaic.types import PathLike
from geomosaic.whole_files import path_of


def ortho(
    scene: Block | PathLike,
    output: PathLike,
    *,
    dem: PathLike | Dem | float | None = None,
    dem_heights: str | None = None,
    dst_crs: str | None = None,
    resolution: float | None = None,
    bounds: Bounds | None = None,
    like: PathLike | Grid | None = None,
    **options: Any,
) -> OrthoResult:
    """Ortho of one image.

    Parameters
    ----------
    scene : Scene or path
        The image with its orientation; a path for one that is georeferenced.
    output : path
        GeoTIFF to write.
    dem : path, Dem or float, optional
        Ground: a DEM, or one height in metres; instead of the scene's own.
    dem_heights : str, optional
        Vertical datum of `dem`, where the file does not say it: 'ellipsoidal', 'egm96', an EPSG code or a geoid grid.
    dst_crs : str, optional
        CRS of the output; that of the DEM, the position or the control unless given.
    resolution : float, optional
        Pixel size in map units; that of the image unless given.
    bounds : tuple of float, optional
        Left, bottom, right, top in map units; all that the image shows unless given.
    like : path or Grid, optional
        Raster or grid whose CRS, pixels and extent the output takes, instead of the three.
    **options
        Of `RenderOptions`, flat: `resampling`, `tolerance`, `true_ortho`, `overwrite`, ...; or whole as `render`.

    Returns
    -------
    OrthoResult
        With the measured error of the geometry; `read()` gives the pixels.

    Raises
    ------
    GeomosaicError
        InputError, OutputError, SensorError or SolveError; nothing is left under the output's name.
    """
    block = on_ground(scene if isinstance(scene, Block) else Scene((path_of(scene, "scene"),)), dem, dem_heights)
    return make_ortho(
        block, area(dst_crs, resolution, bounds, like), path_of(output, "output"), render_options(options)
    )


@dataclass(frozen=True, repr=False)
class ReprojectedRaster(OrthoResult):
    """Raster in another CRS, with the attributes of `OrthoResult`.

    Attributes
    ----------
    operation : str
        How PROJ goes from one CRS to the other, with its accuracy.
    """

    operation: str = ""


def reproject(
    source: PathLike,
    output: PathLike,
    *,
    dst_crs: str | None = None,
    src_crs: str | None = None,
    resolution: float | None = None,
    bounds: Bounds | None = None,
    like: PathLike | Grid | None = None,
    snap: bool = False,
    **options: Any,
) -> ReprojectedRaster | VectorResult:
    """Georeferenced raster, or file of vectors, in another CRS.

    Parameters
    ----------
    source, output : path
    dst_crs : str, optional
        CRS of the output.
    src_crs : str, optional
        CRS of the source, instead of what the file says.
    resolution, bounds, like
        See `ortho`; for rasters only, but that vectors take the CRS of `like`.
    snap : bool
        Widen `bounds` to whole multiples of `resolution`; without bounds that is always done.
    **options
        Of `RenderOptions`; for vectors `overwrite` only.

    Returns
    -------
    ReprojectedRaster or VectorResult

    Raises
    ------
    InputError, OutputError
    """
    place = area(dst_crs, resolution, bounds, like, snap=snap)
    if dst_crs is None and like is None:
        raise InputError("nothing says where to", hint="give `dst_crs` or `like`")
    target = parse_map(dst_crs, "`dst_crs`") if place.like is None and dst_crs else grid_of(place.like or Path()).crs
    own = parse_map(src_crs, "`src_crs`") if src_crs else None
    path, file = path_of(source, "source"), path_of(output, "output")
    if is_vector(path):
        given = {"resolution": resolution, "bounds": bounds, "snap": snap or None, **options}
        useless = [
            f"`{name}`"
            for name, value in given.items()
            if value is not None and name not in ("overwrite", "render", "progress")
        ]
        if useless:
            raise InputError(f"vectors have no pixels: {', '.join(useless)} would do nothing", hint="leave it out")
        return reproject_vectors(path, target, file, source=own, overwrite=render_options(options).overwrite)
    return _reproject_raster(path, file, target, place, src_crs, render_options(options))


def _reproject_raster(
    path: Path, output: Path, target: CRS, place: Area, src_crs: str | None, render: RenderOptions
) -> ReprojectedRaster:
    """Georeferenced raster in another CRS; what is doubtful in its own georeference is told as a warning."""
    own = parse_map(src_crs, "`src_crs`") if src_crs else None
    refuse_existing(output, render.overwrite, Scene((path,)), geotiff=True)
    info = inspect(path)
    source = check_placed(info, own)
    # Warnings point to the caller of `reproject`, two calls up.
    if "palette" in info.colors and render.resampling == "nearest":
        warnings.warn(
            "the numbers of the palette are kept, its colours are not carried over", GeomosaicWarning, stacklevel=3
        )
    if own is None and info.crs is not None and (suspicious := crs_defect(info.crs)):
        if not operation_between(horizontal(info.crs), horizontal(target)).possible:
            what, _, hint = suspicious.partition("; ")
            raise InputError(f"{what}; no operation leads from it to '{target.name}'", where=info.path, hint=hint)
        warnings.warn(suspicious, GeomosaicWarning, stacklevel=3)
    placed: dict[str, Any] = {}
    if src_crs is not None and info.transform is not None:
        placed["transform"] = list(info.transform[:6])
    made = make_ortho(Scene((path,), options=placed, crs=src_crs), place, output, render)
    return ReprojectedRaster(**vars(made), operation=operation_words(source, made.grid.crs))


def deskew(
    image: PathLike,
    output: PathLike,
    nominal: Mapping[str, Any],
    *,
    sensor: str | None = None,
    bands: tuple[int, ...] | None = None,
    resolution: float | None = None,
    bounds: Bounds | None = None,
    **options: Any,
) -> OrthoResult:
    """Scanned strip without skew and tangential distortion, made without control.

    The result is in relative metres, x across and y ahead of the scanner: it has shape and scale, but no place.

    Parameters
    ----------
    image, output : path
    nominal : mapping
        Nominal numbers of the scanner and its flight, as the sensor names them.
    sensor : str, optional
        Sensor that makes models in relative metres; the installed one unless given.
    bands : tuple of int, optional
        Counted from 1.
    resolution, bounds
        See `ortho`, in relative metres.
    **options
        Of `RenderOptions`.

    Returns
    -------
    OrthoResult

    Raises
    ------
    GeomosaicError
        See `ortho`.
    """
    strip = Scene(
        (path_of(image, "image"),), sensor or relative_sensor(), options={**nominal, "relative": True}, bands=bands
    )
    return make_ortho(strip, area(None, resolution, bounds, None), path_of(output, "output"), render_options(options))


def render_options(given: Mapping[str, Any]) -> RenderOptions:
    """Options of rendering from keyword arguments.

    Parameters
    ----------
    given : mapping
        Options of `RenderOptions` by name; or the whole as `render`, of which the others change some.

    Returns
    -------
    RenderOptions

    Raises
    ------
    InputError
        An option is not known, or a value is wrong.
    """
    if "render" not in given:
        return compose(RenderOptions, given)
    whole = given["render"]
    if not isinstance(whole, RenderOptions):
        raise InputError(f"{type(whole).__name__} is no set of options", where="`render`", hint="RenderOptions(...)")
    return replace(whole, **{name: value for name, value in given.items() if name != "render"})


def on_ground(block: Block, dem: PathLike | Dem | float | None, dem_heights: str | None) -> Block:
    """Block over another ground than its own, where one is given.

    Parameters
    ----------
    block : Block
    dem : path, Dem, float or None
        DEM, or one height in metres; the block's own ground unless given.
    dem_heights : str or None
        Vertical datum of the heights, where they do not say it.

    Returns
    -------
    Block
    """
    if dem is None:
        return block if dem_heights is None else replace(block, dem_heights=dem_heights)
    if isinstance(dem, int | float) and not isinstance(dem, bool):
        return replace(block, dem=None, height=float(dem), dem_heights=dem_heights)
    # A block has one ground: the new one replaces a DEM and a constant height alike.
    return replace(block, dem=dem, height=None, dem_heights=dem_heights)


def area(
    crs: str | None,
    resolution: float | None,
    bounds: Bounds | None,
    like: PathLike | Grid | None,
    *,
    snap: bool = False,
) -> Area:
    """Area of an output from keyword arguments.

    Parameters
    ----------
    crs : str or None
    resolution : float or None
        Map units.
    bounds : tuple of float or None
        Left, bottom, right, top in map units.
    like : path, Grid or None
        Raster or grid whose CRS, pixels and extent are taken instead.
    snap : bool
        Widen `bounds` to whole multiples of `resolution`.

    Returns
    -------
    Area

    Raises
    ------
    InputError
        `like` and one of the others are given.
    """
    return Area(crs, resolution, bounds, snap, like)
