"""Rows of a control table that belong to an image, and the points that they are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.control.edit import ControlText, TableRow
from geomosaic.control.points import ControlPoints
from geomosaic.control.read import read_control_file
from geomosaic.control.table import comment_crs
from geomosaic.errors import InputError
from geomosaic.geo.crs import parse_map
from geomosaic.studio.control.station import Station


def rows_of(table: ControlText, station: Station) -> tuple[TableRow, ...]:
    """Rows of the table that are measured in an image.

    Parameters
    ----------
    table : ControlText
    station : Station
        Image with its table, model and surface.
    """
    if table.qgis or "image" not in table.columns:
        return table.rows
    own = {station.path.name.casefold(), station.path.stem.casefold()}
    return tuple(row for row in table.rows if Path(row.values.get("image", "")).name.casefold() in own)


def row_of(table: ControlText, station: Station, name: str) -> TableRow:
    """Row of a point by its name; an error where the image has none of that name.

    Parameters
    ----------
    table : ControlText
    station : Station
        Image with its table, model and surface.
    name : str
        Of the point.
    """
    found = next((row for row in rows_of(table, station) if row.values.get("id") == name), None)
    if found is None:
        raise InputError(
            f"there is no point '{name}' in {station.path.name}", hint="another program may have taken it out"
        )
    return found


def points_of(station: Station, table: ControlText) -> ControlPoints | None:
    """Control points of the image, read as the command line reads them; None where there are none.

    Parameters
    ----------
    station : Station
        Image with its table, model and surface.
    table : ControlText
    """
    if not rows_of(table, station):
        return None
    image = None if table.qgis or "image" not in table.columns else station.path.name
    crs = None if comment_crs(table.origins(str(station.table))) else station.crs
    found = read_control_file(station.table, image=image, crs=crs, size=station.size).control
    if station.crs is not None and not isinstance(station.model, str) and found.ground.shape[1] == 3:
        found = replace(found, crs=station.crs)
    return found


def table_crs(station: Station, table: ControlText) -> CRS | None:
    """CRS that the table is in: of a comment in it, or as declared; None where nothing tells.

    Parameters
    ----------
    station : Station
        Image with its table, model and surface.
    table : ControlText
    """
    named = comment_crs(table.origins(str(station.table)))
    return station.crs if named is None or not isinstance(station.model, str) else parse_map(named, station.table.name)


def number(values: Mapping[str, Any], name: str) -> float:
    """Number that the page sent; an error where it is none.

    Parameters
    ----------
    values : mapping
        As the page sent them.
    name : str
    """
    value = values.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(f"'{name}' is no number", hint="give pixels, or units of the map")
    return float(value)
