"""Sheet lines of named series: national topographic maps, and 100 km squares of MGRS.

After NGA.STND.0037, Universal Grids and Grid Reference Systems (2014): zones of 6°, bands of 8° from 80° S (X of 12°),
with the exceptions of Norway (32V) and Svalbard (31X to 37X); columns of 100 km in three alphabets of eight letters,
rows in one of twenty that starts at A in odd zones and at F in even ones. The poles (UPS) are left out.

Sheets 1:1 000 000 are 6° by 4°: letters from the equator, columns from 180° eastwards; those of the southern
hemisphere have S before the letter (SF-23 Rio de Janeiro), and N before that of northern ones is understood. Numbers
and letters of the divisions run by rows from the upper left. Polish rules: regulation on the spatial reference system
of 15 October 2012 (Dz.U. 2012 poz. 1247), section 18; the Soviet ones differ in their letters and in 1:200 000 for
1:250 000.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar

import numpy as np
import shapely

from geomosaic.errors import InputError
from geomosaic.geo.crs import parse_crs
from geomosaic.geo.transform import Transform
from geomosaic.sheets.grid_lines import densified_ring
from geomosaic.sheets.series.regular import DIRECTIONS, Cell, GridScheme, corners
from geomosaic.types import FloatArray

BANDS = "CDEFGHJKLMNPQRSTUVWX"
COLUMNS = ("ABCDEFGH", "JKLMNPQR", "STUVWXYZ")
_MGRS_ROWS = "ABCDEFGHJKLMNPQRSTUV"
_DIGITS = {100_000: 0, 10_000: 1, 1_000: 2, 100: 3}


def _zone_of(longitude: float, latitude: float) -> int:
    """UTM zone of a place, Norway and Svalbard included."""
    zone = int((longitude + 180.0) // 6.0) % 60 + 1
    if 56.0 <= latitude < 64.0 and 3.0 <= longitude < 12.0:
        return 32
    if 72.0 <= latitude < 84.0 and 0.0 <= longitude < 42.0:
        return 31 if longitude < 9 else 33 if longitude < 21 else 35 if longitude < 33 else 37
    return zone


def _zone_box(zone: int, band: str) -> Cell | None:
    """Longitudes and latitudes of a zone in a band; None where the exceptions leave nothing of it."""
    west, south = 6.0 * zone - 186.0, 8.0 * BANDS.index(band) - 80.0
    east, north = west + 6.0, 84.0 if band == "X" else south + 8.0
    if band == "V" and zone in (31, 32):
        west, east = (west, 3.0) if zone == 31 else (3.0, east)
    if band == "X" and 31 <= zone <= 37:
        if zone % 2 == 0:
            return None
        west, east = {31: (0.0, 9.0), 33: (9.0, 21.0), 35: (21.0, 33.0), 37: (33.0, 42.0)}[zone]
    return west, south, east, north


@dataclass(frozen=True)
class Mgrs:
    """Squares of one size in metres; at the edges of a zone or band only the part inside it.

    A name is as in the system, such as 31UDQ4811 for 1 km.
    """

    size: int = 100_000
    scale: float | None = None
    crs: str = "EPSG:4326"
    area: ClassVar[str] = "UTM ends at 80° S and 84° N"

    def __post_init__(self) -> None:
        if self.size not in _DIGITS:
            raise InputError(
                f"the system has no squares of {self.size} m", where="`size`",
                hint=f"give {', '.join(f'{size} {size}' for size in _DIGITS)}",
            )  # fmt: skip

    @property
    def title(self) -> str:
        """Of messages."""
        return f"MGRS squares of {self.size} m"

    def map_crs(self, name: str) -> str | None:
        """UTM of its zone."""
        zone, band, _, _ = self._parse(name)
        return _utm(zone, band)

    def find(self, x: float, y: float) -> str:
        """Square at a longitude and latitude."""
        if not (-180.0 <= x <= 180.0 and -80.0 <= y < 84.0):
            raise InputError(self.area, where=f"{x:.10g}, {y:.10g}", hint="longitude first, then latitude")
        zone, band = _zone_of(x, y), BANDS[min(int((y + 80.0) // 8.0), 19)]
        east, north = Transform(parse_crs(self.crs), parse_crs(_utm(zone, band)))(np.array([[x, y]]))[0]
        return self._name(zone, band, math.floor(east / self.size + 1e-9), math.floor(north / self.size + 1e-9))

    def _name(self, zone: int, band: str, col: int, row: int) -> str:
        """From indices of squares in UTM."""
        per = 100_000 // self.size
        east, north = col // per, row // per
        letters = COLUMNS[(zone - 1) % 3][east - 1] + _MGRS_ROWS[(north + (5 if zone % 2 == 0 else 0)) % 20]
        digits = _DIGITS[self.size]
        tail = f"{col % per:0{digits}d}{row % per:0{digits}d}" if digits else ""
        return f"{zone}{band}{letters}{tail}"

    def _parse(self, name: str) -> tuple[int, str, int, int]:
        """Zone, band, and indices of the square in UTM."""
        digits = _DIGITS[self.size]
        text = re.sub(r"\s+", "", name).upper()
        found = re.fullmatch(rf"(\d\d?)([C-HJ-NP-X])([A-HJ-NP-Z])([A-HJ-NP-V])(\d{{{digits}}})(\d{{{digits}}})", text)
        wrong = InputError(f"'{name}' is no square of {self.size} m", hint="names look like " + self.find(2.3, 48.9))
        if not found or not 1 <= int(found[1]) <= 60:
            raise wrong
        zone, band = int(found[1]), found[2]
        east = COLUMNS[(zone - 1) % 3].find(found[3]) + 1
        box = _zone_box(zone, band)
        if east == 0 or box is None:
            raise wrong
        # Rows repeat every 2000 km: the one inside the band counts.
        letter = (_MGRS_ROWS.index(found[4]) - (5 if zone % 2 == 0 else 0)) % 20
        low, high = self._reach(zone, band, box)
        per = 100_000 // self.size
        for north in range(letter, 100, 20):
            if north * 1e5 < high and (north + 1) * 1e5 > low:
                inside = int(found[5] or 0), int(found[6] or 0)
                return zone, band, east * per + inside[0], north * per + inside[1]
        raise wrong

    def _reach(self, zone: int, band: str, box: Cell) -> tuple[float, float]:
        """Least and largest northing of a zone in a band."""
        ring = densified_ring(corners(box), 20)
        north = Transform(parse_crs(self.crs), parse_crs(_utm(zone, band)))(ring)[:, 1]
        return float(north.min()), float(north.max())

    def proper(self, name: str) -> str:
        """Without blanks, in capitals, if something of it lies in its zone and band."""
        zone, band, col, row = self._parse(name)
        self.edges(name)
        return self._name(zone, band, col, row)

    def edges(self, name: str) -> tuple[str, FloatArray]:
        """UTM, and the square cut at the edges of its zone and band."""
        zone, band, col, row = self._parse(name)
        area = _zone_box(zone, band) or (0.0, 0.0, 0.0, 0.0)  # a name that is parsed has one
        crs = _utm(zone, band)
        inside = shapely.Polygon(Transform(parse_crs(self.crs), parse_crs(crs))(densified_ring(corners(area), 400)))
        size = float(self.size)
        square = shapely.box(col * size, row * size, (col + 1) * size, (row + 1) * size)
        part = square if inside.contains(square) else square.intersection(inside)
        if part.is_empty or part.geom_type != "Polygon":
            raise InputError(f"'{name}' lies outside zone {zone}{band}", hint="see `geomosaic sheets find`")
        return crs, np.asarray(part.normalize().reverse().exterior.coords)[:-1]

    def neighbours(self, name: str) -> dict[str, str]:
        """Squares at places just beyond the edges: at a zone's edge those of the next zone."""
        _, _, col, row = self._parse(name)
        crs, ring = self.edges(name)
        (left, bottom), (right, top) = ring.min(axis=0), ring.max(axis=0)
        # 2 % of a square beyond the edge: at the edge of a zone the neighbour is a part of a square of the next one.
        middle, half = np.array([(left + right) / 2, (bottom + top) / 2]), np.array([right - left, top - bottom]) / 2
        back = Transform(parse_crs(crs), parse_crs(self.crs))
        found: dict[str, str] = {}
        for way, step in DIRECTIONS.items():
            place = back((middle + np.array(step) * (half + 0.02 * self.size))[None])[0]
            if -80.0 <= place[1] < 84.0:
                other = self.find(float(place[0]), float(place[1]))
                if other not in (*found.values(), self._name(*self._parse(name)[:2], col, row)):
                    found[way] = other
        return found

    def within(self, box: Cell) -> Iterator[str]:
        """Squares that touch a box of longitudes and latitudes."""
        for band in reversed(BANDS):
            for zone in range(1, 61):
                area = _zone_box(zone, band)
                common = None if area is None else shapely.box(*area).intersection(shapely.box(*box))
                if common is None or common.is_empty or common.area == 0:
                    continue
                to = Transform(parse_crs(self.crs), parse_crs(_utm(zone, band)))
                ring = to(densified_ring(corners(common.bounds), 50))
                low, high = ring.min(axis=0) // self.size, ring.max(axis=0) // self.size
                for row in range(int(high[1]), int(low[1]) - 1, -1):
                    for col in range(int(low[0]), int(high[0]) + 1):
                        name = self._name(zone, band, col, row)
                        try:
                            self.edges(name)
                        except InputError:
                            continue
                        yield name


def _utm(zone: int, band: str) -> str:
    """EPSG code of WGS 84 / UTM."""
    return f"EPSG:{(32600 if band >= 'N' else 32700) + zone}"


_SHEET_ROWS = "ABCDEFGHIJKLMNOPQRSTUV"
LETTERS = {"latin": ("ABCD", "abcd"), "cyrillic": ("АБВГ", "абвг")}
# V and G are В and Г in Latin letters.
_FOURTH = {letter: k for alphabet in ("ABCD", "АБВГ") for k, letter in enumerate(alphabet)} | {"V": 2, "G": 3}
_ROMAN = ("I", "II", "III", "IV", "V", "VI", "VII", "VIII", "IX", "X")

# By scale: into how many rows and columns each step divides, and how the parts are called.
DIVISIONS: dict[int, tuple[tuple[int, str], ...]] = {
    1_000_000: (),
    500_000: ((2, "upper"),),
    250_000: ((2, "upper"), (2, "lower")),
    200_000: ((6, "roman"),),
    100_000: ((12, "number"),),
    50_000: ((12, "number"), (2, "upper")),
    25_000: ((12, "number"), (2, "upper"), (2, "lower")),
    10_000: ((12, "number"), (2, "upper"), (2, "lower"), (2, "number")),
}


def roman(number: int) -> str:
    """Roman numeral from 1 to 99.

    Parameters
    ----------
    number : int
    """
    tens, ones = divmod(number, 10)
    head = ("", "X", "XX", "XXX", "XL", "L", "LX", "LXX", "LXXX", "XC")[tens]
    return head + (_ROMAN[ones - 1] if ones else "")


def from_roman(text: str) -> int | None:
    """Value of a Roman numeral from 1 to 99.

    Parameters
    ----------
    text : str
    """
    return next((n for n in range(1, 100) if roman(n) == text.upper()), None)


def _refuse_scale(scale: int, known: Iterable[int], more: str = "") -> None:
    """Refuse a scale that a scheme has not; 0 is one that was not given."""
    if scale not in known:
        what = f"the scheme has no sheets 1:{scale}" if scale else "the scheme has sheets for several scales"
        raise InputError(what, where="`scale`", hint=f"give one of {', '.join(f'1:{s}' for s in known)}{more}")


def international(
    scale: int, *, crs: str = "EPSG:4326", letters: str = "latin", title: str = "", map_crs: str | None = None,
    south: bool = False,
) -> GridScheme:  # fmt: skip
    """Scheme of one scale.

    Parameters
    ----------
    scale : int, one of `DIVISIONS`
    crs : str, geographic; its datum is that of the edges
    letters : 'latin' or 'cyrillic'
    title : str, optional
    map_crs : str, optional
        CRS of the sheets; '{zone}' in it takes the number of the UTM zone, '{zone:02d}' in two digits, and '{gauss}'
        that of the Gauss-Krüger zone of 6°, and '{half}' 6 or 7 in the northern or southern hemisphere.
    south : bool, sheets 1:1 000 000 of the southern hemisphere too; divisions differ there from country to country

    Raises
    ------
    InputError
        The division has no such scale.
    """
    largest = f"1:{max(DIVISIONS)}"
    _refuse_scale(scale, DIVISIONS, f"; below the equator there are sheets {largest} alone" if south else "")
    steps = DIVISIONS[scale]
    fine = 1
    for parts, _ in steps:
        fine *= parts

    def name_of(col: int, row: int) -> str | None:
        big, up = col // fine % 60, row // fine  # the last column has the first one in the east
        if south and not steps and -len(_SHEET_ROWS) <= up < 0:
            return f"S{_SHEET_ROWS[-1 - up]}-{big + 1:02d}"
        if not 0 <= up < len(_SHEET_ROWS):
            return None
        words = [_SHEET_ROWS[up], f"{big + 1:02d}"]
        # Parts count southwards from the upper left.
        across, down, rest = col % fine, fine - 1 - row % fine, fine
        for parts, kind in steps:
            rest //= parts
            number = (down // rest) * parts + across // rest
            across, down = across % rest, down % rest
            words.append(_written(number, kind, letters))
        return "-".join(words)

    def place_of(name: str) -> tuple[int, int] | None:
        half = re.match(r"\s*([NS])(?=[A-V][-.\s]*\d)", name, re.IGNORECASE)
        if half and half[1].upper() == "S":
            found = re.fullmatch(r"([A-V])[-.\s]*(\d\d?)\s*", name[half.end() :], re.IGNORECASE)
            known = south and not steps and found is not None and 1 <= int(found[2]) <= 60
            return (int(found[2]) - 1, -1 - _SHEET_ROWS.index(found[1].upper())) if known and found else None
        name = name[half.end() :] if half else name
        words = re.findall(r"[0-9]+|[IVXL]{2,}|[^\W\d_]", name) if not steps or steps[0][1] != "roman" else None
        if words is None:
            words = [word for word in re.split(r"[-.\s]+", name) if word]
        if len(words) != 2 + len(steps) or words[0].upper() not in _SHEET_ROWS or not words[1].isdigit():
            return None
        col, row = int(words[1]) - 1, _SHEET_ROWS.index(words[0].upper())
        if not 0 <= col < 60:
            return None
        across = down = 0
        for (parts, kind), word in zip(steps, words[2:], strict=True):
            number = _read(word, kind)
            if number is None or not 0 <= number < parts * parts:
                return None
            across, down = across * parts + number % parts, down * parts + number // parts
        return col * fine + across, row * fine + fine - 1 - down

    def own_crs(name: str) -> str | None:
        row, column = name.split("-")[:2]
        zone, half = int(column), 6 if len(row) == 1 else 7
        return None if map_crs is None else map_crs.format(zone=zone, gauss=(zone - 31) % 60 + 1, half=half)

    example = name_of(33 * fine + fine // 2, 12 * fine + fine // 2) or ""
    area = "its sheets lie between the equator and 88° N"
    if south and not steps:
        area = "its sheets lie between 88° S and 88° N"
    elif south:
        area += f"; below the equator there are sheets {largest} alone: give `scale={largest}`, or another scheme"
    return GridScheme(
        title or f"the international division 1:{scale}", crs, float(scale), (Fraction(-180), Fraction(0)),
        (Fraction(6, fine), Fraction(4, fine)), False, name_of, place_of, example, own_crs, area,
    )  # fmt: skip


def _written(number: int, kind: str, letters: str) -> str:
    if kind == "number":
        return str(number + 1)
    if kind == "roman":
        return roman(number + 1)
    return LETTERS[letters][kind == "lower"][number]


def _read(word: str, kind: str) -> int | None:
    if kind == "number":
        return int(word) - 1 if word.isdigit() else None
    if kind == "roman":
        value = int(word) if word.isdigit() else from_roman(word)
        return None if value is None else value - 1
    return _FOURTH.get(word.upper())


# By scale: sheets of TK 25 along a side, and the letters before the number (Roman 50, 100, 200 in thousands).
TK = {25_000: (1, ""), 50_000: (2, "L"), 100_000: (4, "C"), 200_000: (8, "CC")}


def tk(scale: int) -> GridScheme:
    """German sheets: TK 25 of 10′ by 6′, and 2, 4 and 8 times that, named by the TK 25 in their south-western corner.

    The number is row and column of the TK 25, counted from the north and the west: the upper edge of row 0 is 56° N,
    the left edge of column 1 is 5° 50′ E (0916 on Sylt, 4901 Selfkant, 4855 Görlitz, 8727 Biberkopf are outermost).
    The edges are those of the old datum (DHDN).

    Parameters
    ----------
    scale : int, denominator

    Raises
    ------
    InputError
        There is no such scale.
    """
    _refuse_scale(scale, TK)
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
        # Column 38 begins at 12° E, where UTM zone 33 does.
        lambda name: "EPSG:25832" if int(name[-2:]) < 38 else "EPSG:25833",
        "its sheets cover Germany: use another scheme",
    )  # fmt: skip


# Longitude of the meridian of Paris in degrees (2.5969213 gon).
_PARIS = Fraction("2.337229167")
# Degrees.
_GON = Fraction(9, 10)


def ign(scale: int) -> GridScheme:
    """French sheets 1:50 000 (0.4 gon by 0.2 gon, XXIII-14) and 1:25 000 (their halves: 2314 O, 2314 E).

    Parameters
    ----------
    scale : int, denominator

    Raises
    ------
    InputError
        There is no such scale.
    """
    _refuse_scale(scale, (25_000, 50_000))
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

    # Columns count from the west, rows from the north. Their origin is taken from where published sheets lie (XXIII
    # begins at the meridian of Paris, row 14 reaches from 54.2 to 54.4 gon): no text that states it was at hand. The
    # edges are those of the NTF.
    return GridScheme(
        f"the French map 1:{scale}", "EPSG:4275", float(scale),
        (_PARIS - 22 * Fraction(2, 5) * _GON, Fraction(57) * _GON),
        (Fraction(2, 5) / halves * _GON, Fraction(1, 5) * _GON), True, name_of, place_of,
        "2314 O" if halves == 2 else "XXIII-14", lambda name: "EPSG:2154",
        "its sheets cover France: use another scheme",
    )  # fmt: skip
