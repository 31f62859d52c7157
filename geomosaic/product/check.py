"""Holding a product against what is known better: control and check points, a reference image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.block.block import Block
from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.grid import Grid
from geomosaic.geo.transform import Transform
from geomosaic.match.shift import Shifts, shifts
from geomosaic.raster.source import Source
from geomosaic.resample import reference
from geomosaic.types import AnyArray, BoolArray, FloatArray


@dataclass(frozen=True)
class ControlResidual:
    """One measurement of a point against the oriented image: measured minus computed, in pixels."""

    id: str
    image: str
    role: str
    col: float
    row: float


def check_control(block: Block) -> list[ControlResidual]:
    """Residuals of all control and check point measurements, in pixels; NaN where the image cannot see the point."""
    if block.crs is None:
        return []
    found = []
    for point in block.control:
        model = block.scene(point.image).model
        xyz = Transform(block.crs, model.crs)(np.array([point.xyz]))
        dcol, drow = np.array(point.colrow) - model.ground_to_image(xyz)[0]
        found.append(ControlResidual(point.id, point.image, point.role, float(dcol), float(drow)))
    return found


def rms(residuals: list[ControlResidual], role: str) -> float:
    """Root mean square length of the residuals of one role, in pixels; NaN without any."""
    lengths = [r.col**2 + r.row**2 for r in residuals if r.role == role and np.isfinite(r.col)]
    return float(np.sqrt(np.mean(lengths))) if lengths else float("nan")


def against_reference(product: Path, truth: Path, tile: int = 64, reach: int = 8) -> dict[str, Any]:
    """Registration and colour of a product against a reference image of the same ground.

    Parameters
    ----------
    product, truth : Path
        Georeferenced rasters; the product is sampled (bilinear) at the pixel centres of the reference.
    tile, reach : int
        Of the matching, in pixels of the reference.

    Returns
    -------
    dict
        `registration_rms_px`, `registration_robust_rms_px`, `shift_px` (median col, row), `shift_m`, `tiles`,
        `matched`, `colour_rms` per band, `colour_bias` per band, `pixels` compared.
    """
    grid, values, there = _whole(truth)
    own, seen = _sampled(product, grid)
    both = there & seen
    if not both.any():
        raise InputError("the product and the reference share no pixel", where=str(truth))
    bands = min(values.shape[2], own.shape[2])
    moved = match(own[..., :bands], values[..., :bands], both, tile, reach)
    difference = own[both][:, :bands] - values[both][:, :bands]
    middle = np.nanmedian(moved.shifts, axis=0) if moved.matched.any() else np.full(2, np.nan)
    return {
        "registration_rms_px": moved.rms,
        "registration_robust_rms_px": moved.robust_rms,
        "shift_px": [float(v) for v in -middle],
        "shift_m": [float(v) * r for v, r in zip(-middle, grid.resolution, strict=True)],
        "tiles": len(moved.places),
        "matched": int(moved.matched.sum()),
        "colour_rms": [float(v) for v in np.sqrt((difference**2).mean(axis=0))],
        "colour_bias": [float(v) for v in difference.mean(axis=0)],
        "pixels": int(both.sum()),
    }


def match(first: AnyArray, second: AnyArray, both: BoolArray, tile: int = 64, reach: int = 8) -> Shifts:
    """Shifts of `second` against `first` in their mean grey."""
    return shifts(first.mean(axis=2), second.mean(axis=2), both, tile, reach)


def _whole(path: Path) -> tuple[Grid, FloatArray, BoolArray]:
    source = Source(path, memory_limit=1 << 30)
    try:
        info = source.info
        if info.crs is None or info.transform is None:
            raise InputError("the raster is not georeferenced", where=str(path))
        grid = Grid(horizontal(info.crs), info.transform, info.width, info.height)
        values, valid = source.read(grid.window)
    finally:
        source.close()
    seen = np.ones(grid.shape, dtype=bool) if valid is None else valid > 0
    return grid, values.astype(np.float64), seen


def _sampled(path: Path, grid: Grid) -> tuple[FloatArray, BoolArray]:
    """Bilinear values of a raster at the pixel centres of a grid."""
    source = Source(path, memory_limit=1 << 30)
    try:
        info = source.info
        if info.crs is None or info.transform is None:
            raise InputError("the raster is not georeferenced", where=str(path))
        own = Grid(horizontal(info.crs), info.transform, info.width, info.height)
        window = own.window_of(_bounds_in(grid, own)).intersection(own.window)
        if window.empty:
            return np.zeros((*grid.shape, info.bands)), np.zeros(grid.shape, dtype=bool)
        values, valid = source.read(window)
    finally:
        source.close()
    c, r = np.meshgrid(np.arange(grid.width) + 0.5, np.arange(grid.height) + 0.5)
    xy = Transform(grid.crs, own.crs)(grid.xy(np.column_stack([c.ravel(), r.ravel()])))
    place = own.colrow(xy) - (window.col, window.row)
    out = np.zeros((*grid.shape, info.bands))
    seen = np.zeros(grid.shape, dtype=np.uint8)
    mask = np.ones(values.shape[:2], dtype=np.uint8) if valid is None else valid
    cols, rows = place[:, 0].reshape(grid.shape), place[:, 1].reshape(grid.shape)
    ones, zeros = np.ones(info.bands), np.zeros(info.bands)
    where = (0.0, 0.0, 1.0, window.width, window.height)
    reference.sample(
        "bilinear",
        values,
        mask,
        valid is not None,
        cols,
        rows,
        1,
        where,
        ones,
        zeros,
        -np.inf,
        np.inf,
        False,
        out,
        seen,
    )
    return out, seen > 0


def _bounds_in(grid: Grid, own: Grid) -> tuple[float, float, float, float]:
    edge = np.linspace(0, 1, 9)
    c, r = np.meshgrid(edge * grid.width, edge * grid.height)
    xy = Transform(grid.crs, own.crs)(grid.xy(np.column_stack([c.ravel(), r.ravel()])))
    pad = 2 * max(own.resolution)
    (left, bottom), (right, top) = np.nanmin(xy, axis=0) - pad, np.nanmax(xy, axis=0) + pad
    return float(left), float(bottom), float(right), float(top)
