"""Elements around the map: title, number, logo, legend, scale bar, north arrows and notes.

Each stands in the strip above the map, in the panel or in the foot, or where the layout has a position for it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from geomosaic.errors import InputError
from geomosaic.sheets.drawing.canvas import CAP, POINT, Canvas, text_size
from geomosaic.sheets.drawing.contents import Entry, SheetParts, legend
from geomosaic.sheets.drawing.frame import INDEX, draw_index
from geomosaic.sheets.drawing.head import (
    draw_head,
    draw_logo,
    draw_number,
    draw_title,
    number_width,
    sheet_number,
)
from geomosaic.sheets.drawing.labels import draw_swatch
from geomosaic.sheets.drawing.scale_and_north import BLOCK, draw_north, draw_scale, north_lines
from geomosaic.sheets.drawing.text_lines import LEADING, NOTE_SIZE, draw_blocks, fitted, height_of, wrapped
from geomosaic.sheets.layout import ELEMENTS, Declination
from geomosaic.sheets.page import Box, Page, rectangles_overlap
from geomosaic.sheets.style import MARKERS

# Width of a symbol in the legend, mm.
_SWATCH = 9.0
# How far the lines of a legend may move together, where it has more than its room.
_TIGHTEST = 0.7
# White around what the panel or the ground of an element on the map holds, mm.
_PAD, _GROUND = 3.0, 1.5
# Width of north arrows and the words beside them, mm.
_NORTH = 58.0

# From the top left corner of an element, in mm on the page, to its box and what had no room, in words.
_Draw = Callable[[Canvas, float, float], tuple[Box, list[str]]]


def draw_margin(canvas: Canvas, parts: SheetParts) -> tuple[dict[str, Box], list[str]]:
    """Draw everything around the map.

    Parameters
    ----------
    canvas : Canvas
    parts : SheetParts

    Returns
    -------
    boxes : dict of str to Box
        Left, bottom, right, top in mm of the elements that are on the page, by their names in `ELEMENTS`.
    remarks : list of str
        What had no room.

    Raises
    ------
    InputError
        A position beyond the paper, a logo that cannot be read, a scale bar that does not fit.
    """
    own = [name for name in _elements(parts) if parts.layout.position_of(name) is None]
    boxes, remarks = draw_head(canvas, parts.layout.sheet, parts.page.head, own)
    found, more = _draw_panel(canvas, parts, own)
    moved, lost = _draw_moved(canvas, parts)
    return {**boxes, **found, **moved}, [*remarks, *more, *lost]


def _draw_moved(canvas: Canvas, parts: SheetParts) -> tuple[dict[str, Box], list[str]]:
    """Draw the elements that the layout has positions for, each that reaches over the map on a white ground."""
    page = parts.page
    boxes: dict[str, Box] = {}
    remarks: list[str] = []
    for name, draw in _elements(parts).items():
        position = parts.layout.position_of(name)
        if position is None:
            continue
        left, top = position[0], page.height - position[1]
        if not (left < page.width and top > 0.0):
            raise InputError(
                f"the {ELEMENTS[name].title} would stand beyond the paper of {page.width:g} x {page.height:g} mm",
                where=ELEMENTS[name].where,
                hint="give mm from the left and from the upper edge of the paper",
            )
        box, lost = draw(_BLANK, left, top)
        if name != "logo" and rectangles_overlap(box, page.border):
            canvas.rectangle(ground_of(box), fill="#ffffff")
        draw(canvas, left, top)
        boxes[name] = box
        remarks += lost
        if box[2] > page.width + 0.05 or box[1] < -0.05:
            remarks.append(f"the {ELEMENTS[name].title} reaches beyond the paper")
    return boxes, remarks


def ground_of(box: Box) -> Box:
    """White ground of an element that lies on the map.

    Parameters
    ----------
    box : Box, mm
    """
    return (box[0] - _GROUND, box[1] - _GROUND, box[2] + _GROUND, box[3] + _GROUND)


def measured(parts: SheetParts) -> dict[str, Box]:
    """Boxes of the elements that the layout has positions for, nothing drawn.

    Parameters
    ----------
    parts : SheetParts
    """
    return _draw_moved(_BLANK, parts)[0]


class _Blank(Canvas):
    """Canvas that draws nothing: what is drawn on it is measured."""

    def __init__(self) -> None:
        pass

    def lines(self, *_: object, **__: object) -> None:
        """Draw nothing."""

    def area(self, *_: object, **__: object) -> None:
        """Draw nothing."""

    def markers(self, *_: object, **__: object) -> None:
        """Draw nothing."""

    def picture(self, *_: object, **__: object) -> None:
        """Draw nothing."""

    def text(self, *_: object, **__: object) -> None:
        """Draw nothing."""


_BLANK = _Blank()


def _elements(parts: SheetParts) -> Mapping[str, _Draw]:
    """How each element that is on the sheet is drawn from its upper left corner, by name."""
    page, layout, sheet = parts.page, parts.layout, parts.layout.sheet
    found: dict[str, _Draw] = {}
    if sheet.logo:
        found["logo"] = lambda canvas, x, y: (draw_logo(canvas, sheet.logo, x, y, page.width / 3), [])
    if sheet.title or sheet.subtitle:
        found["title"] = lambda canvas, x, y: draw_title(canvas, sheet, x, y, page.width - x)
    if any(sheet_number(sheet)):
        found["number"] = lambda canvas, x, y: draw_number(canvas, sheet, x + number_width(sheet), y, page.width)
    entries = legend(parts) if layout.legend.show else []
    if entries:
        part = layout.legend
        found["legend"] = lambda canvas, x, y: _draw_legend(canvas, entries, part.title, (x, 0.0, x + part.width, y))
    room = _bar_room(page)
    found["scalebar"] = lambda canvas, x, y: (draw_scale(canvas, page, layout, x, y, room), [])
    convergence = parts.convergence
    if convergence is not None and layout.north.show:
        found["north"] = lambda canvas, x, y: (_north(canvas, x, x + _NORTH, y, convergence, parts.magnetic), [])
    if parts.blocks:
        width = layout.notes.width
        found["notes"] = lambda canvas, x, y: _draw_notes(canvas, parts.blocks, (x, 0.0, x + width, y))
    return found


def _draw_legend(canvas: Canvas, entries: Sequence[Entry], title: str, box: Box) -> tuple[Box, list[str]]:
    """Legend from the top of a box down."""
    left, bottom, right, top = box
    heading, large = fitted(title, 8.5, right - left, True)
    canvas.text(left, top - 8.5 * CAP * POINT, heading, large, bold=True)
    widest = text_size(heading, large, True)[0]
    size, line_height = 6.8, 6.8 * POINT * 1.3
    rows = []
    for entry in entries:
        indent = _SWATCH + 2.0 if entry.symbol is not None else 0.0
        lines = wrapped(entry.text, size, right - left - indent, entry.symbol is None) or [""]
        rows.append((entry, indent, lines, max(4.6, len(lines) * line_height + 0.8, _symbol_height(entry))))
    room, need = top - 5.2 - bottom, sum(row[3] for row in rows)
    squeeze = max(_TIGHTEST, min(1.0, room / need))
    y = top - 5.2
    for k, (entry, indent, lines, height) in enumerate(rows):
        height = max(height * squeeze, len(lines) * line_height, _symbol_height(entry) - 0.5)
        if y - height < bottom - 0.3:
            lost = f"the legend has no room for {len(entries) - k} of {len(entries)} entries"
            return (left, y, left + widest, top), [lost]
        middle = y - height / 2
        if entry.symbol is not None:
            draw_swatch(canvas, entry.symbol, set(entry.kinds), (left, middle - 1.3, left + _SWATCH, middle + 1.3))
        for n, line in enumerate(lines):
            down = (n - (len(lines) - 1) / 2) * line_height
            base = middle - down - size * CAP * POINT / 2
            canvas.text(left + indent, base, line, size, bold=entry.symbol is None)
            widest = max(widest, indent + text_size(line, size, entry.symbol is None)[0])
        y -= height
    return (left, y - 0.5, left + widest, top), []


def _symbol_height(entry: Entry) -> float:
    """Height in mm of a legend's line that a pictorial marker needs."""
    marker = None if entry.symbol is None else entry.symbol.marker
    return 0.0 if marker is None or marker.shape in MARKERS else marker.size + 0.8


def _draw_notes(canvas: Canvas, blocks: Sequence[tuple[str, list[str]]], box: Box) -> tuple[Box, list[str]]:
    drawn, fits = draw_blocks(canvas, blocks, box)
    return drawn, [] if fits else ["the notes have no room in the margin"]


def _draw_panel(canvas: Canvas, parts: SheetParts, own: Sequence[str]) -> tuple[dict[str, Box], list[str]]:
    """Panel and foot: legend, scale, north arrows and notes, those apart that have a position."""
    page, layout = parts.page, parts.layout
    entries = legend(parts) if "legend" in own else []
    blocks = parts.blocks if "notes" in own else ()
    boxes: dict[str, Box] = {}
    if page.foot is not None and "scalebar" in own:
        left, _, right, top = page.foot
        boxes["scalebar"] = draw_scale(canvas, page, layout, (left, right), top - 3.5, _bar_room(page))
    if page.panel is None:
        lost = layout.sheet.panel == "auto" and (entries or blocks)
        return boxes, (["the paper is too small for legend, north arrow and notes: they are left out"] if lost else [])
    if parts.series is not None or any(name in own for name in ("legend", "north", "notes")):
        canvas.rectangle(page.panel, edge="#000000", width=0.25)
    found, remarks = (_draw_right if page.side == "right" else _draw_bottom)(canvas, parts, entries, blocks, own)
    return {**boxes, **found}, remarks


def _draw_right(
    canvas: Canvas,
    parts: SheetParts,
    entries: Sequence[Entry],
    blocks: Sequence[tuple[str, list[str]]],
    own: Sequence[str],
) -> tuple[dict[str, Box], list[str]]:
    """Panel at the right: legend, north arrows and notes below each other, with lines between them."""
    assert parts.page.panel is not None
    left, bottom, right, top = parts.page.panel
    boxes: dict[str, Box] = {}
    remarks: list[str] = []
    convergence = parts.convergence if "north" in own else None
    room = right - left - 2 * _PAD
    if parts.series is not None:
        draw_index(canvas, parts.series, (left + _PAD, bottom + _PAD, right - _PAD, bottom + _PAD + INDEX))
        bottom += INDEX + _PAD
    y = top
    if entries:
        need = height_of(blocks, room) + (BLOCK if convergence is not None else 0.0)
        floor = min(bottom + _PAD + need + 2.0, top - 40.0)
        box = (left + _PAD, floor, right - _PAD, top - _PAD)
        boxes["legend"], remarks = _draw_legend(canvas, entries, parts.layout.legend.title, box)
        # A legend that is whole has a little more white below it than one that was cut.
        y = _rule(canvas, left, right, boxes["legend"][1] - 1.0)
    if convergence is not None:
        boxes["north"] = _north(canvas, left + _PAD, right - _PAD, y - 3.0, convergence, parts.magnetic)
        y = _rule(canvas, left, right, boxes["north"][1])
    if blocks:
        boxes["notes"], more = _draw_notes(canvas, blocks, (left + _PAD, bottom + _PAD, right - _PAD, y - _PAD))
        remarks += more
    return boxes, remarks


def _draw_bottom(
    canvas: Canvas,
    parts: SheetParts,
    entries: Sequence[Entry],
    blocks: Sequence[tuple[str, list[str]]],
    own: Sequence[str],
) -> tuple[dict[str, Box], list[str]]:
    """Panel at the bottom: legend, scale with north arrows, and notes beside each other."""
    page, layout = parts.page, parts.layout
    assert page.panel is not None
    left, bottom, right, top = page.panel
    boxes: dict[str, Box] = {}
    remarks: list[str] = []
    cuts = (left, left + 0.32 * (right - left), left + 0.70 * (right - left), right)
    canvas.lines([[(x, bottom), (x, top)] for x in cuts[1:3]], "#000000", 0.15)
    if entries:
        box = (left + _PAD, bottom + _PAD, cuts[1] - _PAD, top - _PAD)
        boxes["legend"], remarks = _draw_legend(canvas, entries, layout.legend.title, box)
    y = top - _PAD + 1.0
    if "scalebar" in own:
        boxes["scalebar"] = draw_scale(canvas, page, layout, (cuts[1], cuts[2]), top - _PAD, _bar_room(page))
        y = boxes["scalebar"][1]
    if parts.convergence is not None and "north" in own:
        boxes["north"] = _north(canvas, cuts[1] + _PAD, cuts[2] - _PAD, y - 4.0, parts.convergence, parts.magnetic)
    if parts.series is not None:
        draw_index(canvas, parts.series, (cuts[2] + _PAD, bottom + _PAD, right - _PAD, bottom + _PAD + INDEX))
        bottom += INDEX + _PAD
    if blocks:
        boxes["notes"], more = _draw_notes(canvas, blocks, (cuts[2] + _PAD, bottom + _PAD, right - _PAD, top - _PAD))
        remarks += more
    return boxes, remarks


def _bar_room(page: Page) -> float:
    """Width in mm for a scale bar in its usual place; elsewhere it is as long."""
    if page.foot is None and page.panel is not None:
        return 0.38 * (page.panel[2] - page.panel[0]) - 2.0
    left, _, right, _ = page.foot or page.border
    return right - left


def _rule(canvas: Canvas, left: float, right: float, y: float) -> float:
    canvas.lines([[(left, y), (right, y)]], "#000000", 0.15)
    return y


def _north(
    canvas: Canvas, left: float, right: float, top: float, convergence: float, magnetic: Declination | None
) -> Box:
    """Arrows at the left, what they mean at the right."""
    end = draw_north(canvas, left + 12.0, top, convergence, magnetic)
    lines = north_lines(convergence, magnetic)
    words = [line for text in lines for line in wrapped(text, NOTE_SIZE, right - left - 26.0)]
    y = top - 6.0
    for line in words:
        canvas.text(left + 26.0, y, line, NOTE_SIZE)
        y -= NOTE_SIZE * POINT * LEADING
    widest = max(text_size(line, NOTE_SIZE)[0] for line in words)
    return (left, min(end, y + 1.0) - 1.0, left + 26.0 + widest, top)
