"""Drawing of a whole sheet: map, frame, and the elements around it, from its parts as values."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from geomosaic.sheets.drawing.canvas import Canvas
from geomosaic.sheets.drawing.contents import SheetParts
from geomosaic.sheets.drawing.frame import (
    around_pole,
    draw_crop_marks,
    draw_edge,
    draw_grid,
    draw_labels,
    draw_neighbour_names,
)
from geomosaic.sheets.drawing.labels import (
    draw_contours,
    draw_heights,
    draw_names,
    draw_overlay,
    draw_spots,
    keep_free,
    place_heights,
    place_names,
    place_spots,
)
from geomosaic.sheets.drawing.margin import draw_margin, ground_of, measured
from geomosaic.sheets.label_placement import LabelPlacer
from geomosaic.sheets.page import Box
from geomosaic.types import ByteArray

# From a rectangle in mm on the page to the pixels (rows, cols, 4) that fill it.
Pixels = Callable[[Box], ByteArray]


@dataclass(frozen=True)
class DrawnSheet:
    """A page that was drawn.

    Attributes
    ----------
    canvas : Canvas
    elements : dict of str to Box
        Boxes in mm of the elements around the map, by name.
    remarks : tuple of str
        What had no room, in words.
    """

    canvas: Canvas
    elements: dict[str, Box]
    remarks: tuple[str, ...]


def draw_map(canvas: Canvas, parts: SheetParts, pixels: Pixels, area: Box, reserved: Iterable[Box] = ()) -> list[str]:
    """Draw what is inside the neatline; returns what had no room, in words.

    Parameters
    ----------
    canvas : Canvas
    parts : SheetParts
    pixels : callable, see `Pixels`
    area : Box, rectangle of the page that the picture fills, mm
    reserved : iterable of Box, rectangles that names and heights keep free, mm
    """
    page, layout = parts.page, parts.layout
    remarks: list[str] = []
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
        placer = LabelPlacer((left + 0.8, bottom + 0.8, right - 0.8, top - 0.8), outline=page.outline_area)
        for box in reserved:
            placer.reserve(box)
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
        remarks.append(f"{lost} of {lost + len(names)} names have no room without touching others")
    return remarks


def draw_sheet(parts: SheetParts, pixels: Pixels) -> DrawnSheet:
    """Draw the whole page.

    Parameters
    ----------
    parts : SheetParts
    pixels : callable, see `Pixels`
    """
    page, layout = parts.page, parts.layout
    canvas = Canvas(page.paper)
    remarks = draw_map(canvas, parts, pixels, page.neatline, map(ground_of, measured(parts).values()))
    placer = LabelPlacer((0.0, 0.0, page.width, page.height))
    draw_labels(canvas, page, ((parts.grids[0], layout.grid), (parts.grids[1], layout.graticule)), placer)
    draw_edge(canvas, page)
    draw_crop_marks(canvas, page)
    if parts.series is not None:
        lost = draw_neighbour_names(canvas, page, parts.series, placer)
        remarks += [f"the frame has no room for the neighbours' names {', '.join(lost)}"] if lost else []
    elements, lost_elements = draw_margin(canvas, parts)
    return DrawnSheet(canvas, elements, (*remarks, *lost_elements))
