"""Orthos: one image onto a DEM or a height; a raster in another CRS; a strip without control."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pyproj import CRS

from geomosaic.block import OrientedBlock, OrientedImage
from geomosaic.errors import InputError, warn
from geomosaic.execution.units import workers_for
from geomosaic.geo.crs import horizontal, parse_map
from geomosaic.geo.grid import Bounds, Grid
from geomosaic.geo.transform import crs_defect, operation_between
from geomosaic.inputs.area import plan
from geomosaic.inputs.build import build_block, gives_exterior, refuse_unused_ground
from geomosaic.inputs.declarations import Block, Scene, image_paths, on_ground
from geomosaic.inputs.images import check_placed
from geomosaic.options.declaration import compose, paths_of
from geomosaic.options.inputs import Area
from geomosaic.options.render import OrthoOptions, RasterOptions, RenderOptions, UncertaintyOptions
from geomosaic.raster.files import check_output, companion
from geomosaic.raster.info import inspect
from geomosaic.render.extent import grid_of, nice
from geomosaic.render.ortho import OrthoResult, stack
from geomosaic.render.ortho import ortho as render_ortho
from geomosaic.sensor.registry import relative_sensor
from geomosaic.stores.path import to_path
from geomosaic.surface.dem import Dem
from geomosaic.types import PathLike
from geomosaic.whole_files import path_of, write_atomic

if TYPE_CHECKING:
    from geomosaic.reprojection import VectorResult


def ortho(
    scene: Block | OrientedBlock | PathLike,
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
    scene : Scene, path or OrientedBlock
        The image with its orientation; a path for one that is georeferenced; `AdjustedBlock.block(NAME)` for one of an
        adjustment.
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
        Of `RenderOptions`, flat: `resampling`, `tolerance`, `true_ortho`, `overwrite`, ...; or whole as `render`. Those
        of the accuracy raster: `accuracy`, `sigma_dem`, `sigmas`, ...; or whole as `uncertainty`.

    Returns
    -------
    OrthoResult
        With the measured error of the geometry; `read()` gives the pixels.

    Raises
    ------
    GeomosaicError
        InputError, OutputError, SensorError or SolveError; nothing is left under the output's name.
    """
    wanted, area = compose(OrthoOptions, options), Area(dst_crs, resolution, bounds, like=like)
    with workers_for(wanted.render):
        if isinstance(scene, OrientedBlock):
            refuse_ground(dem, dem_heights)
            return _ortho_oriented(scene, area, path_of(output, "output"), wanted.render, wanted.uncertainty)
        block = scene if isinstance(scene, Block) else Scene((path_of(scene, "scene"),))
        block = on_ground(block, dem, dem_heights)
        return make_ortho(block, area, path_of(output, "output"), wanted.render, wanted.uncertainty)


def make_ortho(
    inputs: Block,
    area: Area,
    output: Path,
    options: RenderOptions,
    uncertainty: UncertaintyOptions | None = None,
) -> OrthoResult:
    """Ortho of the one image of `inputs`.

    Parameters
    ----------
    inputs : Block
    area : Area
        Its CRS, resolution and bounds, as far as they are given.
    output : Path
        GeoTIFF to write.
    options : RenderOptions
    uncertainty : UncertaintyOptions, optional
        No accuracy raster is made unless it is asked for.

    Returns
    -------
    OrthoResult

    Raises
    ------
    GeomosaicError
        InputError, OutputError, SensorError or SolveError; nothing is left under the final name.
    """
    wanted = uncertainty or UncertaintyOptions()
    beside = companion(output, "-accuracy", ".tif")
    read = (*inputs.files, *paths_of(wanted))
    for file in (output, *placement_files(inputs, output), *([beside] if wanted.accuracy else [])):
        check_output(file, overwrite=options.overwrite, inputs=read, geotiff=file == output)
    refuse_unused_ground((inputs,), uses_surface=wanted.accuracy or options.true_ortho)
    block = build_block(inputs, dem_memory=options.dem_memory)
    if wanted.accuracy:
        from geomosaic.inputs.orientation_covariance import with_covariances

        block = with_covariances(inputs, block, wanted.sigmas)
    made = _rendered(block, area, output, options, wanted)
    facts = place_by_control(inputs, block, output)
    return made if facts is None else replace(made, placement=facts, placement_file=placement_files(inputs, output)[0])


def _ortho_oriented(
    block: OrientedBlock, area: Area, output: Path, options: RenderOptions, wanted: UncertaintyOptions
) -> OrthoResult:
    """Ortho of the one image of a block whose model is known, that of an adjustment for example; see `make_ortho`."""
    if len(block.scenes) != 1:
        what = f"an ortho is of one image, and the block has {len(block.scenes)}"
        raise InputError(what, where="`scene`", hint="name the image: `adjusted.block(NAME)`")
    beside = [companion(output, "-accuracy", ".tif")] if wanted.accuracy else []
    for file in (output, *beside):
        read = (to_path(block.scenes[0].path), *paths_of(wanted))
        check_output(file, overwrite=options.overwrite, inputs=read, geotiff=file == output)
    return _rendered(block, area, output, options, wanted)


def refuse_ground(dem: object, dem_heights: str | None) -> None:
    """Check that no ground is given for a block that stands on one.

    Parameters
    ----------
    dem : object
        As the user gave it; None where it was not given.
    dem_heights : str or None

    Raises
    ------
    InputError
    """
    for name, given in (("dem", dem), ("dem_heights", dem_heights)):
        if given is not None:
            what = f"`{name}` would do nothing: an oriented block has its surface"
            raise InputError(what, hint=f"leave out `{name}`, or give the block another `surface`")


def _rendered(
    block: OrientedBlock, area: Area, output: Path, options: RenderOptions, wanted: UncertaintyOptions
) -> OrthoResult:
    """Ortho of a block of one image, with its accuracy raster where one is wanted."""
    target, known = position_target(wanted), None
    if wanted.accuracy:
        from geomosaic.render.accuracy import Uncertainties, write_accuracy

        known = Uncertainties.of(block, wanted, options)
    grid, outlines = plan(block.scenes, block.surface, area)
    made = render_ortho(block.scenes[0], block.surface, grid, outlines[0], output, options)
    if known is not None:
        beside = companion(output, "-accuracy", ".tif")
        accuracy = write_accuracy(beside, output, block, grid, known, options, labelled=False)
        made = replace(made, accuracy=replace(accuracy, target=target))
    return made


def position_target(wanted: UncertaintyOptions) -> float | None:
    """Largest admissible error of position in plan that the target of an accuracy raster names, metres.

    Parameters
    ----------
    wanted : UncertaintyOptions

    Returns
    -------
    float or None
        None without a target.

    Raises
    ------
    InputError
        The target cannot be read, or has no limit of position.
    """
    if wanted.accuracy_target is None:
        return None
    from geomosaic.accuracy.product_check import read_target

    limits = {one.name: one.most for one in read_target(wanted.accuracy_target)}
    if limits.get("position_error") is None:
        raise InputError(
            "the target has no limit of position", where=str(wanted.accuracy_target), hint="give it a `position_error`"
        )
    return limits["position_error"]


def placement_files(inputs: Block, output: Path) -> tuple[Path, ...]:
    """Files on the placement by control points that stand beside an output.

    Parameters
    ----------
    inputs : Block
    output : Path

    Returns
    -------
    tuple of Path
        Facts, and the adjusted orientation where there is one; none without control.
    """
    if inputs.control is None:
        return ()
    exterior = (companion(output, "-exterior", ".csv"),) if gives_exterior(inputs) else ()
    return (companion(output, "-placement", ".json"), *exterior)


def place_by_control(inputs: Block, block: OrientedBlock, output: Path) -> dict[str, Any] | None:
    """Facts of how control points place the images, which are written beside the output.

    Parameters
    ----------
    inputs : Block
    block : OrientedBlock
        Built from `inputs`.
    output : Path

    Returns
    -------
    dict or None
        None without control.
    """
    files = placement_files(inputs, output)
    if not files or block.crs is None:
        return None
    from geomosaic.accuracy.check_points import control_residuals
    from geomosaic.inputs.adjusted import adjusted_images, adjustment_facts, write_exterior
    from geomosaic.inputs.planar_facts import control_facts
    from geomosaic.inputs.summary import control_discrepancies

    images = adjusted_images(inputs, block)
    facts: dict[str, Any] = {
        **(adjustment_facts(images, block.crs) if images else {"summary": []}),
        **control_facts(control_residuals(block)),
        "control_discrepancies": [points.facts for points in control_discrepancies(inputs, block)],
    }
    if gives_exterior(inputs) and write_exterior(files[1], images, block.crs):
        facts["exterior_file"] = str(files[1])
    write_atomic(files[0], json.dumps(facts, indent=1) + "\n")
    return facts


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
    source: PathLike | Sequence[PathLike],
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
    """Georeferenced raster, or file of vectors, in another CRS; several rasters of one place as one of all their bands.

    Parameters
    ----------
    source : path or sequence of path
        Several rasters may have pixels of any size: each is resampled once, and valid is what all of them show.
    output : path
    dst_crs : str, optional
        CRS of the output.
    src_crs : str, optional
        CRS of the source, instead of what the file says.
    resolution, bounds, like
        See `ortho`; the finest of several rasters gives the pixel size. For rasters only, but that vectors take the CRS
        of `like`.
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
    from geomosaic.raster.vector_copy import is_vector
    from geomosaic.reprojection import reproject_vectors

    place, render = Area(dst_crs, resolution, bounds, snap, like), compose(RasterOptions, options).render
    if dst_crs is None and like is None:
        raise InputError("nothing says where to", hint="give `dst_crs` or `like`")
    target = parse_map(dst_crs, "`dst_crs`") if place.like is None and dst_crs else grid_of(place.like or Path()).crs
    own = parse_map(src_crs, "`src_crs`") if src_crs else None
    paths, file = image_paths(source, "source"), path_of(output, "output")
    if not paths:
        raise InputError("no raster is given", where="`source`", hint="give the path of a file, or several")
    if is_vector(paths[0]) and len(paths) == 1:
        given = {"resolution": resolution, "bounds": bounds, "snap": snap or None, **options}
        useless = [
            f"`{name}`"
            for name, value in given.items()
            if value is not None and name not in ("overwrite", "render", "progress")
        ]
        if useless:
            raise InputError(f"vectors have no pixels: {', '.join(useless)} would do nothing", hint="leave it out")
        return reproject_vectors(paths[0], target, file, source=own, overwrite=render.overwrite)
    return _reproject_rasters(paths, file, target, place, src_crs, render)


def _reproject_rasters(
    paths: Sequence[Path], output: Path, target: CRS, place: Area, src_crs: str | None, render: RenderOptions
) -> ReprojectedRaster:
    """Georeferenced rasters in another CRS; what is doubtful in their own georeference is told as a warning."""
    from geomosaic.raster.vector_copy import is_vector
    from geomosaic.reprojection import operation_text

    own = parse_map(src_crs, "`src_crs`") if src_crs else None
    check_output(output, overwrite=render.overwrite, inputs=paths, geotiff=True)
    scenes: list[OrientedImage] = []
    alike: dict[tuple[Any, ...], OrientedImage] = {}
    operations: dict[str, None] = {}
    for path in paths:
        if is_vector(path):
            raise InputError("this is a file of vectors: it has no bands", where=str(path), hint="reproject it alone")
        info = inspect(path)
        source = check_placed(info, own)
        if "palette" in info.colors and render.resampling == "nearest":
            warn("the numbers of the palette are kept, its colours are not carried over")
        if own is None and info.crs is not None and (suspicious := crs_defect(info.crs)):
            if not operation_between(horizontal(info.crs), horizontal(target)).possible:
                what, _, hint = suspicious.partition("; ")
                raise InputError(f"{what}; no operation leads from it to '{target.name}'", where=info.path, hint=hint)
            warn(suspicious)
        placed: dict[str, Any] = {}
        if src_crs is not None and info.transform is not None:
            placed["transform"] = list(info.transform[:6])
        geometry = info.transform, info.size, source.to_wkt()
        if geometry not in alike:
            (alike[geometry],) = build_block(Scene((path,), options=placed, crs=src_crs)).scenes
        scenes.append(replace(alike[geometry], name=path.name, path=str(path)))
        operations[operation_text(source, target)] = None
    grid, outlines = plan(scenes, None, place)
    if len(scenes) > 1 and place.resolution is None and place.like is None:
        finest = nice(min(outline.sampling for outline in outlines))
        grid, _ = plan(scenes, None, replace(place, resolution=finest), lambda *_: outlines)
    made = stack(scenes, None, grid, outlines, output, render)
    return ReprojectedRaster(**vars(made), operation="\n".join(operations))


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
    render = compose(RasterOptions, options).render
    return make_ortho(strip, Area(None, resolution, bounds), path_of(output, "output"), render)
