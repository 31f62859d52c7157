"""Edge-matched mosaics: photos adjusted to control and common points together, and joined exactly at their edges."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj import CRS

from geomosaic.block import ControlPoint, OrientedBlock, OrientedImage
from geomosaic.errors import InputError, SolveError, counted, warn
from geomosaic.geo.crs import parse_map
from geomosaic.image_names import stem
from geomosaic.inputs.area import plan
from geomosaic.inputs.control_points import check_control, read_control
from geomosaic.inputs.declarations import image_paths
from geomosaic.inputs.tables import read_table
from geomosaic.mosaicking.mosaic import mosaic
from geomosaic.mosaicking.records import MosaicResult
from geomosaic.options.declaration import compose
from geomosaic.options.inputs import EdgeOptions
from geomosaic.options.mosaic import EdgeMosaicOptions
from geomosaic.orientation import edges
from geomosaic.orientation.edges import CommonPoint
from geomosaic.products.mosaics import check_outputs, reference_of
from geomosaic.raster.info import inspect
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.registry import build, plane_sensor
from geomosaic.sensor.solve import image_to_height
from geomosaic.types import PathLike
from geomosaic.whole_files import path_of

if TYPE_CHECKING:
    from geomosaic.orientation.edges import EdgeMatch


COLUMNS = ("id", "image", "col", "row")


@dataclass(frozen=True)
class EdgeInputs:
    """Photos and tables of an edge-matched mosaic.

    Attributes
    ----------
    images : tuple of Path
    control : Path
        id, x, y, image, col, row, as everywhere; z plays no part.
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
        warn(what)
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
    names = [path.name for path in inputs.images]
    control, common = read_control(inputs.control, names, plane=True), read_common(inputs.common, names)
    crs = parse_map(inputs.crs, "CRS of the control")
    check_control(control, crs, inputs.control, inputs.fit.blunder_policy)
    photos, tables = _started(inputs, crs, control, common), f"{inputs.control.name} and {inputs.common.name}"
    matched = edges.match_edges(
        photos, control, common, crs=crs, reach=inputs.fit.reach, policy=inputs.fit.blunder_policy, tables=tables
    )
    if not matched.after.ids:
        raise InputError(
            "the photos share no point: there is no edge to match",
            where=tables,
            hint="measure common points in their overlaps, or georeference each photo by itself",
        )
    return matched


@dataclass(frozen=True, eq=False)
class EdgeMosaic:
    """Photos joined exactly at common points, and their mosaic.

    Attributes
    ----------
    match : EdgeMatch
        Misfits before and after, residuals, blunders.
    mosaic : MosaicResult
    """

    match: EdgeMatch
    mosaic: MosaicResult


def match_edges(
    images: Sequence[PathLike],
    output: PathLike,
    control: PathLike,
    common: PathLike,
    crs: str,
    *,
    bands: tuple[int, ...] | None = None,
    **options: Any,
) -> EdgeMosaic:
    """Photos adjusted to control and common points together, joined exactly at their edges, and their mosaic.

    Parameters
    ----------
    images : sequence of path
    output : path
        GeoTIFF to write.
    control : path
        Control points: id, x, y, image, col, row.
    common : path
        Points that neighbours show: id, image, col, row and optionally sigma_px.
    crs : str
        Of the control points.
    bands : tuple of int, optional
        Counted from 1.
    **options
        Of `EdgeOptions` (`model`, `reach`, `robust`, `insist`), the extent (`dst_crs`, `resolution`, `bounds`) and
        `MosaicOptions`, flat.

    Returns
    -------
    EdgeMosaic

    Raises
    ------
    GeomosaicError
        InputError, OutputError or SolveError; nothing is left under the output's name.
    """
    request, file = compose(EdgeMosaicOptions, options), path_of(output, "output")
    request.uncertainty.refuse("edge-matched mosaics")
    tables = path_of(control, "control"), path_of(common, "common")
    inputs = EdgeInputs(image_paths(images), *tables, crs, request.fit, bands)
    check_outputs(file, request, (*inputs.images, inputs.control, inputs.common))
    matched = match_photos(inputs)
    block = OrientedBlock(matched.photos, None)
    grid, outlines = plan(block.scenes, None, request.area)
    made = mosaic(block, grid, outlines, file, request, reference=reference_of(request, bands))
    return EdgeMosaic(matched, made)


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
