"""What a map says of the ground: contours, spot heights, breaklines and water, read from vector files and tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.control.parsing import ground_crs, number, read_lines
from geomosaic.control.table import WORDS, comment_crs, rows
from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal, is_local
from geomosaic.geo.grid import Bounds
from geomosaic.geo.transform import Transform
from geomosaic.options.terrain import DtmOptions
from geomosaic.raster.vector import layer_names, plain_tables, read_layer
from geomosaic.types import FloatArray

# Columns that hold heights, in the order in which they are looked for.
HEIGHT_COLUMNS = ("height", "elevation", "elev", "ele", "contour", "level", "z", "hoehe", "altitude", "alt")
LINES, POINTS, AREAS = "LineString", "Point", "Polygon"


@dataclass(frozen=True, eq=False)
class TerrainData:
    """Heights of the ground as a map shows them; x, y in `crs`, heights in metres.

    Attributes
    ----------
    crs : CRS
    contours : list of array (N, 3)
        Vertices.
    spots : array (N, 3)
        Spot heights.
    names : tuple of str (N,)
        Of the spot heights.
    breaklines : list of array (N, 3)
        Vertices; z is NaN of lines without heights.
    water : list of (shapely Polygon, float)
        Lakes and their levels.
    """

    crs: CRS
    contours: list[FloatArray]
    spots: FloatArray
    names: tuple[str, ...]
    breaklines: list[FloatArray]
    water: list[tuple[Any, float]]

    @property
    def xy(self) -> FloatArray:
        """All places (N, 2)."""
        import shapely

        shores = [shapely.get_coordinates(area) for area, _ in self.water]
        parts = [*(line[:, :2] for line in (*self.contours, *self.breaklines)), self.spots[:, :2], *shores]
        return np.vstack(parts)

    @property
    def bounds(self) -> Bounds:
        """Left, bottom, right, top of all of it."""
        (left, bottom), (right, top) = self.xy.min(axis=0).tolist(), self.xy.max(axis=0).tolist()
        return left, bottom, right, top


def read_terrain(options: DtmOptions) -> TerrainData:
    """Terrain data from the files that the options name, in one CRS.

    Parameters
    ----------
    options : DtmOptions

    Raises
    ------
    InputError
        Nothing is given, a file has no heights or no such features, the CRS is not known or in degrees.
    """
    named = [path for path in (options.contours, options.points, options.breaklines, options.water) if path]
    if options.contours is None and options.points is None:
        raise InputError("nothing has heights of the ground", hint="give `contours` or `points`, or both")
    crs = ground_crs(None, options.crs, "`crs`") if options.crs else _crs_of(named)
    crs = horizontal(crs)
    if crs.is_geographic:
        raise InputError(
            f"a DTM in degrees has no cells of one size ('{crs.name}')",
            where=str(named[0]),
            hint="bring the vectors to a map first: geomosaic reproject FILE --dst-crs EPSG:...",
        )
    field = options.height_field
    contours = [line for line, _ in _features(options.contours, LINES, crs, field)]
    breaklines = [line for line, _ in _features(options.breaklines, LINES, crs, field, optional=True)]
    points = _features(options.points, POINTS, crs, field)
    spots = np.vstack([place for place, _ in points]) if points else np.empty((0, 3))
    lakes = [(ring, level) for ring, level in _features(options.water, AREAS, crs, field)]
    return TerrainData(crs, contours, spots, tuple(name for _, name in points), breaklines, lakes)


def _crs_of(paths: Sequence[Path]) -> CRS:
    """CRS of the first file that names one."""
    for path in paths:
        if path.suffix.lower() == ".csv":
            stated = comment_crs(read_lines(path))
            if stated:
                return ground_crs(stated, None, str(path))
        else:
            found = read_layer(path, _layers(path)[0]).crs
            if found is not None:
                return CRS.from_user_input(found)
    raise InputError("no file names its CRS", where=str(paths[0]), hint="name it as `crs`, such as EPSG:32633")


def _layers(path: Path) -> list[str]:
    names = layer_names(path)
    tables = plain_tables(path) if names else []
    found = [name for name in names if name not in tables]
    if not found:
        raise InputError("the file has no layer with places", where=str(path), hint="name another file")
    return found


def _features(
    path: Path | None, kind: str, crs: CRS, field: str | None, *, optional: bool = False
) -> list[tuple[Any, Any]]:
    """Simple features of a kind, of all layers of a file, with their heights.

    Lines (N, 3) and points (1, 3) with their names; areas with their level.
    """
    if path is None:
        return []
    if path.suffix.lower() == ".csv" and kind == POINTS:
        return _table(path, crs)
    import shapely

    out: list[tuple[Any, Any]] = []
    for layer in _layers(path):
        frame = read_layer(path, layer)
        flat = crs if frame.crs is None else horizontal(CRS.from_user_input(frame.crs))
        change = None if flat.equals(crs) else Transform(flat, crs)
        levels = _levels(frame, field, f"{path}, layer {layer}")
        for number_, (geometry, level) in enumerate(zip(frame.geometry.values, levels, strict=True), 1):
            for part in shapely.get_parts(shapely.get_parts(geometry)) if geometry is not None else ():
                if part.geom_type != kind or part.is_empty:
                    continue
                vertices = shapely.get_coordinates(part, include_z=True)
                if np.isfinite(level):
                    vertices[:, 2] = level
                elif not optional and not np.isfinite(vertices[:, 2]).all():
                    raise InputError(
                        f"feature {number_} has no height", where=f"{path}, layer {layer}",
                        hint="name the column of heights as `height_field`, or give its vertices a z",
                    )  # fmt: skip
                if change is not None:
                    vertices[:, :2] = change(vertices[:, :2])
                if kind == AREAS:
                    moved = part if change is None else shapely.transform(part, change)
                    out.append((shapely.force_2d(moved), float(np.median(vertices[:, 2]))))
                else:
                    out.append((vertices, f"{number_}"))
    if not out:
        what = {LINES: "lines", POINTS: "points", AREAS: "areas"}[kind]
        raise InputError(f"the file has no {what}", where=str(path), hint="name another file")
    return out


def _levels(frame: Any, field: str | None, where: str) -> FloatArray:
    """Heights of features by their column; NaN where there is none, and z of the vertices counts."""
    import pandas

    columns = {str(name).casefold(): name for name in frame.columns if name != frame.geometry.name}
    if field is not None:
        name = columns.get(field.casefold())
        if name is None:
            hint = f"the layer has: {', '.join(map(str, columns.values())) or 'none'}"
            raise InputError(f"there is no column '{field}'", where=where, hint=hint)
    else:
        name = next((columns[word] for word in HEIGHT_COLUMNS if word in columns), None)
    if name is None:
        return np.full(len(frame), np.nan)
    return np.asarray(pandas.to_numeric(frame[name], errors="coerce"), dtype=np.float64)


def _table(path: Path, crs: CRS) -> list[tuple[FloatArray, str]]:
    """Spot heights of a table with the columns x, y, z and optionally id."""
    lines = read_lines(path)
    header, body, _ = rows(lines, str(path))
    names = {other: word for word in ("id", "x", "y", "z") for other in (word, *WORDS[word])}
    column = {names[name]: at for at, name in enumerate(header) if name in names}
    missing = [name for name in ("x", "y", "z") if name not in column]
    if missing:
        what = f"spot heights need the column {missing[0]}; the header has {', '.join(header)}"
        raise InputError(what, where=str(path), hint="the header should read: id,x,y,z")
    stated = comment_crs(lines)
    own = crs if stated is None else horizontal(ground_crs(stated, None, str(path)))
    out = []
    for index, line in enumerate(body, 1):
        values = [number(line.fields[column[name]], name, line.origin) for name in ("x", "y", "z")]
        out.append((np.array([values]), line.fields[column["id"]] if "id" in column else str(index)))
    if out and not own.equals(crs) and not is_local(crs):
        change = Transform(own, crs)
        out = [(np.column_stack([change(place[:, :2]), place[:, 2]]), name) for place, name in out]
    return out
