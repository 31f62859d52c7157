"""Control diagnostics before any fit: findings, contradicting and repeated points."""

from __future__ import annotations

import numpy as np

from geomosaic.control.coordinate_diagnostics import mirrored, misplaced
from geomosaic.control.distribution import collinear, coverage, few_points, outside_image
from geomosaic.control.findings import SEVERITIES, Advice, plane_coordinates
from geomosaic.control.points import ControlPoints
from geomosaic.types import FloatArray

SAME_POINT = 2.0
"""Pixels, or as much on the ground, within which two places are one: about what a hand setting a mark misses by."""
DISTINCT = 5.0
"""Pixels, or as much on the ground, beyond which they are surely two."""
REPEATED = 0.05
"""Pixels, or as much on the ground, within which a point is the same measurement again."""
_MOST = 300


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


def contradictions(control: ControlPoints) -> list[Advice]:
    """Findings on contradicting pairs: one image point with two ground points, the reverse, and repeated points."""
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
            found.append(Advice("one-place-two-grounds", "error", what, names, "correct or disable one of them"))
        elif apart <= SAME_POINT and image > DISTINCT:
            what = f"{two} are one place on the ground and lie {image:.0f} pixels apart in the image"
            found.append(Advice("one-ground-two-places", "error", what, names, "correct or disable one of them"))
        elif image <= REPEATED and apart <= REPEATED:
            what = f"{two} are the same measurement: it counts twice"
            found.append(Advice("repeated", "warning", what, names, "leave one of them out"))
    return found


def _close(places: FloatArray) -> list[tuple[int, int]]:
    """Pairs of places (N, 2) within SAME of each other: those whose first coordinates are that near, looked through."""
    order = np.argsort(places[:, 0], kind="stable")
    sorted_ = places[order]
    count = np.searchsorted(sorted_[:, 0], sorted_[:, 0] + SAME_POINT, side="right") - np.arange(len(places)) - 1
    first = np.repeat(np.arange(len(places)), count)
    second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(count) - count, count)
    near = np.hypot(*(sorted_[first] - sorted_[second]).T) <= SAME_POINT
    pairs = np.sort(order[np.column_stack([first[near], second[near]])], axis=1)
    return [(int(a), int(b)) for a, b in pairs]


def diagnose(
    control: ControlPoints,
    *,
    kind: str = "affine",
    order: int = 1,
    size: tuple[int, int] | None = None,
    near: tuple[float, float] | None = None,
) -> tuple[Advice, ...]:
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
    tuple of Advice
        Errors first.

    Raises
    ------
    InputError
        There is no such fit.
    """
    enabled = control.select(control.enabled)
    used = enabled.of_role("control")
    found = few_points(used, kind, order)
    beyond = outside_image(enabled, size) if size else []
    places = misplaced(enabled, near)
    found += beyond + places + contradictions(enabled)
    if not any(advice.severity == "error" for advice in beyond + places if _most(advice, enabled)):
        inside = used.select(
            ~np.isin(np.array(used.names, dtype=object), [n for a in beyond + places for n in a.points])
        )
        line = collinear(inside, kind)
        found += line
        if not line:
            found += mirrored(inside)
            if size and len(inside) > 2:
                found += coverage(inside, size)
    return tuple(sorted(found, key=lambda advice: SEVERITIES.index(advice.severity)))


def _most(advice: Advice, control: ControlPoints) -> bool:
    return len(advice.points) > 0.5 * len(control) or advice.code in ("negative-rows", "swapped-columns-rows")
