"""What goes with a mosaic: footprints and seamlines as vectors, and a STAC item."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj import CRS

from geomosaic.block.footprint import Footprint
from geomosaic.errors import OutputExistsError
from geomosaic.geo.crs import horizontal, parse_crs
from geomosaic.geo.grid import Grid
from geomosaic.geo.transform import Transform
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.raster.checksum import sha256
from geomosaic.raster.vector import write_layers

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

STAC_PROJECTION = "https://stac-extensions.github.io/projection/v2.0.0/schema.json"
STAC_FILE = "https://stac-extensions.github.io/file/v2.1.0/schema.json"


def write_vectors(
    path: Path,
    grid: Grid,
    outlines: list[Footprint],
    shares: list[Any],
    balance: Balance,
    pixels: list[int],
    *,
    overwrite: bool,
) -> None:
    """Write a GeoPackage with the layers `footprints`, `seams` (areas) and `seamlines` (what divides them)."""
    layers = {
        "footprints": _footprints(grid.crs, outlines, balance, pixels),
        "seams": _areas(grid.crs, outlines, shares),
        "seamlines": _lines(grid, outlines, shares),
    }
    write_layers(path, layers, overwrite=overwrite)


def _footprints(crs: CRS, outlines: list[Footprint], balance: Balance, pixels: list[int]) -> GeoDataFrame:
    import geopandas

    columns: dict[str, list[Any]] = {
        "label": list(range(1, len(outlines) + 1)),
        "image": [outline.name for outline in outlines],
        "centre_x": [outline.centre[0] for outline in outlines],
        "centre_y": [outline.centre[1] for outline in outlines],
        "sampling": [outline.sampling for outline in outlines],
        "complete": [outline.complete for outline in outlines],
        "pixels": pixels,
    }
    for band in range(balance.gain.shape[1]):
        columns[f"gain_{band + 1}"] = [float(value) for value in balance.gain[:, band]]
        columns[f"offset_{band + 1}"] = [float(value) for value in balance.offset[:, band]]
    return geopandas.GeoDataFrame(columns, geometry=[outline.polygon for outline in outlines], crs=crs.to_wkt())


def _areas(crs: CRS, outlines: list[Footprint], shares: list[Any]) -> GeoDataFrame:
    import geopandas

    kept = [i for i, share in enumerate(shares) if not share.is_empty]
    return geopandas.GeoDataFrame(
        {"label": [i + 1 for i in kept], "image": [outlines[i].name for i in kept]},
        geometry=[shares[i] for i in kept],
        crs=crs.to_wkt(),
    )


def _lines(grid: Grid, outlines: list[Footprint], shares: list[Any]) -> GeoDataFrame:
    import geopandas
    import shapely

    # A hair of width finds the common edge although the two were cut in floating point.
    hair = 1e-5 * grid.resolution[0]
    tree = shapely.STRtree(shares)
    first, second, lines = [], [], []
    for i, share in enumerate(shares):
        for j in sorted(int(k) for k in tree.query(share, predicate="dwithin", distance=hair)):
            if j <= i or shares[j].is_empty or share.is_empty:
                continue
            line = share.boundary.intersection(shares[j].buffer(hair))
            if line.length > 100 * hair:
                first.append(outlines[i].name)
                second.append(outlines[j].name)
                lines.append(shapely.line_merge(line) if line.geom_type != "LineString" else line)
    return geopandas.GeoDataFrame({"first": first, "second": second}, geometry=lines, crs=grid.crs.to_wkt())


def write_item(
    path: Path,
    mosaic: Path,
    labels: Path | None,
    vectors: Path | None,
    grid: Grid,
    outlines: list[Any],
    *,
    overwrite: bool,
) -> None:
    """Write a STAC item whose assets are the files beside it."""
    import pystac
    import shapely

    if path.exists() and not overwrite:
        raise OutputExistsError("the output exists", where=str(path), mend="choose another name, or give --overwrite")
    to_lonlat = Transform(horizontal(grid.crs), parse_crs("OGC:CRS84"))
    hull = shapely.union_all(outlines)
    outer = hull if hull.geom_type == "Polygon" else hull.convex_hull
    ring = to_lonlat(np.asarray(outer.exterior.coords)[:, :2])
    geometry = shapely.geometry.mapping(shapely.Polygon(ring).normalize())
    code = horizontal(grid.crs).to_authority()
    t = grid.transform
    item = pystac.Item(
        id=mosaic.stem,
        geometry=geometry,
        bbox=[float(v) for v in (*ring.min(axis=0), *ring.max(axis=0))],
        datetime=_when(),
        properties={
            "proj:code": ":".join(code) if code else None,
            "proj:shape": list(grid.shape),
            "proj:transform": [t.a, t.b, t.c, t.d, t.e, t.f],
            "gsd": grid.resolution[0],
            "processing:software": {"geomosaic": _version()},
        },
    )
    if code is None:
        item.properties["proj:projjson"] = horizontal(grid.crs).to_json_dict()
    item.stac_extensions += [STAC_PROJECTION, STAC_FILE]
    cog = pystac.MediaType.COG
    for key, file, kind, role in (
        ("mosaic", mosaic, cog, "data"),
        ("labels", labels, cog, "metadata"),
        ("seams", vectors, pystac.MediaType.GEOPACKAGE, "metadata"),
    ):
        if file is not None:
            facts = {"file:size": file.stat().st_size, "file:checksum": "1220" + sha256(file)}
            item.add_asset(key, pystac.Asset(href=f"./{file.name}", media_type=kind, roles=[role], extra_fields=facts))
    partial = path.with_name(f".{path.name}.partial-{os.getpid()}")
    partial.write_text(json.dumps(item.to_dict(include_self_link=False), indent=2) + "\n")
    partial.replace(path)


def _when() -> datetime:
    """Time of processing; SOURCE_DATE_EPOCH makes it repeatable."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    return datetime.fromtimestamp(int(epoch), UTC) if epoch else datetime.now(UTC).replace(microsecond=0)


def _version() -> str:
    from geomosaic import __version__

    return __version__
