"""Control points and their residuals as vectors for a GIS."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import horizontal
from geomosaic.geo.transform import Transform
from geomosaic.raster.vector import Layer, write_layers
from geomosaic.types import FloatArray

LONGEST = 0.05
"""Drawn length of the longest residual, as a share of the diagonal of the points' extent."""

FIELDS = {
    "residual_col": ("residual_px", 0),
    "residual_row": ("residual_px", 1),
    "residual_x": ("residual_map", 0),
    "residual_y": ("residual_map", 1),
    "standardised_col": ("standardised", 0),
    "standardised_row": ("standardised", 1),
    "redundancy_col": ("redundancy_numbers", 0),
    "redundancy_row": ("redundancy_numbers", 1),
    "left_out_col": ("leave_one_out_px", 0),
    "left_out_row": ("leave_one_out_px", 1),
}
"""Columns of the layers, each with the key and the axis of the report's points that it holds."""


def write_residuals(
    path: Path, points: Sequence[Mapping[str, Any]], source: CRS, crs: CRS, *, overwrite: bool
) -> float:
    """GeoPackage with the layers `points` and `residuals`.

    A residual runs from the control point to the map position of the measured image point, enlarged by the factor in
    the column `enlarged`.

    Parameters
    ----------
    path : Path
    points : sequence of mapping
        As in the report: id, state, x, y, residual_px, residual_map ...
    source, crs : CRS
        CRS of the points, and of the file.
    overwrite : bool

    Returns
    -------
    float
        Factor of enlargement.
    """
    from shapely import LineString, Point

    places = np.array([[point["x"], point["y"]] for point in points], dtype=np.float64).reshape(-1, 2)
    steps = np.array([_pair(point["residual_map"]) for point in points], dtype=np.float64).reshape(-1, 2)
    factor = enlargement(places, steps)
    to_crs = Transform(horizontal(source), horizontal(crs))
    starts, ends = to_crs(places), to_crs(places + factor * np.nan_to_num(steps))
    drawn = np.isfinite(steps).all(axis=1)
    layers = {"points": Layer(crs, "Point", [Point(*xy) for xy in starts], _columns(points))}
    kept = np.flatnonzero(drawn).tolist()
    lines = [LineString([starts[i], ends[i]]) for i in kept]
    columns = {**_columns([points[i] for i in kept]), "enlarged": [factor] * len(kept)}
    layers["residuals"] = Layer(crs, "LineString", lines, columns)
    write_layers(path, layers, overwrite=overwrite)
    return factor


def enlargement(places: FloatArray, steps: FloatArray) -> float:
    """Round factor (1, 2 or 5 times a power of ten) that draws the longest vector at about `LONGEST`."""
    lengths = np.hypot(*steps.T)
    longest = float(np.nanmax(lengths)) if np.isfinite(lengths).any() else 0.0
    if not longest > 0.0:
        return 1.0
    limit = max(1e-9, LONGEST * float(np.hypot(*np.ptp(places, axis=0)))) / longest
    power = 10.0 ** math.floor(math.log10(limit))
    return float(max(step * power for step in (1, 2, 5) if step * power <= limit * (1 + 1e-9)))


def _pair(values: Sequence[float | None] | None) -> list[float]:
    return [float("nan")] * 2 if values is None else [float("nan") if v is None else v for v in values]


def _columns(points: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    columns: dict[str, list[Any]] = {name: [point[name] for point in points] for name in ("id", "state", "col", "row")}
    for name, (key, axis) in FIELDS.items():
        columns[name] = [_pair(point[key])[axis] for point in points]
    lengths = zip(columns["residual_col"], columns["residual_row"], strict=True)
    columns["residual_px"] = [math.hypot(*pair) for pair in lengths]
    return columns
