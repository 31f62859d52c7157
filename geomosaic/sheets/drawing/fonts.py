"""Fonts of a sheet: sizes and shapes of texts, and fonts that lend missing characters."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError

FAMILY = "DejaVu Sans"
CAP = 0.729
"""Height of capitals and figures of DejaVu Sans in parts of the text size."""

_MORE: ContextVar[tuple[str, ...]] = ContextVar("fonts", default=())
"""Families of the sheet that is drawn, asked in turn for characters that the first has not."""


def families() -> tuple[str, ...]:
    """Names of the fonts in use, the first one first."""
    return (FAMILY, *_MORE.get())


def lend(paths: Sequence[str]) -> None:
    """Use font files (TrueType) for characters that DejaVu Sans lacks, here and in what is called from here.

    Raises
    ------
    InputError
        A file that is no font.
    """
    from matplotlib.font_manager import fontManager, get_font

    names = []
    for path in paths:
        try:
            if not Path(path).is_file():
                raise OSError("there is no such file")
            font: Any = get_font(path)
            fontManager.addfont(path)
        except (OSError, RuntimeError, ValueError) as error:
            raise InputError(f"the font cannot be read ({error})", where=path, hint="give a TrueType font") from None
        names.append(str(font.family_name))
    _MORE.set(tuple(names))


def properties(bold: bool, italic: bool) -> Any:
    """Matplotlib's description of the fonts in use."""
    from matplotlib.font_manager import FontProperties

    return FontProperties(
        family=list(families()), weight="bold" if bold else "normal", style="oblique" if italic else "normal"
    )


def missing_glyphs(texts: Iterable[str]) -> str:
    """Characters that no font in use has a glyph for, each once, in the order in which they come."""
    from matplotlib.font_manager import FontProperties, findfont, get_font

    known: set[int] = set()
    for family in families():
        known |= set(get_font(findfont(FontProperties(family=family))).get_charmap())
    found = dict.fromkeys(c for text in texts for c in text if ord(c) not in known and c.isprintable())
    return "".join(found)


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
