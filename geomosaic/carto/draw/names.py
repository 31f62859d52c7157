"""Names and heights on the map: placed without collisions, drawn with their halo."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from geomosaic.carto.contours import Contour
from geomosaic.carto.contrast import halo_of
from geomosaic.carto.draw.canvas import Canvas, text_size
from geomosaic.carto.layout import ContoursPart
from geomosaic.carto.overlay import Name, Overlay, parts_of
from geomosaic.carto.page import Page
from geomosaic.carto.place import Placed, Placer, Spot, along_line, around_point
from geomosaic.carto.style import Label
from geomosaic.types import FloatArray

AGAIN = 80.0
"""Least distance in mm at which the same name of the same layer is written again along lines or in areas."""


def place_names(page: Page, layers: Sequence[Overlay], placer: Placer) -> tuple[list[tuple[Placed, Label]], int]:
    """Find places for the names of all layers, points first, then lines, then areas.

    Returns
    -------
    placed : list of (Placed, Label)
    left_out : int
        Names for which there was no room.
    """
    for layer in layers:
        for group in layer.groups:
            if group.symbol.marker is not None:
                for point in parts_of(group.geometries, "point"):
                    x, y = page.to_page(np.array([(point.x, point.y)]))[0]
                    placer.block(float(x), float(y), group.symbol.marker.size)
    found: list[tuple[Placed, Label]] = []
    left_out = 0
    for kind in ("point", "line", "polygon"):
        for layer in layers:
            label = layer.style.label
            if label is None:
                continue
            radius = (
                max((g.symbol.marker.size / 2 for g in layer.groups if g.symbol.marker), default=0.0) + placer.gap + 0.2
            )
            for name in _merged(layer.names) if kind == "line" else layer.names:
                spots = _spots(page, name, kind, label, radius)
                if spots is None or (kind != "point" and _said(found, name.text, label, spots)):
                    continue
                width, height = text_size(name.text, label.size, label.bold, label.italic)
                placed = placer.place(name.text, width, height, spots)
                left_out += placed is None
                if placed is not None:
                    found.append((placed, label))
    return found, left_out


def _merged(names: Sequence[Name]) -> list[Name]:
    """Join lines of one name where they meet, the longest first: a street is often stored in pieces."""
    import shapely

    together: dict[str, list[Any]] = {}
    for name in names:
        for part in parts_of([name.geometry], "line"):
            together.setdefault(name.text, []).append(part)
    joined = []
    for text, parts in together.items():
        merged = shapely.line_merge(shapely.MultiLineString(parts)) if len(parts) > 1 else parts[0]
        joined += [Name(text, part) for part in parts_of([merged], "line")]
    return sorted(joined, key=lambda item: -item.geometry.length)


def _said(found: list[tuple[Placed, Label]], text: str, label: Label, spots: list[Spot]) -> bool:
    """Whether the same name stands near already, or the line is too short to bear it."""
    if not spots:
        return True
    return any(
        p.text == text and lab is label and math.hypot(p.spot.x - spots[0].x, p.spot.y - spots[0].y) < AGAIN
        for p, lab in found
    )


def _spots(page: Page, name: Name, kind: str, label: Label, radius: float) -> list[Spot] | None:
    """Places for a name, best first; None where the geometry is of another kind."""
    parts = parts_of([name.geometry], kind)
    if not parts:
        return None
    width, height = text_size(name.text, label.size, label.bold, label.italic)
    if kind == "point":
        x, y = page.to_page(np.array([(parts[0].x, parts[0].y)]))[0]
        return around_point(float(x), float(y), width, height, radius)
    if kind == "line":
        return along_line(page.to_page(np.asarray(parts[0].coords)), width, ends=1.0)
    import shapely

    largest = shapely.intersection(max(parts, key=lambda p: p.area), shapely.box(*page.bounds))
    if largest.is_empty:
        return []
    middles = [largest.centroid, largest.representative_point()]
    middle = next((m for m in middles if largest.contains(m)), middles[-1])
    x, y = page.to_page(np.array([(middle.x, middle.y)]))[0]
    step = 1.2 * height
    return [Spot(float(x), float(y) + k * step) for k in (0, 1, -1, 2, -2)]


def draw_names(canvas: Canvas, placed: Sequence[tuple[Placed, Label]]) -> None:
    """Halos and texts."""
    for item, label in placed:
        canvas.centred(
            item.spot.x, item.spot.y, item.text, label.size, angle=item.spot.angle, color=label.color,
            bold=label.bold, italic=label.italic, halo=label.halo, halo_width=label.halo_width,
        )  # fmt: skip


def place_heights(page: Page, contours: Sequence[Contour], part: ContoursPart, placer: Placer) -> list[Placed]:
    """Heights on contours, tops uphill: main contours every 120 mm, others where they are the only ones.

    Text that can be read from below is preferred, text on its head is kept where a contour offers nothing else.
    """
    size = part.size
    wanted = [c for c in contours if c.index] or list(contours)
    digits = _digits([c.height for c in contours])
    found: list[Placed] = []
    for contour in sorted(wanted, key=lambda c: -len(c.xy)):
        text = f"{contour.height:.{digits}f}".replace("-", "−")
        width, height = text_size(text, size, True)
        path = page.to_page(contour.xy)
        length = float(np.hypot(*np.diff(path, axis=0).T).sum())
        for piece in _pieces(path, max(1, int(length / 120.0))):
            spots = [uphill(spot, piece) for spot in along_line(piece, width, bend=15.0, ends=1.0)]
            spots.sort(key=lambda spot: math.cos(math.radians(spot.angle)) < -0.17)  # stable: best first stays
            placed = placer.place(text, width, height, spots)
            if placed is not None:
                found.append(placed)
    return found


def _digits(heights: Sequence[float]) -> int:
    return next((n for n in range(4) if all(abs(h - round(h, n)) < 1e-6 for h in heights)), 3)


def _pieces(path: FloatArray, count: int) -> list[FloatArray]:
    cuts = np.linspace(0, len(path) - 1, count + 1).astype(int)
    return [path[a : b + 1] for a, b in itertools.pairwise(cuts) if b - a >= 1]


def uphill(spot: Spot, path: FloatArray) -> Spot:
    """Turn a text on a contour so that its top is uphill, which is to the left of the contour's course.

    Parameters
    ----------
    spot : Spot
        As `along_line` gives it.
    path : array (N, 2)
        The contour on the page, the ground rising to its left.
    """
    middles = (path[:-1] + path[1:]) / 2
    nearest = int(np.argmin(np.hypot(middles[:, 0] - spot.x, middles[:, 1] - spot.y)))
    course = path[nearest + 1] - path[nearest]
    a = math.radians(spot.angle)
    along = course[0] * math.cos(a) + course[1] * math.sin(a)
    return spot if along >= 0 else Spot(spot.x, spot.y, spot.angle + 180.0 if spot.angle <= 0 else spot.angle - 180.0)


def draw_heights(canvas: Canvas, placed: Sequence[Placed], part: ContoursPart) -> None:
    """Heights with a halo that opens their contour."""
    for item in placed:
        canvas.centred(
            item.spot.x, item.spot.y, item.text, part.size, angle=item.spot.angle, color=part.color,
            halo=halo_of(part.color), halo_width=0.35, bold=True,
        )  # fmt: skip
