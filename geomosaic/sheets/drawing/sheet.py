"""Drawing of a whole sheet: map, title, legend and notes, from its parts as values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import InputError
from geomosaic.relief.contours import Contour
from geomosaic.relief.spot_heights import SpotHeight
from geomosaic.sheets.drawing.canvas import CAP, POINT, Canvas, text_size
from geomosaic.sheets.drawing.frame import (
    INDEX,
    around_pole,
    draw_crop_marks,
    draw_edge,
    draw_grid,
    draw_index,
    draw_labels,
    draw_neighbour_names,
)
from geomosaic.sheets.drawing.labels import (
    draw_contours,
    draw_heights,
    draw_names,
    draw_overlay,
    draw_spots,
    draw_swatch,
    keep_free,
    kinds_of,
    place_heights,
    place_names,
    place_spots,
)
from geomosaic.sheets.drawing.scale_and_north import BLOCK, draw_north, draw_scale, north_lines
from geomosaic.sheets.grid_lines import MapGrid
from geomosaic.sheets.label_placement import LabelPlacer
from geomosaic.sheets.layout import Declination, Layout
from geomosaic.sheets.notes import grid_line
from geomosaic.sheets.page import Box, Page
from geomosaic.sheets.series.regular import SheetPlace
from geomosaic.sheets.style import Marker, Symbol, halo_of, legend_line
from geomosaic.sheets.vector_layers import Overlay
from geomosaic.types import ByteArray

# From a rectangle in mm on the page to the pixels (rows, cols, 4) that fill it.
Pixels = Callable[[Box], ByteArray]


@dataclass(frozen=True)
class SheetParts:
    """Everything that is on a sheet.

    Attributes
    ----------
    page : Page
    layout : Layout
    grids : tuple of MapGrid or None, map grid and graticule, None where not wanted
    layers : tuple of Overlay, lowest first
    contours : tuple of Contour
    interval : float, of the contours in metres, 0 without
    spots : tuple of SpotHeight, the most prominent first
    blocks : tuple of (heading, lines), notes
    convergence : float, degrees, at the centre; None in a local frame, which has no north
    series : SheetPlace, optional, the sheet's place in its series
    magnetic : Declination, optional, at the centre
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


# Width of a symbol in the legend, mm.
_SWATCH = 9.0
# Distance of lines in parts of the text size.
_LEADING = 1.42
# Size in points below which notes are left out rather than printed: it could not be read without a lens.
_SMALLEST_TEXT = 4.5
# Size in points below which titles are cut rather than made smaller.
_SMALLEST_HEAD = 6.0
# Height of the logo, mm.
_LOGO = 11.0
# How far the lines of a legend may move together, where it has more than its room.
_TIGHTEST = 0.7


@dataclass(frozen=True)
class Entry:
    """A line of the legend; without symbol a heading."""

    text: str
    symbol: Symbol | None = None
    kinds: frozenset[str] = frozenset()


def wrapped(text: str, size: float, room: float, bold: bool = False) -> list[str]:
    """Break a text into lines that are not wider than `room` mm; a word that is wider stands alone, cut into pieces.

    Parameters
    ----------
    text : str
    size : float, points
    room : float, mm
    bold : bool
    """
    lines: list[str] = []
    for word in filter(None, text.split(" ")):  # other spaces hold together what stands at their sides
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and text_size(longer, size, bold)[0] <= room:
            lines[-1] = longer
            continue
        while text_size(word, size, bold)[0] > room and len(word) > 1:
            fits = next(n for n in range(len(word) - 1, 0, -1) if n == 1 or text_size(word[:n], size, bold)[0] <= room)
            lines.append(word[:fits])
            word = word[fits:]
        lines.append(word)
    return lines


def _fitted(text: str, size: float, room: float, bold: bool = False) -> tuple[str, float]:
    """Text and size that fit into `room` mm: those given, or smaller, or the beginning and an ellipsis."""
    width = text_size(text, size, bold)[0]
    size = max(size if width <= room else size * room / width, _SMALLEST_HEAD)
    if text_size(text, size, bold)[0] <= room + 1e-6:
        return text, size
    low, high = 0, len(text)  # so many letters fit; so many do not
    while high - low > 1:
        middle = (low + high) // 2
        fits = text_size(f"{text[:middle]}…", size, bold)[0] <= room
        low, high = (middle, high) if fits else (low, middle)
    return f"{text[:low].rstrip()}…", size


def _draw_head(canvas: Canvas, page: Page, layout: Layout) -> list[str]:
    """Title and subtitle at the left, series, number and name of the sheet at the right.

    Each is made smaller where it has no room, down to a size that can be read, and then cut; what was is returned in
    words.
    """
    sheet, (left, bottom, right, top) = layout.sheet, page.head
    if top <= bottom:
        return []
    if sheet.logo:
        left = _logo(canvas, sheet.logo, left, bottom + 2.0, (right - left) / 3)
    number = f"Sheet {sheet.number}" if sheet.number else ""
    name = " · ".join(filter(None, (sheet.series, sheet.name)))
    most = right - left if not sheet.title + sheet.subtitle else 0.45 * (right - left)
    aside = max(min(text_size(number, 12.0, True)[0], most), min(text_size(name, 8.5)[0], most))
    room = right - left - (aside + 6.0 if aside else 0.0)
    upper, lower = bottom + 8.0, bottom + 3.2
    remarks = []
    for x, y, text, size, width, align, bold in (
        (left, upper, sheet.title, 18.0, room, "left", True),
        (left, lower, sheet.subtitle, 9.0, room, "left", False),
        (right, upper, number, 12.0, aside, "right", True),
        (right, lower, name, 8.5, aside, "right", False),
    ):
        shown, small = _fitted(text, size, width, bold)
        if shown != text:
            remarks.append(f"there is no room above the map for all of '{text}'")
        canvas.text(x, y, shown, small, align=align, bold=bold, color="#000000" if bold else "#333333")
    return remarks


def _logo(canvas: Canvas, path: str, left: float, bottom: float, widest: float) -> float:
    """Draw a picture of `_LOGO` mm height, or as high as the width allows; returns where the title starts."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            pixels = np.asarray(image.convert("RGBA"))
    except (OSError, UnidentifiedImageError) as error:
        raise InputError(f"the logo cannot be read ({error})", where=path, hint="give a PNG or JPEG file") from None
    ratio = float(pixels.shape[1] / pixels.shape[0])
    height = min(_LOGO, widest / ratio)
    canvas.picture(pixels, (left, bottom, left + height * ratio, bottom + height))
    return left + height * ratio + 3.0


def _draw_legend(canvas: Canvas, entries: Sequence[Entry], title: str, box: Box) -> tuple[float, int]:
    """Legend from the top of a box down."""
    left, bottom, right, top = box
    if not entries:
        return top, 0
    canvas.text(left, top - 8.5 * CAP * POINT, *_fitted(title, 8.5, right - left, True), bold=True)
    size, line_height = 6.8, 6.8 * POINT * 1.3
    rows = []
    for entry in entries:
        indent = _SWATCH + 2.0 if entry.symbol is not None else 0.0
        lines = wrapped(entry.text, size, right - left - indent, entry.symbol is None) or [""]
        rows.append((entry, indent, lines, max(4.6, len(lines) * line_height + 0.8)))
    room, need = top - 5.2 - bottom, sum(row[3] for row in rows)
    squeeze = max(_TIGHTEST, min(1.0, room / need))
    y = top - 5.2
    for k, (entry, indent, lines, height) in enumerate(rows):
        height = max(height * squeeze, len(lines) * line_height)
        if y - height < bottom - 0.3:
            return y, len(entries) - k
        middle = y - height / 2
        if entry.symbol is not None:
            draw_swatch(canvas, entry.symbol, set(entry.kinds), (left, middle - 1.3, left + _SWATCH, middle + 1.3))
        for n, line in enumerate(lines):
            down = (n - (len(lines) - 1) / 2) * line_height
            base = middle - down - size * CAP * POINT / 2
            canvas.text(left + indent, base, line, size, bold=entry.symbol is None)
        y -= height
    return y - 0.5, 0


def _draw_blocks(canvas: Canvas, blocks: Sequence[tuple[str, list[str]]], box: Box, size: float = 6.2) -> bool:
    """Headed blocks of text from the top of a box down, in a smaller size where they would not fit; whether they do."""
    left, bottom, right, top = box
    rows: list[tuple[str, bool]] = []
    fits = False
    while not fits and size >= _SMALLEST_TEXT:
        rows = _rows(blocks, right - left, size)
        fits = _height(rows, size) <= top - bottom + 0.5
        size = size if fits else size - 0.1
    y = top - size * CAP * POINT
    for text, bold in rows:
        if y < bottom - 0.5:
            break
        canvas.text(left, y, text, size, bold=bold)
        y -= size * POINT * _LEADING * (1.0 if text else 0.5)
    return fits


def _draw_panel(canvas: Canvas, parts: SheetParts, entries: Sequence[Entry]) -> list[str]:
    """Everything in the panel and the foot; returns what had no room, in words."""
    page, layout, blocks, series = parts.page, parts.layout, parts.blocks, parts.series
    convergence = parts.convergence if layout.north.show else None
    remarks: list[str] = []
    if page.foot is not None:
        left, bottom, right, top = page.foot
        draw_scale(canvas, page, layout, (left + right) / 2, top - 3.5, right - left)
    if page.panel is None:
        if layout.sheet.panel == "auto" and (entries or blocks):
            remarks.append("the paper is too small for legend, north arrow and notes: they are left out")
        return remarks
    left, bottom, right, top = page.panel
    canvas.rectangle(page.panel, edge="#000000", width=0.25)
    pad = 3.0
    if page.side == "right":
        room = right - left - 2 * pad
        if series is not None:
            draw_index(canvas, series, (left + pad, bottom + pad, right - pad, bottom + pad + INDEX))
            bottom += INDEX + pad
        need = _height(_rows(blocks, room))
        floor = min(bottom + pad + need + (BLOCK if convergence is not None else 0.0) + 2.0, top - 40.0)
        end, lost = _draw_legend(canvas, entries, layout.legend.title, (left + pad, floor, right - pad, top - pad))
        y = _rule(canvas, left, right, end - 1.0) if entries else top
        if convergence is not None:
            end = _north(canvas, left + pad, right - pad, y - 3.0, convergence, parts.magnetic)
            y = _rule(canvas, left, right, end)
        fits = _draw_blocks(canvas, blocks, (left + pad, bottom + pad, right - pad, y - pad))
    else:
        wide = 0.38 * (right - left)
        cuts = (left, left + 0.32 * (right - left), left + 0.70 * (right - left), right)
        canvas.lines([[(x, bottom), (x, top)] for x in cuts[1:3]], "#000000", 0.15)
        _, lost = _draw_legend(
            canvas, entries, layout.legend.title, (left + pad, bottom + pad, cuts[1] - pad, top - pad)
        )
        y = draw_scale(canvas, page, layout, (cuts[1] + cuts[2]) / 2, top - pad, wide - 2.0)
        if convergence is not None:
            _north(canvas, cuts[1] + pad, cuts[2] - pad, y - 4.0, convergence, parts.magnetic)
        if series is not None:
            draw_index(canvas, series, (cuts[2] + pad, bottom + pad, right - pad, bottom + pad + INDEX))
            bottom += INDEX + pad
        fits = _draw_blocks(canvas, blocks, (cuts[2] + pad, bottom + pad, right - pad, top - pad))
    if lost:
        remarks.append(f"the legend has no room for {lost} of {len(entries)} entries")
    if not fits:
        remarks.append("the notes have no room in the margin")
    return remarks


def _rows(blocks: Sequence[tuple[str, list[str]]], room: float, size: float = 6.2) -> list[tuple[str, bool]]:
    """Lines of blocks of text, bold or not; an empty one between blocks."""
    rows: list[tuple[str, bool]] = []
    for k, (head, lines) in enumerate(blocks):
        rows += [("", False)] if k else []
        rows += [(head, True)] if head else []
        rows += [(part, False) for line in lines for part in wrapped(line, size, room)]
    return rows


def _height(rows: Sequence[tuple[str, bool]], size: float = 6.2) -> float:
    """Height in mm of lines of text; empty ones are half as high."""
    return sum(1.0 if text else 0.5 for text, _ in rows) * size * POINT * _LEADING


def _rule(canvas: Canvas, left: float, right: float, y: float) -> float:
    canvas.lines([[(left, y), (right, y)]], "#000000", 0.15)
    return y


def _north(
    canvas: Canvas, left: float, right: float, top: float, convergence: float, magnetic: Declination | None
) -> float:
    """Arrows at the left, what they mean at the right; returns the lower end."""
    end = draw_north(canvas, left + 12.0, top, convergence, magnetic)
    lines = north_lines(convergence, magnetic)
    words = [line for text in lines for line in wrapped(text, 6.2, right - left - 26.0)]
    y = top - 6.0
    for line in words:
        canvas.text(left + 26.0, y, line, 6.2)
        y -= 6.2 * POINT * _LEADING
    return min(end, y + 1.0) - 1.0


def draw_map(canvas: Canvas, parts: SheetParts, pixels: Pixels, area: Box) -> list[str]:
    """Draw what is inside the neatline; returns what had no room, in words.

    Parameters
    ----------
    canvas : Canvas
    parts : SheetParts
    pixels : callable, see `Pixels`
    area : Box, rectangle of the page that the picture fills, mm
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


def draw_sheet(parts: SheetParts, pixels: Pixels) -> tuple[Canvas, list[str]]:
    """Draw the whole page; returns it and what had no room, in words.

    Parameters
    ----------
    parts : SheetParts
    pixels : callable, see `Pixels`
    """
    page, layout = parts.page, parts.layout
    canvas = Canvas(page.paper)
    remarks = draw_map(canvas, parts, pixels, page.neatline)
    placer = LabelPlacer((0.0, 0.0, page.width, page.height))
    draw_labels(canvas, page, ((parts.grids[0], layout.grid), (parts.grids[1], layout.graticule)), placer)
    draw_edge(canvas, page)
    draw_crop_marks(canvas, page)
    if parts.series is not None:
        lost = draw_neighbour_names(canvas, page, parts.series, placer)
        remarks += [f"the frame has no room for the neighbours' names {', '.join(lost)}"] if lost else []
    remarks += _draw_head(canvas, page, layout)
    entries = legend(parts) if layout.legend.show else []
    remarks += _draw_panel(canvas, parts, entries)
    return canvas, remarks


def legend(parts: SheetParts) -> list[Entry]:
    """Entries in the order in which layers lie, the uppermost first.

    Parameters
    ----------
    parts : SheetParts
    """
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
