"""Series of sheets from plain inputs: schemes by name or from polygons, sheets at a place, all sheets of a raster."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.errors import InputError, did_you_mean
from geomosaic.geo.crs import horizontal, parse_crs, parse_map
from geomosaic.geo.transform import Transform
from geomosaic.options.control import parse_place
from geomosaic.options.declaration import compose, declared
from geomosaic.options.sheet import SchemeOptions, SeriesOptions, SheetOptions
from geomosaic.raster.vector import read_layer
from geomosaic.sheets.drawing.save import check_format
from geomosaic.sheets.inputs import sheet_inputs
from geomosaic.sheets.series.make import SeriesResult, make_series
from geomosaic.sheets.series.national import Mgrs, ign, international, tk
from geomosaic.sheets.series.regular import Polygons, Scheme, regular, sheet_place
from geomosaic.sheets.vector_layers import is_missing
from geomosaic.stores.path import given_path
from geomosaic.types import PathLike, Progress

SCHEMES = ("international", "puwg1992", "soviet", "tk", "ign", "mgrs", "grid")


def _scheme_by_name(wanted: SchemeOptions) -> Scheme:
    """A scheme by its name."""
    name, scale = wanted.scheme or "", wanted.scale
    if name not in SCHEMES:
        hint = did_you_mean(name, SCHEMES) or f"one of {', '.join(SCHEMES)}"
        raise InputError(f"there is no scheme '{name}'", where="`scheme`", hint=hint)
    whole = round(scale or 0)
    if name == "international":
        return international(whole, map_crs="EPSG:32{half}{zone:02d}", south=True)
    if name == "puwg1992":
        return international(whole, crs="EPSG:4258", map_crs="EPSG:2180", title=f"the division of PUWG 1992, 1:{whole}")
    if name == "soviet":
        return international(
            whole, crs="EPSG:4284", letters="cyrillic", map_crs="EPSG:284{gauss:02d}",
            title=f"the Soviet division 1:{whole}",
        )  # fmt: skip
    if name == "tk":
        return tk(whole)
    if name == "ign":
        return ign(whole)
    if name == "mgrs":
        width, height = wanted.size or (100_000.0, 100_000.0)
        if width != height:
            raise InputError("MGRS squares are as wide as high", where="`size`", hint="give one number twice")
        return Mgrs(round(width), scale)
    if wanted.size is None or wanted.crs is None:
        given = (("`size`", wanted.size), ("`crs`", wanted.crs))
        missing = " and ".join(key for key, value in given if value is None)
        raise InputError("a grid needs the width and height of its sheets and a CRS", hint=f"give {missing}")
    return regular(wanted.crs, wanted.size, origin=wanted.origin, scale=scale)


def sheet_scheme(scheme: str | None = None, scale: float | None = None, **options: Any) -> Scheme:
    """Division of the ground into sheets: by the name of a scheme, or of polygons in a file.

    Parameters
    ----------
    scheme : str, optional
        'international', 'puwg1992', 'soviet', 'tk', 'ign', 'mgrs' or 'grid'.
    scale : float, optional
        N of 1:N.
    **options
        Of `SchemeOptions`: `size`, `origin`, `crs`; `polygons` and `name_column`.

    Returns
    -------
    Scheme

    Raises
    ------
    InputError
    """
    wanted = compose(SchemeOptions, {"scheme": scheme, "scale": scale, **options})
    polygons, name_column = wanted.polygons, wanted.name_column
    if polygons is None:
        if wanted.scheme is None:
            raise InputError("sheets need a scheme or polygons", where="`scheme`", hint="give `scheme` or `polygons`")
        return _scheme_by_name(wanted)
    path, _, layer = polygons.rpartition("#") if "#" in polygons and not Path(polygons).exists() else (polygons, "", "")
    frame = read_layer(path, layer or None)
    if frame.crs is None:
        raise InputError("the polygons have no CRS", where=polygons, hint="assign one")
    if name_column not in frame.columns:
        raise InputError(
            f"there is no column '{name_column}'",
            where=polygons,
            hint=f"`name_column`: {', '.join(map(str, frame.columns))}",
        )
    rings: dict[str, Any] = {}
    for number, (name, geometry) in enumerate(zip(frame[name_column], frame.geometry, strict=True), start=1):
        if is_missing(name):
            raise InputError(
                f"polygon {number} has no name in column '{name_column}'", where=polygons, hint="give each a name"
            )
        if geometry is None or geometry.geom_type != "Polygon" or not geometry.is_valid or len(geometry.interiors):
            raise InputError(
                f"sheet '{name}' is no simple polygon", where=polygons, hint="one outer ring each, no holes"
            )
        if str(name) in rings:
            raise InputError(f"two sheets are called '{name}'", where=polygons, hint="give each its own name")
        rings[str(name)] = np.asarray(geometry.normalize().reverse().exterior.coords)[:-1, :2]
    if not rings:
        raise InputError("there are no polygons", where=polygons, hint="draw some")
    return Polygons(Path(path).stem, horizontal(parse_crs(frame.crs.to_wkt(), polygons)).to_wkt(), rings, scale)


@dataclass(frozen=True)
class FoundSheet:
    """Sheet of a scheme.

    Attributes
    ----------
    name, title : str
        Of the sheet and of its scheme.
    scale : float, optional
        Denominator.
    crs : str
        In which its edges are straight.
    corners : list of [x, y]
        In `crs`, counter-clockwise from the lower left.
    map_crs : str, optional
        In which it is drawn.
    map_corners : list of [x, y], optional
    neighbours : mapping of str to str
        Names of the sheets around, by direction.
    """

    name: str
    title: str
    scale: float | None
    crs: str
    corners: list[list[float]]
    map_crs: str | None
    map_corners: list[list[float]] | None
    neighbours: Mapping[str, str]


def find_sheet(scheme: Scheme, at: str | tuple[float, float], *, map_crs: str | None = None) -> FoundSheet:
    """Sheet of a name or at a place: its corners and neighbours.

    Parameters
    ----------
    scheme : Scheme
        See `sheet_scheme`.
    at : str or tuple of float
        Name of the sheet, or longitude and latitude on WGS 84, degrees.
    map_crs : str, optional
        CRS of `map_corners`; that of the scheme unless given.

    Returns
    -------
    FoundSheet

    Raises
    ------
    InputError
        There is no such sheet.
    """
    if not isinstance(at, str):
        place = Transform(parse_crs("EPSG:4326"), parse_crs(scheme.crs))(np.array([parse_place(at)]))[0]
        at = scheme.find(float(place[0]), float(place[1]))
    name = scheme.proper(at)
    crs, ring = scheme.edges(name)
    target = map_crs or scheme.map_crs(name)
    on_map = None if target is None else sheet_place(scheme, name, parse_map(target, "`map_crs`")).corners.tolist()
    return FoundSheet(name, scheme.title, scheme.scale, crs, ring.tolist(), target, on_map, scheme.neighbours(name))


def sheet_series(
    raster: PathLike, folder: PathLike, scheme: Scheme, *, progress: Progress | None = None, **options: Any
) -> SeriesResult:
    """All sheets of a series that show something of a raster, with their index; finished ones are kept.

    Parameters
    ----------
    raster : path
        Georeferenced.
    folder : path
        For the sheets and their index.
    scheme : Scheme
        Division of the ground, see `sheet_scheme`.
    progress : callable, optional
        Called with (done, total, stage).
    **options
        Of `SeriesOptions`: `format`, `overlap`, `only`, `workers`; and of `SheetOptions`, see `sheet`.

    Returns
    -------
    SeriesResult

    Raises
    ------
    InputError, OutputError
    """
    own = {one.name for one in declared(SeriesOptions)}
    series = compose(SeriesOptions, {name: value for name, value in options.items() if name in own})
    look = compose(SheetOptions, {name: value for name, value in options.items() if name not in own})
    suffix = f".{series.format}"
    try:
        check_format(Path(f"sheet{suffix}"), look.files)
        inputs = sheet_inputs(given_path(raster), look, suffix)
    except InputError as error:  # a series has a format where a sheet has the ending of its name
        raise InputError(error.what.replace("`output=.", "`format="), where=error.where, hint=error.hint) from None
    return make_series(inputs, scheme, Path(folder), series, progress)
