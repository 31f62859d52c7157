"""Photos of flat ground with known parameters, for the tests of geomosaic.adjust."""

from __future__ import annotations

import numpy as np
from pyproj import CRS

from geomosaic.orientation.single.fit import ControlAdjustment, ControlFit, fit_problem
from geomosaic.orientation.single.problem import Build, registry_build
from geomosaic.sensor.plugin import SensorRequest

UTM = CRS.from_epsg(32633)
SIZE = (2000, 2000)
CENTRE = np.array([500_500.0, 5_400_500.0])
OPTIONS = {
    "conformal": {"kind": "conformal"},
    "affine": {"kind": "affine"},
    "projective": {"kind": "projective"},
    "poly2": {"kind": "polynomial", "order": 2},
    "poly3": {"kind": "polynomial", "order": 3},
    "tps": {"kind": "tps"},
}


def places(count: int, seed: int = 0) -> np.ndarray:
    """Points spread over a square kilometre."""
    return np.random.default_rng(seed).uniform(-500.0, 500.0, (count, 2)) + CENTRE


def fit_control(
    build: Build,
    ids: list[str],
    xy: np.ndarray,
    colrow: np.ndarray,
    sigma: np.ndarray | None = None,
    omission: bool = True,
) -> ControlFit:
    """Fit to all points."""
    return fit_problem(ControlAdjustment.of(build, ids, xy, colrow, sigma), omission=omission)


def truth(kind: str, xy: np.ndarray) -> np.ndarray:
    """Exact image positions in a photo of one kind."""
    u, v = ((xy - CENTRE) / 500.0).T
    if kind == "conformal":
        return np.column_stack([1000 + 900 * u + 100 * v, 1000 - 900 * v + 100 * u])
    col, row = 1000 + 900 * u + 110 * v, 1000 - 880 * v + 100 * u
    if kind == "projective":
        w = 1 + 0.03 * u - 0.02 * v
        return np.column_stack([col / w, row / w])
    if kind in ("poly2", "poly3"):
        col, row = col + 15 * u**2 + 8 * u * v, row - 12 * v**2 + 5 * u**2
    if kind == "poly3":
        col, row = col + 9 * u**3, row - 9 * v**3
    if kind == "wavy":
        col, row = col + 20 * np.sin(5 * v + u), row + 20 * np.sin(6 * u + 2 * v)
    return np.column_stack([col, row])


def names(count: int) -> list[str]:
    return [f"P{i}" for i in range(count)]


def builder(kind: str, xy: np.ndarray, colrow: np.ndarray) -> Build:
    return registry_build("planar", SensorRequest("scan", SIZE, OPTIONS[kind], UTM), xy, colrow)


def control(kind: str, xy: np.ndarray, colrow: np.ndarray, sigma: np.ndarray | None = None) -> ControlAdjustment:
    return ControlAdjustment.of(builder(kind, xy, colrow), names(len(xy)), xy, colrow, sigma)


def noisy(kind: str, count: int, seed: int, sigma: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Ground and measured image of a photo."""
    xy = places(count, seed)
    return xy, truth(kind, xy) + np.random.default_rng([seed, 1]).normal(0.0, sigma, (count, 2))


def spoil(colrow: np.ndarray, share: float, seed: int, low: float = 20.0, high: float = 400.0) -> set[str]:
    """Move a share of the points, in place; return their names."""
    random = np.random.default_rng([seed, 2])
    bad = random.choice(len(colrow), round(share * len(colrow)), replace=False)
    turn, size = random.uniform(0.0, 2.0 * np.pi, len(bad)), random.uniform(low, high, len(bad))
    colrow[bad] += np.column_stack([np.cos(turn), np.sin(turn)]) * size[:, None]
    return {f"P{i}" for i in bad}
