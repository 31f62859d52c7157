"""Ray intersection: first points where rays meet a surface."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pyproj import CRS

from geomosaic.geo.transform import Transform
from geomosaic.surface.model import Surface
from geomosaic.types import BoolArray, FloatArray, IntArray

_RAYS = 20_000
_STEPS = 16
_MOST_STEPS = 1 << 16
_TOLERANCE = 1e-7


def intersect(surface: Surface, crs: CRS, origins: FloatArray, directions: FloatArray) -> FloatArray:
    """First points where rays meet a surface from above.

    Parameters
    ----------
    surface : Surface
    crs : CRS
        Cartesian frame of the rays: geocentric, or the surface's own map CRS (a ray is then straight on the map).
    origins : array (N, 3)
        In `crs`.
    directions : array (N, 3)
        Of unit length.

    Returns
    -------
    array (N, 3)
        In `crs`, on the surface within 1e-6 m along the ray; NaN where the ray never meets it from above: it looks at
        the sky, leaves the known heights, starts below, or comes out of unknown heights below the surface.

    Notes
    -----
    The ray is cut to the stretch between the highest and the lowest height of the surface, searched downwards in steps
    of half the surface's node spacing, and the step in which it dives is solved by the Illinois rule. Spikes narrower
    than a step that the ray only grazes may be passed.
    """
    points = np.full(np.shape(origins), np.nan)
    usable = np.isfinite(origins).all(axis=1) & np.isfinite(directions).all(axis=1)
    index = np.flatnonzero(usable)
    for start in range(0, len(index), _RAYS):
        part = index[start : start + _RAYS]
        o, d = np.asarray(origins[part], dtype=np.float64), np.asarray(directions[part], dtype=np.float64)
        points[part] = o + _distances(surface, Transform(crs, surface.crs), o, d)[:, None] * d
    return points


class _Clearance:
    """Height of a ray above the surface as a function of the distance from its origin."""

    def __init__(self, surface: Surface, to_surface: Transform, origins: FloatArray, directions: FloatArray) -> None:
        self.surface, self.to_surface, self.origins, self.directions = surface, to_surface, origins, directions

    def place(self, rays: IntArray, t: FloatArray) -> FloatArray:
        """Surface coordinates (M, 3) at distances t (M,) along rays (M,)."""
        return self.to_surface(self.origins[rays] + t[:, None] * self.directions[rays])

    def __call__(self, rays: IntArray, t: FloatArray) -> FloatArray:
        place = self.place(rays, t)
        return place[:, 2] - self.surface.height(place[:, :2])


def _distances(surface: Surface, to_surface: Transform, origins: FloatArray, directions: FloatArray) -> FloatArray:
    """Distance (N,) from the origin to the first meeting; NaN where there is none."""
    low, high = surface.range
    clearance = _Clearance(surface, to_surface, origins, directions)
    rays = np.arange(len(origins))
    # The search must begin above the surface and end below it, though `_descend` stops within 1 mm of a level.
    margin = 0.1 + 1e-3 * (high - low)
    enter = _descend(lambda r, t: clearance.place(r, t)[:, 2], rays, np.zeros(len(rays)), high + margin)
    leave = _descend(lambda r, t: clearance.place(r, t)[:, 2], rays, enter, low - margin)
    result = np.full(len(rays), np.nan)
    rays = np.flatnonzero(np.isfinite(leave))
    if not len(rays):
        return result
    above, below = _search(clearance, surface, rays, enter, leave)
    rays = np.flatnonzero(np.isfinite(below))
    result[rays] = _illinois(clearance, rays, above[rays], below[rays])
    return result


def _descend(
    height: Callable[[IntArray, FloatArray], FloatArray], rays: IntArray, start: FloatArray, level: float
) -> FloatArray:
    """Distance at which rays come down to a level, by Newton's rule from above; NaN where they never do."""
    # Over the round Earth the height along a ray is convex, so the steps never pass the level; where the ray turns
    # upwards before it, there is no meeting.
    t = start.copy()
    active = rays[np.isfinite(t[rays])]
    for _ in range(60):
        z = height(active, t[active])
        over = z - level
        active, over = active[~(over <= 1e-3)], over[~(over <= 1e-3)]
        if not len(active):
            break
        # Metres of the difference that gives the slope: a thousandth of what is left, but well above rounding.
        step = np.maximum(1e-3, 1e-3 * np.abs(over))
        slope = (height(active, t[active] + step) - (over + level)) / step
        # A ray that does not fall here has passed its lowest point above the level.
        falling = slope < -1e-9
        t[active[~falling]] = np.nan
        active, over, slope = active[falling], over[falling], slope[falling]
        t[active] += -over / slope
    t[active] = np.nan
    return t


def _search(
    clearance: _Clearance, surface: Surface, rays: IntArray, enter: FloatArray, leave: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Last distance above and first below the surface, over all rays (N,); NaN where there is no dive."""
    above, below = np.full(len(enter), np.nan), np.full(len(enter), np.nan)
    first, last = clearance.place(rays, enter[rays]), clearance.place(rays, leave[rays])
    length = np.hypot(*(last - first)[:, :2].T)
    near = _near(surface, first, last, length)
    if not near.any():
        return above, below
    rays, first, last, length = rays[near], first[near], last[near], length[near]
    counts = np.clip(np.ceil(2.0 * length / _spacing(surface, first, last)), 1, _MOST_STEPS)
    counts[~np.isfinite(counts)] = 1
    step = (leave[rays] - enter[rays]) / counts
    known_above: BoolArray = clearance(rays, enter[rays]) > 0.0
    done = 0
    while len(rays):
        numbers = done + np.arange(1, _STEPS + 1)
        t = enter[rays, None] + step[:, None] * np.minimum(numbers, counts[:, None])
        gap = clearance(np.repeat(rays, _STEPS), t.ravel()).reshape(t.shape)
        under = gap <= 0.0
        hit = under.argmax(axis=1)
        found = under[np.arange(len(rays)), hit]
        before = np.where(hit > 0, gap[np.arange(len(rays)), np.maximum(hit - 1, 0)] > 0.0, known_above)
        dives = found & before
        previous = enter[rays] + step * np.minimum(done + hit, counts)
        above[rays[dives]] = previous[dives]
        below[rays[dives]] = t[np.arange(len(rays)), hit][dives]
        known_above = gap[:, -1] > 0.0
        done += _STEPS
        on = ~found & (counts > done)
        rays, step, counts, known_above = rays[on], step[on], counts[on], known_above[on]
    return above, below


def _near(surface: Surface, first: FloatArray, last: FloatArray, length: FloatArray) -> BoolArray:
    """Whether rays (N,) may pass over the surface; those beside a raster need no search, however fine its nodes are."""
    grid = getattr(surface, "grid", None)
    if grid is None:
        return np.ones(len(length), dtype=bool)
    bounds = np.array(grid.bounds)
    slack = 0.05 * length[:, None]  # on a map a ray is not quite straight
    least, most = np.minimum(first, last)[:, :2] - slack, np.maximum(first, last)[:, :2] + slack
    near: BoolArray = np.all((most >= bounds[:2]) & (least <= bounds[2:]), axis=1)
    return near


def _spacing(surface: Surface, first: FloatArray, last: FloatArray) -> float:
    """Distance between the surface's nodes, read off a small patch where a surface does not tell."""
    low, high = surface.range
    if low == high:
        return np.inf
    known = getattr(surface, "spacing", None)
    if known is not None:
        return float(known)
    x, y = np.nanmedian(np.concatenate([first[:, :2], last[:, :2]]), axis=0)
    transform = surface.patch((x, y, x, y)).transform
    return float(1.0 / max(np.hypot(transform.a, transform.d), np.hypot(transform.b, transform.e)))


def _illinois(clearance: _Clearance, rays: IntArray, above: FloatArray, below: FloatArray) -> FloatArray:
    """Root of the clearance between a distance above and one below the surface (Dowell and Jarratt, 1971)."""
    a, b = above.copy(), below.copy()
    fa, fb = clearance(rays, a), clearance(rays, b)
    active = np.arange(len(rays))
    # Every fourth step bisects, so that the bracket shrinks even where the Illinois rule creeps.
    for turn in range(100):
        active = active[(b - a)[active] > _TOLERANCE]
        if not len(active):
            break
        width, drop = (b - a)[active], (fa - fb)[active]
        share = fa[active] / drop if turn % 4 < 3 else np.full(len(active), 0.5)
        # A hair inside the bracket, so that both ends close in on the root.
        share = np.clip(share, 0.25 * _TOLERANCE / width, 1.0 - 0.25 * _TOLERANCE / width)
        t = a[active] + share * width
        f = clearance(rays[active], t)
        under = f <= 0.0
        down, up = active[under], active[~under]
        b[down], fb[down], fa[down] = t[under], f[under], fa[down] * 0.5
        a[up], fa[up], fb[up] = t[~under], f[~under], fb[up] * 0.5
    middle: FloatArray = 0.5 * (a + b)
    middle[~np.isfinite(fa + fb)] = np.nan
    return middle
