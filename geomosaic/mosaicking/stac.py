"""STAC records of a mosaic: an item, or a collection with an item for each of its tiles."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.digests import sha256
from geomosaic.errors import InputError, counted
from geomosaic.geo.crs import horizontal, parse_crs
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import metres_per_unit
from geomosaic.mosaicking.kept_tiles import WrittenTile
from geomosaic.mosaicking.outputs import MosaicFiles
from geomosaic.mosaicking.provenance import time_span
from geomosaic.raster.files import check_output, write_text

STAC_EXTENSIONS = (
    "https://stac-extensions.github.io/projection/v2.0.0/schema.json",
    "https://stac-extensions.github.io/file/v2.1.0/schema.json",
    "https://stac-extensions.github.io/processing/v1.2.0/schema.json",
)
COG = "image/tiff; application=geotiff; profile=cloud-optimized"
VRT = "application/xml"


def write_item(
    files: MosaicFiles,
    grid: Grid,
    shapes: list[Any],
    images: list[Path],
    checksums: Mapping[Path, str],
    facts: Mapping[str, Sequence[Any]] | None = None,
    *,
    overwrite: bool,
) -> None:
    """STAC item (version 1.1) whose assets are the mosaic and its companions.

    Its times are the span in which the images were taken, see `provenance.time_span`; `geomosaic:times` says how it is
    known. Equal runs make equal bytes.

    Parameters
    ----------
    files : MosaicFiles
        `item` is written; the others are assets.
    grid : Grid
        Of the mosaic.
    shapes : list of Polygon or MultiPolygon
        Valid outlines of the images, in the map of the mosaic.
    images : list of Path
    checksums : mapping of Path to str
        SHA-256 of files, as far as known.
    facts : mapping of str to sequence, optional
        Columns of facts by image, for the property `geomosaic:sources`.
    overwrite : bool

    Raises
    ------
    OutputExistsError, OutputError
        The name is taken; writing failed.
    """
    assert files.item is not None
    check_output(files.item, overwrite=overwrite)
    properties = {**_common_properties(grid, images, facts), **_place(grid)}
    if facts:
        rows = zip(*facts.values(), strict=True)
        properties["geomosaic:sources"] = [
            {"image": image.name, **{k: _json_number(v) for k, v in zip(facts, row, strict=True)}}
            for image, row in zip(images, rows, strict=True)
        ]
    item = _item(files, _outline(grid, shapes), properties, _assets(files, checksums), [])
    write_text(files.item, json.dumps(item, indent=2) + "\n", overwrite=overwrite)


def write_collection(
    files: MosaicFiles,
    grid: Grid,
    shapes: list[Any],
    images: list[Path],
    tiles: Mapping[Window, tuple[MosaicFiles, WrittenTile]],
    facts: Mapping[str, Sequence[Any]],
    *,
    overwrite: bool,
) -> None:
    """STAC collection (version 1.1) of a mosaic in tiles, with an item beside each tile.

    Parameters
    ----------
    files, grid, shapes, images, facts, overwrite
        As for `write_item`.
    tiles : mapping of Window to (MosaicFiles, WrittenTile)
        Each tile by its place in the grid.

    Raises
    ------
    OutputExistsError, OutputError
        The name is taken; writing failed.
    """
    import shapely

    assert files.item is not None
    common, root = _common_properties(grid, images, facts), f"../{files.item.name}"
    up = [{"rel": rel, "href": root, "type": "application/json"} for rel in ("root", "parent", "collection")]
    # What all images show together, clipped to each tile, would take time as tiles times images.
    near, links = shapely.STRtree(shapes), []
    for window, (own, written) in tiles.items():
        assert own.item is not None
        part = grid.crop(window)
        box = shapely.box(*part.bounds)
        seen = shapely.union_all([shapely.intersection(shapes[i], box) for i in sorted(near.query(box))])
        outline = _outline(part, [seen if seen.area > 0 else box])
        sums = {own.mosaic.parent / name: str(known[2]) for name, known in written.files.items()}
        item = _item(own, outline, {**common, **_place(part)}, _assets(own, sums), up)
        item["collection"] = files.mosaic.stem
        write_text(own.item, json.dumps(item, indent=2) + "\n", overwrite=overwrite)
        links.append({"rel": "item", "href": f"./{files.folder.name}/{own.item.name}", "type": "application/geo+json"})
    _, bounds = _outline(grid, shapes)
    span = [common["start_datetime"], common["end_datetime"]]
    collection = {
        "type": "Collection",
        "stac_version": "1.1.0",
        "stac_extensions": list(STAC_EXTENSIONS[1:]),
        "id": files.mosaic.stem,
        "description": f"Mosaic of {counted(len(images), 'image')} in {counted(len(tiles), 'tile')}",
        "license": "other",
        "extent": {
            "spatial": {"bbox": [bounds or [-180.0, -90.0, 180.0, 90.0]]},
            "temporal": {"interval": [span]},
        },
        "links": [{"rel": "root", "href": f"./{files.item.name}", "type": "application/json"}, *links],
        "assets": _assets(files, {}),
    }
    write_text(files.item, json.dumps(collection, indent=2) + "\n", overwrite=overwrite)


def _common_properties(grid: Grid, images: list[Path], facts: Mapping[str, Sequence[Any]] | None) -> dict[str, Any]:
    """Properties of all items of a mosaic: times and pixel size."""
    start, end, known = time_span([str(text) for text in (facts or {}).get("acquired", ())], images)
    first, last = (f"{time:%Y-%m-%dT%H:%M:%SZ}" for time in (start, end))
    return {
        # STAC wants null where a span is given instead.
        "datetime": last if first == last else None,
        "start_datetime": first,
        "end_datetime": last,
        "geomosaic:times": known,
        "gsd": _metres(grid),
        "processing:software": {"geomosaic": _version()},
    }


def _place(grid: Grid) -> dict[str, Any]:
    """CRS and place of a raster, by the extension `projection`."""
    code, t = horizontal(grid.crs).to_authority(), grid.transform
    return {
        "proj:code": ":".join(code) if code else None,
        "proj:shape": list(grid.shape),
        "proj:transform": [t.a, t.b, t.c, t.d, t.e, t.f],
        **({} if code else {"proj:projjson": horizontal(grid.crs).to_json_dict()}),
    }


def _item(
    files: MosaicFiles,
    outline: tuple[dict[str, Any] | None, list[float] | None],
    properties: Mapping[str, Any],
    assets: Mapping[str, Any],
    links: list[dict[str, str]],
) -> dict[str, Any]:
    """Item of a raster with its companions."""
    geometry, box = outline
    return {
        "type": "Feature",
        "stac_version": "1.1.0",
        "stac_extensions": list(STAC_EXTENSIONS),
        "id": files.mosaic.stem,
        "geometry": geometry,
        **({"bbox": box} if box else {}),
        "properties": properties,
        "links": links,
        "assets": assets,
    }


def _assets(files: MosaicFiles, checksums: Mapping[Path, str]) -> dict[str, Any]:
    """Assets by name: the files that there are, each with its checksum."""
    raster, package = VRT if files.tiled else COG, "application/geopackage+sqlite3"
    kinds = (
        ("mosaic", files.mosaic, raster, "data"),
        ("index", files.index if files.tiled else None, package, "metadata"),
        ("labels", files.labels, raster, "metadata"),
        ("views", files.views, COG, "metadata"),
        ("displacement", files.displacement, COG, "metadata"),
        ("accuracy", files.accuracy, COG, "metadata"),
        ("seams", files.vectors, package, "metadata"),
    )
    return {
        key: _asset(file, kind, role, checksums.get(file) or sha256(file))
        for key, file, kind, role in kinds
        if file is not None
    }


def _asset(file: Path, kind: str, role: str, checksum: str) -> dict[str, Any]:
    return {
        "href": f"./{file.name}",
        "type": kind,
        "roles": [role],
        "file:size": file.stat().st_size,
        "file:checksum": "1220" + checksum,  # a multihash: SHA-256, 32 bytes
    }


def _outline(grid: Grid, shapes: list[Any]) -> tuple[dict[str, Any] | None, list[float] | None]:
    """GeoJSON of the covered ground in longitude and latitude, and its bounds; None where the datum is unknown."""
    import shapely

    try:
        to_degrees = Transform(horizontal(grid.crs), parse_crs("OGC:CRS84"))
    except InputError:
        return None, None  # a STAC item may have no geometry, and a mosaic needs none

    hull = shapely.union_all(shapes)
    # A block in several parts is found by the hull of all.
    outer = hull if hull.geom_type == "Polygon" else hull.convex_hull
    ring = to_degrees(np.asarray(outer.exterior.coords)[:, :2])
    geometry: dict[str, Any] = shapely.geometry.mapping(shapely.Polygon(ring).normalize())
    return geometry, [float(v) for v in (*ring.min(axis=0), *ring.max(axis=0))]


def _metres(grid: Grid) -> float:
    """Pixel size in metres, along y at the middle of the grid."""
    middle = grid.xy(np.array([[grid.width / 2, grid.height / 2]]))[0]
    return float(grid.resolution[1] * metres_per_unit(grid.crs, middle)[1])


def _json_number(value: Any) -> Any:
    """Value, or None for NaN and infinity, which JSON does not know."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _version() -> str:
    from geomosaic import __version__

    return __version__
