"""Vector layers and contours on the map, and the same symbols small in the legend."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from geomosaic.relief.contours import Contour
from geomosaic.sheets.drawing.canvas import Canvas
from geomosaic.sheets.layout import ContoursPart
from geomosaic.sheets.page import Box, Page
from geomosaic.sheets.styles.contrast import halo_of, legend_line
from geomosaic.sheets.styles.style import Line, Marker, Symbol
from geomosaic.sheets.vector_layers import Overlay, parts_of
from geomosaic.types import FloatArray


def draw_overlay(canvas: Canvas, page: Page, layer: Overlay) -> None:
    """Areas first, then the casings of all lines, then the lines, so that roads join; points on top."""
    groups = [group for group in layer.groups if group.geometries]
    for group in groups:
        fill, line = group.symbol.fill, group.symbol.line
        for polygon in parts_of(group.geometries, "polygon"):
            rings = _rings(page, polygon)
            if fill is not None:
                canvas.area(rings, fill.color, opacity=fill.opacity)
            if line is not None:
                _line(canvas, rings, line, casing=True)
                _line(canvas, rings, line, casing=False)
    for casing in (True, False):
        for group in groups:
            if group.symbol.line is not None:
                paths = [page.to_page(np.asarray(p.coords)) for p in parts_of(group.geometries, "line")]
                _line(canvas, paths, group.symbol.line, casing=casing)
    for group in groups:
        points = parts_of(group.geometries, "point")
        if group.symbol.marker is not None and points:
            _marker(canvas, page.to_page(np.array([(p.x, p.y) for p in points])), group.symbol.marker)


def draw_contours(canvas: Canvas, page: Page, contours: Sequence[Contour], part: ContoursPart) -> None:
    """Lines, thin and thick, with a breath of white (black below light lines) that lifts them off the picture."""
    paths = [[page.to_page(c.xy) for c in contours if c.index == main] for main in (False, True)]
    widths = (part.width, part.index_width)
    for lines, width in zip(paths, widths, strict=True):
        canvas.lines(lines, halo_of(part.color), width + 0.25, opacity=0.35)
    for lines, width in zip(paths, widths, strict=True):
        canvas.lines(lines, part.color, width)


def draw_swatch(canvas: Canvas, symbol: Symbol, kinds: set[str], box: Box) -> None:
    """A symbol in the legend, as what its layer has: an area, a line that bends, or a point."""
    left, bottom, right, top = box
    middle = (bottom + top) / 2
    if "polygon" in kinds and (symbol.fill or symbol.line):
        ring = np.array([(left, bottom), (right, bottom), (right, top), (left, top), (left, bottom)])
        if symbol.fill is not None:
            canvas.area([ring], symbol.fill.color, opacity=symbol.fill.opacity)
        if symbol.line is not None:
            _line(canvas, [ring], symbol.line, casing=True)
            _line(canvas, [ring], symbol.line, casing=False)
    elif "line" in kinds and symbol.line is not None:
        path = np.array([(left, middle), (right, middle)])
        if symbol.line.casing is None:  # light lines would not be seen on the paper
            _line(canvas, [path], legend_line(symbol.line.color, symbol.line.width), casing=True)
        _line(canvas, [path], symbol.line, casing=True)
        _line(canvas, [path], symbol.line, casing=False)
    if "point" in kinds and symbol.marker is not None:
        _marker(canvas, np.array([((left + right) / 2, middle)]), symbol.marker)


def kinds_of(geometries: Sequence[Any]) -> set[str]:
    """Which kinds of geometry there are."""
    return {kind for kind in ("polygon", "line", "point") if parts_of(geometries, kind)}


def _line(canvas: Canvas, paths: Sequence[FloatArray], line: Line, *, casing: bool) -> None:
    if casing:
        if line.casing is not None:
            cap = "butt" if line.dash else "round"
            canvas.lines(paths, line.casing, line.full_width, opacity=line.opacity, cap=cap)
        return
    cap = "butt" if line.dash else "round"
    canvas.lines(paths, line.color, line.width, dash=line.dash, opacity=line.opacity, cap=cap)


def _marker(canvas: Canvas, xy: FloatArray, marker: Marker) -> None:
    canvas.markers(xy, marker.shape, marker.size, marker.color, marker.outline, marker.outline_width, marker.opacity)


def _rings(page: Page, polygon: Any) -> list[FloatArray]:
    """Rings of an area on the page; holes run against the outer ring."""
    import shapely

    turned = shapely.normalize(polygon)
    return [page.to_page(np.asarray(ring.coords)) for ring in (turned.exterior, *turned.interiors)]
