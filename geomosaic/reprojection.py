"""Vector files brought to another CRS, cut where its map does not show them, whole or not at all."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.projection_domain import Domain, domain
from geomosaic.geo.transform import Transform, operation_between
from geomosaic.raster.vector import VectorProduct
from geomosaic.raster.vector_copy import rewrite_layers
from geomosaic.types import BoolArray, FloatArray

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
    """
    return f"{source.name} to {target.name}: {operation_between(horizontal(source), horizontal(target)).text()}"


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

    Raises
    ------
    InputError
        The input cannot be read or has no CRS; the output is the input, its suffix is not known, or it cannot take
        several layers, or several kinds of geometry.
    OutputError
        Writing failed.
    """
    sources: list[CRS] = []
    lost, cut = 0, 0

    def change(frame: GeoDataFrame, name: str) -> GeoDataFrame:
        nonlocal lost, cut
        own = source or _own(frame, f"{path}, layer {name}")
        found, gone, pieces = _moved(frame, own, crs)
        if own not in sources:
            sources.append(own)
        lost, cut = lost + gone, cut + pieces
        return found

    nothing = InputError(
        f"none of the features has a place in {crs.name}", where=str(path),
        hint="their coordinates are not of the CRS that the file names: give the right one as `src_crs`",
    )  # fmt: skip
    layers = rewrite_layers(path, output, change, nothing, overwrite=overwrite)
    operation = "; ".join(operation_text(own, crs) for own in sources)
    return VectorResult(output, layers, lost, crs, cut, operation)


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
