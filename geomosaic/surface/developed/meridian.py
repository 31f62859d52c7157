"""Lengths and areas along the meridian of an ellipsoid of revolution, flat or long, and the ways back.

β is the parametric latitude: the meridian is (a·cos β, c·sin β). The length of the arc from the equator is the elliptic
integral c·E(β | 1 − a²/c²); the area between the equator and β is 2π·a·q, q = ∫ √(c² + (a² − c²)·s²) ds to s = sin β.
"""

from __future__ import annotations

import numpy as np

from geomosaic.types import FloatArray


def arc(latitude: FloatArray, a: float, c: float) -> FloatArray:
    """Length of the meridian from the equator to parametric latitudes (N,) in radians."""
    if a == c:
        return a * np.asarray(latitude, dtype=np.float64)
    from scipy.special import ellipeinc

    length: FloatArray = c * ellipeinc(latitude, 1.0 - (a / c) ** 2)
    return length


def latitude_of_arc(length: FloatArray, a: float, c: float) -> FloatArray:
    """Parametric latitudes (N,) at lengths from the equator; NaN beyond the poles."""
    quarter = float(arc(np.array(np.pi / 2), a, c))
    given = np.where(np.abs(length) <= quarter * (1 + 1e-12), np.clip(length, -quarter, quarter), np.nan)
    latitude = given * (np.pi / 2 / quarter)
    for _ in range(0 if a == c else 12):
        slope = np.hypot(a * np.sin(latitude), c * np.cos(latitude))
        latitude = np.clip(latitude - (arc(latitude, a, c) - given) / slope, -np.pi / 2, np.pi / 2)
    return latitude


def area(sine: FloatArray, a: float, c: float) -> FloatArray:
    """Area from the equator to parametric latitudes of given sine (N,), divided by 2π·a: q, in metres."""
    s = np.asarray(sine, dtype=np.float64)
    root = np.sqrt(c * c + (a * a - c * c) * s * s)
    k = np.sqrt(abs(a * a - c * c))
    if k * k < 1e-14 * a * c:  # a sphere, to rounding
        return s * root
    tail = (np.arcsinh if a > c else np.arcsin)(k * s / c)
    q: FloatArray = (s * root + c * c / k * tail) / 2
    return q


def sine_of_area(q: FloatArray, a: float, c: float) -> FloatArray:
    """Sines of parametric latitudes (N,) at which `area` is q; NaN beyond the poles."""
    most = float(area(np.array(1.0), a, c))
    given = np.where(np.abs(q) <= most * (1 + 1e-12), np.clip(q, -most, most), np.nan)
    sine = given / most
    for _ in range(12):
        slope = np.sqrt(c * c + (a * a - c * c) * sine * sine)
        sine = np.clip(sine - (area(sine, a, c) - given) / slope, -1.0, 1.0)
    return sine
