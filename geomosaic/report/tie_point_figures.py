"""Figures of tie points as plain values: graph and matrix of the images, rays of the points, matches over the images.

Everything is drawn without a script: a pair that is asked for is the target of a link, and style sheets show it alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import shortest_path

from geomosaic.errors import GeomosaicError
from geomosaic.raster.info import open_raster
from geomosaic.raster.pictures import jpeg_bytes, png_bytes, preview
from geomosaic.report.figures import data_uri
from geomosaic.report.tied_images import TiedImages
from geomosaic.types import FloatArray, IntArray

# Width of the graph, and side of the matrix.
WIDTH, SIDE = 1100.0, 620.0
# Edges that the graph shows, each image's strongest first, and images whose names it shows.
MOST_EDGES, NAMED = 4000, 60
# Images up to which each cell of the matrix is a link; above, the matrix is a picture.
LINKED = 90
# Images above which nothing lays out a graph of which no place is known: it takes the cube of their number.
LAID_OUT = 1200
# Points in common from which on, and the colour of a pair.
CLASSES = ((0, "#d3261b"), (1, "#b98b73"), (30, "#e0a030"), (100, "#5aa9b8"), (300, "#1f6f8b"), (1000, "#12303f"))
# Bytes of all pictures of images in a page, of a pixel of them in the mean, and their longer sides at most and least.
PICTURES, PER_PIXEL = 8_000_000, 0.4
LARGEST, SMALLEST, QUALITY = 720, 96, 70
# Pixels of an image without overviews above which reading it for a picture of it takes too long.
TOO_LARGE = 150_000_000
# Pairs that are drawn, lines of all of them, and of one at most and at least.
MOST_PAIRS, MOST_LINES = 20_000, 150_000
LINES = 10, 160
# Longer side of an image beside its partner, in units of the picture, and the gap between the two.
SHOWN, GAP = 540.0, 20.0
HUES = ("#ffd23f", "#3fd0ff", "#ff7ac6", "#8dff6a")


@dataclass(frozen=True)
class Drawing:
    """Matches of two images: key of the pair, numbers, points in common and SVG paths of lines by colour."""

    key: str
    one: int
    other: int
    count: int
    shown: int
    width: float
    height: float
    lines: list[tuple[str, str]]
    left_out: str


@dataclass(frozen=True)
class Picture:
    """Image in a page: width and height in units of the picture, and its data URI; empty where it has none."""

    width: float
    height: float
    data: str


@dataclass(frozen=True)
class TieFigures:
    """All figures of tie points.

    Attributes
    ----------
    graph_height : float
        0 where there is no graph.
    nodes : list of (float, float, str, bool)
        x, y, name, and whether the image is held weakly.
    edges : list of (str, str, str, int)
        Words, colour, SVG path and number of pairs of each class.
    placed : bool
        Whether nodes lie where the cameras were; else where the numbers of common points put them.
    named : bool
    cells : list of (float, float, str, str, str)
        Place in the matrix, colour, key and words of each pair.
    cell : float
    matrix : str
        The matrix as a data URI, where it has too many cells for links.
    bars : list of (float, float, float, float, str, int)
        x, y, width, height, rays and number of points, in a picture of 400 × 230.
    pictures : list of Picture
    drawings : list of Drawing
    partners : mapping of str to list of (str, str, int)
        Of each image: key of the pair, name of the partner, points in common, most first.
    """

    graph_height: float
    nodes: list[tuple[float, float, str, bool]]
    edges: list[tuple[str, str, str, int]]
    placed: bool
    named: bool
    cells: list[tuple[float, float, str, str, str]]
    cell: float
    matrix: str
    bars: list[tuple[float, float, float, float, str, int]]
    pictures: list[Picture]
    drawings: list[Drawing]
    partners: Mapping[str, list[tuple[str, str, int]]]


def tie_figures(tied: TiedImages, facts: Mapping[str, Any], drawn: bool = True) -> TieFigures:
    """Figures of tie points.

    Parameters
    ----------
    tied : TiedImages
    facts : mapping
        `geomosaic.report.tied_images.tie_facts`.
    drawn : bool
        Whether matches are drawn over the images, which makes a page large.
    """
    weak = {each["name"] for each in facts["images"] if each["weak"]}
    height, xy, placed = _layout(tied)
    nodes = [
        (float(x), float(y), name, name in weak) for name, (x, y) in zip(tied.names, xy.tolist(), strict=True)
    ] if height else []  # fmt: skip
    pictures = _pictures(tied) if drawn else []
    drawings = _drawings(tied, pictures) if drawn else []
    keys = {each.key for each in drawings}
    cell, cells, matrix = _matrix(tied, keys)
    return TieFigures(
        height, nodes, _edges(tied, xy) if height else [], placed, len(tied.names) <= NAMED, cells, cell, matrix,
        _bars(facts["rays"]), pictures, drawings, _partners(tied, keys),
    )  # fmt: skip


def _key_of(one: int, other: int) -> str:
    """Name of a pair in links of a page."""
    return f"p{one}-{other}"


def _layout(tied: TiedImages) -> tuple[float, FloatArray, bool]:
    """Height of the graph, places (M, 2) of its nodes, and whether they are those of cameras."""
    places, placed = tied.places, bool(np.isfinite(tied.places).all())
    if not placed and len(tied.names) > LAID_OUT:
        return 0.0, np.zeros((len(tied.names), 2)), False
    if not placed:
        places = _by_common_points(tied)
    low, high = places.min(axis=0), places.max(axis=0)
    extent = np.maximum(high - low, 1e-9 + 0.02 * float(np.max(high - low)))
    scale = min(0.88 * WIDTH / extent[0], 640.0 / extent[1])
    height = float(extent[1] * scale) + 90.0
    xy: FloatArray = (places - (low + high) / 2.0) * [scale, -scale] + [WIDTH / 2.0, height / 2.0]
    return height, xy, placed


def _by_common_points(tied: TiedImages) -> FloatArray:
    """Places (M, 2) such that images with many points in common are near each other: classical scaling of the shortest
    ways through the graph (Torgerson, 1952), whose edges are the shorter the more points both images show.
    """
    count = len(tied.names)
    one, other, shared = tied.pairs.T
    graph = sparse.coo_array((1.0 / np.sqrt(np.maximum(shared, 0.1)), (one, other)), shape=(count, count))
    apart = shortest_path(graph.tocsr(), directed=False)
    known = np.isfinite(apart)
    apart[~known] = 1.3 * float(apart[known].max(initial=0.0)) or 1.0
    np.fill_diagonal(apart, 0.0)
    middle = np.eye(count) - 1.0 / count
    values, vectors = np.linalg.eigh(-0.5 * middle @ apart**2 @ middle)
    found: FloatArray = vectors[:, -2:][:, ::-1] * np.sqrt(np.maximum(values[-2:][::-1], 0.0))
    return found if found.shape[1] == 2 else np.column_stack([found, np.zeros(count)])


def _edges(tied: TiedImages, xy: FloatArray) -> list[tuple[str, str, str, int]]:
    """Edges of the graph by classes of their points in common, those with most drawn last."""
    pairs = tied.pairs[_strongest(tied.pairs, MOST_EDGES)]
    limits, found = [low for low, _ in CLASSES], []
    for (low, colour), high in zip(CLASSES, [*limits[1:], np.inf], strict=True):
        mine = pairs[(pairs[:, 2] >= low) & (pairs[:, 2] < high)]
        if len(mine):
            words = f"{low} to {high - 1:g}" if high < np.inf else f"{low} or more"
            words = words if low else "all left out"
            ends = np.hstack([xy[mine[:, 0]], xy[mine[:, 1]]])
            path = "".join(f"M{a:.0f} {b:.0f}L{c:.0f} {d:.0f}" for a, b, c, d in ends.tolist())
            found.append((words, colour, path, len(mine)))
    return found


def _strongest(pairs: IntArray, most: int) -> IntArray:
    """Rows of pairs, at most so many: of each image the strongest, then the second, and so on."""
    if len(pairs) <= most:
        return np.arange(len(pairs))
    ends, row = pairs[:, :2].ravel(), np.repeat(np.arange(len(pairs)), 2)
    order = np.lexsort((-pairs[row, 2], ends))
    starts = np.flatnonzero(np.diff(ends[order], prepend=-1))
    rank = np.arange(len(order)) - np.repeat(starts, np.diff(np.append(starts, len(order))))
    best = np.full(len(pairs), len(order))
    np.minimum.at(best, row[order], rank)
    return np.sort(np.lexsort((-pairs[:, 2], best))[:most])


def _matrix(tied: TiedImages, keys: set[str]) -> tuple[float, list[tuple[float, float, str, str, str]], str]:
    """Matrix of the images: side of a cell and its cells, or a picture where they are too many."""
    count = len(tied.names)
    colour_of = np.searchsorted([low for low, _ in CLASSES], tied.pairs[:, 2], side="right") - 1
    cell = SIDE / max(count, 1)
    if count <= LINKED:
        cells = []
        for (one, other, shared), colour in zip(tied.pairs.tolist(), colour_of.tolist(), strict=True):
            key = _key_of(one, other) if _key_of(one, other) in keys else ""
            words = f"{tied.names[one]} and {tied.names[other]}: {shared}"
            cells += [(c * cell, r * cell, CLASSES[colour][1], key, words) for c, r in ((other, one), (one, other))]
        return cell, cells, ""
    by = -(-count // int(SIDE))
    best = np.full((-(-count // by),) * 2, -1)
    for a, b in ((0, 1), (1, 0)):
        np.maximum.at(best, (tied.pairs[:, a] // by, tied.pairs[:, b] // by), colour_of)
    colours = np.array([*(tuple(bytes.fromhex(colour[1:])) for _, colour in CLASSES), (251, 252, 253)], dtype=np.uint8)
    return cell, [], data_uri(png_bytes(colours[best]))


def _bars(rays: Mapping[str, int]) -> list[tuple[float, float, float, float, str, int]]:
    """Bars of the histogram of rays; those above eleven are one."""
    numbers = {int(n): count for n, count in rays.items()}
    last = min(max(numbers, default=2), 12)
    counts = [numbers.get(n, 0) for n in range(2, last)]
    counts.append(sum(count for n, count in numbers.items() if n >= last))
    wide, most = min(400.0 / len(counts), 60.0), max(*counts, 1, 0)
    return [
        (k * wide + 0.1 * wide, 200.0 - 180.0 * count / most, 0.8 * wide, 180.0 * count / most,
         f"{k + 2}{'+' if k + 2 == 12 else ''}", count)
        for k, count in enumerate(counts)
    ]  # fmt: skip


def _pictures(tied: TiedImages) -> list[Picture]:
    """Images as small JPEGs, as large as the bytes of all allow; without data where they are exhausted."""
    wide = math.sqrt(PICTURES / max(len(tied.names), 1) / PER_PIXEL / 0.7)
    largest, left, found = int(min(wide, LARGEST)), PICTURES, []
    for path, size in zip(tied.paths, tied.sizes.tolist(), strict=True):
        data = _picture(path, largest) if largest >= SMALLEST and left > 0 else ""
        data = data if len(data) <= left else ""
        left -= len(data)
        shrink = SHOWN / max(*size, 1)
        found.append(Picture(size[0] * shrink, size[1] * shrink, data))
    return found


def _picture(path: str, largest: int) -> str:
    """Small JPEG as a data URI; empty of an image that is not there, or takes long to read."""
    try:
        with open_raster(path) as dataset:
            if dataset.width * dataset.height > TOO_LARGE and not dataset.overviews(1):
                return ""
        return data_uri(jpeg_bytes(*preview(path, largest), QUALITY), "image/jpeg")
    except (GeomosaicError, OSError):
        return ""


def _drawings(tied: TiedImages, pictures: list[Picture]) -> list[Drawing]:
    """Matches of pairs as lines from one image to the other."""
    rows = _strongest(tied.pairs, MOST_PAIRS)
    least, most = LINES
    most = int(np.clip(MOST_LINES // max(len(rows), 1), least, most))
    # Rays of each image in order of their points: those of two are joined by a merge.
    order = np.lexsort((tied.point, tied.image))
    part = np.split(order, np.searchsorted(tied.image[order], np.arange(1, len(tied.names))))
    found = []
    for one, other, count in tied.pairs[rows].tolist():
        _, a, b = np.intersect1d(tied.point[part[one]], tied.point[part[other]], return_indices=True)
        first, second = part[one][a], part[other][b]
        bad = tied.left_out[first] | tied.left_out[second]
        left, right = pictures[one], pictures[other]
        ends = np.hstack([
            tied.colrow[first] * (SHOWN / tied.sizes[one].max()),
            tied.colrow[second] * (SHOWN / tied.sizes[other].max()) + [left.width + GAP, 0.0],
        ])  # fmt: skip
        good = np.flatnonzero(~bad)
        # From top to bottom of the image, so that lines are spread over it.
        good = good[np.argsort(ends[good, 1], kind="stable")]
        kept = good[np.unique(np.linspace(0, len(good) - 1, min(most, len(good))).astype(np.int64))] if count else good
        lines = [(hue, _lines(ends[kept[k :: len(HUES)]])) for k, hue in enumerate(HUES)]
        found.append(
            Drawing(_key_of(one, other), one, other, count, len(kept), left.width + GAP + right.width,
                    max(left.height, right.height), lines, _lines(ends[bad][:most]))
        )  # fmt: skip
    return found


def _lines(ends: FloatArray) -> str:
    """SVG path of lines (N, 4)."""
    return "".join(f"M{a:.0f} {b:.0f}L{c:.0f} {d:.0f}" for a, b, c, d in ends.tolist())


def _partners(tied: TiedImages, keys: set[str]) -> dict[str, list[tuple[str, str, int]]]:
    """Images that share points with each, most first."""
    found: dict[str, list[tuple[str, str, int]]] = {name: [] for name in tied.names}
    for one, other, shared in tied.pairs[np.argsort(-tied.pairs[:, 2], kind="stable")].tolist():
        key = _key_of(one, other) if _key_of(one, other) in keys else ""
        found[tied.names[one]].append((key, tied.names[other], shared))
        found[tied.names[other]].append((key, tied.names[one], shared))
    return found
