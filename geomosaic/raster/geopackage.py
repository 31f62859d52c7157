"""Features of a GeoPackage's layer with their row numbers, and edits of them in one transaction of its database.

A file that another program may have open is not replaced: its write-ahead journal, which stands beside it, would be
taken for that of the new one. SQLite's own transaction is whole or not at all, waits for that program, and is seen by
it. The layout of a geometry and the functions that triggers of the spatial index call are those of OGC 12-128r18.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from pyproj import CRS

from geomosaic.errors import InputError, OutputError
from geomosaic.raster.attributes import EMPTY, Field, field_of, read_value
from geomosaic.raster.files import check_output
from geomosaic.raster.vector import Layer, write_layers

# Seconds that an edit waits for another program to end its own.
_PATIENCE = 2.0
# Bytes before the WKB of a geometry, by the kind of its envelope.
_ENVELOPES = {0: 0, 1: 32, 2: 48, 3: 48, 4: 64}


@dataclass(frozen=True)
class Feature:
    """Geometry, and attributes by name.

    Attributes
    ----------
    geometry : shapely geometry or None
    values : mapping
        Text, numbers and None; dates as ISO 8601 has them.
    """

    geometry: Any
    values: Mapping[str, Any]


@dataclass(frozen=True)
class FeatureTable:
    """Layer of a GeoPackage.

    Attributes
    ----------
    kind : str
        Geometry type in capitals: POINT, MULTIPOLYGON, GEOMETRY, ...
    heights : bool
        Whether vertices may have heights.
    crs : CRS or None
    fields : tuple of Field
    features : dict of int to Feature
        By row number.
    """

    kind: str
    heights: bool
    crs: CRS | None
    fields: tuple[Field, ...]
    features: dict[int, Feature]


@dataclass(frozen=True)
class FeatureChange:
    """Feature before and after an edit.

    Attributes
    ----------
    id : int
        Row number.
    before, after : Feature or None
        None where there is none.
    """

    id: int
    before: Feature | None
    after: Feature | None

    @property
    def reverse(self) -> FeatureChange:
        """The change that takes this one back."""
        return FeatureChange(self.id, self.after, self.before)


class FeatureConflict(InputError):
    """Features that are neither as they were before an edit nor as it leaves them.

    Attributes
    ----------
    ids : tuple of int
    """

    def __init__(self, ids: Sequence[int], where: str) -> None:
        self.ids = tuple(ids)
        names = ", ".join(map(str, ids))
        super().__init__(
            f"another program has changed feature {names} meanwhile: nothing was saved",
            where=where,
            hint="look at what it is now, and repeat the edit",
        )


def feature_layers(path: Path) -> list[str]:
    """Names of the layers of features of a GeoPackage.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        The file is missing or no GeoPackage.
    """
    with _database(path) as database:
        query = "SELECT table_name FROM gpkg_contents WHERE data_type = 'features' ORDER BY table_name"
        return [name for (name,) in database.execute(query)]


def read_features(path: Path, layer: str, most: int) -> FeatureTable:
    """Features of a layer.

    Parameters
    ----------
    path : Path
    layer : str
    most : int
        Features that are read at most.

    Raises
    ------
    InputError
        The file is missing or no GeoPackage, has no such layer, more features, or a geometry that cannot be read.
    """
    with _database(path) as database:
        table = _Table.of(database, path, layer)
        fields = table.fields
        columns = ", ".join(_quoted(name) for name in (table.key, table.geometry, *(field.name for field in fields)))
        rows = database.execute(f"SELECT {columns} FROM {_quoted(layer)} ORDER BY 1 LIMIT ?", (most + 1,)).fetchall()
        if len(rows) > most:
            raise InputError(
                f"the layer has more than {most:,} features",
                where=table.where,
                hint="cut it into parts, for example in QGIS",
            )
        found = {key: table.feature(blob, values, fields) for key, blob, *values in rows}
        return FeatureTable(table.kind, table.heights, _crs_of(database, table.srs), fields, found)


def edit_features(path: Path, layer: str, changes: Sequence[FeatureChange]) -> None:
    """Make changes of features, all or none; those that are made already are left.

    Parameters
    ----------
    path : Path
    layer : str
    changes : sequence of FeatureChange

    Raises
    ------
    FeatureConflict
        Another program has changed a feature.
    InputError
        The file is no GeoPackage any more, or an attribute is not allowed.
    OutputError
        Another program holds the file, the disk is full, or the file cannot be written.
    """
    with _database(path, write=True) as database:
        table = _Table.of(database, path, layer)
        now = {change.id: _row(database, table, change.id) for change in changes}
        todo = [change for change in changes if not same_feature(now[change.id], change.after)]
        if conflicting := [change.id for change in todo if not same_feature(now[change.id], change.before)]:
            raise FeatureConflict(conflicting, table.where)
        for change in todo:
            _make(database, table, change)
        if todo:
            _note_extent(database, layer, [one.after.geometry for one in todo if one.after is not None])


def next_ids(path: Path, layer: str, count: int) -> list[int]:
    """Row numbers that no feature has had, as far as the file knows.

    Parameters
    ----------
    path : Path
    layer : str
    count : int
    """
    with _database(path) as database:
        table = _Table.of(database, path, layer)
        (largest,) = database.execute(f"SELECT max({_quoted(table.key)}) FROM {_quoted(layer)}").fetchone()
        kept = database.execute("SELECT 1 FROM sqlite_master WHERE name = 'sqlite_sequence'").fetchone()
        used = kept and database.execute("SELECT seq FROM sqlite_sequence WHERE name = ?", (layer,)).fetchone()
        first = max(largest or 0, used[0] if used else 0) + 1
        return list(range(first, first + count))


def create_layer(path: Path, layer: str, kind: str, crs: CRS, fields: Sequence[Field]) -> None:
    """GeoPackage with one empty layer.

    Parameters
    ----------
    path : Path
    layer : str
    kind : str
        'Point', 'LineString' or 'Polygon'.
    crs : CRS
        Of the map, 2-D.
    fields : sequence of Field

    Raises
    ------
    OutputExistsError, OutputError
        There is such a file, or it cannot be written.
    """
    check_output(path, overwrite=False)
    columns: dict[str, Any] = {one.name: np.array([], dtype=EMPTY.get(one.kind, object)) for one in fields}
    write_layers(path, {layer: Layer(crs, kind, [], columns)})


def same_feature(one: Feature | None, other: Feature | None) -> bool:
    """Whether two features have the same vertices and attributes.

    Parameters
    ----------
    one, other : Feature or None
    """
    if one is None or other is None:
        return one is other
    return dict(one.values) == dict(other.values) and _wkb(one.geometry) == _wkb(other.geometry)


def _wkb(geometry: Any) -> bytes | None:
    return None if geometry is None else shapely.to_wkb(geometry, byte_order=1, flavor="iso")


@dataclass(frozen=True)
class _Table:
    """Columns of a layer's table."""

    path: Path
    name: str
    key: str
    geometry: str
    kind: str
    heights: bool
    srs: int
    fields: tuple[Field, ...]

    @classmethod
    def of(cls, database: sqlite3.Connection, path: Path, layer: str) -> _Table:
        query = "SELECT column_name, geometry_type_name, z, srs_id FROM gpkg_geometry_columns WHERE table_name = ?"
        found = database.execute(query, (layer,)).fetchone()
        columns = database.execute(f"PRAGMA table_info({_quoted(layer)})").fetchall()
        keys = [name for _, name, kind, _, _, key in columns if key == 1 and kind.upper() == "INTEGER"]
        if found is None or not keys:
            raise InputError(
                f"there is no layer '{layer}'", where=path.name, hint="another program may have renamed it"
            )
        geometry, kind, z, srs = found
        fields = (field_of(name, kind) for _, name, kind, _, _, _ in columns if name not in (keys[0], geometry))
        known = tuple(field for field in fields if field is not None)
        return cls(path, layer, keys[0], geometry, kind.upper(), bool(z), srs, known)

    @property
    def where(self) -> str:
        return f"{self.path.name}, layer {self.name}"

    def feature(self, blob: bytes | None, values: Sequence[Any], fields: Sequence[Field]) -> Feature:
        try:
            geometry = None if blob is None else _geometry(blob)
        except (ValueError, struct.error, shapely.errors.ShapelyError) as error:
            raise InputError(
                f"a geometry cannot be read ({error})", where=self.where, hint="mend it, for example in QGIS"
            ) from error
        return Feature(
            geometry, {field.name: read_value(value, field) for field, value in zip(fields, values, strict=True)}
        )


def _geometry(blob: bytes) -> Any:
    if blob[:2] != b"GP":
        raise ValueError("no geometry of a GeoPackage")
    return shapely.from_wkb(blob[8 + _ENVELOPES.get((blob[3] >> 1) & 7, 0) :])


def _blob(geometry: Any, srs: int) -> bytes | None:
    if geometry is None:
        return None
    enveloped = not geometry.is_empty and geometry.geom_type != "Point"
    flags = 1 | (2 if enveloped else 0) | (16 if geometry.is_empty else 0)
    left, bottom, right, top = geometry.bounds if enveloped else (0.0,) * 4
    envelope = struct.pack("<4d", left, right, bottom, top) if enveloped else b""
    return struct.pack("<2sBBi", b"GP", 0, flags, srs) + envelope + (_wkb(geometry) or b"")


def _crs_of(database: sqlite3.Connection, srs: int) -> CRS | None:
    query = "SELECT organization, organization_coordsys_id, definition FROM gpkg_spatial_ref_sys WHERE srs_id = ?"
    found = database.execute(query, (srs,)).fetchone()
    if found is None or srs in (-1, 0):
        return None
    organization, code, definition = found
    for text in ((f"{organization}:{code}",) if organization.upper() in ("EPSG", "ESRI") else ()) + (definition,):
        try:
            return CRS.from_user_input(text)
        except Exception:  # whatever PROJ makes of the text of another program
            continue
    return None


def _row(database: sqlite3.Connection, table: _Table, key: int) -> Feature | None:
    columns = ", ".join(_quoted(name) for name in (table.geometry, *(field.name for field in table.fields)))
    query = f"SELECT {columns} FROM {_quoted(table.name)} WHERE {_quoted(table.key)} = ?"
    found = database.execute(query, (key,)).fetchone()
    return None if found is None else table.feature(found[0], found[1:], table.fields)


def _make(database: sqlite3.Connection, table: _Table, change: FeatureChange) -> None:
    """Write one row; columns that the page does not know keep what they have."""
    after, name, key = change.after, _quoted(table.name), _quoted(table.key)
    if after is None:
        database.execute(f"DELETE FROM {name} WHERE {key} = ?", (change.id,))
        return
    columns: dict[str, Any] = dict(after.values)
    if change.before is None or _wkb(change.before.geometry) != _wkb(after.geometry):
        columns[table.geometry] = _blob(after.geometry, table.srs)
    if change.before is None:
        columns[table.key] = change.id
        names, marks = ", ".join(map(_quoted, columns)), ", ".join("?" * len(columns))
        database.execute(f"INSERT INTO {name} ({names}) VALUES ({marks})", tuple(columns.values()))
    elif columns:
        sets = ", ".join(f"{_quoted(column)} = ?" for column in columns)
        database.execute(f"UPDATE {name} SET {sets} WHERE {key} = ?", (*columns.values(), change.id))


def _note_extent(database: sqlite3.Connection, layer: str, geometries: Sequence[Any]) -> None:
    """Extent and time of change in the table of contents; the extent may be larger than what the layer holds."""
    moment = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S.000Z")
    database.execute("UPDATE gpkg_contents SET last_change = ? WHERE table_name = ?", (moment, layer))
    there = [one for one in geometries if one is not None and not one.is_empty]
    if not there:
        return
    query = "SELECT min_x, min_y, max_x, max_y FROM gpkg_contents WHERE table_name = ?"
    before = database.execute(query, (layer,)).fetchone()
    boxes = [shapely.total_bounds(there).tolist(), *([list(before)] if None not in before else [])]
    extent = *np.min(boxes, axis=0)[:2].tolist(), *np.max(boxes, axis=0)[2:].tolist()
    database.execute(
        "UPDATE gpkg_contents SET min_x = ?, min_y = ?, max_x = ?, max_y = ? WHERE table_name = ?", (*extent, layer)
    )


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


@contextmanager
def _database(path: Path, *, write: bool = False) -> Iterator[sqlite3.Connection]:
    """Database of a file, in one transaction."""
    if not path.is_file():
        raise InputError("the file is gone", where=path.name, hint="bring it back, or choose another layer")
    failing = OutputError if write else InputError
    try:
        with closing(sqlite3.connect(path, timeout=_PATIENCE, isolation_level=None)) as database:
            if write:
                _add_functions(database)
            database.execute("BEGIN IMMEDIATE" if write else "BEGIN")
            try:
                yield database
            except BaseException:
                database.rollback()
                raise
            database.commit()
    except sqlite3.IntegrityError as error:
        raise InputError(
            f"the layer does not allow this ({error})", where=path.name, hint="change the attributes"
        ) from error
    except sqlite3.Error as error:
        what, hint = "the GeoPackage cannot be read", "check the file and the rights of its folder"
        if write:
            what, hint = "the GeoPackage cannot be written", "check the space on the disk and the rights of the folder"
        if "locked" in str(error):
            what, hint = "another program is writing the file", "end its edits there"
        raise failing(f"{what} ({error})", where=path.name, hint=hint) from error


def _add_functions(database: sqlite3.Connection) -> None:
    """Functions of the standard's triggers, which keep the spatial index."""

    def bound(index: int) -> Any:
        def of(blob: bytes | None) -> float | None:
            found = None if blob is None else _geometry(blob)
            return None if found is None or found.is_empty else float(found.bounds[index])

        return of

    for index, name in enumerate(("ST_MinX", "ST_MinY", "ST_MaxX", "ST_MaxY")):
        database.create_function(name, 1, bound(index), deterministic=True)
    database.create_function(
        "ST_IsEmpty", 1, lambda blob: None if blob is None else int(_geometry(blob).is_empty), deterministic=True
    )
