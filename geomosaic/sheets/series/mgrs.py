"""Squares of the Military Grid Reference System on UTM: 100 km, 10 km, 1 km and 100 m.

After NGA.STND.0037, Universal Grids and Grid Reference Systems (2014): zones of 6°, bands of 8° from 80° S (X of 12°),
with the exceptions of Norway (32V) and Svalbard (31X to 37X); columns of 100 km in three alphabets of eight letters,
rows in one of twenty that starts at A in odd zones and at F in even ones. The poles (UPS) are left out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import InputError
from geomosaic.geo.crs import parse_crs
from geomosaic.geo.transform import Transform
from geomosaic.sheets.grid_lines import densified_ring
from geomosaic.sheets.series.regular import DIRECTIONS, Cell, corners
from geomosaic.types import FloatArray

BANDS = "CDEFGHJKLMNPQRSTUVWX"
COLUMNS = ("ABCDEFGH", "JKLMNPQR", "STUVWXYZ")
ROWS = "ABCDEFGHJKLMNPQRSTUV"
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

    def __post_init__(self) -> None:
        if self.size not in _DIGITS:
            raise InputError(
                f"the system has no squares of {self.size} m", where="`size`", hint="100000, 10000, 1000 or 100"
            )

    @property
    def title(self) -> str:
        """Of messages."""
        return f"MGRS squares of {self.size} m"

    def map_crs(self, name: str) -> str | None:
        """UTM of its zone."""
        zone, band, _, _ = self._parse(name)
        return utm(zone, band)

    def find(self, x: float, y: float) -> str:
        """Square at a longitude and latitude."""
        if not (-180.0 <= x <= 180.0 and -80.0 <= y < 84.0):
            raise InputError(
                "UTM ends at 80° S and 84° N", where=f"{x:.10g}, {y:.10g}", hint="longitude first, then latitude"
            )
        zone, band = _zone_of(x, y), BANDS[min(int((y + 80.0) // 8.0), 19)]
        east, north = Transform(parse_crs(self.crs), parse_crs(utm(zone, band)))(np.array([[x, y]]))[0]
        return self._name(zone, band, math.floor(east / self.size + 1e-9), math.floor(north / self.size + 1e-9))

    def _name(self, zone: int, band: str, col: int, row: int) -> str:
        """From indices of squares in UTM."""
        per = 100_000 // self.size
        east, north = col // per, row // per
        letters = COLUMNS[(zone - 1) % 3][east - 1] + ROWS[(north + (5 if zone % 2 == 0 else 0)) % 20]
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
        letter = (ROWS.index(found[4]) - (5 if zone % 2 == 0 else 0)) % 20
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
        north = Transform(parse_crs(self.crs), parse_crs(utm(zone, band)))(ring)[:, 1]
        return float(north.min()), float(north.max())

    def proper(self, name: str) -> str:
        """Without blanks, in capitals, if something of it lies in its zone and band."""
        zone, band, col, row = self._parse(name)
        self.edges(name)
        return self._name(zone, band, col, row)

    def edges(self, name: str) -> tuple[str, FloatArray]:
        """UTM, and the square cut at the edges of its zone and band."""
        from shapely import Polygon, box

        zone, band, col, row = self._parse(name)
        area = _zone_box(zone, band) or (0.0, 0.0, 0.0, 0.0)  # a name that is parsed has one
        crs = utm(zone, band)
        inside = Polygon(Transform(parse_crs(self.crs), parse_crs(crs))(densified_ring(corners(area), 400)))
        size = float(self.size)
        square = box(col * size, row * size, (col + 1) * size, (row + 1) * size, ccw=True)
        part = square if inside.contains(square) else square.intersection(inside)
        if part.is_empty or part.geom_type != "Polygon":
            raise InputError(f"'{name}' lies outside zone {zone}{band}", hint="see `geomosaic sheets find`")
        ring = part if part is square else part.normalize().reverse()
        return crs, np.asarray(ring.exterior.coords)[:-1]

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
        from shapely import box as rectangle

        for band in reversed(BANDS):
            for zone in range(1, 61):
                area = _zone_box(zone, band)
                common = None if area is None else rectangle(*area).intersection(rectangle(*box))
                if common is None or common.is_empty or common.area == 0:
                    continue
                to = Transform(parse_crs(self.crs), parse_crs(utm(zone, band)))
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


def utm(zone: int, band: str) -> str:
    """EPSG code of WGS 84 / UTM.

    Parameters
    ----------
    zone : int
    band : str
    """
    return f"EPSG:{(32600 if band >= 'N' else 32700) + zone}"
