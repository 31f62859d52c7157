"""Neighbours of a sheet in its series: their names on the frame, and a small index map."""

from __future__ import annotations

from geomosaic.sheets.drawing.canvas import Canvas
from geomosaic.sheets.drawing.fonts import CAP, POINT, text_size
from geomosaic.sheets.page import Box, Page
from geomosaic.sheets.series.neatline import SheetPlace
from geomosaic.sheets.series.regular import DIRECTIONS

INDEX = 24.0
"""Height in mm of the index map with its heading."""


SIZE = 5.5
"""Of the names on the frame, points."""


def draw_around(canvas: Canvas, page: Page, series: SheetPlace) -> None:
    """Names of the four neighbours in gaps of the border, in the middle of its sides."""
    left, bottom, right, top = page.border
    places = {
        "N": ((left + right) / 2, top, 0.0), "S": ((left + right) / 2, bottom, 0.0),
        "W": (left, (bottom + top) / 2, 90.0), "E": (right, (bottom + top) / 2, 90.0),
    }  # fmt: skip
    for way, (x, y, angle) in places.items():
        name = series.neighbours.get(way)
        if name is None:
            continue
        long, high = text_size(name, SIZE)[0] / 2 + 1.0, SIZE * CAP * POINT / 2 + 0.3
        wide, tall = (high, long) if angle else (long, high)
        canvas.rectangle((x - wide, y - tall, x + wide, y + tall), fill="#ffffff")
        canvas.centred(x, y, name, SIZE, angle=angle)


def draw_index(canvas: Canvas, series: SheetPlace, box: Box) -> None:
    """Three by three sheets with their names, this one in the middle; those that do not exist stay empty."""
    left, bottom, right, top = box
    canvas.text(left, top - 6.2 * CAP * POINT, "Neighbouring sheets", 6.2, bold=True)
    top -= 3.4
    wide, high = (right - left) / 3, (top - bottom) / 3
    names = {(0, 0): series.name} | {DIRECTIONS[way]: name for way, name in series.neighbours.items()}
    longest = max(text_size(name, 1.0)[0] for name in names.values())
    size = min(5.5, (wide - 1.0) / longest)
    # Names that would be too small to read are broken before their last parts.
    broken = size < 4.2
    for (east, north), name in names.items():
        x, y = left + (1 + east) * wide, bottom + (1 + north) * high
        own = (east, north) == (0, 0)
        canvas.rectangle((x, y, x + wide, y + high), fill="#d9d9d9" if own else None, edge="#000000", width=0.12)
        lines = _halves(name) if broken else [name]
        points = min([5.5, *((wide - 1.0) / text_size(line, 1.0)[0] for line in lines)])
        for k, line in enumerate(lines):
            down = (k - (len(lines) - 1) / 2) * points * POINT * 1.3
            canvas.centred(x + wide / 2, y + high / 2 - down, line, points, bold=own)


def _halves(name: str) -> list[str]:
    """A name in two lines, broken after the hyphen or blank nearest to its middle."""
    cuts = [k + 1 for k, letter in enumerate(name[:-1]) if letter in "- "]
    if not cuts:
        return [name]
    cut = min(cuts, key=lambda k: abs(2 * k - len(name)))
    return [name[:cut], name[cut:].strip()]
