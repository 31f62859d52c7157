"""Magnetic declination by the World Magnetic Model 2025 (NOAA NCEI and British Geological Survey, public domain).

The formulas are those of section 1.2 of the technical report (A. Chulliat and others, The US/UK World Magnetic Model
for 2025-2030): spherical harmonics of degree 12 with Schmidt's normalisation in geocentric
coordinates, linear in time, turned into the geodetic frame.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import FloatArray

NAME = "WMM2025"
# Years that the model is made for.
FIRST, LAST = 2025.0, 2030.0
# Horizontal field in nT below which a compass does not point anywhere (blackout zones of the report).
WEAKEST = 2000.0
# Metres. The model's coefficients refer to this geomagnetic radius, not to the mean radius of the Earth; the other two
# are the semi-major axis and squared eccentricity of WGS 84.
_RADIUS = 6371200.0
_AXIS, _ECCENTRICITY2 = 6378137.0, 0.0066943799901413165
_DEGREE = 12


@dataclass(frozen=True)
class MagneticField:
    """Magnetic field at a place and a time.

    Attributes
    ----------
    north, east, down : float
        nT, in the geodetic frame of WGS 84.
    declination : float
        Degrees from true north to magnetic north, east positive.
    annual_change : float
        Of the declination, degrees a year.
    """

    north: float
    east: float
    down: float
    declination: float
    annual_change: float

    @property
    def horizontal(self) -> float:
        """Horizontal intensity, nT."""
        return math.hypot(self.north, self.east)

    @property
    def sigma(self) -> float:
        """Standard deviation in degrees of the declination against measured ones (error model of the report)."""
        return math.hypot(0.26, 5417.0 / self.horizontal)


def magnetic_field(longitude: float, latitude: float, height: float, year: float) -> MagneticField:
    """Field of the model at a place.

    Parameters
    ----------
    longitude, latitude : float
        Degrees, WGS 84.
    height : float
        Metres above the ellipsoid.
    year : float
        Decimal, such as 2026.5.
    """
    latitude = min(max(latitude, -89.9999), 89.9999)  # east and north have no meaning at the poles
    values, rates = _coefficients()
    basis = _basis(longitude, latitude, height)
    north, east, down = (float(v) for v in basis @ (values + (year - FIRST) * rates))
    north_rate, east_rate, _ = (float(v) for v in basis @ rates)
    change = math.degrees((north * east_rate - east * north_rate) / (north * north + east * east))
    return MagneticField(north, east, down, math.degrees(math.atan2(east, north)), change)


def decimal_year(text: str, where: str | None = None) -> float:
    """Decimal year of a date: the middle of the year, month or day that is named.

    Parameters
    ----------
    text : str
        '2026', '2026-06' or '2026-06-15'.
    where : str, optional
        Named in errors.

    Returns
    -------
    float
        Years.

    Raises
    ------
    InputError
        The text is no date.
    """
    import datetime

    found = re.fullmatch(r"\s*(\d{4})(?:-(\d{1,2})(?:-(\d{1,2}))?)?\s*", text)
    try:
        if found is None:
            raise ValueError
        year, month, day = (int(part) if part else None for part in found.groups())
        if year is None or month is None:
            return float(found[1]) + 0.5
        middle = datetime.date(year, month, day or 15).timetuple().tm_yday - 0.5
        return year + middle / datetime.date(year, 12, 31).timetuple().tm_yday
    except ValueError:
        raise InputError(f"'{text}' is no date", where=where, hint="write 2026, 2026-06 or 2026-06-15") from None


@lru_cache(maxsize=1)
def _coefficients() -> tuple[FloatArray, FloatArray]:
    """Values in nT at 2025.0 and their rates a year, each (180,): g and h of every degree and order by turns."""
    lines = (Path(__file__).parent / "data" / "wmm2025.cof").read_text(encoding="ascii").splitlines()[1:]
    table = np.array([[float(part) for part in line.split()] for line in lines])
    return table[:, 2:4].ravel(), table[:, 4:6].ravel()


def _basis(longitude: float, latitude: float, height: float) -> FloatArray:
    """North, east and down (3, 180) of a field with one coefficient 1."""
    phi, lam = math.radians(latitude), math.radians(longitude)
    normal = _AXIS / math.sqrt(1.0 - _ECCENTRICITY2 * math.sin(phi) ** 2)
    across = (normal + height) * math.cos(phi)
    up = (normal * (1.0 - _ECCENTRICITY2) + height) * math.sin(phi)
    radius, geocentric = math.hypot(across, up), math.atan2(up, across)
    values, slopes = _legendre(geocentric)
    out = []
    for n in range(1, _DEGREE + 1):
        power = (_RADIUS / radius) ** (n + 2)
        for m in range(n + 1):
            c, s = math.cos(m * lam), math.sin(m * lam)
            p, slope = power * values[n, m], power * slopes[n, m]
            aside = m * p / math.cos(geocentric)
            out.append((-slope * c, aside * s, -(n + 1) * p * c))
            out.append((-slope * s, -aside * c, -(n + 1) * p * s))
    turn = geocentric - phi
    c, s = math.cos(turn), math.sin(turn)
    return np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]]) @ np.array(out).T


def _legendre(latitude: float) -> tuple[FloatArray, FloatArray]:
    """Schmidt's functions of the sine of a latitude in radians, (13, 13) by degree and order, and their slopes."""
    s, c = math.sin(latitude), math.cos(latitude)
    p, d = np.zeros((_DEGREE + 1, _DEGREE + 1)), np.zeros((_DEGREE + 1, _DEGREE + 1))
    p[0, 0] = 1.0
    for n in range(1, _DEGREE + 1):
        for m in range(n):
            before = math.sqrt((n - 1) ** 2 - m * m) if n - 1 > m else 0.0
            root = math.sqrt(n * n - m * m)
            p[n, m] = ((2 * n - 1) * s * p[n - 1, m] - before * p[n - 2, m]) / root
            d[n, m] = ((2 * n - 1) * (s * d[n - 1, m] + c * p[n - 1, m]) - before * d[n - 2, m]) / root
        factor = 1.0 if n == 1 else math.sqrt((2 * n - 1) / (2 * n))
        p[n, n] = factor * c * p[n - 1, n - 1]
        d[n, n] = factor * (c * d[n - 1, n - 1] - s * p[n - 1, n - 1])
    return p, d
