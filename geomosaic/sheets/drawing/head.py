"""Strip above the map: logo, title and subtitle at the left, number and names of the sheet at the right."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomosaic.errors import InputError
from geomosaic.sheets.drawing.canvas import POINT, Canvas, text_size
from geomosaic.sheets.drawing.text_lines import fitted
from geomosaic.sheets.layout import ELEMENTS, SheetPart
from geomosaic.sheets.page import Box
from geomosaic.types import ByteArray

# Height of the logo, mm.
LOGO = 11.0


def draw_head(canvas: Canvas, sheet: SheetPart, head: Box, own: Sequence[str]) -> tuple[dict[str, Box], list[str]]:
    """Draw the strip above the map.

    Parameters
    ----------
    canvas : Canvas
    sheet : SheetPart
    head : Box
        The strip, mm.
    own : sequence of str
        Elements of the sheet that have no position of their own.

    Returns
    -------
    boxes : dict of str to Box
    remarks : list of str
        What had no room.
    """
    left, bottom, right, top = head
    boxes, remarks = dict[str, Box](), list[str]()
    if top <= bottom:
        left_out = [ELEMENTS[name] for name in ("title", "number", "logo") if name in own]
        note = "no strip is above the map: the {} is left out; {} gives it a place"
        return boxes, [note.format(one.title, one.where) for one in left_out]
    upper = bottom + 13.0
    if "logo" in own:
        boxes["logo"] = draw_logo(canvas, sheet.logo, left, upper, (right - left) / 3)
        left = boxes["logo"][2] + 3.0
    room = right - left
    most = room if "title" not in own else 0.45 * room
    aside = min(number_width(sheet), most) if "number" in own else 0.0
    if "title" in own:
        boxes["title"], remarks = draw_title(canvas, sheet, left, upper, room - (aside + 6.0 if aside else 0.0))
    if "number" in own:
        boxes["number"], lost = draw_number(canvas, sheet, right, upper, most)
        remarks += lost
    return boxes, remarks


def draw_title(canvas: Canvas, sheet: SheetPart, left: float, top: float, room: float) -> tuple[Box, list[str]]:
    """Title and subtitle.

    Parameters
    ----------
    canvas : Canvas
    sheet : SheetPart
    left, top, room : float
        Upper left corner and width, mm.

    Returns
    -------
    box : Box
    remarks : list of str
        What had no room.
    """
    rows = [(top - 5.0, sheet.title, 18.0, True), (top - 9.8, sheet.subtitle, 9.0, False)]
    return _draw_rows(canvas, rows, left, room, "left")


def draw_number(canvas: Canvas, sheet: SheetPart, right: float, top: float, room: float) -> tuple[Box, list[str]]:
    """Number of the sheet, and below it its series and name; they end at `right`.

    Parameters
    ----------
    canvas : Canvas
    sheet : SheetPart
    right, top, room : float
        Upper right corner and width, mm.

    Returns
    -------
    box : Box
    remarks : list of str
        What had no room.
    """
    number, name = sheet_number(sheet)
    return _draw_rows(canvas, [(top - 5.0, number, 12.0, True), (top - 9.8, name, 8.5, False)], right, room, "right")


def sheet_number(sheet: SheetPart) -> tuple[str, str]:
    """Number of a sheet, and its series and name, in words; empty where there is none.

    Parameters
    ----------
    sheet : SheetPart
    """
    return f"Sheet {sheet.number}" if sheet.number else "", " · ".join(filter(None, (sheet.series, sheet.name)))


def number_width(sheet: SheetPart) -> float:
    """Width of number, series and name of a sheet, mm.

    Parameters
    ----------
    sheet : SheetPart
    """
    number, name = sheet_number(sheet)
    return max(text_size(number, 12.0, True)[0], text_size(name, 8.5)[0])


def _draw_rows(
    canvas: Canvas, rows: Sequence[tuple[float, str, float, bool]], x: float, room: float, align: str
) -> tuple[Box, list[str]]:
    """Lines of a title: made smaller where they have no room, down to a size that can be read, and then cut."""
    remarks, widest, low, high = [], 0.0, np.inf, -np.inf
    for y, text, size, bold in rows:
        if not text:
            continue
        shown, small = fitted(text, size, room, bold)
        if shown != text:
            remarks.append(f"there is no room above the map for all of '{text}'")
        canvas.text(x, y, shown, small, align=align, bold=bold, color="#000000" if bold else "#333333")
        widest = max(widest, text_size(shown, small, bold)[0])
        low, high = min(low, y - 0.25 * size * POINT), max(high, y + (5.0 if bold else 2.5))
    left = x if align == "left" else x - widest
    return (left, low, left + widest, max(high, rows[0][0] + 5.0)), remarks


def draw_logo(canvas: Canvas, path: str, left: float, top: float, widest: float) -> Box:
    """Picture below `top`, on the line on which one of the full height would stand, lower where that is too wide.

    Parameters
    ----------
    canvas : Canvas
    path : str
    left, top, widest : float
        Millimetres on the page.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            pixels: ByteArray = np.asarray(image.convert("RGBA"))
    except (OSError, UnidentifiedImageError) as error:
        raise InputError(f"the logo cannot be read ({error})", where=path, hint="give a PNG or JPEG file") from None
    ratio = float(pixels.shape[1] / pixels.shape[0])
    bottom = top - LOGO
    height = min(LOGO, widest / ratio)
    box = (left, bottom, left + height * ratio, bottom + height)
    canvas.picture(pixels, box)
    return box
