"""Figures of a block report as plain values: block, accuracy, residuals over the format and their histogram."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import norm

from geomosaic.errors import GeomosaicError
from geomosaic.numbers import round_below
from geomosaic.orientation.block.facts import formats
from geomosaic.orientation.block.initial_values import at_level
from geomosaic.orientation.block.residual_pattern import residual_pattern
from geomosaic.orientation.block.solution import BlockSolution
from geomosaic.report.figures import Outline, Vector, path_data
from geomosaic.report.page import length_text
from geomosaic.types import BoolArray, FloatArray, IntArray

# Width of the maps, and their height at most, in units of the picture.
WIDTH, HEIGHT = 1100.0, 900.0
# Tie points and ellipses that a map shows at most: more would cover each other, and make the page large.
MOST_POINTS, MOST_ELLIPSES = 12_000, 240
# Names that a map shows at most, and cameras whose residuals are drawn.
NAMED, MOST_FORMATS = 60, 6
# Long ellipses and vectors, as shares of the map's width: the 95th percentile is drawn so long.
ELLIPSE, VECTOR = 0.018, 0.05
# Classes of points by their rays: from how many on, and the colour.
RAYS = ((2, "#c8553d"), (3, "#e0a030"), (4, "#5aa9b8"), (6, "#1f6f8b"))
# Side of a cell of standard deviations in units of the picture; from how many times the median on, and the colour.
SIGMA_CELL = 22
SIGMAS = ((0.0, "#cfe6ea"), (1.25, "#8fc5ce"), (1.6, "#f0cf8e"), (2.5, "#e0913c"), (4.0, "#c8453d"))
BINS = np.linspace(-5.0, 5.0, 41)

_Pixels = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Ellipse:
    """Error ellipse of a point in plan, and its standard deviation in height, enlarged, in units of the picture."""

    x: float
    y: float
    a: float
    b: float
    turn: float
    height: float
    title: str


@dataclass(frozen=True)
class BlockMap:
    """Block from above, north up.

    Attributes
    ----------
    width, height : float
        Of the picture.
    footprints : list of Outline
    rays : list of (str, str, int, str)
        Words, colour, number of points and SVG path of dots, of each class of tie points.
    marks : list of Vector
        Control and check points with their errors in plan, enlarged.
    heights : list of float
        Errors of these in height, enlarged as much; up is positive.
    ellipses : list of Ellipse
    ellipse_factor, vector_factor : float
        Enlargement of ellipses and of errors over the ground.
    bars : mapping of str to (float, str)
        Length of the scale bars of the map, of errors and of standard deviations, with their words.
    points : int
        Tie points of which those drawn were taken.
    sigmas : list of (str, str, int, str)
        Words, colour, number and SVG path of cells, by the standard deviation of the heights of their points over that
        of the median point; empty where none is known.
    median_height : str
        Standard deviation of the height of the median point, with its unit.
    """

    width: float
    height: float
    footprints: list[Outline]
    rays: list[tuple[str, str, int, str]]
    marks: list[Vector]
    heights: list[float]
    ellipses: list[Ellipse]
    ellipse_factor: float
    vector_factor: float
    bars: Mapping[str, tuple[float, str]]
    points: int
    sigmas: list[tuple[str, str, int, str]]
    median_height: str


@dataclass(frozen=True)
class FormatPlot:
    """Mean residuals over the format of a camera, enlarged, in a picture 400 wide or high."""

    camera: str
    width: float
    height: float
    vectors: list[Vector]
    bar: float
    bar_text: str
    factor: float
    cells: str


@dataclass(frozen=True)
class Histogram:
    """Normalised residuals beside the normal curve, in a picture of 400 × 240.

    Attributes
    ----------
    bars : list of (float, float, float, float)
        x, y, width and height.
    curve : str
        SVG path.
    count, beyond : int
        Residuals, and those beyond the picture.
    within : list of (int, float, float)
        Of 1, 2 and 3 standard deviations: shares found and to be expected, per cent.
    """

    bars: list[tuple[float, float, float, float]] = field(default_factory=list)
    curve: str = ""
    count: int = 0
    beyond: int = 0
    within: list[tuple[int, float, float]] = field(default_factory=list)


@dataclass(frozen=True)
class BlockFigures:
    """All figures of a block report."""

    map: BlockMap
    formats: list[FormatPlot]
    histogram: Histogram


def block_figures(solution: BlockSolution) -> BlockFigures:
    """Figures of a block report.

    Parameters
    ----------
    solution : BlockSolution
    """
    return BlockFigures(_map(solution), _formats(solution), _histogram(solution))


def _map(solution: BlockSolution) -> BlockMap:
    state = solution.adjustment.state
    outlines = _outlines(solution)
    places = state.points[:, :2]
    shown = np.vstack([places[state.moving], *outlines.values()])
    low, high = np.nanmin(shown, axis=0), np.nanmax(shown, axis=0)
    extent = np.maximum(high - low, 1e-6 * max(float(np.max(high - low)), 1.0))
    scale = min(0.94 * WIDTH / extent[0], 0.94 * HEIGHT / extent[1])
    width, height = WIDTH, float(extent[1] * scale + 0.06 * WIDTH)
    middle = (low + high) / 2.0

    def pixels(xy: FloatArray) -> FloatArray:
        found: FloatArray = (np.asarray(xy)[:, :2] - middle) * [scale, -scale] + [width / 2, height / 2]
        return found

    footprints = []
    for name, ring in outlines.items():
        corners = pixels(ring)
        x, y = corners.mean(axis=0)
        footprints.append(Outline(name, path_data(corners, closed=True), float(x), float(y)))
    marks, heights, vector_factor = _marks(solution, pixels, scale)
    ellipses, ellipse_factor = _ellipses(solution, pixels, scale)
    bars = {
        "map": _bar(WIDTH / 6.0, scale, solution.length_unit),
        "errors": _bar(VECTOR * WIDTH, scale * vector_factor, solution.length_unit),
        "sigmas": _bar(VECTOR * WIDTH, scale * ellipse_factor, solution.length_unit),
    }
    ties = np.flatnonzero(state.moving)
    return BlockMap(
        width, height, footprints, _rays(solution, ties, pixels), marks, heights, ellipses, ellipse_factor,
        vector_factor, bars, len(ties), *_height_sigmas(solution, pixels),
    )  # fmt: skip


def _height_sigmas(solution: BlockSolution, pixels: _Pixels) -> tuple[list[tuple[str, str, int, str]], str]:
    """Cells of the map by the median standard deviation of the heights of their points, and that of all."""
    state, up = solution.adjustment.state, solution.point_sigmas[:, 2]
    known = np.flatnonzero(state.moving & np.isfinite(up) & (solution.rays >= 2))
    middle = float(np.median(up[known])) if len(known) else 0.0
    if middle <= 0.0:
        return [], ""
    xy = np.floor(pixels(state.points[known]) / SIGMA_CELL).astype(np.int64)
    cells, of = np.unique(xy, axis=0, return_inverse=True)
    order = np.lexsort((up[known], of.ravel()))
    count = np.bincount(of.ravel())
    ratio = up[known][order[np.cumsum(count) - count + count // 2]] / middle
    found, limits = [], [low for low, _ in SIGMAS]
    for (low, colour), high in zip(SIGMAS, [*limits[1:], np.inf], strict=True):
        mine = cells[(ratio >= low) & (ratio < high)]
        if len(mine):
            words = f"up to {high:g}" if low == 0.0 else f"over {low:g}" if high == np.inf else f"{low:g} to {high:g}"
            side = f"h{SIGMA_CELL}v{SIGMA_CELL}h-{SIGMA_CELL}z"
            path = "".join(f"M{x} {y}{side}" for x, y in (SIGMA_CELL * mine).tolist())
            found.append((words, colour, len(mine), path))
    return found, length_text(middle, solution.length_unit)


def _bar(most: float, scale: float, unit: str) -> tuple[float, str]:
    """Scale bar of a round length that is at most so long in the picture."""
    length = round_below(most / scale)
    return length * scale, length_text(length, unit)


def _outlines(solution: BlockSolution) -> dict[str, FloatArray]:
    """Outlines (N, 2) of the images in the block's frame: their borders at the median height of their points."""
    frame, state, views = (
        solution.adjustment.problem.frame,
        solution.adjustment.state,
        solution.adjustment.problem.views,
    )
    used, level = state.weights[0] > 0.0, float(np.median(state.points[state.moving, 2]))
    side, corners = np.linspace(0.0, 1.0, 5)[:-1], np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    edge = np.vstack([a + side[:, None] * (b - a) for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)])
    found = {}
    for image, (name, model) in enumerate(zip(solution.images, solution.models, strict=True)):
        rows = views.slice_of(image)
        mine = state.points[views.points[rows][used[rows]], 2]
        try:
            ring = at_level(model, edge * model.size, frame.local, float(np.median(mine)) if len(mine) else level)
        except GeomosaicError:  # nothing of the border meets the ground
            continue
        ring = ring[np.isfinite(ring).all(axis=1)]
        if len(ring) >= 3:
            found[name] = ring[:, :2]
    return found


def _rays(solution: BlockSolution, ties: IntArray, pixels: _Pixels) -> list[tuple[str, str, int, str]]:
    """Dots of tie points by the number of their rays."""
    rays = solution.rays[ties]
    step = max(1, -(-len(ties) // MOST_POINTS))
    found = []
    limits = [low for low, _ in RAYS]
    for (low, colour), high in zip(RAYS, [*limits[1:], np.inf], strict=True):
        mine = ties[(rays >= low) & (rays < high)]
        if len(mine):
            words = f"{low} to {high - 1:g} rays" if high < np.inf else f"{low} rays or more"
            words = words.replace(f"{low} to {low} ", f"{low} ")
            dots = "".join(f"M{x:.0f} {y:.0f}h0" for x, y in pixels(solution.adjustment.state.points[mine[::step]]))
            found.append((words, colour, len(mine), dots))
    return found


def _marks(solution: BlockSolution, pixels: _Pixels, scale: float) -> tuple[list[Vector], list[float], float]:
    """Control and check points with their errors, the errors in height, and the enlargement of both."""
    tables = (("control", solution.control), ("check", solution.checks))
    point = np.concatenate([known.point for _, known in tables])
    errors = np.vstack([_in_frame(solution, known.point, np.nan_to_num(known.errors)) for _, known in tables])
    state = np.array([word for word, known in tables for _ in known.ids], dtype=object)
    state[np.concatenate([known.rejected for _, known in tables])] = "rejected"
    used = np.abs(errors[state != "rejected"])
    longest = float(np.percentile(used, 95)) if used.size else 0.0
    factor = round_below(VECTOR * WIDTH / scale / longest) if longest > 0.0 else 1.0
    drawn = errors * scale * factor
    length = np.linalg.norm(drawn, axis=1)
    # Blunders would run across the map.
    most = 2.0 * VECTOR * WIDTH
    cut = length > most
    drawn[cut] *= (most / length[cut])[:, None]
    places, marks = pixels(solution.adjustment.state.points[point]) if len(point) else np.zeros((0, 2)), []
    for row, index in enumerate(point.tolist()):
        e, n, h = errors[row]
        title = f"{solution.ids[index]} ({state[row]}): east {e:+.3f}, north {n:+.3f}, height {h:+.3f} "
        title += solution.length_unit
        (x, y), (dx, dy) = places[row], drawn[row, :2]
        name = solution.ids[index] if len(point) <= NAMED else ""
        marks.append(Vector(x, y, dx, -dy, str(state[row]), title, name, bool(cut[row])))
    return marks, drawn[:, 2].tolist(), factor


def _in_frame(solution: BlockSolution, point: IntArray, errors: FloatArray) -> FloatArray:
    """Errors (N, 3) along the axes of the ground's CRS, along those of the block."""
    axes = solution.axes[_of(solution.axes, point)]
    found: FloatArray = (np.linalg.inv(axes) @ errors[:, :, None])[:, :, 0]
    return found


def _of(axes: FloatArray, point: IntArray) -> IntArray:
    """Rows of derivatives at points: there is one where it is the same everywhere."""
    return point if len(axes) > 1 else np.zeros_like(point)


def _ellipses(solution: BlockSolution, pixels: _Pixels, scale: float) -> tuple[list[Ellipse], float]:
    """Error ellipses of points that are spread over the block, and their enlargement."""
    state = solution.adjustment.state
    known = np.flatnonzero(state.moving & np.isfinite(solution.point_sigmas).all(axis=1) & (solution.rays >= 2))
    chosen = known[_spread(state.points[known, :2], MOST_ELLIPSES)]
    if not len(chosen):
        return [], 1.0
    turn = np.linalg.inv(solution.axes[_of(solution.axes, chosen)])
    covariance = turn @ solution.point_covariance[chosen] @ np.swapaxes(turn, 1, 2)
    values, vectors = np.linalg.eigh(covariance[:, :2, :2])
    sigmas = np.sqrt(np.maximum(values[:, ::-1], 0.0))
    up = np.sqrt(covariance[:, 2, 2])
    # Bars in height may be twice as long: most blocks know heights less well.
    longest = max(float(np.percentile(sigmas[:, 0], 95)), 0.5 * float(np.percentile(up, 95)), 1e-12)
    factor = round_below(ELLIPSE * WIDTH / scale / longest)
    angle = -np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
    found, unit = [], solution.length_unit
    for row, (x, y) in enumerate(pixels(state.points[chosen])):
        a, b = sigmas[row]
        title = f"{solution.ids[chosen[row]]}: {a:.3f} × {b:.3f} {unit} in plan, {up[row]:.3f} {unit} in height, "
        title += f"{solution.rays[chosen[row]]} rays"
        a, b, h = (min(value * scale * factor, 4.0 * VECTOR * WIDTH) for value in (a, b, up[row]))
        found.append(Ellipse(float(x), float(y), a, b, float(angle[row]), h, title))
    return found, factor


def _spread(xy: FloatArray, most: int) -> IntArray:
    """Some of the points (N, 2), one in each cell of a grid: that nearest to the middle of the cell."""
    if len(xy) <= most:
        return np.arange(len(xy))
    low, extent = xy.min(axis=0), np.maximum(np.ptp(xy, axis=0), 1e-9)
    cell = float(np.sqrt(extent.prod() / most))
    place = (xy - low) / cell
    column = np.floor(place).astype(np.int64)
    number = column[:, 1] * (int(column[:, 0].max()) + 1) + column[:, 0]
    order = np.lexsort((((place - column - 0.5) ** 2).sum(axis=1), number))
    first: BoolArray = np.concatenate([[True], np.diff(number[order]) > 0])
    return order[first]


def _formats(solution: BlockSolution) -> list[FormatPlot]:
    """Mean residuals over the format of each camera, those with most images first."""
    views, used, found = solution.adjustment.problem.views, solution.adjustment.state.weights[0] > 0.0, []
    for name, images in sorted(formats(solution), key=lambda each: -len(each[1]))[:MOST_FORMATS]:
        mine, size = used & np.isin(views.image, images), solution.models[images[0]].size
        pattern = residual_pattern(views.colrow[mine], solution.residuals[mine], size)
        down, across = pattern.count.shape
        shrink = 400.0 / max(size)
        width, height = size[0] * shrink, size[1] * shrink
        lengths = np.linalg.norm(pattern.mean, axis=2)
        longest = float(np.nanmax(lengths)) if np.isfinite(lengths).any() else 0.0
        cell = min(width / across, height / down)
        factor = round_below(1.2 * cell / shrink / longest) if longest > 1e-9 else 1.0
        vectors = []
        for row, col in np.argwhere(np.isfinite(lengths)).tolist():
            dx, dy = pattern.mean[row, col]
            title = f"{pattern.count[row, col]} residuals, mean {dx:+.3f}, {dy:+.3f} px"
            place = ((col + 0.5) * width / across, (row + 0.5) * height / down)
            vectors.append(Vector(*place, dx * shrink * factor, dy * shrink * factor, "camera", title))
        grid = "".join(f"M{width * k / across:.1f} 0V{height:.1f}" for k in range(1, across))
        grid += "".join(f"M0 {height * k / down:.1f}H{width:.1f}" for k in range(1, down))
        bar, text = _bar(60.0, shrink * factor, "px")
        found.append(FormatPlot(name, width, height, vectors, bar, text, factor, grid))
    return found


def _histogram(solution: BlockSolution) -> Histogram:
    """Histogram of the normalised residuals of image positions that others check."""
    statistic = solution.adjustment.statistics[0]
    used = (solution.adjustment.state.weights[0] > 0.0) & statistic.checked
    share = np.diagonal(statistic.share[used], axis1=1, axis2=2)
    # Below a hundredth the residual is rounding, and nothing is known of the error.
    known = share > 0.01
    values = (statistic.residuals[used][known]) / np.sqrt(share[known])
    if not len(values):
        return Histogram()
    counts, _ = np.histogram(values, BINS)
    wide, step = 400.0 / (len(BINS) - 1), BINS[1] - BINS[0]
    expected = len(values) * step * norm.pdf(np.linspace(BINS[0], BINS[-1], 101))
    tallest = max(float(counts.max()), float(expected.max()))
    bars = [(k * wide + 0.5, 230.0 - 220.0 * n / tallest, wide - 1.0, 220.0 * n / tallest)
            for k, n in enumerate(counts.tolist()) if n]  # fmt: skip
    curve = path_data(np.column_stack([np.linspace(0.0, 400.0, 101), 230.0 - 220.0 * expected / tallest]))
    within = [
        (k, 100.0 * float((np.abs(values) <= k).mean()), 100.0 * float(norm.cdf(k) - norm.cdf(-k))) for k in (1, 2, 3)
    ]
    return Histogram(bars, curve, len(values), int((np.abs(values) > BINS[-1]).sum()), within)
