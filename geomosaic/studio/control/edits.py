"""Edits of the control table of an image, each one step of the history."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.control.edit import ControlText, TableRow
from geomosaic.errors import InputError
from geomosaic.geo.crs import has_heights, horizontal
from geomosaic.studio.control.places import ground_under, map_frame
from geomosaic.studio.control.station import Station, Stations
from geomosaic.studio.control.table import number, row_of, rows_of, table_crs
from geomosaic.studio.history import text_of
from geomosaic.studio.workspace import Workspace

# Decimals of image and ground coordinates that are written.
_PIXEL, _GROUND, _DEGREE = 3, 3, 9


class TableEdits:
    """Edits of control tables."""

    def __init__(self, workspace: Workspace, stations: Stations) -> None:
        self._workspace, self._stations = workspace, stations

    def add(self, layer: str, values: Mapping[str, Any]) -> str:
        """Add a point to the image's table.

        Parameters
        ----------
        layer : str
        values : mapping
            `col` and `row` of the image; `x` and `y` (and `z`), or `layer`, `map_col` and `map_row`; `id` and `role`
            optionally.

        Returns
        -------
        str
            Its name.
        """
        station = self._stations.find(layer)
        with self._workspace.history.lock:
            text = text_of(station.table)
            table = ControlText.of(text)
            taken = {row.values.get("id", "") for row in table.rows}
            own = {row.values.get("id", "") for row in rows_of(table, station)}
            name = str(values.get("id") or "").strip() or _free_name(taken)
            if table.qgis:
                name = str(len(table.rows))
            if name in own:
                raise InputError(f"point '{name}' is measured in {station.path.name} already", hint="give another name")
            fields = {"id": name, "image": station.path.name, **self._fields(station, table, values)}
            if missing := {"x", "y", "col", "row"} - fields.keys():
                raise InputError(f"the point has no {', '.join(sorted(missing))}", hint="give both of its places")
            if text is None and station.crs is not None:
                table = replace(table, lines=(f"#CRS: {_crs_code(station.crs)}", *table.lines), header=table.header + 1)
            self._save(f"point {name} measured in {station.path.name}", station, text, table.with_row(None, fields))
        return name

    def change(self, layer: str, name: str, values: Mapping[str, Any]) -> None:
        """Change a point of the image's table.

        Parameters
        ----------
        layer, name : str
        values : mapping
            Any of those of `add`, `enabled`, and `was`: column and row of the point as it was told.
        """
        station = self._stations.find(layer)
        with self._workspace.history.lock:
            text = text_of(station.table)
            table = ControlText.of(text)
            row = _row(table, station, name, values)
            fields = self._fields(station, table, values)
            if not fields:
                raise InputError("nothing is to be changed", hint="give col, row, x, y, role or enabled")
            self._save(_edit_title(name, fields), station, text, table.with_row(row.line, fields))

    def remove(self, layer: str, name: str, values: Mapping[str, Any]) -> None:
        """Take a point out of the image's table; `was` as for `change`."""
        station = self._stations.find(layer)
        with self._workspace.history.lock:
            text = text_of(station.table)
            table = ControlText.of(text)
            row = _row(table, station, name, values)
            self._save(f"point {name} taken out of {station.path.name}", station, text, table.without_row(row.line))

    def _fields(self, station: Station, table: ControlText, values: Mapping[str, Any]) -> dict[str, str]:
        """Fields of a row from what the page sends."""
        fields = {name: f"{number(values, name):.{_PIXEL}f}" for name in ("col", "row") if name in values}
        if "map_col" in values:
            crs, affine = map_frame(self._workspace.raster(str(values.get("layer"))))
            xy = np.array([affine @ [number(values, "map_col"), number(values, "map_row"), 1.0]])
            own = table_crs(station, table)
            if own is None:
                raise InputError(
                    "nothing says which CRS the table is in",
                    where=station.table.name,
                    hint="declare `crs` in the project",
                )
            place = ground_under(xy, crs, own, station.surface)[0]
            digits = _DEGREE if own.is_geographic else _GROUND
            fields |= {"x": f"{place[0]:.{digits}f}", "y": f"{place[1]:.{digits}f}"}
            if has_heights(own):
                fields["z"] = f"{place[2]:.{_GROUND}f}"
        for name in ("x", "y", "z"):
            if values.get(name) is not None:
                fields[name] = f"{number(values, name):.12g}"
        if "role" in values:
            fields["role"] = str(values["role"])
            if fields["role"] not in ("control", "check"):
                raise InputError(f"a point cannot have the role '{fields['role']}'", hint="control or check")
        if "enabled" in values:
            fields["enabled"] = "1" if values["enabled"] else "0"
        return fields

    def _save(self, title: str, station: Station, before: str | None, table: ControlText) -> None:
        self._workspace.history.save(title, {station.table: before}, {station.table: table.text})


def _row(table: ControlText, station: Station, name: str, values: Mapping[str, Any]) -> TableRow:
    """Row of a point, where it is still the one that was told: names come again, and those of QGIS are row numbers."""
    row = row_of(table, station, name)
    if "was" in values and values["was"] != [float(row.values["col"]), float(row.values["row"])]:
        raise InputError(
            f"point '{name}' is not where it was: nothing was changed", hint="look where it is now, and repeat the edit"
        )
    return row


def _free_name(taken: set[str]) -> str:
    """Lowest number that is no point's name."""
    number = 1
    while str(number) in taken:
        number += 1
    return str(number)


def _edit_title(name: str, fields: Mapping[str, str]) -> str:
    if "enabled" in fields:
        return f"point {name} switched {'on' if fields['enabled'] == '1' else 'off'}"
    return f"point {name} made a {fields['role']} point" if "role" in fields else f"point {name} moved"


def _crs_code(crs: CRS) -> str:
    found = horizontal(crs).to_epsg()
    return f"EPSG:{found}" if found else horizontal(crs).to_wkt()
