"""The size and shape of texts, in millimetres and in points."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from geomosaic.carto.draw.fonts import CAP, families, properties

POINT = 25.4 / 72.0
"""Millimetres in a point."""

BREAKS = dict.fromkeys((*range(32), 0x7F, 0x85, 0x2028, 0x2029), " ")
"""Characters that would break a line, or have no form: one line of text has blanks in their place."""


def text_size(text: str, size: float, bold: bool = False, italic: bool = False) -> tuple[float, float]:
    """Width and height in mm of one line of text at a size in points; the height is that of capitals."""
    return _text_size(text, size, bold, italic, families())


@lru_cache(maxsize=4096)
def _text_size(text: str, size: float, bold: bool, italic: bool, fonts: tuple[str, ...]) -> tuple[float, float]:
    if not text.strip():
        return 0.0, size * CAP * POINT
    # Control points of the outline's curves reach a little beyond it, which is on the safe side.
    return float(outline(text, size, bold, italic).vertices[:, 0].max()) * POINT, size * CAP * POINT


def advances(letters: Sequence[str], size: float, bold: bool = False, italic: bool = False) -> list[float]:
    """How far each letter takes the pen, in mm: to the next one, kerned."""
    found = []
    for letter, after in itertools.pairwise([*letters, ""]):
        if not after:
            found.append(advance(letter, size, bold, italic))
        else:
            found.append(advance(letter + after, size, bold, italic) - advance(after, size, bold, italic))
    return found


def advance(text: str, size: float, bold: bool, italic: bool) -> float:
    """Width with the room that the font leaves before what comes next, mm."""
    return text_size(text + "|", size, bold, italic)[0] - text_size("|", size, bold, italic)[0]


def outline(text: str, size: float, bold: bool, italic: bool) -> Any:
    """Matplotlib's path of one line of text from the left end of its baseline, in points."""
    from matplotlib.textpath import TextPath

    return TextPath((0, 0), text.translate(BREAKS).replace("$", r"\$"), size=size, prop=properties(bold, italic))
