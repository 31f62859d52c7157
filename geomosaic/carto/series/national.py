"""German topographic maps (TK) and French maps of the IGN."""

from __future__ import annotations

import re
from fractions import Fraction

from geomosaic.carto.series.international import from_roman, roman
from geomosaic.carto.series.scheme import GridScheme
from geomosaic.errors import InputError

TK = {25_000: (1, ""), 50_000: (2, "L"), 100_000: (4, "C"), 200_000: (8, "CC")}
"""By scale: sheets of TK 25 along a side, and the letters before the number (Roman 50, 100, 200 in thousands)."""


def tk(scale: int) -> GridScheme:
    """German sheets: TK 25 of 10′ by 6′, and 2, 4 and 8 times that, named by the TK 25 in their south-western corner.

    The number is row and column of the TK 25, counted from the north and the west: the upper edge of row 0 is 56° N,
    the left edge of column 1 is 5° 50′ E (0916 on Sylt, 4901 Selfkant, 4855 Görlitz, 8727 Biberkopf are outermost).
    The edges are those of the old datum (DHDN).

    Raises
    ------
    InputError
        There is no such scale.
    """
    if scale not in TK:
        raise InputError(f"there is no TK 1:{scale}", where="--scale", mend=f"one of {', '.join(f'1:{s}' for s in TK)}")
    side, prefix = TK[scale]

    # Blocks start at even columns and end with odd rows: L 7934 has rows 78 and 79, columns 34 and 35.
    west = 2 if side > 1 else 1

    def name_of(col: int, row: int) -> str | None:
        x, y = west + col * side, (row + 1) * side - 1
        if not (0 <= x <= 99 and 0 <= y <= 99):
            return None
        return f"{prefix} {y:02d}{x:02d}".strip()

    def place_of(name: str) -> tuple[int, int] | None:
        found = re.fullmatch(r"([LC]{0,2})\s*(\d\d)(\d\d)", name.upper())
        if not found or found[1] != prefix:
            return None
        y, x = int(found[2]), int(found[3])
        if (x - west) % side or (y + 1) % side:
            return None
        return (x - west) // side, (y + 1) // side - 1

    left = Fraction(35, 6) + Fraction(west - 1, 6)
    return GridScheme(
        f"TK {scale // 1000}", "EPSG:4314", float(scale), (left, Fraction(56)),
        (Fraction(side, 6), Fraction(side, 10)), True, name_of, place_of, f"{prefix} 7934".strip(),
        lambda name: "EPSG:25832" if _tk_column(name) < 38 else "EPSG:25833",
    )  # fmt: skip


def _tk_column(name: str) -> int:
    """Column of a sheet; 38 begins at 12° E, where UTM zone 33 does."""
    return int(name[-2:])


PARIS = Fraction("2.337229167")
"""Longitude of the meridian of Paris in degrees (2.5969213 gon)."""
GON = Fraction(9, 10)
"""Degrees."""


def ign(scale: int) -> GridScheme:
    """French sheets 1:50 000 (0.4 gon by 0.2 gon, XXIII-14) and 1:25 000 (their halves: 2314 O, 2314 E).

    Columns count from the west, rows from the north. Their origin is taken from where published sheets lie (XXIII
    begins at the meridian of Paris, row 14 reaches from 54.2 to 54.4 gon): no text that states it was at hand. The
    edges are those of the NTF.

    Raises
    ------
    InputError
        There is no such scale.
    """
    if scale not in (25_000, 50_000):
        raise InputError(f"there are no such French sheets 1:{scale}", where="--scale", mend="1:25000 or 1:50000")
    halves = 2 if scale == 25_000 else 1

    def name_of(col: int, row: int) -> str | None:
        column, half = col // halves + 1, col % halves
        if not (1 <= column <= 45 and 1 <= row + 1 <= 60):
            return None
        return f"{column:02d}{row + 1:02d} {'OE'[half]}" if halves == 2 else f"{roman(column)}-{row + 1}"

    def place_of(name: str) -> tuple[int, int] | None:
        found = re.fullmatch(r"(?:(\d\d)(\d\d)|([IVXL]+)\s*-\s*(\d+))\s*(O|E|OUEST|EST)?", name.upper())
        if not found or (found[5] is None) != (halves == 1):
            return None
        column = int(found[1]) if found[1] else from_roman(found[3])
        if column is None:
            return None
        half = 1 if halves == 2 and found[5].startswith("E") else 0
        return (column - 1) * halves + half, int(found[2] or found[4]) - 1

    return GridScheme(
        f"the French map 1:{scale}", "EPSG:4275", float(scale),
        (PARIS - 22 * Fraction(2, 5) * GON, Fraction(57) * GON),
        (Fraction(2, 5) / halves * GON, Fraction(1, 5) * GON), True, name_of, place_of,
        "2314 O" if halves == 2 else "XXIII-14", lambda name: "EPSG:2154",
    )  # fmt: skip
