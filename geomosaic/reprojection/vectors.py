"""Vector files brought to another CRS, whole under their final name or not at all."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pyproj import CRS

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.raster.output_files import check_output
from geomosaic.raster.vector import append_layer, layer_names, plain_tables, read_layer, read_table
from geomosaic.reprojection.vector_cut import moved
from geomosaic.whole_files import partial, remove, sync

if TYPE_CHECKING:
    from geopandas import GeoDataFrame


DRIVERS = {
    ".gpkg": "GPKG",
    ".geojson": "GeoJSON",
    ".json": "GeoJSON",
    ".fgb": "FlatGeobuf",
    ".shp": "ESRI Shapefile",
}
"""Formats that can be written, by suffix."""
PARTS = (".shx", ".dbf", ".prj", ".cpg", ".shp")
"""Files of a shapefile that is written, in the order in which they get their names: with the last one it is there."""
INDEXES = (".qix", ".sbn", ".sbx")
"""Spatial indexes of an older shapefile, which know nothing of a new one."""
READ = (*DRIVERS, ".osm", ".pbf", ".kml", ".gml", ".gpx", ".tab", ".mif", ".dxf")
_SEVERAL = ("GPKG",)


@dataclass(frozen=True)
class VectorResult:
    """Vector file in another CRS.

    Attributes
    ----------
    path : Path
    layers : dict of str to int
        Number of features by layer.
    lost : int
        Features without a place in the new CRS, left out.
    sources : tuple of CRS
        CRS of the layers read.
    cut : int
        Features that the new map shows in pieces or in part.
    """

    path: Path
    layers: dict[str, int]
    lost: int
    sources: tuple[CRS, ...]
    cut: int = 0


def is_vector(path: Path) -> bool:
    """Whether a file's suffix is that of a vector file.

    Parameters
    ----------
    path : Path

    Returns
    -------
    bool
    """
    return path.suffix.lower() in READ


def reproject_vectors(
    path: Path, crs: CRS, output: Path, *, source: CRS | None = None, overwrite: bool = False
) -> VectorResult:
    """All layers of a vector file in another CRS; attributes stay as they are.

    Vertices are transformed; straight lines between them stay straight. What reaches over the edge of the new map is
    cut there, see `vector_cut`.

    Parameters
    ----------
    path : Path
        GeoPackage, GeoJSON, FlatGeobuf, shapefile, OpenStreetMap, KML ... Layers without features stay so;
        tables without places are copied to a GeoPackage, and left out of other formats, with a note.
    crs : CRS
        Of the output.
    output : Path
        Its suffix says the format.
    source : CRS, optional
        Of the input, instead of what the file says.
    overwrite : bool
        Replace an existing output.

    Returns
    -------
    VectorResult

    Raises
    ------
    InputError
        The input cannot be read or has no CRS; the output is the input, its suffix is not known, or it cannot take
        several layers, or several kinds of geometry.
    OutputError
        Writing failed.
    """
    driver = DRIVERS.get(output.suffix.lower())
    if driver is None:
        raise InputError(
            f"'{output.suffix}' is no format of vectors that can be written",
            where=str(output),
            hint=f"end the name in {', '.join(DRIVERS)}",
        )
    for part in _files(output, driver):
        check_output(part, overwrite=overwrite, inputs=(path,))
    tables = plain_tables(path) if (names := layer_names(path)) else []
    names = [name for name in names if name not in tables]
    if not names:
        raise InputError("the file has no layer with places", where=str(path), hint="name another file")
    if len(names) > 1 and driver not in _SEVERAL:
        raise InputError(
            f"the file has {len(names)} layers, of which {driver} takes one", where=str(path), hint="write a .gpkg"
        )
    layers: dict[str, int] = {}
    sources: list[CRS] = []
    told: list[str] = []
    lost, cut = 0, 0
    unfinished = partial(output)
    # With the suffix of the output: GDAL names the parts of a shapefile after it.
    whole = unfinished.with_name(unfinished.name + output.suffix.lower())
    try:
        for name in names:
            frame = read_layer(path, name)
            own = source or _own(frame, f"{path}, layer {name}")
            found, gone, pieces = _moved(frame, own, crs)
            if own not in sources:
                sources.append(own)
            if driver == "ESRI Shapefile":
                _check_one_kind(found, f"{path}, layer {name}")
            told += append_layer(whole, found, output.stem if driver == "ESRI Shapefile" else name, driver)
            layers[name], lost, cut = len(found), lost + gone, cut + pieces
        if lost and not sum(layers.values()):
            raise InputError(
                f"none of the features has a place in {crs.name}", where=str(path),
                hint="their coordinates are not of the CRS that the file names: give the right one as `src_crs`",
            )  # fmt: skip
        for name in tables if driver in _SEVERAL else ():
            told += append_layer(whole, read_table(path, name), name, driver)
        _publish(whole, output, driver)
    finally:
        remove(unfinished)
    if tables and driver not in _SEVERAL:
        told.append(f"tables without places are left out: {', '.join(tables)}")
    for text in dict.fromkeys(told):
        warnings.warn(f"{output}: {text}", GeomosaicWarning, stacklevel=2)
    return VectorResult(output, layers, lost, tuple(sources), cut)


def _files(output: Path, driver: str) -> list[Path]:
    """All files that will be there under the name of the output, that one last."""
    return [output.with_suffix(end) for end in PARTS[:-1]] + [output] if driver == "ESRI Shapefile" else [output]


def _publish(whole: Path, output: Path, driver: str) -> None:
    """Give finished files their names; an older shapefile goes first, so that parts of two are never taken for one."""
    parts = _files(output, driver)
    if len(parts) > 1:
        for old in (output, *(output.with_suffix(end) for end in INDEXES)):
            old.unlink(missing_ok=True)
    for part in parts:
        made = whole.with_suffix(part.suffix.lower())
        if made.exists():
            sync(made)
            made.replace(part)


def _check_one_kind(frame: GeoDataFrame, where: str) -> None:
    kinds = {str(kind).removeprefix("Multi") if "Point" not in str(kind) else str(kind) for kind in frame.geom_type}
    kinds -= {"None", "nan"}
    if len(kinds) > 1:
        raise InputError(
            f"the layer holds {' and '.join(sorted(kinds))}, of which a shapefile takes one", where=where,
            hint="write a .gpkg",
        )  # fmt: skip


def _own(frame: GeoDataFrame, where: str) -> CRS:
    if frame.crs is None:
        raise InputError("the layer has no CRS", where=where, hint="name it with `src_crs`")
    return CRS.from_user_input(frame.crs)


def _moved(frame: GeoDataFrame, own: CRS, crs: CRS) -> tuple[GeoDataFrame, int, int]:
    """Layer in the new CRS, the number of features without a place there, and of those that were cut."""
    import shapely

    before = np.asarray(frame.geometry.values)
    after, cut = moved(before, own, crs)
    finite = [g is None or bool(np.isfinite(shapely.get_coordinates(g)).all()) for g in after]
    known = np.array(finite, dtype=bool) & ~(shapely.is_empty(after) & ~shapely.is_empty(before))
    found = frame.set_geometry(after).set_crs(crs, allow_override=True)
    return found[known], int((~known).sum()), int((cut & known).sum())
