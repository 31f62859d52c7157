"""Vector files brought to another CRS, whole under their final name or not at all."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.product.vector_cut import moved
from geomosaic.raster.output import check_output, partial, remove, sync
from geomosaic.raster.vector import append_layer, layer_names, read_layer

DRIVERS = {
    ".gpkg": "GPKG",
    ".geojson": "GeoJSON",
    ".json": "GeoJSON",
    ".fgb": "FlatGeobuf",
}
"""Formats that can be written, by suffix; a shapefile is several files, which cannot appear all at once."""
READ = (*DRIVERS, ".shp", ".osm", ".pbf", ".kml", ".gml", ".gpx", ".tab", ".mif", ".dxf")
_SEVERAL = ("GPKG",)


@dataclass(frozen=True)
class VectorResult:
    """What was made: layers with their numbers of features, features without a place in the new CRS, CRS met.

    `cut` is the number of features that the new map shows in pieces or in part.
    """

    path: Path
    layers: dict[str, int]
    lost: int
    sources: tuple[CRS, ...]
    cut: int = 0


def is_vector(path: Path) -> bool:
    """Whether a file's suffix is that of a vector file."""
    return path.suffix.lower() in READ


def reproject_vectors(
    path: Path, crs: CRS, output: Path, *, source: CRS | None = None, overwrite: bool = False
) -> VectorResult:
    """Bring all layers of a vector file to another CRS; attributes stay as they are.

    Vertices are transformed; straight lines between them stay straight. What reaches over the edge of the new map is
    cut there, see `vector_cut`.

    Parameters
    ----------
    path : Path
        GeoPackage, GeoJSON, FlatGeobuf, shapefile, OpenStreetMap, KML ...; layers without features are left out of what
        is written.
    crs : CRS
        Of the output.
    output : Path
        Its suffix says the format.
    source : CRS, optional
        Of the input, instead of what the file says.
    overwrite : bool
        Replace an existing output.

    Raises
    ------
    InputError
        The input cannot be read or has no CRS; the output's suffix is not known or cannot take several layers.
    OutputError
        Writing failed.
    """
    driver = DRIVERS.get(output.suffix.lower())
    if driver is None:
        raise InputError(
            f"'{output.suffix}' is no format of vectors that can be written",
            where=str(output),
            mend=f"end the name in {', '.join(DRIVERS)}",
        )
    check_output(output, overwrite=overwrite)
    names = layer_names(path)
    if len(names) > 1 and driver not in _SEVERAL:
        raise InputError(
            f"the file has {len(names)} layers, of which {driver} takes one", where=str(path), mend="write a .gpkg"
        )
    layers: dict[str, int] = {}
    sources: list[CRS] = []
    lost, cut = 0, 0
    unfinished = partial(output, output.suffix)
    try:
        for name in names:
            frame = read_layer(path, name)
            own = source or _own(frame, f"{path}, layer {name}")
            found, gone, pieces = _moved(frame, own, crs)
            if own not in sources:
                sources.append(own)
            append_layer(unfinished, found, name, driver)
            layers[name], lost, cut = len(found), lost + gone, cut + pieces
        sync(unfinished)
        unfinished.replace(output)
    finally:
        remove(unfinished)
    return VectorResult(output, layers, lost, tuple(sources), cut)


def _own(frame: Any, where: str) -> CRS:
    if frame.crs is None:
        raise InputError("the layer has no CRS", where=where, mend="name it with --src-crs")
    return CRS.from_user_input(frame.crs)


def _moved(frame: Any, own: CRS, crs: CRS) -> tuple[Any, int, int]:
    """Return the layer in the new CRS, how many features have no place there, and how many were cut."""
    import shapely

    before = np.asarray(frame.geometry.values)
    after, cut = moved(before, own, crs)
    finite = [g is None or bool(np.isfinite(shapely.get_coordinates(g)).all()) for g in after]
    known = np.array(finite, dtype=bool) & ~(shapely.is_empty(after) & ~shapely.is_empty(before))
    found = frame.set_geometry(after).set_crs(crs, allow_override=True)
    return found[known], int((~known).sum()), int((cut & known).sum())
