"""Control diagnostics before any fit: distribution in the image, contradicting and repeated points."""

from __future__ import annotations

import re

import numpy as np

from geomosaic.control.coordinate_diagnostics import (
    SEVERITIES,
    Diagnostic,
    is_mirrored,
    mirrored,
    misplaced,
    plane_coordinates,
    point_names,
)
from geomosaic.control.points import ControlPoints
from geomosaic.errors import InputError, counted, did_you_mean, listed
from geomosaic.estimation.expected_errors import convex_hull
from geomosaic.types import BoolArray, FloatArray, IntArray

# Points that determine a fit.
NEEDED = {"conformal": 2, "affine": 3, "projective": 4, "tps": 3}
# Across over along, root mean squares, below which points count as lying on a line.
LINE_RATIO = 0.05
# Pixels across the line (root mean square) that cannot be kept from errors of measurement.
LINE_NOISE = 1.0
# Share of the image inside the hull of the points, below which they are in one place.
CLUSTER = 0.05
# The same, below which most of the image is extrapolated.
HULL = 0.4
# Share of the diagonal within which a corner needs a point.
CORNER = 0.4


def points_needed(kind: str, order: int = 1) -> int:
    """Number of points that determine a model: 'conformal', 'affine', 'projective', 'tps', 'polynomial' or 'poly3'.

    Parameters
    ----------
    kind : str
        'conformal', 'affine', 'projective', 'polynomial' or 'tps'.
    order : int
        Of a polynomial.
    """
    match = re.fullmatch(r"poly(?:nomial)?([1-9])?", kind)
    if match:
        order = int(match[1] or order)
        return (order + 1) * (order + 2) // 2
    if kind not in NEEDED:
        known = [*NEEDED, "polynomial"]
        raise InputError(
            f"there is no fit '{kind}'", hint=did_you_mean(kind, known) or f"choose one of {', '.join(known)}"
        )
    return NEEDED[kind]


def _few_points(control: ControlPoints, kind: str, order: int = 1) -> list[Diagnostic]:
    """Findings on the number of points: too few for the model ('few-points'), or just enough ('no-redundancy')."""
    least, count = points_needed(kind, order), len(np.unique(control.colrow, axis=0))
    name = f"{kind} of order {order}" if kind == "polynomial" else kind
    if count < least:
        what = f"{counted(count, 'place')}, and a fit ({name}) needs {least}"
        return [Diagnostic("few-points", "error", what, (), f"measure {least - count} more, better twice as many")]
    if count == least:
        what = f"{count} places just determine the fit ({name}) and leave none to check it by: residuals are 0"
        return [
            Diagnostic("no-redundancy", "warning", what, (), "measure more points, or choose a fit of fewer parameters")
        ]
    return []


def _elongation(points: FloatArray) -> tuple[float, float]:
    """RMS extents of points (N, 2) along and across their principal axis, in their unit."""
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
    return float(values[0]), float(values[1])


def collinear(control: ControlPoints, kind: str) -> list[Diagnostic]:
    """Finding that points are collinear, in the image or on the ground; for 'projective' also all but one of them.

    Parameters
    ----------
    control : ControlPoints
    kind : str
        'conformal', 'affine', 'projective', 'polynomial' or 'tps'.
    """
    # A conformal transformation is determined by two points, so there it is a warning only.
    count = len(control)
    if count < 3:
        return []
    ground = plane_coordinates(control)
    subsets = [np.arange(count)]
    if kind == "projective" and 4 <= count <= 50:
        subsets += [np.delete(subsets[0], i) for i in range(count)]
    for chosen in subsets:
        along, across = _elongation(control.colrow[chosen])
        far, wide = _elongation(ground[chosen])
        if across >= LINE_RATIO * along and wide >= LINE_RATIO * far:
            continue
        names = point_names(control, chosen)
        hopeless = across <= LINE_NOISE or across < 1e-3 * along or wide < 1e-3 * far
        who = (
            "the points lie"
            if len(chosen) == count
            else f"all points but {point_names(control, [_left(chosen, count)])[0]} lie"
        )
        what = f"{who} on a line{'' if hopeless else ', nearly'}: {across:.1f} px across, {along:.0f} px along (RMS)"
        if kind == "conformal":
            what += "; a conformal fit is determined by them, and nothing checks it beside the line"
            return [Diagnostic("collinear", "warning", what, names, "measure points on both sides of the line")]
        hint = "measure points on both sides of the line, or choose a conformal fit"
        return [Diagnostic("collinear", "error" if hopeless else "warning", what, names, hint)]
    return []


def _left(chosen: np.ndarray[tuple[int], np.dtype[np.int64]], count: int) -> int:
    return int(np.setdiff1d(np.arange(count), chosen)[0])


def _outside_image(control: ControlPoints, size: tuple[int, int]) -> list[Diagnostic]:
    """Findings on points beyond the edges of the image, with the likely cause where most are."""
    # Mirrored ground alone may be right, and so may a point beyond the edge; where exchanging columns and rows corrects
    # both, they are taken as exchanged.
    colrow = control.colrow
    limit = np.array(size, dtype=np.float64)
    out: BoolArray = np.any((colrow < 0) | (colrow > limit), axis=1)
    if not out.any():
        return []
    names = point_names(control, out)
    swapped, turned = colrow[:, ::-1], colrow * [1.0, -1.0]
    most = out.mean() >= 0.5
    if most and ((turned >= 0) & (turned <= limit)).all():
        what, hint = "rows are negative: they count upwards", "change the sign of the rows"
        return [Diagnostic("negative-rows", "error", what, names, hint)]
    if ((swapped >= 0) & (swapped <= limit)).all() and (most or is_mirrored(control)):
        who = "all points lie" if len(names) == len(control) else _lie(len(names), len(control))
        what = f"{who} outside the image of {size[0]} × {size[1]} pixels, and all inside with col and row exchanged"
        if is_mirrored(control):
            what += ", which also turns the mirrored ground the right way round"
        return [Diagnostic("swapped-columns-rows", "error", what, names, "exchange the columns 'col' and 'row'")]
    who = _lie(len(names), len(control))
    what = f"{who} outside the image of {size[0]} × {size[1]} pixels: {listed(names)}"
    reach = colrow.max(axis=0)
    hint = f"points reach column {reach[0]:g}, row {reach[1]:g}: is it the right image, at the size it was measured in?"
    return [Diagnostic("outside-image", "error" if most else "warning", what, names, hint)]


def _lie(some: int, count: int) -> str:
    return f"{some} of {count} points lie{'s' * (some == 1)}"


def hull_area(points: FloatArray) -> float:
    """Area of the convex hull of points (N, 2), in their unit squared.

    Parameters
    ----------
    points : array (N, 2)
    """
    x, y = points[convex_hull(points)].T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def _coverage(control: ControlPoints, size: tuple[int, int]) -> list[Diagnostic]:
    """Findings on coverage: points in one cluster, corners without a point, an image mostly outside their hull."""
    width, height = size
    points = np.clip(control.colrow, 0.0, size)
    share = hull_area(points) / (width * height)
    if share < CLUSTER:
        what = f"the points surround {share:.1%} of the image; the rest is extrapolated"
        return [Diagnostic("clustered", "warning", what, control.names, "measure points near all corners of the image")]
    found = []
    corners = {
        "upper left": (0, 0),
        "upper right": (width, 0),
        "lower right": (width, height),
        "lower left": (0, height),
    }
    reach = CORNER * np.hypot(width, height)
    empty = [name for name, at in corners.items() if np.hypot(*(points - at).T).min() > reach]
    if empty:
        what = f"no point is near the {', '.join(empty)} corner{'s' * (len(empty) > 1)} of the image"
        found.append(
            Diagnostic("empty-corner", "warning", what, (), "measure one there, or use the image only between points")
        )
    if share < HULL:
        what = f"{1 - share:.0%} of the image lies outside the hull of the points and is extrapolated"
        hint = "measure points nearer to the edges; do not use a polynomial of order above 1 or a spline there"
        found.append(Diagnostic("extrapolation", "warning", what, (), hint))
    return found


# Pixels, or as much on the ground, within which two places are one: about what a hand setting a mark misses by.
SAME_POINT = 2.0
# Pixels, or as much on the ground, beyond which they are surely two.
DISTINCT = 5.0
# Pixels, or as much on the ground, within which a point is the same measurement again.
REPEATED = 0.05
_MOST = 300
_NEIGHBOURS = 16  # of a place that are looked at, in its own row of squares and in the next
_MOST_LISTED = 10


def pixel_on_ground(colrow: FloatArray, ground: FloatArray) -> float:
    """Length of a pixel on the ground: median over pairs of points, robust to blunders in 25 % of the points.

    Parameters
    ----------
    colrow : array (N, 2)
        Pixels.
    ground : array (N, 2)
        Units of the map.
    """
    step = -(-len(colrow) // _MOST)
    colrow, ground = colrow[::step], ground[::step]
    first, second = np.triu_indices(len(colrow), 1)
    image = np.hypot(*(colrow[first] - colrow[second]).T)
    apart = np.hypot(*(ground[first] - ground[second]).T)
    kept = image > SAME_POINT
    return float(np.median(apart[kept] / image[kept])) if kept.any() else 0.0


def contradictions(control: ControlPoints) -> list[Diagnostic]:
    """Findings on contradicting pairs: one image point with two ground points, the reverse, and repeated points.

    Parameters
    ----------
    control : ControlPoints
    """
    if len(control) < 2:
        return []
    ground = plane_coordinates(control)
    pixel = pixel_on_ground(control.colrow, ground)
    if pixel <= 0.0:
        return []
    pixels = ground / pixel
    close = set(_close(control.colrow)) | set(_close(pixels))
    found = []
    for first, second in sorted(close):
        image = float(np.hypot(*(control.colrow[first] - control.colrow[second])))
        apart = float(np.hypot(*(pixels[first] - pixels[second])))
        names = control.names[first], control.names[second]
        two = f"points {names[0]} ({control.origins[first]}) and {names[1]} ({control.origins[second]})"
        if image <= SAME_POINT and apart > DISTINCT:
            what = f"{two} are one place in the image and lie {apart:.0f} pixels apart on the ground"
            found.append(Diagnostic("one-place-two-grounds", "error", what, names, "correct or disable one of them"))
        elif apart <= SAME_POINT and image > DISTINCT:
            what = f"{two} are one place on the ground and lie {image:.0f} pixels apart in the image"
            found.append(Diagnostic("one-ground-two-places", "error", what, names, "correct or disable one of them"))
        elif image <= REPEATED and apart <= REPEATED:
            what = f"{two} are the same measurement: it counts twice"
            found.append(Diagnostic("repeated", "warning", what, names, "leave one of them out"))
    return _summarised(found)


def _summarised(found: list[Diagnostic]) -> list[Diagnostic]:
    """Findings, of each code the first `_MOST_LISTED`, and one that counts the rest."""
    kept = []
    for code in dict.fromkeys(each.code for each in found):
        same = [each for each in found if each.code == code]
        kept += same[:_MOST_LISTED]
        if rest := same[_MOST_LISTED:]:
            names = tuple(dict.fromkeys(name for each in rest for name in each.points))
            what = f"so are {counted(len(rest), 'further pair')} of points: {listed(names)}"
            kept.append(Diagnostic(code, rest[0].severity, what, names, rest[0].hint))
    return kept


def _close(places: FloatArray) -> list[tuple[int, int]]:
    """Pairs of points within `SAME_POINT` of each other; of a crowd, a few for each of the places (N, 2)."""
    if not len(places):
        return []
    # A tree of places would load SciPy, which takes as long as all the rest of a small job.
    distinct, point, place = np.unique(places, axis=0, return_index=True, return_inverse=True)
    # Points of one place follow each other in a chain: one pair less than points, however many there are.
    chain = np.argsort(place, kind="stable")
    same = place[chain][1:] == place[chain][:-1]
    pairs = [np.column_stack([chain[:-1][same], chain[1:][same]])]
    col, row = (_adjacent(np.floor(axis / SAME_POINT)) for axis in distinct.T)
    stride = col.max() + 2
    order = np.argsort(row * stride + col, kind="stable")
    square, numbers = (row * stride + col)[order], np.arange(len(order))
    # Squares row by row: what may be near a place follows it in its own and the next one, or in three of the next row.
    for low, high in ((0, 1), (stride - 1, stride + 1)):
        start = np.maximum(np.searchsorted(square, square + low), numbers + 1)
        count = np.clip(np.searchsorted(square, square + high, side="right") - start, 0, _NEIGHBOURS)
        first = np.repeat(numbers, count)
        second = np.arange(len(first)) + np.repeat(start - np.cumsum(count) + count, count)
        apart = distinct[order[first]] - distinct[order[second]]
        near = np.hypot(apart[:, 0], apart[:, 1]) <= SAME_POINT
        pairs.append(point[order[np.column_stack([first[near], second[near]])]])
    return [(a, b) for a, b in np.sort(np.vstack(pairs), axis=1).tolist()]


def _adjacent(cells: FloatArray) -> IntArray:
    """Numbers of cells (N,) from 1: neighbours differ by 1, all others by 2, so that they stay small."""
    found, place = np.unique(cells, return_inverse=True)
    steps = np.minimum(np.diff(found, prepend=found[0] - 1.0), 2.0)
    numbers: IntArray = np.cumsum(steps).astype(np.int64)[place]
    return numbers


def diagnose(
    control: ControlPoints,
    *,
    kind: str = "affine",
    order: int = 1,
    size: tuple[int, int] | None = None,
    near: tuple[float, float] | None = None,
) -> tuple[Diagnostic, ...]:
    """Findings on control points before any fit; consequences of a graver fault are left out.

    Parameters
    ----------
    control : ControlPoints
        Points that are not enabled are left out. Check points are examined for their coordinates only.
    kind : str
        Model to be fitted: 'conformal', 'affine', 'projective', 'tps', 'polynomial' (with `order`), 'poly1' ...
    order : int
        Of a polynomial.
    size : tuple of int, optional
        Width and height of the image, pixels; without it nothing is said of edges and corners.
    near : tuple of float, optional
        Longitude and latitude, degrees, near the image: tells zones apart.

    Returns
    -------
    tuple of Diagnostic
        Errors first.

    Raises
    ------
    InputError
        There is no such fit.
    """
    enabled = control.select(control.enabled)
    used = enabled.of_role("control")
    found = _few_points(used, kind, order)
    beyond = _outside_image(enabled, size) if size else []
    places = misplaced(enabled, near)
    found += beyond + places + contradictions(enabled)
    if not any(finding.severity == "error" for finding in beyond + places if _most(finding, enabled)):
        inside = used.select(
            ~np.isin(np.array(used.names, dtype=object), [n for a in beyond + places for n in a.points])
        )
        line = collinear(inside, kind)
        found += line
        if not line:
            found += mirrored(inside)
            if size and len(inside) > 2:
                found += _coverage(inside, size)
    return tuple(sorted(found, key=lambda finding: SEVERITIES.index(finding.severity)))


def _most(finding: Diagnostic, control: ControlPoints) -> bool:
    return len(finding.points) > 0.5 * len(control) or finding.code in ("negative-rows", "swapped-columns-rows")
