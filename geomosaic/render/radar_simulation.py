"""Simulation of a radar scene from the ground and the orbit alone, and its match with the scene.

Each facet of the ground sends back its area times cos² of the local incidence angle (a Lambertian surface: the area lit
and the direction that it sends to each bring one cosine), which falls on the pixels around its place in the image:
powers of layover add up there, and what lies in shadow sends nothing. The law matters little: what is matched is where
slopes are bright and dark. Points are hard to see in a radar image; of hills the simulation has as many as there are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from affine import Affine
from pyproj import CRS

from geomosaic.geo.crs import horizontal
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.transform import Transform
from geomosaic.matching.shifts import shifts
from geomosaic.options.render import BLOCK_HEIGHT, BLOCK_WIDTH
from geomosaic.render.radar_terrain import RadarTerrain
from geomosaic.resample.layover_shadow import LAYOVER, SHADOW, UNKNOWN
from geomosaic.sensor.solve import image_to_ground
from geomosaic.surface.model import Surface
from geomosaic.types import BoolArray, FloatArray

# Side of the box that evens out speckle before images are compared, pixels.
LOOKS = 5
# Windows along a side of the scene: more would make the control no better than the DEM is.
MOST = 12
# Share of a tile's variance that the simulation must explain; one look of speckle leaves little.
LEAST_CORRELATION = 0.25


@dataclass(frozen=True, eq=False)
class SimulatedScene:
    """Expected powers of a radar scene.

    Attributes
    ----------
    power : array (rows, cols)
        In units of a level pixel's area; 0 where nothing comes from.
    ground : array (rows, cols, 3)
        Mean place, by power, of the ground that a pixel shows, in the model's frame; NaN without power.
    single : bool array (rows, cols)
        Pixels that show one stretch of ground, without layover.
    """

    power: FloatArray
    ground: FloatArray
    single: BoolArray


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
    """

    ground: FloatArray
    colrow: FloatArray
    covariance: FloatArray
    shifts: FloatArray
    correlation: FloatArray


def simulated_scene(model: Any, surface: Surface, grid: Grid, region: Window) -> SimulatedScene:
    """Expected powers of a part of a radar scene.

    Parameters
    ----------
    model : SensorModel with `sensor_positions`
    surface : Surface
    grid : Grid
        Whose pixels are the facets: they cover the ground of the part and are at most half as large as its pixels.
    region : Window
        Part of the scene.
    """
    width, height = region.width, region.height
    corner = np.array([region.col, region.row])
    terrain = RadarTerrain(grid, surface, model)
    power, layered = np.zeros(width * height), np.zeros(width * height)
    places = np.zeros((3, width * height))
    # Sums of coordinates of the Earth's size would lose millimetres.
    origin = np.array(model.seed)
    for window in grid.window.split(2 * BLOCK_WIDTH, BLOCK_HEIGHT):
        classes, facets = terrain.classes(window), terrain.facets(window)
        sends = (classes & (SHADOW | UNKNOWN) == 0) & (facets.cosine > 0.0)
        ground = facets.places[sends]
        image = model.ground_to_image(ground) - corner - 0.5
        near = np.isfinite(image).all(axis=1) & (image > -1.0).all(axis=1) & (image < [width, height]).all(axis=1)
        image, ground = image[near], ground[near] - origin
        sent = (facets.area[sends] * facets.cosine[sends] ** 2)[near]
        over = (classes[sends] & LAYOVER > 0)[near]
        first = np.floor(image).astype(int)
        part = image - first
        for right in (0, 1):
            for down in (0, 1):
                col, row = first[:, 0] + right, first[:, 1] + down
                share = np.abs(1 - right - part[:, 0]) * np.abs(1 - down - part[:, 1]) * sent
                inside = (col >= 0) & (col < width) & (row >= 0) & (row < height)
                index, share = (row * width + col)[inside], share[inside]
                power += np.bincount(index, share, width * height)
                layered += np.bincount(index, share * over[inside], width * height)
                for axis in range(3):
                    places[axis] += np.bincount(index, share * ground[inside, axis], width * height)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = origin + (places / power).T
    pixel = grid.resolution[0] * grid.resolution[1]
    shape = height, width
    single = (power > 0.0) & (layered <= 0.0)
    return SimulatedScene((power / pixel).reshape(shape), mean.reshape(*shape, 3), single.reshape(shape))


def matched_control(
    model: Any,
    surface: Surface,
    crs: CRS,
    read: Callable[[Window], tuple[FloatArray, BoolArray]],
    tile: int,
    reach: int,
) -> SimulatedControl:
    """Control points where windows of the scene look like their simulation.

    Parameters
    ----------
    model : SensorModel with `sensor_positions`
    surface : Surface
    crs : CRS
        Map, in which the facets lie.
    read : callable
        Amplitudes (rows, cols) of a window of the scene, and whether they are valid.
    tile : int
        Side of the windows, pixels.
    reach : int
        Largest shift that is looked for, pixels.
    """
    kept = []
    margin = reach + 2
    for region in _windows(model.size, tile, margin):
        grid = facet_grid(model, surface, crs, region)
        if grid is None:
            continue
        simulated = simulated_scene(model, surface, grid, region)
        amplitude, valid = read(region)
        expected, shown = _evened(simulated.power), _evened(amplitude.astype(np.float64) ** 2)
        known = np.asarray(valid & (simulated.power > 0.0))
        found = shifts(expected, shown, known, tile, reach, LEAST_CORRELATION)
        inner = np.s_[margin:-margin, margin:-margin]
        rows, cols = np.nonzero(simulated.single[inner])
        if not found.matched.any() or not len(rows):
            continue
        covariance = _covariance(expected[inner], found.correlation[0])
        if covariance is None:
            continue
        nearest = np.argmin((rows - tile / 2) ** 2 + (cols - tile / 2) ** 2)
        ground = simulated.ground[inner][rows[nearest], cols[nearest]]
        kept.append((ground, found.shifts[0], covariance, found.correlation[0]))
    ground = np.array([one[0] for one in kept]).reshape(-1, 3)
    moved = np.array([one[1] for one in kept]).reshape(-1, 2)
    covariances = np.array([one[2] for one in kept]).reshape(-1, 2, 2)
    places = model.ground_to_image(ground) if len(ground) else np.zeros((0, 2))
    return SimulatedControl(ground, places + moved, covariances, moved, np.array([one[3] for one in kept]))


def facet_grid(model: Any, surface: Surface, crs: CRS, region: Window) -> Grid | None:
    """Grid over the ground of a part of a scene, in pixels half as large as its own; None where that is not known.

    Parameters
    ----------
    model : SensorModel
    surface : Surface
    crs : CRS
        Of the grid, a map.
    region : Window
        Of the scene.
    """
    across, down = np.linspace(region.col, region.stop_col, 5), np.linspace(region.row, region.stop_row, 5)
    col, row = np.meshgrid(across, down)
    edge = np.column_stack([col.ravel(), row.ravel()])
    middle = np.array([[region.col + region.width / 2, region.row + region.height / 2]])
    beside = middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    ground = image_to_ground(model, np.concatenate([edge, beside]), surface)
    if not np.isfinite(ground).all():
        return None
    xy = Transform(horizontal(surface.crs), crs)(ground[:, :2])
    one, right, below = xy[-3:]
    pixel = 0.5 * float(min(np.hypot(*(right - one)), np.hypot(*(below - one))))
    low, high = xy[:-3].min(axis=0), xy[:-3].max(axis=0)
    # Ground beside the part falls into it where it is higher or lower.
    beyond = 0.15 * (high - low) + 4.0 * pixel
    (left, bottom), (width, height) = low - beyond, np.ceil((high - low + 2.0 * beyond) / pixel).astype(int).tolist()
    return Grid(crs, Affine(pixel, 0.0, float(left), 0.0, -pixel, float(bottom) + height * pixel), width, height)


def _windows(size: tuple[int, int], tile: int, margin: int) -> Iterator[Window]:
    """Windows of a tile and a margin around it, spread over a scene, at most `MOST` along each side."""
    side = tile + 2 * margin
    counts = [max(0, min(MOST, (length - 2 * margin) // tile)) for length in size]
    firsts = [np.linspace(0, length - side, count).astype(int) for length, count in zip(size, counts, strict=True)]
    for row in firsts[1].tolist():
        for col in firsts[0].tolist():
            yield Window(col, row, side, side)


def _evened(power: FloatArray) -> FloatArray:
    """Logarithm of the mean power of some pixels: speckle, which multiplies it, becomes noise of one size."""
    from scipy.ndimage import uniform_filter

    mean = uniform_filter(power, LOOKS)
    least = 1e-3 * float(np.median(mean[mean > 0.0])) if (mean > 0.0).any() else 1.0
    logarithm: FloatArray = np.log(np.maximum(mean, least))
    return logarithm


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
