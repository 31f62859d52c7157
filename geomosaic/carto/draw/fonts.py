"""The font of a sheet, and those that lend it the characters it lacks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextvars import ContextVar
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
            raise InputError(f"the font cannot be read ({error})", where=path, mend="give a TrueType font") from None
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
