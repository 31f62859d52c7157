"""What goes with a mosaic: footprints and seamlines as vectors, and a STAC item."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.block.footprint import Footprint
from geomosaic.digests import sha256
from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal, parse_crs
from geomosaic.geo.grid import Grid
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import metres_per_unit
from geomosaic.mosaicking.records.provenance import time_span
from geomosaic.mosaicking.seams.seamlines import SeamQuality, Segment, seam_segments
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.raster.output_files import check_output, write_text
from geomosaic.raster.vector import Layer, write_layers

STAC_EXTENSIONS = (
    "https://stac-extensions.github.io/projection/v2.0.0/schema.json",
    "https://stac-extensions.github.io/file/v2.1.0/schema.json",
    "https://stac-extensions.github.io/processing/v1.2.0/schema.json",
)
COG = "image/tiff; application=geotiff; profile=cloud-optimized"


def write_vectors(
    path: Path,
    grid: Grid,
    outlines: list[Footprint],
    shares: list[Any],
    balance: Balance,
    pixels: list[int],
    parts: Sequence[Segment] | None = None,
    quality: Sequence[SeamQuality] = (),
    sources: Mapping[str, Sequence[Any]] | None = None,
    *,
    overwrite: bool,
) -> None:
    """Write a GeoPackage with the layers `footprints`, `seams` (areas) and `seamlines` (what divides them).

    An image keeps its `label`, a piece of a seam its `id`, as long as the images of the block stay the same.

    Parameters
    ----------
    path : Path
        Ends in .gpkg.
    grid : Grid
        Of the mosaic; geometries are in its CRS.
    outlines : list of Footprint
    shares : list of Polygon or MultiPolygon
        What each image shows; empty where it shows nothing.
    balance : Balance
        Gains and offsets.
    pixels : list of int
        Number that each image shows.
    parts : sequence of Segment, optional
        Pieces of seams; whole ones unless given.
    quality : sequence of SeamQuality
        Of each piece, where judged.
    sources : mapping of str to sequence, optional
        Columns of facts by image, for `footprints`.
    overwrite : bool

    Raises
    ------
    OutputExistsError, OutputError
        The name is taken; writing failed.
    """
    parts = seam_segments(shares, grid.resolution[0], math.inf) if parts is None else parts
    layers = {
        "footprints": _footprints(grid.crs, outlines, balance, pixels, sources or {}),
        "seams": _areas(grid.crs, outlines, shares),
        "seamlines": _lines(grid, outlines, parts, quality),
    }
    write_layers(path, layers, overwrite=overwrite)


def _footprints(
    crs: CRS, outlines: list[Footprint], balance: Balance, pixels: list[int], sources: Mapping[str, Sequence[Any]]
) -> Layer:
    columns: dict[str, list[Any]] = {
        "label": list(range(1, len(outlines) + 1)),
        "image": [outline.name for outline in outlines],
        "centre_x": [outline.centre[0] for outline in outlines],
        "centre_y": [outline.centre[1] for outline in outlines],
        "sampling": [outline.sampling for outline in outlines],
        "complete": [outline.complete for outline in outlines],
        "pixels": pixels,
    }
    columns.update(gains(balance))
    columns.update({name: list(values) for name, values in sources.items()})
    shapes = [outline.polygon for outline in outlines]
    kind = "Polygon" if all(shape.geom_type == "Polygon" for shape in shapes) else "MultiPolygon"
    return Layer(crs, kind, shapes, columns)


def gains(balance: Balance) -> dict[str, list[float]]:
    """Columns of gains and offsets, one of each per band."""
    columns = {}
    for band in range(balance.gain.shape[1]):
        columns[f"gain_{band + 1}"] = [float(value) for value in balance.gain[:, band]]
        columns[f"offset_{band + 1}"] = [float(value) for value in balance.offset[:, band]]
    return columns


def _areas(crs: CRS, outlines: list[Footprint], shares: list[Any]) -> Layer:
    kept = [i for i, share in enumerate(shares) if not share.is_empty]
    columns: dict[str, list[Any]] = {"label": [i + 1 for i in kept], "image": [outlines[i].name for i in kept]}
    return Layer(crs, "MultiPolygon", [shares[i] for i in kept], columns)


def _lines(grid: Grid, outlines: list[Footprint], parts: Sequence[Segment], quality: Sequence[SeamQuality]) -> Layer:
    names = [outline.name for outline in outlines]
    first, second = [names[part.first] for part in parts], [names[part.second] for part in parts]
    columns: dict[str, list[Any]] = {
        "id": [f"{a}|{b}|{part.number}" for a, b, part in zip(first, second, parts, strict=True)],
        "first": first,
        "second": second,
        "length": [float(part.line.length) for part in parts],
    }
    if quality:
        for name in ("step_before", "step_after", "difference", "mismatch", "shift_col", "shift_row", "correlation"):
            columns[name] = [float(getattr(one, name)) for one in quality]
    return Layer(grid.crs, "MultiLineString", [part.line for part in parts], columns)


def write_item(
    path: Path,
    mosaic: Path,
    labels: Path | None,
    vectors: Path | None,
    grid: Grid,
    outlines: list[Any],
    images: list[Path],
    checksums: Mapping[Path, str],
    sources: Mapping[str, Sequence[Any]] | None = None,
    views: Path | None = None,
    *,
    overwrite: bool,
) -> None:
    """Write a STAC item (version 1.1) whose assets are the files beside it.

    Its times are the span in which the images were taken (`taken.py`); `geomosaic:times` says how it is known. Equal
    runs make equal bytes.

    Parameters
    ----------
    path : Path
    mosaic : Path
    labels, vectors, views : Path or None
        As far as they were written.
    grid : Grid
        Of the mosaic.
    outlines : list of Footprint
    images : list of Path
    checksums : mapping of Path to str
        SHA-256 of files, as far as known.
    sources : mapping of str to sequence, optional
        Columns of facts by image, for the property `geomosaic:sources`.
    overwrite : bool

    Raises
    ------
    OutputExistsError, OutputError
        The name is taken; writing failed.
    """
    check_output(path, overwrite=overwrite)
    geometry, box = _outline(grid, outlines)
    start, end, known = time_span([str(text) for text in (sources or {}).get("acquired", ())], images)
    first, last = (f"{time:%Y-%m-%dT%H:%M:%SZ}" for time in (start, end))
    code, t = horizontal(grid.crs).to_authority(), grid.transform
    properties: dict[str, Any] = {
        "datetime": last if first == last else None,
        "start_datetime": first,
        "end_datetime": last,
        "geomosaic:times": known,
        "gsd": _metres(grid),
        "processing:software": {"geomosaic": _version()},
        "proj:code": ":".join(code) if code else None,
        "proj:shape": list(grid.shape),
        "proj:transform": [t.a, t.b, t.c, t.d, t.e, t.f],
    }
    if code is None:
        properties["proj:projjson"] = horizontal(grid.crs).to_json_dict()
    if sources:
        rows = zip(*sources.values(), strict=True)
        properties["geomosaic:sources"] = [
            {"image": image.name, **{k: _plain(v) for k, v in zip(sources, row, strict=True)}}
            for image, row in zip(images, rows, strict=True)
        ]
    item = {
        "type": "Feature",
        "stac_version": "1.1.0",
        "stac_extensions": list(STAC_EXTENSIONS),
        "id": mosaic.stem,
        "geometry": geometry,
        **({"bbox": box} if box else {}),
        "properties": properties,
        "links": [],
        "assets": {
            key: _asset(file, kind, role, checksums.get(file) or sha256(file))
            for key, file, kind, role in (
                ("mosaic", mosaic, COG, "data"),
                ("labels", labels, COG, "metadata"),
                ("views", views, COG, "metadata"),
                ("seams", vectors, "application/geopackage+sqlite3", "metadata"),
            )
            if file is not None
        },
    }
    write_text(path, json.dumps(item, indent=2) + "\n", overwrite=overwrite)


def _asset(file: Path, kind: str, role: str, checksum: str) -> dict[str, Any]:
    return {
        "href": f"./{file.name}",
        "type": kind,
        "roles": [role],
        "file:size": file.stat().st_size,
        "file:checksum": "1220" + checksum,  # a multihash: SHA-256, 32 bytes
    }


def _outline(grid: Grid, outlines: list[Any]) -> tuple[dict[str, Any] | None, list[float] | None]:
    """GeoJSON of what the images cover, in longitude and latitude, and its bounds; None where the datum is unknown."""
    import shapely

    try:
        to_degrees = Transform(horizontal(grid.crs), parse_crs("OGC:CRS84"))
    except InputError:
        return None, None  # a STAC item may do without a place; the mosaic needs none

    hull = shapely.union_all(outlines)
    outer = hull if hull.geom_type == "Polygon" else hull.convex_hull
    ring = to_degrees(np.asarray(outer.exterior.coords)[:, :2])
    geometry: dict[str, Any] = shapely.geometry.mapping(shapely.Polygon(ring).normalize())
    return geometry, [float(v) for v in (*ring.min(axis=0), *ring.max(axis=0))]


def _metres(grid: Grid) -> float:
    """Pixel size in metres, along y at the middle of the grid."""
    middle = grid.xy(np.array([[grid.width / 2, grid.height / 2]]))[0]
    return float(grid.resolution[1] * metres_per_unit(grid.crs, middle)[1])


def _plain(value: Any) -> Any:
    """JSON knows no NaN."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _version() -> str:
    from geomosaic import __version__

    return __version__
