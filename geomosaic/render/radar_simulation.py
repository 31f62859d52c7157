"""Match of a radar scene with its simulation from the ground and the orbit alone.

The brightness that is expected is that of ground of one gamma nought: the area that is lit in each pixel, across the
line of sight (`illuminated_area`). Layover adds up there, and shadow sends nothing. The law matters little: what is
matched is where slopes are bright and dark. Points are hard to see in a radar image; of hills the simulation has as
many as there are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.geo.grid import Window
from geomosaic.geo.transform import Transform
from geomosaic.matching.shifts import shifts
from geomosaic.render.illuminated_area import IlluminatedArea
from geomosaic.sensor.solve import image_to_ground
from geomosaic.surface.model import Surface
from geomosaic.types import BoolArray, FloatArray

# Side of the box that evens out speckle before images are compared, pixels.
LOOKS = 5
# Windows along a side of the scene: more would make the control no better than the DEM is.
MOST = 12
# Thermal noise over the mean power: where nothing is lit, a scene shows it.
NOISE = 0.05
# Share of a tile's variance that the simulation must explain; one look of speckle leaves little.
LEAST_CORRELATION = 0.25


@dataclass(frozen=True, eq=False)
class SimulatedControl:
    """Control points of a scene by the match of its simulation.

    Attributes
    ----------
    ground : array (N, 3)
        In the model's frame.
    colrow : array (N, 2)
        Where the scene shows them, pixels.
    covariance : array (N, 2, 2)
        Of `colrow`, pixels squared.
    shifts : array (N, 2)
        From the place that the model gives, pixels.
    correlation : array (N,)
    windows : int
        Windows for which the scene has room.
    covered : int
        Those of them that show ground of the surface.
    whole : int
        Those of them that surface and scene fill.
    """

    ground: FloatArray
    colrow: FloatArray
    covariance: FloatArray
    shifts: FloatArray
    correlation: FloatArray
    windows: int
    covered: int
    whole: int


def matched_control(
    model: Any,
    surface: Surface,
    read: Callable[[Window], tuple[FloatArray, BoolArray]],
    tile: int,
    reach: int,
) -> SimulatedControl:
    """Control points where windows of the scene look like their simulation.

    Parameters
    ----------
    model : SensorModel with `sensor_positions`
    surface : Surface
    read : callable
        Powers (rows, cols) of a window of the scene, and whether they are valid.
    tile : int
        Side of the windows, pixels.
    reach : int
        Largest shift that is looked for, pixels.
    """
    kept = []
    margin = reach + 2
    area = IlluminatedArea(model, surface)
    regions, covered, whole = list(_windows(model.size, tile, margin)), 0, 0
    for region in regions:
        power = area.summed(region)
        if not np.isfinite(power).any():
            continue
        covered += 1
        expected = _evened(power, np.isfinite(power))
        shown = _evened(*read(region))
        filled: BoolArray = np.isfinite(expected) & np.isfinite(shown)
        whole += bool(filled.all())
        found = shifts(expected, shown, filled, tile, reach, LEAST_CORRELATION)
        if not found.matched.any():
            continue
        covariance = _covariance(expected[margin:-margin, margin:-margin], found.correlation[0])
        if covariance is not None:
            middle = region.col + region.width / 2, region.row + region.height / 2
            kept.append((middle, found.shifts[0], covariance, found.correlation[0]))
    middles = np.array([one[0] for one in kept]).reshape(-1, 2)
    moved = np.array([one[1] for one in kept]).reshape(-1, 2)
    covariances = np.array([one[2] for one in kept]).reshape(-1, 2, 2)
    # In layover the middle of a window shows several places; whichever it is, the model and the scene put it there.
    ground = Transform(surface.crs, model.crs)(image_to_ground(model, middles, surface)) if kept else np.zeros((0, 3))
    correlation = np.array([one[3] for one in kept])
    # No place may be found for a middle in a fold of layover.
    known = np.isfinite(ground).all(axis=1)
    return SimulatedControl(
        ground[known], (middles + moved)[known], covariances[known], moved[known], correlation[known], len(regions),
        covered, whole,
    )  # fmt: skip


def _windows(size: tuple[int, int], tile: int, margin: int) -> Iterator[Window]:
    """Windows of a tile and a margin around it, spread over a scene, at most `MOST` along each side."""
    side = tile + 2 * margin
    counts = [max(0, min(MOST, (length - 2 * margin) // tile)) for length in size]
    firsts = [np.linspace(0, length - side, count).astype(int) for length, count in zip(size, counts, strict=True)]
    for row in firsts[1].tolist():
        for col in firsts[0].tolist():
            yield Window(col, row, side, side)


def _evened(power: FloatArray, known: BoolArray) -> FloatArray:
    """Logarithm of the mean of the known powers about each pixel, NaN where there are none.

    Speckle, which multiplies power, becomes noise of one size.
    """
    from scipy.ndimage import uniform_filter

    share = uniform_filter(known.astype(np.float64), LOOKS)
    # A running sum leaves rounding errors where it passes no pixel.
    some = share > 0.5 / LOOKS**2
    mean = uniform_filter(np.where(known, power, 0.0), LOOKS)[some] / share[some]
    out = np.full(power.shape, np.nan)
    if mean.any():
        out[some] = np.log(mean + NOISE * mean.mean())
    return out


def _covariance(expected: FloatArray, correlation: float) -> FloatArray | None:
    """Covariance (2, 2) of the shift of a tile by least-squares matching; None where the tile is even.

    The scene is gain times the simulation and noise of (1 − ρ²) / ρ² times the simulation's variance; the pixels of a
    box share their noise.
    """
    by_row, by_col = np.gradient(expected)
    normal = np.array([[np.sum(by_col**2), np.sum(by_col * by_row)], [np.sum(by_col * by_row), np.sum(by_row**2)]])
    if np.linalg.det(normal) <= 1e-9 * np.trace(normal) ** 2:
        return None
    noise = expected.var() * (1.0 - correlation**2) / correlation**2
    covariance: FloatArray = noise * LOOKS**2 * np.linalg.inv(normal)
    return covariance
