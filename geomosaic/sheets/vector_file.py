"""Vector file as a layer of a sheet."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.geo.crs import horizontal, is_local, parse_crs
from geomosaic.raster.vector import layer_counts, read_layer
from geomosaic.sheets.page import Page
from geomosaic.sheets.styles.style import Style, plain
from geomosaic.sheets.vector_layers import Overlay, overlay

COLORS = ("#d7191c", "#2c6fbb", "#f58231", "#7b3294", "#1a9641", "#00a6c8")
"""Colours of layers without a style, in turn."""


@dataclass(frozen=True)
class VectorInput:
    """Vector file with layer (the first by default), style and title."""

    path: Path
    layer: str | None = None
    style: Style | None = None
    title: str = ""


def read_overlay(vector: VectorInput, page: Page, number: int) -> Overlay:
    """Vector layer in the CRS of the map; in a local frame vectors without a CRS are used unchanged.

    Raises
    ------
    InputError
        The file cannot be read, has no CRS, or one that has nothing to do with a local frame.
    """
    name = vector.layer or _first_layer(vector.path)
    frame = read_layer(vector.path, name)
    where = f"{vector.path}, layer '{vector.layer}'" if vector.layer else str(vector.path)
    local = is_local(page.crs)
    if frame.crs is None and not local:
        raise InputError(
            "the layer has no CRS", where=where, hint="assign one: ogr2ogr -a_srs EPSG:... OUT IN, or add a .prj file"
        )
    # WKT between the libraries: each has a PROJ of its own.
    crs = page.crs if frame.crs is None else horizontal(parse_crs(frame.crs.to_wkt(), where))
    if local and not is_local(crs):
        raise InputError(
            f"the layer is in '{crs.name}', the map in the local frame '{page.crs.name}'",
            where=where,
            hint="give vectors in the coordinates of the map, without a CRS",
        )
    crs = page.crs if local else crs
    geometries = list(frame.geometry)
    style = vector.style or plain(_kind(geometries), COLORS[number % len(COLORS)])
    columns = {str(name): frame[name].tolist() for name in frame.columns if name != frame.geometry.name}
    title = vector.title or (vector.layer or vector.path.stem).replace("_", " ")
    made = overlay(
        geometries, columns, crs, style, title, page.crs, page.bounds, straight=2.0 / page.mm_per_unit, where=where
    )
    if vector.title and vector.title != made.title:
        made = replace(made, title=vector.title)
    for note in made.notes:
        warnings.warn(f"{where}: {note}", GeomosaicWarning, stacklevel=2)
    return made


def _first_layer(path: Path) -> str | None:
    """The first layer that has objects; the others that have some are named in a note."""
    full = [name for name, count in layer_counts(path).items() if count]
    # GPX has each track a second time, as its points.
    others = [name for name in full[1:] if name not in ("track_points", "route_points")]
    if others:
        warnings.warn(
            f"{path}: layer '{full[0]}' is drawn; name one with FILE#LAYER for {', '.join(others)}",
            GeomosaicWarning,
            stacklevel=3,
        )
    return full[0] if full else None


def _kind(geometries: Sequence[Any]) -> str:
    names = {geometry.geom_type for geometry in geometries if geometry is not None}
    for part, kind in (("Polygon", "polygon"), ("Line", "line")):
        if any(part in name for name in names):
            return kind
    return "point"
