"""Drawing of a whole sheet from its parts as values, with its neighbours in a series."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from geomosaic.relief.contours import Contour
from geomosaic.relief.spot_heights import SpotHeight
from geomosaic.sheets.drawing.canvas import Canvas
from geomosaic.sheets.drawing.frame import around_pole, draw_around, draw_crop_marks, draw_edge, draw_grid, draw_labels
from geomosaic.sheets.drawing.labels import (
    draw_contours,
    draw_heights,
    draw_names,
    draw_overlay,
    draw_spots,
    keep_free,
    kinds_of,
    place_heights,
    place_names,
    place_spots,
)
from geomosaic.sheets.drawing.margin import Entry, draw_head, draw_panel
from geomosaic.sheets.grid_lines import MapGrid
from geomosaic.sheets.label_placement import LabelPlacer
from geomosaic.sheets.layout import Declination, Layout
from geomosaic.sheets.notes import grid_line
from geomosaic.sheets.page import Box, Page
from geomosaic.sheets.series.regular import SheetPlace
from geomosaic.sheets.styles.style import Marker, Symbol, halo_of, legend_line
from geomosaic.sheets.vector_layers import Overlay
from geomosaic.types import ByteArray

Pixels = Callable[[Box], ByteArray]
"""From a rectangle in mm on the page to the pixels (rows, cols, 4) that fill it."""


@dataclass(frozen=True)
class SheetParts:
    """Everything that is on a sheet.

    Attributes
    ----------
    page : Page
    layout : Layout
    grids : tuple of MapGrid or None
        Map grid and graticule, None where not wanted.
    layers : tuple of Overlay
        Lowest first.
    contours : tuple of Contour
    interval : float
        Of the contours in metres, 0 without.
    spots : tuple of SpotHeight
        The most prominent first.
    blocks : tuple of (heading, lines)
        Notes.
    convergence : float
        Degrees, at the centre; None in a local frame, which has no north.
    series : SheetPlace, optional
        The sheet's place in its series.
    magnetic : Declination, optional
        At the centre.
    """

    page: Page
    layout: Layout
    grids: tuple[MapGrid | None, MapGrid | None]
    layers: tuple[Overlay, ...]
    contours: tuple[Contour, ...]
    interval: float
    spots: tuple[SpotHeight, ...]
    blocks: tuple[tuple[str, list[str]], ...]
    convergence: float | None
    series: SheetPlace | None = None
    magnetic: Declination | None = None


def draw_map(canvas: Canvas, parts: SheetParts, pixels: Pixels, area: Box) -> list[str]:
    """Draw what is inside the neatline; returns what had no room, in words."""
    page, layout = parts.page, parts.layout
    told: list[str] = []
    with canvas.clipped(area, page.outline_mm):
        canvas.rectangle(area, fill=layout.map.background)
        canvas.picture(pixels(area), area)
        if parts.contours:
            draw_contours(canvas, page, parts.contours, layout.contours)
        for grid, part in zip(parts.grids, (layout.grid, layout.graticule), strict=True):
            if grid is not None:
                draw_grid(canvas, page, grid, part)
        for layer in parts.layers:
            draw_overlay(canvas, page, layer)
        left, bottom, right, top = page.neatline
        placer = LabelPlacer((left + 0.8, bottom + 0.8, right - 0.8, top - 0.8), outline=page.outline_mm)
        for grid, part in zip(parts.grids, (layout.grid, layout.graticule), strict=True):
            if grid is not None and part.style == "lines" and part.labels:
                placer.take(around_pole(page, grid, part.size))
        keep_free(page, parts.spots, placer)
        names, lost = place_names(page, parts.layers, placer)
        draw_spots(
            canvas, page, place_spots(page, parts.spots, layout.contours, parts.interval, placer), layout.contours
        )
        if parts.contours and layout.contours.labels:
            draw_heights(canvas, place_heights(page, parts.contours, layout.contours, placer), layout.contours)
        draw_names(canvas, names)
    if lost:
        told.append(f"{lost} of {lost + len(names)} names have no room without touching others")
    return told


def draw_sheet(parts: SheetParts, pixels: Pixels) -> tuple[Canvas, list[str]]:
    """Draw the whole page; returns it and what had no room, in words."""
    page, layout = parts.page, parts.layout
    canvas = Canvas(page.paper)
    told = draw_map(canvas, parts, pixels, page.neatline)
    draw_labels(canvas, page, ((parts.grids[0], layout.grid), (parts.grids[1], layout.graticule)))
    draw_edge(canvas, page)
    draw_crop_marks(canvas, page)
    if parts.series is not None:
        draw_around(canvas, page, parts.series)
    told += draw_head(canvas, page, layout)
    entries = legend(parts) if layout.legend.show else []
    told += draw_panel(canvas, page, layout, entries, parts.blocks, parts.convergence, parts.magnetic, parts.series)
    return canvas, told


def legend(parts: SheetParts) -> list[Entry]:
    """Entries in the order in which things lie, the uppermost first."""
    entries: list[Entry] = []
    for layer in reversed(parts.layers):
        if len(layer.groups) > 1 and layer.title:
            entries.append(Entry(layer.title))
        for group in layer.groups:
            text = layer.title if len(layer.groups) == 1 and not layer.style.rules else group.title
            entries.append(Entry(text, group.symbol, frozenset(kinds_of(group.geometries))))
    part = parts.layout.contours
    line = frozenset({"line"})
    if parts.contours:
        shown: Sequence[tuple[bool, str, float]] = (
            (True, f"Index contours, every {parts.interval * part.index:g}\u00a0m", part.index_width),
            (False, f"Contours, every {parts.interval:g}\u00a0m", part.width),
        )
        for main, text, width in shown:
            if any(c.index == main for c in parts.contours):
                entries.append(Entry(text, Symbol(line=legend_line(part.color, width)), line))
    if parts.spots:
        dot = Marker("circle", 1.0, part.color, halo_of(part.color), 0.15)
        entries.append(Entry("Spot heights, metres", Symbol(marker=dot), frozenset({"point"})))
    for grid, looks in zip(parts.grids, (parts.layout.grid, parts.layout.graticule), strict=True):
        if grid is not None:
            entries.append(Entry(grid_line(grid), Symbol(line=legend_line(looks.color, max(looks.width, 0.15))), line))
    return entries
