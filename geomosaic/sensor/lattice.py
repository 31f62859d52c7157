"""Interpolation lattice: the sensor at nodes in (x, y, z), with the error between them measured.

A block of output pixels gets nodes every `step` pixels. At each node the exact model is evaluated at the four Chebyshev
heights of the block's height range, which makes image (col, row) a cubic in height; between nodes the four coefficients
are interpolated bilinearly. Half-way between nodes, where that errs most, the result is held against the exact model,
and the step is halved until half the tolerance is met. Where heights play no part and cubics are seen to follow the
model, closer nodes are taken from them: a thin plate spline needs close nodes, and asks all its points at each. The
nodes are then moved by what interpolation errs to one side in the mean. A block depends on nothing but itself: the same
pixels come out whatever the tiles and threads.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.options.render import BLOCK_HEIGHT, BLOCK_WIDTH, CELL
from geomosaic.sensor.lattice_error import ENDS, HOPELESS, Cells, at_heights, both
from geomosaic.sensor.map_to_image import BlockGround, MapToImage
from geomosaic.types import BoolArray, FloatArray

# Output pixels between nodes: of the first lattice tried, and of one so close that its cells are judged singly.
FIRST_STEP, CLOSE_STEP = CELL, 4
# Output pixels of a part's longer side that is not divided any more.
SMALLEST = 16
# Pixels that nodes at every pixel may err without anything being wrong.
ROUNDING = 1e-3
# Pixels by which nodes at every pixel err only where the image is torn; at the rim of a map of the globe, which may
# squeeze it endlessly, what errs less is left.
JUMP = 2.0
# Pixels of a block that are put one by one.
MOST_TORN = 8192
# Share of the admissible error that interpolation of exact places may take. At a quarter of it the model is asked twice
# as often; with more, closer nodes are needed to stay within the rest.
INTERPOLATED = 0.5
# Error of cubics between the places that the model was asked, as a share of that between every other one of them: next
# to the points of a spline, where its second derivative has no limit, up to 0.43; 0.06 where it has one.
SHORTER = 0.5
# Image pixels by which a lattice bends only from rounding; what an affine map gives is left as it is.
STRAIGHT = 1e-6

# Interpolation at Chebyshev points has nearly the least largest error of all cubics over the height range.
_CHEBYSHEV = np.cos((2 * np.arange(4) + 1) * np.pi / 8)
_TO_CUBIC = np.linalg.inv(np.vander(_CHEBYSHEV, 4, increasing=True))


@dataclass(frozen=True, eq=False)
class Lattice:
    """Image positions over one block of output pixels.

    Attributes
    ----------
    window : Window
        The block, in pixels of the output grid.
    step : int
        Pixels between nodes.
    nodes : array (rows, cols, 8)
        Cubic coefficients, constant first, of col then row in the normalised height t = (z − z_middle) / z_half, such
        that what is interpolated between them has no error in the mean.
    surface : array (rows, cols, 2)
        Surface map (x, y) of the nodes.
    z_middle, z_half : float
        Height range of the block, in metres of the surface's datum.
    error : float
        Largest interpolation error, measured before the nodes are moved, in image pixels, or in output pixels where
        those are larger.
    bounds : tuple of float
        Left, top, right, bottom of all that the block can see, in image pixels.
    scale : float
        Image pixels per output pixel, along the direction where that is most.
    seen : bool array (rows − 1, cols − 1)
        Cells that may show the image.
    levels : array (3 or 1, rows, cols, 2)
        Image of the nodes at the bottom, the middle and the top of the height range; one level where it is flat.
    """

    window: Window
    step: int
    nodes: FloatArray
    surface: FloatArray
    z_middle: float
    z_half: float
    error: float
    bounds: tuple[float, float, float, float]
    scale: float
    seen: BoolArray
    levels: FloatArray

    @property
    def flat(self) -> bool:
        """Whether height plays no part in this block."""
        return self.z_half == 0.0


def blocks(window: Window) -> list[Window]:
    """Blocks of the lattice, aligned to the output grid, that touch a window.

    Parameters
    ----------
    window : Window
        In pixels of the output grid.

    Returns
    -------
    list of Window
        Row by row. They start at multiples of the block size counted from the grid's origin, not from the window's,
        and end at the window's right and lower edges.
    """
    first_col, first_row = window.col // BLOCK_WIDTH * BLOCK_WIDTH, window.row // BLOCK_HEIGHT * BLOCK_HEIGHT
    whole = Window(first_col, first_row, window.stop_col - first_col, window.stop_row - first_row)
    return whole.split(BLOCK_WIDTH, BLOCK_HEIGHT)


def build(mapper: MapToImage, grid: Grid, ground: BlockGround, tolerance: float) -> list[Lattice]:
    """Lattices of one block: one as a rule, several smaller ones where a cubic cannot follow the block's relief.

    Parameters
    ----------
    mapper : MapToImage
    grid : Grid
        The output.
    ground : BlockGround
        The block and its heights.
    tolerance : float
        Largest admissible error in image pixels, or in output pixels where those are larger; half of it is used. At 0
        every pixel has nodes at its corners.

    Returns
    -------
    list of Lattice
        Disjoint parts of the block that may see the image; empty where it is not seen or no height is known. Where the
        two sides of a picture of the whole globe meet, the same part may come twice, once for each side.
    """
    return _build(mapper, grid, ground, ground.window, tolerance)


def _build(mapper: MapToImage, grid: Grid, ground: BlockGround, window: Window, tolerance: float) -> list[Lattice]:
    low, high = _heights(mapper, grid, ground, window)
    if np.isnan(low):
        return []
    middle, half = (low + high) / 2, (high - low) / 2
    # Tolerance 0 asks for exact maths at every pixel: no coarser lattice is tried.
    step, before = _first_step(window) if tolerance > 0 else 1, np.inf
    divisible = half > 0 and max(window.width, window.height) > SMALLEST
    places, nodes, exact = _sampled(mapper, grid, window, step, middle, half)
    # Half of the tolerance: the error is sampled at edges and centres, and may be somewhat larger between them. The
    # exact places may be off themselves, once they are interpolated.
    limit, off = tolerance / 2, 0.0
    while True:
        # An infinite `before` marks the first round: seams and rims are looked for once, on the coarsest lattice.
        small = max(window.width, window.height) <= FIRST_STEP
        if np.isinf(before) and mapper.branch == 0.0 and mapper.torn(places):
            sides = mapper.beside()
            if not any(side.torn(_sampled(side, grid, window, step, middle, half)[0]) for side in sides):
                return [lattice for side in sides for lattice in _build(side, grid, ground, window, tolerance)]
            if not small:  # a pole is among them
                return _parts(mapper, grid, ground, window, tolerance)
        shown = both(np.isfinite(places))
        if mapper.rim is not None and np.isinf(before) and not small and shown.any() and not shown.all():
            return _parts(mapper, grid, ground, window, tolerance)  # only those at the rim are worth closer nodes
        levels = at_heights(nodes, (-1.0, 0.0, 1.0) if half else (0.0,))
        bounds = _bounds(levels)
        if bounds is None and mapper.rim is not None and step > (CLOSE_STEP if small else SMALLEST):
            step //= 2  # the rim of the globe may pass between the nodes
            places, nodes, exact = _sampled(mapper, grid, window, step, middle, half)
            continue
        if bounds is None or _misses(bounds, mapper.model.size):
            return []
        at_rim = mapper.rim is not None and not shown.all()
        # At the rim of the globe the mapping is as steep as can be: only single pixels are close enough there.
        scale, close = _scale(nodes, step), step <= (1 if at_rim else CLOSE_STEP)
        cells = Cells(mapper, grid, window, step, middle, half, places, nodes, levels[::2], exact, scale)
        miss = cells.measure(limit - off, thorough=close)
        good = not miss.error > limit - off
        if (good and (close or not miss.ragged)) or step == 1:
            break
        # What bends as much in most of a small part, as a scan in turbulence does, bends in its parts: they would only
        # find that again, step by step.
        even = small and close and miss.cubic <= limit and miss.share(HOPELESS * limit) > 0.5
        if divisible and not good and not even:
            # An error of the cubic in height stands at the nodes themselves: closer nodes cannot lessen it.
            cubic = np.isinf(before) and miss.cubic > limit
            if cubic or close or miss.error > before / 2:
                return _parts(mapper, grid, ground, window, tolerance)
        # Where half the step would still err too much, it is not tried, unless all shorter ones may follow from it.
        hopeless = not miss.ragged and HOPELESS * limit < miss.error < np.inf and (close or step >= 4 * CLOSE_STEP)
        if not mapper.uses_heights and not off:
            err = SHORTER * _cubic_error(exact[0]) / max(1.0, scale)
            off = err if err <= INTERPOLATED * limit else 0.0
        shorter, before = min(step, 4 if hopeless and (off or mapper.uses_heights) else 2), miss.error
        step //= shorter
        if off:
            places, nodes, exact = _interpolated(places, exact, shorter)
        else:
            places, nodes, exact = _sampled(mapper, grid, window, step, middle, half)
    nodes = _centred(nodes, levels[::2], exact, step, max(tolerance, ROUNDING) * max(1.0, scale))
    error = miss.error + off
    made = Lattice(window, step, nodes, places[::2, ::2], middle, half, error, bounds, scale, miss.seen, levels)
    torn = miss.worst > max(limit, ROUNDING if np.isfinite(places).all() else JUMP)
    return _mended(made, places, exact[0], miss.worst, torn, mapper.model.size) if step == 1 and not half else [made]


def _centred(nodes: FloatArray, ends: FloatArray, exact: FloatArray, step: int, most: float) -> FloatArray:
    """Nodes (rows, cols, 8) less the mean error of what is interpolated between them; left where that is over `most`.

    Between nodes h apart, a chord lies h² f''/8 from its curve half-way; over the pixel centres of its cell it does so
    by 2/3 + 1/(3 step²) of that in the mean. Without this all of a picture is drawn to the side to which its geometry
    bends, by up to a third of the tolerance.
    """
    if step == 1:  # the model was asked at the centres only, where the chords of both directions add up
        corners = ends[:, :-1] + ends[:, 1:]
        sag = _at_nodes(_at_nodes((corners[:, :, :-1] + corners[:, :, 1:]) / 4 - exact[:, 1::2, 1::2], 1), 2)
    else:
        down = (exact[:, :-2:2, ::2] + exact[:, 2::2, ::2]) / 2 - exact[:, 1::2, ::2]
        across = (exact[:, ::2, :-2:2] + exact[:, ::2, 2::2]) / 2 - exact[:, ::2, 1::2]
        sag = (_at_nodes(down, 1) + _at_nodes(across, 2)) * (2 / 3 + 1 / (3 * step**2))
    size = np.abs(sag).max(axis=0)
    size = np.maximum(size[..., 0], size[..., 1])
    with np.errstate(invalid="ignore"):
        sag[:, ~((size > STRAIGHT) & (size <= most))] = 0.0  # where the image is torn or ends, nothing bends
    moved = nodes.copy()
    moved[..., ::4] -= sag.mean(axis=0)
    if len(sag) > 1:  # linear in height between both ends of its range
        moved[..., 1::4] -= (sag[1] - sag[0]) / 2
    return moved


def _at_nodes(between: FloatArray, axis: int) -> FloatArray:
    """Means at nodes of what lies between them along an axis of (levels, rows, cols, 2): of both sides, or of one."""
    sides = np.concatenate([between.take([0], axis), between, between.take([-1], axis)], axis)
    sides = np.moveaxis(sides, axis, 0)
    return np.moveaxis((sides[:-1] + sides[1:]) / 2, 0, axis)


def _mended(
    made: Lattice, places: FloatArray, exact: FloatArray, worst: FloatArray, torn: BoolArray, size: tuple[int, int]
) -> list[Lattice]:
    """Lattices without torn pixels, and one lattice for each of those that the model places by itself."""
    # So it is at the seam of longitude and latitude: from one pixel to the next it jumps by all the width of the image.
    if not torn.any():
        return [made]
    corners, around = np.zeros(made.nodes.shape[:2], dtype=bool), np.zeros_like(torn)
    for down in (0, 1):
        for right in (0, 1):
            corners[down : down + torn.shape[0], right : right + torn.shape[1]] |= torn
    for down in (0, 1):
        for right in (0, 1):
            around |= corners[down : down + torn.shape[0], right : right + torn.shape[1]]
    if around.sum() > MOST_TORN:
        return [made]
    nodes, levels = made.nodes.copy(), made.levels.copy()
    nodes[corners], levels[:, corners] = np.nan, np.nan
    rest = replace(made, nodes=nodes, levels=levels, error=float(worst[~torn].max(initial=0.0)))
    centres = exact[1::2, 1::2]
    with np.errstate(invalid="ignore"):
        shown = around & both((centres >= 0.0) & (centres < np.array(size)))
    return [rest, *(_pixel(made, places, centres[row, col], int(row), int(col)) for row, col in np.argwhere(shown))]


def _pixel(made: Lattice, places: FloatArray, image: FloatArray, row: int, col: int) -> Lattice:
    """Lattice of one pixel, which lies at `image` (2,) as a whole."""
    nodes = np.zeros((2, 2, 8))
    nodes[..., ::4] = image
    return replace(
        made,
        window=Window(made.window.col + col, made.window.row + row, 1, 1),
        nodes=nodes,
        surface=np.tile(places[2 * row + 1, 2 * col + 1], (2, 2, 1)),
        error=0.0,
        bounds=(float(image[0]), float(image[1]), float(image[0]), float(image[1])),
        seen=np.ones((1, 1), dtype=bool),
        levels=np.tile(image, (1, 2, 2, 1)),
    )


def _parts(mapper: MapToImage, grid: Grid, ground: BlockGround, window: Window, tolerance: float) -> list[Lattice]:
    """Lattices of smaller parts, whose relief is lower: closer nodes do not help where it is too high for one cubic."""
    parts = window.split(_half(window.width), _half(window.height))
    return [lattice for part in parts for lattice in _build(mapper, grid, ground, part, tolerance)]


def _first_step(window: Window) -> int:
    """Largest step that is not much longer than the window."""
    step = FIRST_STEP
    while step > CLOSE_STEP and step >= 2 * max(window.width, window.height):
        step //= 2
    return step


def _half(length: int) -> int:
    """Half of a length in whole first steps, or of one such step: a part never straddles two cells of `FIRST_STEP`."""
    if length > FIRST_STEP:
        return length // 2 // FIRST_STEP * FIRST_STEP or FIRST_STEP
    return FIRST_STEP // 2 if length > FIRST_STEP // 2 else SMALLEST


def _heights(mapper: MapToImage, grid: Grid, ground: BlockGround, window: Window) -> tuple[float, float]:
    """Height range of a part of the block, in metres of the surface's datum."""
    if not mapper.uses_heights:
        return (0.0, 0.0) if not ground.unknown else ground.heights
    if window == ground.window:
        return ground.heights
    c, r = np.meshgrid(np.linspace(window.col, window.stop_col, 5), np.linspace(window.row, window.stop_row, 5))
    return ground.over(mapper.surface_xy(grid.xy(np.column_stack([c.ravel(), r.ravel()]))))


def _sampled(
    mapper: MapToImage, grid: Grid, window: Window, step: int, middle: float, half: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Surface map of nodes and places half-way between, nodes' cubics, the model at both ends of the range or NaN."""
    # Asked of the model in one go: of so few places the way there costs more than the answer.
    rows, cols = -(-window.height // step), -(-window.width // step)  # enough cells to cover the block
    c = window.col + step * 0.5 * np.arange(2 * cols + 1)
    r = window.row + step * 0.5 * np.arange(2 * rows + 1)
    xy = mapper.surface_xy(grid.xy(np.stack(np.meshgrid(c, r), axis=-1).reshape(-1, 2)))
    places = xy.reshape(len(r), len(c), 2)
    ends = ENDS if half else ENDS[:1]
    at_nodes, levels = places[::2, ::2].reshape(-1, 2), _CHEBYSHEV if half else ENDS[:0]
    evaluated: BoolArray | slice = slice(None)
    if step == 1:  # nodes at every pixel are the last: of what lies between them only the pixels' centres are seen
        evaluated = np.zeros(len(r) * len(c), dtype=bool)
        evaluated.reshape(len(r), len(c))[1::2, 1::2] = True
        evaluated.reshape(len(r), len(c))[::2, ::2] = not half
    xy = xy[evaluated]
    z = np.concatenate([np.repeat(ends, len(xy)), np.repeat(levels, len(at_nodes))])
    image = mapper.image(np.concatenate([xy] * len(ends) + [at_nodes] * len(levels)), middle + half * z)
    exact: FloatArray = np.full((len(ends), len(r) * len(c), 2), np.nan)
    exact[:, evaluated] = image[: len(ends) * len(xy)].reshape(len(ends), -1, 2)
    exact = exact.reshape(len(ends), *places.shape)
    nodes = np.zeros((rows + 1, cols + 1, 8))
    if half:
        values = image[len(ends) * len(xy) :].reshape(4, rows + 1, cols + 1, 2)
        cubics = nodes.reshape(rows + 1, cols + 1, 2, 4)
        # Sums written out, not a matrix product: the same digits on every machine.
        for power in range(4):
            total = _TO_CUBIC[power, 0] * values[0]
            for k in (1, 2, 3):
                total += _TO_CUBIC[power, k] * values[k]
            cubics[..., power] = total
    else:
        nodes[..., ::4] = exact[0, ::2, ::2]
    return places, nodes, exact


def _interpolated(places: FloatArray, exact: FloatArray, shorter: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What `_sampled` gives for a step that is shorter by 2 or 4, from cubics through what it gave for this one."""
    image = exact[0]
    for _ in range(shorter // 2):
        places, image = _doubled(places), _doubled(image)
    nodes = np.zeros((*image[::2, ::2].shape[:2], 8))
    nodes[..., ::4] = image[::2, ::2]
    return places, nodes, image[None]


def _cubic_error(exact: FloatArray) -> float:
    """Largest error of cubics through every other place (rows, cols, 2) at those between, pixels; infinite if few."""
    if min(exact.shape[:2]) < 7:
        return np.inf
    off = _doubled(exact[::2, ::2]) - exact
    miss = float(np.sqrt((off[..., 0] ** 2 + off[..., 1] ** 2).max()))
    return miss if np.isfinite(miss) else np.inf


def _doubled(pairs: FloatArray) -> FloatArray:
    """Pairs (2 · rows − 1, 2 · cols − 1, 2) at places and half-way between: cubics through the nearest four."""
    # As complex numbers: over a last axis of two, loops take five times as long.
    values = np.ascontiguousarray(pairs).view(np.complex128)[..., 0]
    for _ in range(2):
        fine = np.empty((2 * values.shape[1] - 1, len(values)), dtype=np.complex128).T
        fine[:, ::2] = values
        fine[:, 3:-3:2] = (values[:, 1:-2] + values[:, 2:-1]) * (9 / 16) - (values[:, :-3] + values[:, 3:]) * (1 / 16)
        fine[:, 1] = (values[:, 0] + 3 * values[:, 1] - values[:, 2]) * (5 / 16) + values[:, 3] * (1 / 16)
        fine[:, -2] = (values[:, -1] + 3 * values[:, -2] - values[:, -3]) * (5 / 16) + values[:, -4] * (1 / 16)
        values = fine.T
    return np.ascontiguousarray(values)[..., None].view(np.float64)


def _bounds(levels: FloatArray) -> tuple[float, float, float, float] | None:
    finite = both(np.isfinite(levels))
    if not finite.any():
        return None
    cols, rows = (levels[..., axis] if finite.all() else levels[..., axis][finite] for axis in (0, 1))
    return float(cols.min()), float(rows.min()), float(cols.max()), float(rows.max())


def _misses(bounds: tuple[float, float, float, float], size: tuple[int, int]) -> bool:
    left, top, right, bottom = bounds
    # A coarse lattice may cut a corner of the image: keep a margin as wide as the cells are curved.
    margin = 2.0 + 0.05 * max(right - left, bottom - top)
    return right < -margin or bottom < -margin or left > size[0] + margin or top > size[1] + margin


def _scale(nodes: FloatArray, step: int) -> float:
    """Scale in image pixels per output pixel: median over the nodes of the largest singular value, at middle height."""
    image = nodes[..., [0, 4]]
    along, down = np.diff(image, axis=1)[:-1] / step, np.diff(image, axis=0)[:, :-1] / step
    # Singular values of 2 x 2 matrices in closed form: hypot(e, h) + hypot(f, g).
    e, f = (along[..., 0] + down[..., 1]) / 2, (along[..., 0] - down[..., 1]) / 2
    g, h = (along[..., 1] + down[..., 0]) / 2, (along[..., 1] - down[..., 0]) / 2
    return finite_median(np.hypot(e, h) + np.hypot(f, g))


def finite_median(values: FloatArray) -> float:
    """Median of the finite values.

    Parameters
    ----------
    values : array (...)
        Of any shape.

    Returns
    -------
    float
        NaN where no value is finite.
    """
    # NumPy's own loads its masked arrays first, which takes as long as a small job's pixels.
    finite = np.sort(values[np.isfinite(values)])
    half, odd = divmod(len(finite), 2)
    return float(finite[half] if odd else finite[half - 1 : half + 1].mean()) if len(finite) else float("nan")
