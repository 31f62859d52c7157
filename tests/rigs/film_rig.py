"""A film camera written plainly: certificate, scan and projection, independent of the code under test."""

from __future__ import annotations

from typing import Any

import numpy as np

FIDUCIALS = {
    "1": [-106.003, -105.996],
    "2": [106.004, 105.998],
    "3": [-105.998, 106.007],
    "4": [106.001, -106.002],
    "5": [-112.006, 0.004],
    "6": [111.994, -0.003],
    "7": [0.002, 112.001],
    "8": [-0.005, -111.997],
}
CERTIFICATE: dict[str, Any] = {
    "name": "a wide-angle camera",
    "focal_length": 152.818,
    "principal_point_autocollimation": [0.006, -0.004],
    "principal_point_symmetry": [0.011, 0.002],
    "fiducials": FIDUCIALS,
    "distortion": {
        "model": "radial",
        "radius": [0, 20, 40, 60, 80, 100, 120, 140, 160],
        "distortion": [0.0, -1.2, -2.6, -3.1, -1.9, 1.4, 4.8, 5.5, -6.3],
    },
}
SIZE = (4600, 4640)


def scan_of(film: np.ndarray, pixel: float = 0.05, turn: float = 0.4, middle: tuple[float, float] = (2310.0, 2295.0)):
    """Millimetres (N, 2), y up, to pixels: an affinity with 0.02 % of difference in scale and 20'' of shear."""
    t, shear = np.radians(turn), np.radians(20.0 / 3600.0)
    x, y = np.asarray(film, dtype=float).T
    right, down = x * 1.0001 + y * np.sin(shear), -y * 0.9999
    col = middle[0] + (right * np.cos(t) + down * np.sin(t)) / pixel
    row = middle[1] + (-right * np.sin(t) + down * np.cos(t)) / pixel
    return np.column_stack([col, row])


def marks(names: Any = FIDUCIALS, **scan: Any) -> dict[str, list[float]]:
    """Fiducials as measured in the scan."""
    return {name: scan_of(np.array([FIDUCIALS[name]]), **scan)[0].tolist() for name in names}


def distorted(ideal: np.ndarray) -> np.ndarray:
    """Ideal image (N, 2), mm from the autocollimation point, to the film in fiducial axes; scipy's spline."""
    from scipy.interpolate import CubicSpline

    table = CERTIFICATE["distortion"]
    r, d = np.array(table["radius"], dtype=float), np.array(table["distortion"]) / 1000.0
    spline = CubicSpline(np.r_[-r[:0:-1], r], np.r_[-d[:0:-1], d], bc_type="not-a-knot")
    a = np.array(CERTIFICATE["principal_point_autocollimation"])
    s = np.array(CERTIFICATE["principal_point_symmetry"])
    measured = ideal + a
    for _ in range(30):
        radius = np.hypot(*(measured - s).T)
        measured = ideal + a + (measured - s) * (spline(radius) / radius)[:, None]
    return measured


def project(local: np.ndarray, rotation: np.ndarray, **scan: Any) -> np.ndarray:
    """Ground minus projection centre (N, 3) and ground → image rotation to pixels of the scan."""
    u, v, w = rotation @ local.T
    c = CERTIFICATE["focal_length"]
    return scan_of(distorted(np.column_stack([-c * u / w, -c * v / w])), **scan)
