"""Image to ground for every sensor model: lines of sight, and their first meeting with a height or a surface.

A line of sight is the locus P(h): the ground point at height h that the model maps onto a given image point. It is
found by Newton's method on (x, y) with h held, so it needs nothing but `ground_to_image`. Heights, x and y are those of
a 3-D map CRS; the model is reached through a `Transform`, so geoid and projection are exact at every point.

The line is solved exactly at a few heights and interpolated between them for the search, which goes down in steps of
half a cell of the surface. The crossing found is then refined on the exact line, so interpolation never shows in the
result: it can only decide which crossing is taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic.errors import HeightDatumError, InputError
from geomosaic.geo.crs import has_heights, horizontal, in_degrees
from geomosaic.geo.transform import Transform
from geomosaic.sensor.plugin import HasRays, SensorModel
from geomosaic.sensor.solve.newton import ACCEPTED, pixel_step, solve_pairs
from geomosaic.surface.model import Surface
from geomosaic.surface.ray_intersection import intersect
from geomosaic.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class SightLines:
    """Lines of sight of N image points.

    Attributes
    ----------
    model : SensorModel
    colrow : array (N, 2)
        Pixels.
    to_model : Transform
        From the map CRS to `model.crs`.
    step : float
        Map units that move the image by about one pixel.
    height : float
        Height of the model's seed in the map CRS.
    xy : array (N, 2)
        The lines at that height; NaN where a line does not reach it.
    slope : array (N, 2)
        Change of xy per unit of height there: a line of sight is nearly straight, so this starts every other height.
    seed : array (2,)
        Map position of the model's seed.
    """

    model: SensorModel
    colrow: FloatArray
    to_model: Transform
    step: float
    height: float
    xy: FloatArray
    slope: FloatArray
    seed: FloatArray

    @classmethod
    def of(cls, model: SensorModel, colrow: FloatArray, crs: CRS) -> SightLines:
        """Lines of sight of image points, found at the height of the model's seed.

        Parameters
        ----------
        model : SensorModel
        colrow : array (N, 2)
            Pixels.
        crs : CRS
            Of the map positions and heights.

        Raises
        ------
        HeightDatumError
            The model needs heights and `crs` does not say what its heights are.
        """
        if has_heights(model.crs) and not has_heights(crs):
            raise HeightDatumError(
                f"the heights of '{crs.name}' have no vertical datum: they cannot meet a model in '{model.crs.name}'",
                hint="declare the heights: 'ellipsoidal', 'egm96', a vertical EPSG code or a geoid grid",
            )
        to_model = Transform(crs, model.crs)
        seed = to_model.inverse()(np.array([model.seed], dtype=np.float64))[0]
        image = np.asarray(colrow, dtype=np.float64).reshape(-1, 2)
        height = float(seed[2]) if has_heights(model.crs) else 0.0

        def near_seed(xy: FloatArray) -> FloatArray:
            return model.ground_to_image(to_model(np.column_stack([xy, np.full(len(xy), height)])))

        # A degree is about 1e5 metres: both starts are about a metre.
        step = pixel_step(near_seed, seed[:2], 1e-5 if in_degrees(crs) else 1.0)
        unknown = np.full_like(image, np.nan)
        lines = cls(model, image, to_model, step, height, unknown, np.zeros_like(image), seed[:2])
        xy = lines._solve(np.arange(len(image)), np.full(len(image), height), np.tile(seed[:2], (len(image), 1)))
        if not has_heights(model.crs):
            return cls(model, image, to_model, step, height, xy, np.zeros_like(image), seed[:2])
        # A second height, as far off as moves the image by some pixels, gives the slope for all others.
        rise = 10.0 * step * (1e5 if in_degrees(crs) else 1.0)
        above = lines._solve(np.arange(len(image)), np.full(len(image), height + rise), xy)
        return cls(model, image, to_model, step, height, xy, (above - xy) / rise, seed[:2])

    def at(self, heights: FloatArray, rows: IntArray | None = None, start: FloatArray | None = None) -> FloatArray:
        """Map positions (M, 2) of the lines `rows` (M,) at heights (M,); NaN where a line does not reach the height.

        `start` (M, 2) gives better first guesses than the lines' slopes. Solutions are as good as rounding allows. That
        is not 1e-6 pixel close to the projection centre, where a search may pass but no result may lie: see `exact`.

        Parameters
        ----------
        heights : array (M,)
            Metres.
        rows : int array (M,), optional
            Numbers of the lines.
        start : array (M, 2), optional
            First map positions.
        """
        which = np.arange(len(self.colrow)) if rows is None else rows
        known = np.isfinite(self.xy[which, 0]) & np.isfinite(self.slope[which, 0])
        guess = np.where(
            known[:, None], self.xy[which] + self.slope[which] * (heights - self.height)[:, None], self.seed
        )
        # No other start: from elsewhere Newton may end where the line leaves the Earth again, on its far side.
        return self._solve(which, heights, guess if start is None else start)

    def _solve(self, rows: IntArray, heights: FloatArray, start: FloatArray) -> FloatArray:
        def evaluate(xy: FloatArray, index: IntArray) -> FloatArray:
            return self.model.ground_to_image(self.to_model(np.column_stack([xy, heights[index]])))

        return solve_pairs(evaluate, self.colrow[rows], start, self.step)

    def exact(self, xyz: FloatArray) -> BoolArray:
        """Which of the map points (N, 3) fall on the image points of their lines within 1e-6 pixel."""
        off = np.abs(self.model.ground_to_image(self.to_model(xyz)) - self.colrow)
        return (off[:, 0] <= ACCEPTED) & (off[:, 1] <= ACCEPTED)


# Heights at which a line is solved exactly and interpolated between, for the search only.
NODES = 5
# Steps of the search along a line: at least, and at most for a grazing one.
FEWEST_STEPS, MOST_STEPS = 8, 100_000
# Heights of the surface that are looked up at a time: bounds the memory.
SAMPLES = 400_000
# Metres between line and surface at which the search for the crossing stops.
HEIGHT_GOAL = 1e-9
# Metres between line and surface of a crossing that counts.
HEIGHT_ACCEPTED = 1e-6


def first_meeting(lines: SightLines, surface: Surface) -> FloatArray:
    """First intersection of each line of sight with a surface, from above.

    Parameters
    ----------
    lines : SightLines
        In `surface.crs`.
    surface : Surface

    Returns
    -------
    array (N, 3)
        x, y, z in `surface.crs`; NaN where a line does not meet the surface.

    Raises
    ------
    InputError
        The surface has no known range of heights.
    """
    low, high = surface.range
    if not (np.isfinite(low) and np.isfinite(high)):
        raise InputError("the surface has no known height", hint="give a DEM with data under the image, or a height")
    count = len(lines.colrow)
    result = np.full((count, 3), np.nan)
    # A level surface: one solution at its height, nothing to search.
    if high - low < HEIGHT_GOAL:
        result[:, :2] = lines.at(np.full(count, low))
        seen = np.flatnonzero(np.isfinite(result[:, 0]))
        result[seen, 2] = surface.height(result[seen, :2])
        result[~np.isfinite(result).all(axis=1)] = np.nan
        return result
    # Beyond the range, so that a crossing on the highest or lowest point lies between two samples.
    margin = max(0.1, 0.01 * (high - low))
    top, bottom = _reach(lines, np.full(count, high + margin)), _reach(lines, np.full(count, low - margin))
    rows = np.flatnonzero(np.isfinite(top) & np.isfinite(bottom) & (top > bottom))
    # Chebyshev-Lobatto nodes keep the interpolated line close to the exact one up to its ends.
    nodes = 0.5 - 0.5 * np.cos(np.pi * np.arange(NODES) / (NODES - 1))
    heights = top[rows, None] + (bottom - top)[rows, None] * nodes
    positions = np.stack([lines.at(heights[:, k], rows) for k in range(NODES)], axis=1)
    whole = np.isfinite(positions).all(axis=(1, 2))
    rows, positions = rows[whole], positions[whole]
    steps = _step_counts(positions, surface)
    order = np.argsort(steps)
    start = 0
    while start < len(order):  # lines of like length together, as many as the memory for their samples allows
        stop = start + 1
        while stop < len(order) and (stop + 1 - start) * (steps[order[stop]] + 1) <= SAMPLES:
            stop += 1
        part = order[start:stop]
        _meet(lines, surface, rows[part], top[rows[part]], bottom[rows[part]], positions[part], nodes, result)
        start = stop
    return result


def _reach(lines: SightLines, heights: FloatArray) -> FloatArray:
    """Heights that lines reach: moved towards that of the seed as far as they do not; NaN where none is reached."""
    # A DEM may hold mountains above a low-flying camera: its lines of sight start below the DEM's highest height.
    reached = heights.copy()
    lost = np.flatnonzero(~np.isfinite(lines.at(heights)).all(axis=1))
    known = np.isfinite(lines.xy[lost]).all(axis=1)
    reached[lost[~known]] = np.nan
    lost = lost[known]
    inside, outside = np.full(len(lost), lines.height), heights[lost]
    # Bisection: 16 halvings find the end of the line to 1/65 000 of the way.
    for _ in range(16 if len(lost) else 0):
        middle = 0.5 * (inside + outside)
        good = np.isfinite(lines.at(middle, lost)).all(axis=1)
        inside, outside = np.where(good, middle, inside), np.where(good, outside, middle)
    reached[lost] = inside
    return reached


def _step_counts(positions: FloatArray, surface: Surface) -> IntArray:
    """Steps (M,) that move by half a cell of the surface or less."""
    if not len(positions):
        return np.zeros(0, dtype=np.int64)
    length = np.linalg.norm(positions[:, -1] - positions[:, 0], axis=1)
    counts: IntArray = np.clip(np.ceil(2.0 * length / _cell(surface, positions)), FEWEST_STEPS, MOST_STEPS).astype(int)
    return counts


def _cell(surface: Surface, positions: FloatArray) -> float:
    """Cell size of the surface's own heights, read off a small patch."""
    known = getattr(surface, "spacing", None)
    if known is not None:
        return float(known)
    x, y = np.median(positions[:, -1], axis=0)
    transform = surface.patch((x, y, x, y)).transform  # map to cells
    return float(1.0 / max(np.hypot(transform.a, transform.d), np.hypot(transform.b, transform.e), 1e-12))


def _lagrange(nodes: FloatArray, at: FloatArray) -> FloatArray:
    """Weights (K, len(nodes)) of the polynomial through `nodes` at K places."""
    weights = np.ones((len(at), len(nodes)))
    for j, node in enumerate(nodes):
        for other in np.delete(nodes, j):
            weights[:, j] *= (at - other) / (node - other)
    return weights


def _meet(
    lines: SightLines,
    surface: Surface,
    rows: IntArray,
    top: FloatArray,
    bottom: FloatArray,
    positions: FloatArray,
    nodes: FloatArray,
    result: FloatArray,
) -> None:
    """Crossings of interpolated lines with the surface, refined; written into the rows of `result` that have one."""
    count = int(_step_counts(positions, surface).max())
    at = np.linspace(0.0, 1.0, count + 1)
    xy = np.einsum("kj,mjd->mkd", _lagrange(nodes, at), positions)
    heights = top[:, None] + (bottom - top)[:, None] * at
    above = surface.height(xy.reshape(-1, 2)).reshape(heights.shape) - heights
    hit = np.argmax(above >= 0.0, axis=1)
    index = np.arange(len(rows))
    # Without a known height just before the hit the line came up from under the edge of the surface: hidden.
    found = np.flatnonzero((hit > 0) & (above[index, np.maximum(hit - 1, 0)] < 0.0))
    hit = hit[found]
    # One step more on either side, since the exact line may cross a hair beside the interpolated one.
    first, last = np.maximum(hit - 2, 0), np.minimum(hit + 1, count)
    first = np.where(above[found, first] < 0.0, first, hit - 1)
    last = np.where(above[found, last] >= 0.0, last, hit)
    crossing = _Bracket(lines, surface, rows[found])
    result[rows[found]] = crossing.refine(
        heights[found, first], heights[found, last], xy[found, first], xy[found, last]
    )


class _Bracket:
    """Root of surface height minus line height between two heights, on the exact lines (Illinois rule, bisection)."""

    def __init__(self, lines: SightLines, surface: Surface, rows: IntArray) -> None:
        self.lines, self.surface, self.rows = lines, surface, rows

    def _excess(self, heights: FloatArray, which: IntArray, start: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Surface above the line (M,), and the line's exact positions (M, 2)."""
        xy = self.lines.at(heights, self.rows[which], start)
        excess = np.full(len(which), np.nan)
        seen = np.flatnonzero(np.isfinite(xy).all(axis=1))
        excess[seen] = self.surface.height(xy[seen]) - heights[seen]
        return excess, xy

    def refine(self, upper: FloatArray, lower: FloatArray, xy_upper: FloatArray, xy_lower: FloatArray) -> FloatArray:
        """Meeting x, y, height (M, 3) within the bracket; NaN where it does not hold."""
        everyone = np.arange(len(self.rows))
        result = np.full((len(everyone), 3), np.nan)
        f_upper, xy_upper = self._excess(upper, everyone, xy_upper)
        f_lower, xy_lower = self._excess(lower, everyone, xy_lower)
        best = np.full(len(everyone), np.inf)
        active = everyone[(f_upper <= 0.0) & (f_lower >= 0.0)]
        for height, f, xy in ((upper, f_upper, xy_upper), (lower, f_lower, xy_lower)):
            self._keep(result, best, active, height[active], f[active], xy[active])
        for turn in range(80):
            active = active[(best[active] > HEIGHT_GOAL) & (upper - lower > HEIGHT_GOAL)[active]]
            if not len(active):
                break
            a, b, fa, fb = upper[active], lower[active], f_upper[active], f_lower[active]
            share = (
                # Every third turn bisects, so that the bracket shrinks whatever the surface does, at cliffs too.
                np.where(fb > fa, fa / np.where(fb > fa, fa - fb, 1.0), 0.5) if turn % 3 < 2 else np.full(len(a), 0.5)
            )
            middle = a + (b - a) * share
            start = xy_upper[active] + (xy_lower - xy_upper)[active] * share[:, None]
            f, xy = self._excess(middle, active, start)
            self._keep(result, best, active, middle, f, xy)
            below = f >= 0.0
            # The end that stays twice has its value halved (Illinois), or the secant would creep.
            f_upper[active] = np.where(below, fa * 0.5, f)
            f_lower[active] = np.where(below, f, fb * 0.5)
            upper[active], lower[active] = np.where(below, a, middle), np.where(below, middle, b)
            xy_upper[active] = np.where(below[:, None], xy_upper[active], xy)
            xy_lower[active] = np.where(below[:, None], xy, xy_lower[active])
            active = active[np.isfinite(f)]
        closed = (best <= HEIGHT_ACCEPTED) | (upper - lower <= HEIGHT_ACCEPTED)
        result[~closed] = np.nan
        return result

    @staticmethod
    def _keep(
        result: FloatArray, best: FloatArray, rows: IntArray, height: FloatArray, f: FloatArray, xy: FloatArray
    ) -> None:
        better = np.abs(f) < best[rows]
        kept = rows[better]
        best[kept] = np.abs(f[better])
        result[kept] = np.column_stack([xy, height])[better]


def image_to_height(model: SensorModel, colrow: FloatArray, heights: FloatArray | float, crs: CRS) -> FloatArray:
    """Ground points at given heights.

    Parameters
    ----------
    model : SensorModel
    colrow : array (N, 2)
        Pixels.
    heights : float or array (N,)
        In the height unit and datum of `crs`.
    crs : CRS
        3-D map CRS of the heights and of the result; a 2-D one will do for models without heights.

    Returns
    -------
    array (N, 3)
        x, y, height in `crs`; x and y are NaN where the line of sight does not reach the height.
    """
    image = _as_image(colrow)
    levels = np.broadcast_to(np.asarray(heights, dtype=np.float64), (len(image),)).copy()
    lines = SightLines.of(model, image, crs)
    ground = np.column_stack([lines.at(levels), levels])
    ground[~lines.exact(ground), :2] = np.nan
    return ground


def image_to_ground(model: SensorModel, colrow: FloatArray, surface: Surface | None = None) -> FloatArray:
    """Ground points where lines of sight first meet a surface.

    Parameters
    ----------
    model : SensorModel
    colrow : array (N, 2)
        Pixels.
    surface : Surface, optional
        May be left out for a model without heights: the result is then in `model.crs`, with z = 0.

    Returns
    -------
    array (N, 3)
        x, y, z in `surface.crs`; NaN where a line of sight meets no known height. `ground_to_image` of the result
        gives `colrow` back within 1e-6 pixel.

    Raises
    ------
    InputError
        The model needs heights and there is no surface.
    HeightDatumError
        The heights of the surface have no vertical datum.
    """
    image = _as_image(colrow)
    if has_heights(model.crs):
        if surface is None:
            raise InputError("the lines of sight of this sensor need a surface", hint="give a DEM or a height")
        # Rays in closed form need no iteration for the line itself.
        if isinstance(model, HasRays):
            return Transform(model.crs, surface.crs)(intersect(surface, model.crs, *model.rays(image)))
        lines = SightLines.of(model, image, surface.crs)
        ground = first_meeting(lines, surface)
        ground[~lines.exact(ground)] = np.nan
        return ground
    if surface is None:
        return image_to_height(model, image, 0.0, model.crs)
    # Heights play no part in this model: the place is found first, and the surface gives its height.
    ground = image_to_height(model, image, 0.0, horizontal(surface.crs))
    seen = np.isfinite(ground[:, :2]).all(axis=1)
    ground[seen, 2] = surface.height(ground[seen, :2])
    ground[~np.isfinite(ground).all(axis=1)] = np.nan
    return ground


def _as_image(colrow: FloatArray) -> FloatArray:
    image = np.asarray(colrow, dtype=np.float64)
    if image.ndim != 2 or image.shape[1] != 2:
        raise ValueError(f"image coordinates have shape {image.shape}, expected (N, 2)")
    return image
