"""What may be wrong in a network, by name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomosaic.adjust.network.findings import Label
from geomosaic.adjust.network.linear import Network
from geomosaic.adjust.network.shifts import Shifts

Doubt = tuple[str, str | None]
"""A point in a photo; None in place of the photo: its coordinates on the ground."""


def named(
    network: Network, ids: Sequence[str], images: Sequence[str], lines: Sequence[str], unknown: str
) -> tuple[Shifts, list[Label], list[Doubt]]:
    """Shifts of a network: each measurement, and given coordinates that several photos see.

    Of a point in two photos whose place nobody gave, one measurement stands for both: nothing tells which is wrong.
    Coordinates that one photo sees are not told from its measurement.

    Parameters
    ----------
    network : Network
    ids : sequence of str (S,)
        Of the points.
    images, lines : sequence of str (N,)
        Photo of each measurement; file and line, or empty.
    unknown : str
        What points without given coordinates are called.
    """
    by_point: dict[int, list[int]] = {}
    for view, point in enumerate(network.point.tolist()):
        by_point.setdefault(point, []).append(view)
    labels, doubts, chosen = list[Label](), list[Doubt](), list[int]()
    given = [p for p, seen in by_point.items() if np.isfinite(network.given_sigma[p]) and len(seen) > 1]
    for point, seen in by_point.items():
        is_control = bool(np.isfinite(network.given_sigma[point]))
        alone = len(seen) == 2 and not is_control
        for view in seen[:1] if alone else seen:
            shown = seen if alone else [view]
            where = tuple(images[v] for v in shown)
            name = f"{'control point' if is_control else unknown} '{ids[point]}' in {' and '.join(where)}"
            own = tuple(lines[v] for v in shown if lines[v])
            labels.append(Label(name, ids[point], where, own, 1.0, is_control))
            doubts.append((ids[point], images[view]))
            chosen.append(view)
    for point in given:
        first = by_point[point][0]
        pixel = float(np.abs(np.linalg.det(network.by_point[first])) ** -0.5)
        own = (lines[first],) if lines[first] else ()
        labels.append(Label(f"coordinates of control point '{ids[point]}'", ids[point], (), own, pixel, True))
        doubts.append((ids[point], None))
    return Shifts(network, np.array(chosen, dtype=np.int64), np.array(given, dtype=np.int64)), labels, doubts
