"""Vector files brought to another CRS, cut where its map does not show them, whole or not at all."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.projection_domain import Domain, domain
from geomosaic.geo.transform import Transform, operation_between
from geomosaic.raster.files import check_output
from geomosaic.raster.vector import VectorProduct, append_layer, layer_names, plain_tables, read_layer, read_table
from geomosaic.types import BoolArray, FloatArray
from geomosaic.whole_files import partial, remove, sync

if TYPE_CHECKING:
    from geopandas import GeoDataFrame


# Degrees left out along a seam, which PROJ would count to the other side.
SLIVER = 1e-9
# Degrees between the vertices of a feature that was cut: the rim of a map is curved.
CLOSE = 1.0


def moved(geometries: Any, own: CRS, crs: CRS) -> tuple[Any, BoolArray]:
    """Geometries in another CRS, cut where they reach over the edge of its map.

    Parameters
    ----------
    geometries : array (N,) of shapely geometry or None
    own, crs : CRS
        Of the geometries, and of the new map; z stays as it is.

    Returns
    -------
    geometries : array (N,)
        Not finite, or empty, where a feature has no place in the new map.
    cut : bool array (N,)
        Which of them were cut.
    """
    # Vertices are transformed and lines between them stay straight. A feature that crosses the seam of the new map (the
    # meridian opposite to its centre), or reaches where the map has no end, is cut there and gets a vertex every
    # degree.
    import shapely

    straight = Transform(horizontal(own), horizontal(crs))
    geodetic = crs.geodetic_crs
    cut = np.zeros(len(geometries), dtype=bool)
    if geodetic is None or not (own.is_geographic or own.is_projected):
        return _over(geometries, straight), cut
    to_degrees = Transform(horizontal(own), horizontal(geodetic))
    whole, home = domain(crs), domain(own)
    degrees = shapely.transform(geometries, lambda xy: _plain(_unrolled(to_degrees(xy), own, home)))
    cut = ~_within(shapely.bounds(degrees), whole) & ~shapely.is_empty(degrees) & ~shapely.is_missing(degrees)
    out = _over(np.where(cut, None, geometries), straight)
    torn = np.zeros_like(cut) if whole.centre is not None else shapely.bounds(degrees)[:, 0] < SLIVER - 180.0
    if (cut | torn).any():
        to_map = Transform(horizontal(geodetic), horizontal(crs))
        for k in np.nonzero(cut | torn)[0]:
            here = _pieces(degrees[k], whole) if cut[k] else degrees[k]
            out[k] = shapely.transform(here, lambda xy, torn=torn[k]: _plain(to_map(_closed(xy) if torn else xy)))
    return _mended(geometries, out), cut


def _over(geometries: Any, transform: Transform) -> Any:
    """Transform x and y; z, where there is one, stays."""
    import shapely

    out = shapely.transform(geometries, lambda xy: _plain(transform(xy)))
    deep = shapely.has_z(geometries)
    if deep.any():
        out[deep] = shapely.transform(
            geometries[deep], lambda xyz: np.column_stack([_plain(transform(xyz[:, :2])), xyz[:, 2]]), include_z=True
        )
    return out


def _plain(xy: FloatArray) -> FloatArray:
    """Infinity where there is no place: rings of NaN would not count as closed."""
    xy[np.isnan(xy).any(axis=1)] = np.inf
    return xy


def _unrolled(lonlat: FloatArray, own: CRS, home: Domain) -> FloatArray:
    """Longitudes without a jump within the old map; those of a geographic CRS are as they are."""
    if own.is_projected and home.centre is not None:
        lonlat[:, 0] = home.centre + (lonlat[:, 0] - home.centre + 180.0) % 360.0 - 180.0
    return lonlat


def _closed(lonlat: FloatArray) -> FloatArray:
    """The date line once, where a map shows both its sides side by side: sines of ±180 degrees differ by a hair."""
    lonlat[np.abs(np.abs(lonlat[:, 0]) - 180.0) < SLIVER, 0] = 180.0
    return lonlat


def _within(bounds: FloatArray, whole: Domain) -> BoolArray:
    """Whether a map shows all of what has these bounds (left, bottom, right, top), degrees."""
    inside: BoolArray = (bounds[:, 1] >= whole.south) & (bounds[:, 3] <= whole.north)
    if whole.centre is None:
        return inside
    limit = whole.reach - SLIVER
    return inside & (bounds[:, 0] >= whole.centre - limit) & (bounds[:, 2] <= whole.centre + limit)


def _pieces(geometry: Any, whole: Domain) -> Any:
    """What lies within the map, each turn of the globe brought to the same one and joined again."""
    import shapely

    if not shapely.is_valid(geometry):
        geometry = shapely.make_valid(geometry)
    # Without a centre the map has no seam and shows all longitudes, as about a pole; 540 degrees hold three turns.
    middle, reach = (0.0, 540.0) if whole.centre is None else (whole.centre, whole.reach - SLIVER)
    found = []
    for turn in (0.0,) if whole.centre is None else (-360.0, 0.0, 360.0):
        box = shapely.box(middle - reach + turn, whole.south, middle + reach + turn, whole.north)
        piece = shapely.intersection(geometry, box)
        if not piece.is_empty:
            found.append(shapely.transform(piece, lambda xy, turn=turn: xy - (turn, 0.0)))
    joined = shapely.union_all(_alike(found, shapely.get_dimensions(geometry)))
    if joined.geom_type == "MultiLineString":
        joined = shapely.line_merge(joined)
    return shapely.segmentize(joined, CLOSE)


def _alike(pieces: list[Any], dimension: int) -> list[Any]:
    """Parts of a dimension: an area that only touches the edge leaves a line there."""
    import shapely

    parts = [part for piece in pieces for part in shapely.get_parts(shapely.get_parts(piece))]
    return [part for part in parts if shapely.get_dimensions(part) == dimension]


def _mended(before: Any, after: Any) -> Any:
    """Areas that touch themselves only in the new map, as along the meridian that leads to a pole, made simple."""
    import shapely

    areas = (shapely.get_dimensions(after) == 2) & ~shapely.is_valid(after)
    for k in np.nonzero(areas)[0]:
        if np.isfinite(shapely.get_coordinates(after[k])).all() and shapely.is_valid(before[k]):
            after[k] = shapely.union_all(_alike([shapely.make_valid(after[k])], 2))
    return after


# Formats that can be written, by suffix.
DRIVERS = {
    ".gpkg": "GPKG",
    ".geojson": "GeoJSON",
    ".json": "GeoJSON",
    ".fgb": "FlatGeobuf",
    ".shp": "ESRI Shapefile",
}
# Files of a shapefile that is written, in the order in which they get their names: with the last one it is there.
PARTS = (".shx", ".dbf", ".prj", ".cpg", ".shp")
# Spatial indexes of an older shapefile, which know nothing of a new one.
INDEXES = (".qix", ".sbn", ".sbx")
READ = (*DRIVERS, ".osm", ".pbf", ".kml", ".gml", ".gpx", ".tab", ".mif", ".dxf")
_SEVERAL = ("GPKG",)


@dataclass(frozen=True)
class VectorResult(VectorProduct):
    """Vector file in another CRS; `read` gives its layers.

    Attributes
    ----------
    path : Path
    layers : dict of str to int
        Number of features by layer.
    lost : int
        Features without a place in the new CRS, left out.
    crs : CRS
        Of the output.
    cut : int
        Features that the new map shows in pieces or in part.
    operation : str
        How PROJ goes from one CRS to the other, with its accuracy.
    """

    path: Path
    layers: dict[str, int]
    lost: int
    crs: CRS
    cut: int
    operation: str


def operation_text(source: CRS, target: CRS) -> str:
    """Operation between two CRS in words: its name, its accuracy, and what a better one needs.

    Parameters
    ----------
    source, target : CRS

    Returns
    -------
    str
    """
    return f"{source.name} to {target.name}: {operation_between(horizontal(source), horizontal(target)).text()}"


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
    notes: list[str] = []
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
            notes += append_layer(whole, found, output.stem if driver == "ESRI Shapefile" else name, driver)
            layers[name], lost, cut = len(found), lost + gone, cut + pieces
        if lost and not sum(layers.values()):
            raise InputError(
                f"none of the features has a place in {crs.name}", where=str(path),
                hint="their coordinates are not of the CRS that the file names: give the right one as `src_crs`",
            )  # fmt: skip
        for name in tables if driver in _SEVERAL else ():
            notes += append_layer(whole, read_table(path, name), name, driver)
        _publish(whole, output, driver)
    finally:
        remove(unfinished)
    if tables and driver not in _SEVERAL:
        notes.append(f"tables without places are left out: {', '.join(tables)}")
    for text in dict.fromkeys(notes):
        warnings.warn(f"{output}: {text}", GeomosaicWarning, stacklevel=2)
    operation = "; ".join(operation_text(own, crs) for own in sources)
    return VectorResult(output, layers, lost, crs, cut, operation)


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
