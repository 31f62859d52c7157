"""What an RPC cannot follow of a sensor, as a correction grid: attitude that trembles, detector lines that bend."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import SolveError
from geomosaic.geo.transform import Transform
from geomosaic.sensor.corrected import Corrected
from geomosaic.sensor.correction_grid import CorrectionGrid
from geomosaic.sensor.model import SensorModel
from geomosaic.sensor.rational import HasRational
from geomosaic.sensor.solve import image_to_height
from geomosaic.types import FloatArray

WGS84 = CRS.from_epsg(4979)
_GOAL = 2.5e-3
"""Pixels that interpolation along a line may err; nodes stand as far apart as that lets them."""
_SPACINGS = (512.0, 256.0, 128.0, 64.0, 32.0, 16.0, 8.0)
_LINES = (0.1, 0.5, 0.9)
"""Where, as parts of the other side, the lines lie on which the spacing is tried."""
_LEVELS = 3
_CHECKS = 20_000
_BLOCK = 200_000
_TURN = np.array([0.7548776662466927, 0.5698402909980532, 0.2198])  # spread evenly over a box without a pattern

Apart = Callable[[FloatArray, FloatArray | float], FloatArray]


@dataclass(frozen=True)
class GridFit:
    """A correction grid behind an RPC, with the error of the pair.

    Attributes
    ----------
    grid : CorrectionGrid
        Sensor minus RPC, at the position by the RPC, in pixels.
    rms, worst : float
        RMS and largest distance in pixels between the pair and the sensor, at check points over image and heights.
    alone_rms, alone_worst : float
        The same of the RPC without the grid.
    checks : int
    """

    grid: CorrectionGrid
    rms: float
    worst: float
    alone_rms: float
    alone_worst: float
    checks: int


def fit_pair(tool: HasRational, exact: SensorModel, sensor: str, heights: tuple[float, float]) -> tuple[Any, GridFit]:
    """An RPC and a grid that are a sensor together, as well as they can be.

    An RPC fitted to what trembles follows it a little, at each height in another way, and no grid takes that back. So
    the RPC is fitted again to the sensor without what the first grid has found: alone it is a few per cent worse, and
    the pair is better by up to the factor ten.

    Raises
    ------
    SolveError
        No rational map describes the sensor, or it does not see the ground at these heights.
    """
    first = grid_behind(tool.fit_rational(exact, heights).model, exact, heights).grid
    rows, columns, _ = first.nodes.shape
    sides = (first.origin[axis] + first.spacing[axis] * np.arange(n) for axis, n in enumerate((columns, rows)))
    places = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    nodes = (first.ideal(places) - places).reshape(rows, columns, 2)
    back = CorrectionGrid(first.origin, first.spacing, nodes, beyond="held")
    model = tool.fit_rational(Corrected.of(exact, back, sensor), heights).model
    return model, grid_behind(model, exact, heights)


def grid_behind(rational: SensorModel, exact: SensorModel, heights: tuple[float, float]) -> GridFit:
    """Make the grid that brings an RPC to the model it was fitted to.

    Each node is the mean of the differences at three heights: what trembles or bends turns lines of sight, and a turn
    moves the image by nearly the same at all heights.

    Parameters
    ----------
    rational, exact : SensorModel
        The RPC, and the model it stands for, of one image.
    heights : tuple of float
        Lowest and highest ellipsoidal height in metres.

    Raises
    ------
    SolveError
        The models do not see the ground at these heights.
    """
    to_exact = Transform(WGS84, exact.crs)

    def apart(places: FloatArray, levels: FloatArray | float) -> FloatArray:
        """Sensor minus RPC (N, 2) at image positions by the RPC (N, 2) and heights."""
        high = np.broadcast_to(levels, len(places))
        parts = []
        for start in range(0, len(places), _BLOCK):
            some = slice(start, start + _BLOCK)
            ground = image_to_height(rational, places[some], high[some], WGS84)
            parts.append(exact.ground_to_image(to_exact(ground)) - places[some])
        return np.vstack(parts)

    middle = 0.5 * (heights[0] + heights[1])
    width, height = (float(side) for side in exact.size)
    counts = [_cells(apart, middle, (width, height), axis) for axis in (0, 1)]
    spacing = np.array([width / counts[0], height / counts[1]])
    # One node beyond each edge, so that the outermost cells are as good as the others.
    cols, rows = (spacing[axis] * np.arange(-1.0, counts[axis] + 2.0) for axis in (0, 1))
    places = np.stack(np.meshgrid(cols, rows), axis=-1).reshape(-1, 2)
    found = [apart(places, level) for level in np.linspace(*heights, _LEVELS)]
    nodes = _filled(np.mean(found, axis=0).reshape(len(rows), len(cols), 2))
    grid = CorrectionGrid(-spacing, spacing, nodes, beyond="held")
    share = np.mod(0.5 + np.arange(1.0, _CHECKS + 1.0)[:, None] * _TURN, 1.0)
    image = share[:, :2] * exact.size
    alone = apart(image, heights[0] + share[:, 2] * (heights[1] - heights[0]))
    if not np.isfinite(alone).all():
        raise SolveError("the RPC or the sensor does not see all of the image's ground at these heights")
    return GridFit(grid, *_length(alone - grid.at(image)), *_length(alone), _CHECKS)


def _length(off: FloatArray) -> tuple[float, float]:
    """RMS and largest length of differences (N, 2)."""
    square = (off**2).sum(axis=1)
    return float(np.sqrt(square.mean())), float(np.sqrt(square.max()))


def _cells(apart: Apart, middle: float, size: tuple[float, float], axis: int) -> int:
    """Number of cells along an axis: the fewest between whose nodes the corrections are interpolated well enough."""
    side, other = size[axis], size[1 - axis]
    along = np.linspace(0.0, side, int(min(4097.0, side + 1.0)))
    for spacing in _SPACINGS:
        cells = int(np.ceil(side / spacing))
        step = side / cells
        nodes = step * np.arange(-1.0, cells + 2.0)
        worst = 0.0
        for share in _LINES:
            at_nodes, truth = (apart(_line(t, share * other, axis), middle) for t in (nodes, along))
            line = _filled(at_nodes[None] if axis == 0 else at_nodes[:, None])
            origin, spacings = np.full(2, share * other), np.ones(2)
            origin[axis], spacings[axis] = -step, step
            if not np.isfinite(truth).all():
                raise SolveError("the RPC or the sensor does not see all of the image's ground at these heights")
            error = CorrectionGrid(origin, spacings, line, beyond="held").at(_line(along, share * other, axis)) - truth
            worst = max(worst, float(np.abs(error).max()))
        if worst <= _GOAL:
            break
    return cells


def _line(along: FloatArray, across: float, axis: int) -> FloatArray:
    places = np.full((len(along), 2), across)
    places[:, axis] = along
    return places


def _filled(nodes: FloatArray) -> FloatArray:
    """Nodes (R, C, 2) beyond the image that a model does not see are those of the edge."""
    rows, columns, _ = nodes.shape
    inner = nodes[min(1, rows - 1) : max(rows - 1, 1), min(1, columns - 1) : max(columns - 1, 1)]
    around = tuple((1, 1) if count > 1 else (0, 0) for count in (rows, columns))
    return np.where(np.isfinite(nodes), nodes, np.pad(inner, (*around, (0, 0)), mode="edge"))
