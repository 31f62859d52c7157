"""Products from plain inputs: orthos, mosaics, planar and edge-matched mosaics."""

from __future__ import annotations

import json
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj import CRS

from geomosaic.block import ControlPoint, OrientedBlock, OrientedImage
from geomosaic.errors import GeomosaicWarning, InputError, SolveError, counted
from geomosaic.geo.crs import parse_map
from geomosaic.inputs.area import plan
from geomosaic.inputs.build import build_block, gives_exterior, join_blocks
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.tables import read_table, stem
from geomosaic.mosaicking.outputs import companion
from geomosaic.options.inputs import Area, PlanarInputs
from geomosaic.raster.files import check_output
from geomosaic.raster.info import inspect
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.registry import build, plane_sensor
from geomosaic.sensor.solve import image_to_height
from geomosaic.types import PathLike
from geomosaic.whole_files import write_atomic

if TYPE_CHECKING:
    from geomosaic.mosaicking.records import MosaicResult
    from geomosaic.options.control import EdgeOptions
    from geomosaic.options.mosaic import MosaicOptions
    from geomosaic.options.render import RenderOptions
    from geomosaic.orientation.edges import CommonPoint, EdgeMatch
    from geomosaic.render.ortho import OrthoResult


def refuse_existing(path: Path, overwrite: bool, inputs: Block | None = None, *, geotiff: bool = False) -> None:
    """Check, before any work, that an output may be written.

    Parameters
    ----------
    path : Path
    overwrite : bool
        Whether an existing file may be replaced; an input never is.
    inputs : Block, optional
        Whose files are read.
    geotiff : bool
        Whether it becomes a GeoTIFF.

    Raises
    ------
    OutputExistsError
        The output exists.
    InputError
        The output is one of the inputs, or is called as another format.
    """
    read = () if inputs is None else (*inputs.images, *inputs.tables, *inputs.ground)
    check_output(path, overwrite=overwrite, inputs=read, geotiff=geotiff)


def make_ortho(inputs: Block, area: Area, output: Path, options: RenderOptions) -> OrthoResult:
    """Ortho of the one image of `inputs`.

    Parameters
    ----------
    inputs : Block
    area : Area
        Its CRS, resolution and bounds, as far as they are given.
    output : Path
        GeoTIFF to write.
    options : RenderOptions

    Returns
    -------
    OrthoResult

    Raises
    ------
    GeomosaicError
        InputError, OutputError, SensorError or SolveError; nothing is left under the final name.
    """
    from geomosaic.render.ortho import ortho

    for file in (output, *_placement_files(inputs, output)):
        refuse_existing(file, options.overwrite, inputs, geotiff=file == output)
    block = build_block(inputs)
    grid, outlines = plan(block.scenes, block.surface, area)
    made = ortho(block.scenes[0], block.surface, grid, outlines[0], output, options)
    facts = _place_by_control(inputs, block, output)
    return made if facts is None else replace(made, placement=facts, placement_file=_placement_files(inputs, output)[0])


def _placement_files(inputs: Block, output: Path) -> tuple[Path, ...]:
    """Files on the placement by control points that stand beside an output."""
    if inputs.control is None:
        return ()
    exterior = (companion(output, "-exterior", ".csv"),) if gives_exterior(inputs) else ()
    return (companion(output, "-placement", ".json"), *exterior)


def _place_by_control(inputs: Block, block: OrientedBlock, output: Path) -> dict[str, Any] | None:
    """Facts of how control points place the images, which are written beside the output; None without control."""
    files = _placement_files(inputs, output)
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


def reference_of(options: MosaicOptions, bands: Sequence[int] | None) -> OrientedImage | None:
    """Georeferenced raster that colours are matched to, as a scene.

    Parameters
    ----------
    options : MosaicOptions
        The raster and its bands are `colours.reference` and `colours.reference_bands`.
    bands : sequence of int or None
        Bands of the images, counted from 1; those of the raster unless it has its own.

    Returns
    -------
    OrientedImage or None
        None where there is no reference.
    """
    path, bands = options.colours.reference, options.colours.reference_bands or bands
    if path is None:
        return None
    return build_block(Block((path,), plane_sensor(), bands=None if bands is None else tuple(bands))).scenes[0]


def make_mosaic(inputs: Block | Sequence[Block], area: Area, output: Path, options: MosaicOptions) -> MosaicResult:
    """Mosaic of all images of `inputs`.

    Parameters
    ----------
    inputs : Block or sequence of Block
        Several for images of different sensors or cameras; they share one ground.
    area : Area
        Its CRS, resolution and bounds, as far as they are given.
    output : Path
        GeoTIFF to write; labels, vectors and the STAC item go beside it.
    options : MosaicOptions

    Returns
    -------
    MosaicResult

    Raises
    ------
    GeomosaicError
        InputError, OutputError, SensorError or SolveError; nothing is left under the final names.
    """
    from geomosaic.inputs.area import note_scattered, plan_mosaic
    from geomosaic.inputs.images import check_same_bands
    from geomosaic.mosaicking.mosaic import mosaic
    from geomosaic.mosaicking.outputs import MosaicFiles

    parts = (inputs,) if isinstance(inputs, Block) else tuple(inputs)
    # All files at once, before any is made: half a set of outputs would be left otherwise.
    placement = _placement_files(parts[0], output) if len(parts) == 1 else ()
    for file, part in product((output, *MosaicFiles.of(output, options).companions, *placement), parts):
        refuse_existing(file, options.render.overwrite, part, geotiff=file == output)
    block = join_blocks(parts, [build_block(part) for part in parts])
    check_same_bands(block.scenes)
    grid, outlines = plan_mosaic(block.scenes, block.surface, area)
    note_scattered(grid, outlines)
    made = mosaic(block, grid, outlines, output, options, reference=reference_of(options, parts[0].bands))
    facts = _place_by_control(parts[0], block, output) if placement else None
    return made if facts is None else replace(made, placement=facts, placement_file=placement[0])


def make_planar_mosaic(
    inputs: Block, wanted: PlanarInputs, area: Area, output: Path, options: MosaicOptions
) -> MosaicResult:
    """Mosaic of photos of flat ground, placed together by plane transformations.

    Parameters
    ----------
    inputs : Block
    wanted : PlanarInputs
        How they are placed.
    area : Area
    output : Path
        GeoTIFF to write; labels, vectors, the STAC item and the facts go beside it.
    options : MosaicOptions

    Returns
    -------
    MosaicResult
        With `placement`; the same facts stand in NAME-placement.json beside the mosaic.
    """
    from geomosaic.accuracy.check_points import control_residuals
    from geomosaic.inputs.planar_block import build_planar
    from geomosaic.inputs.planar_facts import control_facts
    from geomosaic.mosaicking.mosaic import mosaic
    from geomosaic.mosaicking.outputs import MosaicFiles

    facts_path = companion(output, "-placement", ".json")
    for file in (output, facts_path, *MosaicFiles.of(output, options).companions):
        refuse_existing(file, options.render.overwrite, inputs, geotiff=file == output)
    block, placed = build_planar(inputs, wanted)
    facts = {**placed, **control_facts(control_residuals(block))}
    grid, outlines = plan(block.scenes, block.surface, area)
    result = mosaic(block, grid, outlines, output, options, reference=reference_of(options, inputs.bands))
    write_atomic(facts_path, json.dumps(facts, indent=1) + "\n")
    return replace(result, placement=facts, placement_file=facts_path)


COLUMNS = ("id", "image", "col", "row")


@dataclass(frozen=True)
class EdgeInputs:
    """Photos and tables of an edge-matched mosaic.

    Attributes
    ----------
    images : tuple of Path
    control : Path
        id, x, y, z, image, col, row, as everywhere; z plays no part.
    common : Path
        id, image, col, row and optionally sigma_px.
    crs : str
        Map of the control.
    fit : EdgeOptions
    bands : tuple of int, optional
        Counted from 1; all unless given.
    """

    images: tuple[Path, ...]
    control: Path
    common: Path
    crs: str
    fit: EdgeOptions
    bands: tuple[int, ...] | None = None


def read_common(path: PathLike, images: Sequence[str]) -> tuple[CommonPoint, ...]:
    """Common points of photos, from a table with columns id, image, col, row and optionally sigma_px and z.

    Parameters
    ----------
    path : path
    images : sequence of str
        Names of the photos; the table may name them without extension. Rows of other images are left out.

    Returns
    -------
    tuple of CommonPoint
        col and row in pixels; only points that two or more of the photos show. A note counts the others.

    Raises
    ------
    InputError
        Names file and line.
    """
    from geomosaic.orientation.edges import CommonPoint

    table = read_table(path, "table of common points", ",".join(COLUMNS))
    table.require(*COLUMNS, what="common points")
    by_stem = {stem(image): image for image in images}
    points = []
    for row in table:
        image = by_stem.get(stem(row.text("image")))
        if image is not None:
            place = (row.number("col"), row.number("row"))
            sigma, z = row.number("sigma_px", 1.0), row.number("z", 0.0)
            points.append(CommonPoint(row.text("id"), image, place, sigma, z, row.where))
    if not points:
        raise InputError(
            "the table has no point of these images", where=str(path), hint="check the names of the images"
        )
    seen = Counter(point.id for point in points)
    alone = [point.id for point in points if seen[point.id] == 1]
    if alone:
        some = ", ".join(alone[:4]) + (" and more" if len(alone) > 4 else "")
        what = f"{path}: {counted(len(alone), 'point')} in one of these photos only, left out: {some}"
        warnings.warn(what, GeomosaicWarning, stacklevel=2)
    return tuple(point for point in points if seen[point.id] > 1)


def match_photos(inputs: EdgeInputs) -> EdgeMatch:
    """Edge matching of photos by their tables of control and common points.

    Parameters
    ----------
    inputs : EdgeInputs

    Returns
    -------
    EdgeMatch

    Raises
    ------
    InputError
        A table is wrong, or no two photos share a point.
    SolveError
        A photo cannot be placed.
    """
    from geomosaic.inputs.control_points import check_control, read_control
    from geomosaic.orientation.edges import match_edges

    names = [path.name for path in inputs.images]
    control, common = read_control(inputs.control, names), read_common(inputs.common, names)
    crs = parse_map(inputs.crs, "CRS of the control")
    check_control(control, crs, inputs.control, inputs.fit.wrong)
    photos, tables = _started(inputs, crs, control, common), f"{inputs.control.name} and {inputs.common.name}"
    matched = match_edges(
        photos, control, common, crs=crs, reach=inputs.fit.reach, policy=inputs.fit.wrong, tables=tables
    )
    if not matched.after.ids:
        raise InputError(
            "the photos share no point: there is no edge to match",
            where=tables,
            hint="measure common points in their overlaps, or georeference each photo by itself",
        )
    return matched


def make_edge_mosaic(
    inputs: EdgeInputs, area: Area, output: Path, options: MosaicOptions
) -> tuple[EdgeMatch, MosaicResult]:
    """Edge-matched mosaic of photos.

    Parameters
    ----------
    inputs : EdgeInputs
    area : Area
    output : Path
        GeoTIFF to write; labels, vectors and the STAC item go beside it.
    options : MosaicOptions

    Returns
    -------
    match : EdgeMatch
    result : MosaicResult

    Raises
    ------
    GeomosaicError
        InputError, OutputError or SolveError; nothing is left under the final names.
    """
    from geomosaic.mosaicking.mosaic import mosaic

    refuse_existing(output, options.render.overwrite, geotiff=True)
    matched = match_photos(inputs)
    grid, outlines = plan(matched.photos, None, area)
    return matched, mosaic(
        OrientedBlock(matched.photos, None),
        grid,
        outlines,
        output,
        options,
        reference=reference_of(options, inputs.bands),
    )


def _started(
    inputs: EdgeInputs, crs: CRS, control: Sequence[ControlPoint], common: Sequence[CommonPoint]
) -> list[OrientedImage]:
    """Initial models of the photos: from a photo's own control, else from common points with photos placed before."""
    sensor = plane_sensor()
    scenes: dict[str, OrientedImage] = {}
    waiting = {path.name: path for path in inputs.images}
    reason: SolveError | None = None
    # Photos without control of their own follow in rounds, outwards from those that have it.
    while waiting:
        known: dict[str, list[np.ndarray]] = {}
        for point in common:
            if point.image in scenes:
                # Plane models know no heights: any will do.
                place = image_to_height(scenes[point.image].model, np.array([point.colrow]), 0.0, crs)[0, :2]
                known.setdefault(point.id, []).append(place)
        made = {}
        for name, path in waiting.items():
            rows = [(*p.xyz[:2], *p.colrow) for p in control if p.image == name and p.role == "control"]
            rows += [(*np.mean(known[p.id], axis=0), *p.colrow) for p in common if p.image == name and p.id in known]
            points = [dict(zip(("x", "y", "col", "row"), map(float, row), strict=True)) for row in rows]
            size = inspect(path, inputs.bands).size
            try:
                if not points:
                    raise SolveError(
                        "the photo has no control and shares no point with one that has",
                        where=name,
                        hint="measure control in it, or points that a photo with control shows too",
                    )
                model = build(sensor, SensorRequest(name, size, {"points": points, "kind": inputs.fit.model}, crs))
            except SolveError as error:
                reason = error
                continue
            made[name] = OrientedImage(name, str(path), sensor, model, bands=inputs.bands)
        if not made:
            raise reason or SolveError("no photo can be placed", hint="measure control points in one photo at least")
        scenes.update(made)
        waiting = {name: path for name, path in waiting.items() if name not in made}
    return [scenes[path.name] for path in inputs.images]
