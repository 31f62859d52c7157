"""Texts that fit their room: lines broken between words, sizes made smaller, blocks under headings."""

from __future__ import annotations

from collections.abc import Sequence

from geomosaic.sheets.drawing.canvas import CAP, POINT, Canvas, text_size
from geomosaic.sheets.page import Box

# Distance of lines in parts of the text size.
LEADING = 1.42
# Size in points of notes, and that below which they are left out rather than printed: it could not be read without a
# lens.
NOTE_SIZE, _SMALLEST_TEXT = 6.2, 4.5
# Size in points below which titles are cut rather than made smaller.
_SMALLEST_HEAD = 6.0


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


def fitted(text: str, size: float, room: float, bold: bool = False) -> tuple[str, float]:
    """Text and size that fit into `room` mm: those given, or smaller, or the beginning and an ellipsis.

    Parameters
    ----------
    text : str
    size : float, points
    room : float, mm
    bold : bool
    """
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


def draw_blocks(canvas: Canvas, blocks: Sequence[tuple[str, list[str]]], box: Box) -> tuple[Box, bool]:
    """Headed blocks of text from the top of a box down, in a smaller size where they would not fit.

    Parameters
    ----------
    canvas : Canvas
    blocks : sequence of (heading, lines)
    box : Box, mm

    Returns
    -------
    box : Box, of what was drawn
    fits : bool, whether that is all
    """
    left, bottom, right, top = box
    size = NOTE_SIZE
    rows: list[tuple[str, bool]] = []
    fits = False
    while not fits and size >= _SMALLEST_TEXT:
        rows = _rows(blocks, right - left, size)
        fits = _height(rows, size) <= top - bottom + 0.5
        size = size if fits else size - 0.1
    y, widest = top - size * CAP * POINT, 0.0
    for text, bold in rows:
        if y < bottom - 0.5:
            break
        canvas.text(left, y, text, size, bold=bold)
        widest = max(widest, text_size(text, size, bold)[0])
        y -= size * POINT * LEADING * (1.0 if text else 0.5)
    return (left, y + size * POINT, left + widest, top), fits


def height_of(blocks: Sequence[tuple[str, list[str]]], room: float) -> float:
    """Height in mm that headed blocks of text take in their full size.

    Parameters
    ----------
    blocks : sequence of (heading, lines)
    room : float, width in mm
    """
    return _height(_rows(blocks, room, NOTE_SIZE), NOTE_SIZE)


def _rows(blocks: Sequence[tuple[str, list[str]]], room: float, size: float) -> list[tuple[str, bool]]:
    """Lines of blocks of text, bold or not; an empty one between blocks."""
    rows: list[tuple[str, bool]] = []
    for k, (head, lines) in enumerate(blocks):
        rows += [("", False)] if k else []
        rows += [(head, True)] if head else []
        rows += [(part, False) for line in lines for part in wrapped(line, size, room)]
    return rows


def _height(rows: Sequence[tuple[str, bool]], size: float) -> float:
    """Height in mm of lines of text; empty ones are half as high."""
    return sum(1.0 if text else 0.5 for text, _ in rows) * size * POINT * LEADING
