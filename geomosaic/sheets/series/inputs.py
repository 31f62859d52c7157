"""Series of sheets from plain inputs: schemes by name or from polygons, sheets at a place, all sheets of a raster."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.errors import InputError, did_you_mean
from geomosaic.geo.crs import horizontal, parse_crs, parse_map
from geomosaic.geo.transform import Transform
from geomosaic.options.declaration import compose
from geomosaic.options.sheet import SheetOptions
from geomosaic.raster.vector import read_layer
from geomosaic.sheets.inputs import sheet_inputs
from geomosaic.sheets.series.make import SeriesResult, make_series
from geomosaic.sheets.series.national import Mgrs, ign, international, tk
from geomosaic.sheets.series.regular import Polygons, Scheme, regular, sheet_place
from geomosaic.sheets.vector_layers import is_missing
from geomosaic.types import PathLike, Progress

SCHEMES = ("international", "puwg1992", "soviet", "tk", "ign", "mgrs", "grid")
_NEEDS_SCALE = ("international", "puwg1992", "soviet", "tk", "ign")


def _scheme_by_name(
    name: str,
    scale: float | None = None,
    *,
    size: tuple[float, float] | None = None,
    crs: str | None = None,
    origin: tuple[float, float] = (0.0, 0.0),
) -> Scheme:
    """A scheme by its name."""
    if name not in SCHEMES:
        hint = did_you_mean(name, SCHEMES) or f"one of {', '.join(SCHEMES)}"
        raise InputError(f"there is no scheme '{name}'", where="`scheme`", hint=hint)
    if name in _NEEDS_SCALE and scale is None:
        raise InputError(f"'{name}' has sheets for several scales", where="`scale`", hint="write `scale=1:25000`")
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
        width, height = size or (100_000.0, 100_000.0)
        if width != height:
            raise InputError("MGRS squares are as wide as high", where="`size`", hint="give one number twice")
        return Mgrs(round(width), scale)
    if size is None or crs is None:
        missing = " and ".join(name for name, value in (("`size`", size), ("`crs`", crs)) if value is None)
        raise InputError("a grid needs the width and height of its sheets and a CRS", hint=f"give {missing}")
    return regular(crs, size, origin=origin, scale=scale)


def sheet_scheme(
    scheme: str | None = None,
    scale: float | None = None,
    *,
    size: tuple[float, float] | None = None,
    origin: tuple[float, float] = (0.0, 0.0),
    crs: str | None = None,
    polygons: str | None = None,
    name_column: str = "name",
) -> Scheme:
    """Division of the ground into sheets: by the name of a scheme, or of polygons in a file.

    Parameters
    ----------
    scheme : str, optional
        'international', 'puwg1992', 'soviet', 'tk', 'ign', 'mgrs' or 'grid'.
    scale : float, optional
        N of 1:N.
    size : tuple of float, optional
        Width and height of the sheets of 'mgrs' or 'grid', map units.
    origin : tuple of float
        x, y of 'grid'.
    crs : str, optional
        Of 'grid'.
    polygons : str, optional
        FILE or FILE#LAYER of sheets that are drawn, instead of a scheme.
    name_column : str
        Of their names.

    Raises
    ------
    InputError
    """
    if polygons is None:
        return _scheme_by_name(scheme or "", scale, size=size, crs=crs, origin=origin)
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


def find_sheet(scheme: Scheme, longitude: float, latitude: float) -> str:
    """Sheet at a place on WGS 84.

    Parameters
    ----------
    scheme : Scheme
    longitude, latitude : float, degrees
    """
    place = Transform(parse_crs("EPSG:4326"), parse_crs(scheme.crs))(np.array([[longitude, latitude]]))[0]
    return scheme.find(float(place[0]), float(place[1]))


def sheet_corners(scheme: Scheme, name: str, crs: str) -> list[list[float]]:
    """Corners of a sheet in a CRS.

    Parameters
    ----------
    scheme : Scheme
    name : str
    crs : str
    """
    found: list[list[float]] = sheet_place(scheme, name, parse_map(crs)).corners.tolist()
    return found


def sheet_series(
    raster: PathLike,
    folder: PathLike,
    scheme: Scheme,
    *,
    format: str = "pdf",
    overlap: float = 0.0,
    only: tuple[str, ...] = (),
    workers: int = 1,
    progress: Progress | None = None,
    **options: Any,
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
    format : str
        'pdf', 'png', 'tif', 'mbtiles' or 'kmz'.
    overlap : float
        Reach of a sheet beyond its edges, map units.
    only : tuple of str
        Names of the sheets to make; all unless given.
    workers : int
        Processes that draw.
    progress : callable, optional
        Called with (done, total, stage).
    **options
        Fields of `SheetOptions`, see `sheet`.

    Raises
    ------
    InputError, OutputError
    """
    inputs = sheet_inputs(Path(raster), compose(SheetOptions, options))
    return make_series(
        inputs, scheme, Path(folder), suffix=f".{format}", overlap=overlap, only=only, workers=workers,
        progress=progress,
    )  # fmt: skip
