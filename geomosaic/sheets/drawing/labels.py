"""Vector layers and contours on the map, their names, heights and spot heights, placed without collisions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import shapely

from geomosaic.relief.contours import Contour
from geomosaic.relief.spot_heights import SpotHeight
from geomosaic.sheets.drawing.canvas import Canvas, SymbolLook, advances, text_size
from geomosaic.sheets.label_placement import (
    LabelPart,
    LabelPlacer,
    LabelPosition,
    PlacedLabel,
    along_curve,
    along_line,
    around_point,
    cut_evenly,
    letters_of,
)
from geomosaic.sheets.layout import ContoursPart
from geomosaic.sheets.line_patterns import pattern_places
from geomosaic.sheets.page import Box, Page
from geomosaic.sheets.pictograms import pictogram
from geomosaic.sheets.style import MARKERS, Label, Line, Marker, Symbol, halo_of, legend_line
from geomosaic.sheets.vector_layers import KINDS, LabelRequest, Overlay, parts_of
from geomosaic.types import FloatArray


def draw_overlay(canvas: Canvas, page: Page, layer: Overlay) -> None:
    """Areas first, then the casings of all lines, then the lines, so that roads join; points on top.

    Parameters
    ----------
    canvas : Canvas
    page : Page
    layer : Overlay
    """
    groups = [group for group in layer.groups if group.geometries]
    for group in groups:
        for polygon in parts_of(group.geometries, "polygon"):
            _area(canvas, _rings(page, polygon), group.symbol)
    for casing in (True, False):
        for group in groups:
            if group.symbol.line is not None:
                paths = [page.to_page(np.asarray(p.coords)) for p in parts_of(group.geometries, "line")]
                _line(canvas, paths, group.symbol.line, casing=casing)
    for group in groups:
        points = parts_of(group.geometries, "point")
        if group.symbol.marker is not None and points:
            _marker(canvas, page.to_page(np.array([(p.x, p.y) for p in points])), group.symbol.marker)


def draw_contours(canvas: Canvas, page: Page, contours: Sequence[Contour], part: ContoursPart) -> None:
    """Contours and index contours, on a faint halo: white, black below light lines.

    Parameters
    ----------
    canvas : Canvas
    page : Page
    contours : sequence of Contour, in the CRS of the map
    part : ContoursPart
    """
    paths = [[page.to_page(c.xy) for c in contours if c.index == main] for main in (False, True)]
    widths = (part.width, part.index_width)
    for lines, width in zip(paths, widths, strict=True):
        canvas.lines(lines, halo_of(part.color), width + 0.25, opacity=0.35)
    for lines, width in zip(paths, widths, strict=True):
        canvas.lines(lines, part.color, width)


def draw_swatch(canvas: Canvas, symbol: Symbol, kinds: set[str], box: Box) -> None:
    """A symbol in the legend, as what its layer has: an area, a line that bends, or a point.

    Parameters
    ----------
    canvas : Canvas
    symbol : Symbol
    kinds : set of str, of geometry
    box : Box, mm
    """
    left, bottom, right, top = box
    middle = (bottom + top) / 2
    if "polygon" in kinds and (symbol.fill or symbol.line):
        ring = np.array([(left, bottom), (right, bottom), (right, top), (left, top), (left, bottom)])
        _area(canvas, [ring], symbol)
    elif "line" in kinds and symbol.line is not None:
        path = np.array([(left, middle), (right, middle)])
        line = replace(symbol.line, pattern_interval=min(symbol.line.pattern_interval, right - left))
        if symbol.line.casing is None:  # light lines would not be seen on the paper
            _line(canvas, [path], legend_line(symbol.line.color, symbol.line.width), casing=True)
        _line(canvas, [path], line, casing=True)
        _line(canvas, [path], line, casing=False)
    if "point" in kinds and symbol.marker is not None:
        _marker(canvas, np.array([((left + right) / 2, middle)]), symbol.marker)


def kinds_of(geometries: Sequence[Any]) -> set[str]:
    """Which kinds of geometry there are.

    Parameters
    ----------
    geometries : sequence of shapely geometry
    """
    return {kind for kind in KINDS if parts_of(geometries, kind)}


def _area(canvas: Canvas, rings: Sequence[FloatArray], symbol: Symbol) -> None:
    if symbol.fill is not None:
        canvas.area(rings, symbol.fill.color, opacity=symbol.fill.opacity)
    if symbol.line is not None:
        for casing in (True, False):
            _line(canvas, rings, symbol.line, casing=casing)


def _line(canvas: Canvas, paths: Sequence[FloatArray], line: Line, *, casing: bool) -> None:
    cap = "butt" if line.dash else "round"
    if not casing:
        canvas.lines(paths, line.color, line.width, dash=line.dash, opacity=line.opacity, cap=cap)
        _pattern(canvas, paths, line, line.color, 0.0)
    elif line.casing is not None:
        canvas.lines(paths, line.casing, line.full_width, opacity=line.opacity, cap=cap)
        _pattern(canvas, paths, line, line.casing, (line.full_width - line.width) / 2)


def _pattern(canvas: Canvas, paths: Sequence[FloatArray], line: Line, color: str, seam: float) -> None:
    """Symbols along lines in a colour, `seam` mm larger on all sides."""
    if line.pattern is None or not paths:
        return
    places = [pattern_places(path, line.pattern_interval, line.pattern_size) for path in paths]
    xy, angles = (np.concatenate(parts) for parts in zip(*places, strict=True))
    look = SymbolLook(line.pattern_size, color, line.casing or "#ffffff", seam, line.opacity)
    canvas.pictograms(xy, pictogram(line.pattern), look, angles)


def _marker(canvas: Canvas, xy: FloatArray, marker: Marker) -> None:
    if marker.shape not in MARKERS:
        look = SymbolLook(marker.size, marker.color, marker.outline, marker.outline_width, marker.opacity)
        canvas.pictograms(xy, pictogram(marker.shape), look)
        return
    canvas.markers(xy, marker.shape, marker.size, marker.color, marker.outline, marker.outline_width, marker.opacity)


def _rings(page: Page, polygon: Any) -> list[FloatArray]:
    """Rings of an area on the page; holes run against the outer ring."""
    turned = shapely.normalize(polygon)
    return [page.to_page(np.asarray(ring.coords)) for ring in (turned.exterior, *turned.interiors)]


# Least distance in mm at which the same name of the same layer is written again along lines or in areas.
AGAIN = 80.0
# Length of line in mm for each time that its name is written.
LONG = 160.0


def place_names(
    page: Page, layers: Sequence[Overlay], placer: LabelPlacer
) -> tuple[list[tuple[PlacedLabel, Label]], int]:
    """Places for the names of all layers, points first, then lines, then areas.

    Parameters
    ----------
    page : Page
    layers : sequence of Overlay
    placer : LabelPlacer

    Returns
    -------
    placed : list of (Placed, Label)
    left_out : int, names for which there was no room
    """
    for layer in layers:
        for group in layer.groups:
            if group.symbol.marker is not None:
                for point in parts_of(group.geometries, "point"):
                    x, y = page.to_page(np.array([(point.x, point.y)]))[0]
                    placer.block(float(x), float(y), group.symbol.marker.size)
    found: list[tuple[PlacedLabel, Label]] = []
    left_out = 0
    for kind in ("point", "line", "polygon"):
        for layer in layers:
            label = layer.style.label
            if label is None:
                continue
            wanted: set[str] = set()
            radius = (
                max((g.symbol.marker.size / 2 for g in layer.groups if g.symbol.marker), default=0.0) + placer.gap + 0.2
            )
            for name in _merged(layer.names) if kind == "line" else layer.names:
                for ways in _ways(page, name, kind, label, radius):
                    wanted.add(name.text)
                    if kind != "point":
                        ways = [way for way in ways if not _is_repeated(found, name.text, label, way)]
                    placed = placer.place_pieces(name.text, ways, kind == "line")
                    if placed is not None:
                        found.append((placed, label))
                    elif kind == "point":
                        left_out += 1
            if kind != "point":  # objects of one name need it once
                left_out += len(wanted - {item.text for item, lab in found if lab is label})
    return found, left_out


def _merged(names: Sequence[LabelRequest]) -> list[LabelRequest]:
    """Join lines of one name where they meet, the longest first: a street is often stored in pieces."""
    together: dict[str, list[Any]] = {}
    for name in names:
        for part in parts_of([name.geometry], "line"):
            together.setdefault(name.text, []).append(part)
    joined = []
    for text, parts in together.items():
        merged = shapely.line_merge(shapely.MultiLineString(parts)) if len(parts) > 1 else parts[0]
        joined += [LabelRequest(text, part) for part in parts_of([merged], "line")]
    return sorted(joined, key=lambda item: -item.geometry.length)


def _is_repeated(found: list[tuple[PlacedLabel, Label]], text: str, label: Label, way: tuple[LabelPart, ...]) -> bool:
    """Whether the same name stands near already."""
    spot = way[len(way) // 2].spot
    return any(
        p.text == text and lab is label and math.hypot(p.spot.x - spot.x, p.spot.y - spot.y) < AGAIN for p, lab in found
    )


def _ways(page: Page, name: LabelRequest, kind: str, label: Label, radius: float) -> list[list[tuple[LabelPart, ...]]]:
    """Ways to write a name, best first, for each time that it is to be written; none of a geometry of another kind."""
    parts = parts_of([name.geometry], kind)
    if not parts:
        return []
    width, height = text_size(name.text, label.size, label.bold, label.italic)

    def straight(spots: Sequence[LabelPosition]) -> list[tuple[LabelPart, ...]]:
        return [(LabelPart(name.text, spot, width, height),) for spot in spots]

    if kind == "point":
        x, y = page.to_page(np.array([(parts[0].x, parts[0].y)]))[0]
        return [straight(around_point(float(x), float(y), width, height, radius))]
    if kind == "line":
        letters = letters_of(name.text)
        steps = advances(letters, label.size, label.bold, label.italic)
        path = page.to_page(np.asarray(parts[0].coords))
        pieces = cut_evenly(path, LONG)
        if len(letters) == 1:
            return [straight(along_line(piece, width, ends=1.0)) for piece in pieces]
        return [along_curve(piece, letters, steps, height, ends=1.0) for piece in pieces]
    largest = shapely.intersection(max(parts, key=lambda p: p.area), shapely.box(*page.bounds))
    if largest.is_empty:
        return []
    middles = [largest.centroid, largest.representative_point()]
    middle = next((m for m in middles if largest.contains(m)), middles[-1])
    x, y = page.to_page(np.array([(middle.x, middle.y)]))[0]
    step = 1.2 * height
    return [straight([LabelPosition(float(x), float(y) + k * step) for k in (0, 1, -1, 2, -2)])]


def draw_names(canvas: Canvas, placed: Sequence[tuple[PlacedLabel, Label]]) -> None:
    """Halos and texts.

    Parameters
    ----------
    canvas : Canvas
    placed : sequence of (PlacedLabel, Label)
    """
    for item, label in placed:
        canvas.pieces(
            item.pieces, label.size, color=label.color, bold=label.bold, italic=label.italic, halo=label.halo,
            halo_width=label.halo_width, bridge=item.on_line,
        )  # fmt: skip


def place_heights(
    page: Page, contours: Sequence[Contour], part: ContoursPart, placer: LabelPlacer
) -> list[PlacedLabel]:
    """Heights on contours, tops uphill: index contours every 120 mm, others where they are the only ones.

    Parameters
    ----------
    page : Page
    contours : sequence of Contour, in the CRS of the map
    part : ContoursPart
    placer : LabelPlacer
    """
    size = part.size
    wanted = [c for c in contours if c.index] or list(contours)
    digits = _digits([c.height for c in contours])
    found: list[PlacedLabel] = []
    for contour in sorted(wanted, key=lambda c: -len(c.xy)):
        text = f"{contour.height:.{digits}f}".replace("-", "−")
        width, height = text_size(text, size, True)
        path = page.to_page(contour.xy)
        for piece in cut_evenly(path, 120.0):
            spots = [uphill(spot, piece) for spot in along_line(piece, width, bend=15.0, ends=1.0)]
            # Text that can be read from below is preferred; text on its head stays where a contour offers nothing else.
            # The sort is stable: the best position of each kind comes first.
            spots.sort(key=lambda spot: math.cos(math.radians(spot.angle)) < -0.17)
            placed = placer.place(text, width, height, spots)
            if placed is not None:
                found.append(placed)
    return found


def _digits(heights: Sequence[float]) -> int:
    return next((n for n in range(4) if all(abs(h - round(h, n)) < 1e-6 for h in heights)), 3)


def uphill(spot: LabelPosition, path: FloatArray) -> LabelPosition:
    """Turn a text on a contour so that its top is uphill, which is to the left of the contour's course.

    Parameters
    ----------
    spot : Spot, as `along_line` gives it
    path : array (N, 2), the contour on the page, the ground rising to its left
    """
    middles = (path[:-1] + path[1:]) / 2
    nearest = int(np.argmin(np.hypot(middles[:, 0] - spot.x, middles[:, 1] - spot.y)))
    course = path[nearest + 1] - path[nearest]
    a = math.radians(spot.angle)
    along = course[0] * math.cos(a) + course[1] * math.sin(a)
    return spot if along >= 0 else replace(spot, angle=spot.angle + (180.0 if spot.angle <= 0 else -180.0))


def draw_heights(canvas: Canvas, placed: Sequence[PlacedLabel], part: ContoursPart) -> None:
    """Heights with a halo that opens their contour.

    Parameters
    ----------
    canvas : Canvas
    placed : sequence of PlacedLabel
    part : ContoursPart
    """
    for item in placed:
        canvas.pieces(item.pieces, part.size, color=part.color, halo=halo_of(part.color), halo_width=0.35, bold=True)


# Diameter in mm.
_DOT = 0.7


def _dots(page: Page, spots: Sequence[SpotHeight]) -> FloatArray:
    """Places (N, 2) in mm on the page."""
    return page.to_page(np.array([(spot.x, spot.y) for spot in spots]).reshape(-1, 2))


def keep_free(page: Page, spots: Sequence[SpotHeight], placer: LabelPlacer) -> None:
    """Keep names off the dots.

    Parameters
    ----------
    page : Page
    spots : sequence of SpotHeight
    placer : LabelPlacer
    """
    for x, y in _dots(page, spots).tolist():
        placer.block(x, y, _DOT)


def place_spots(
    page: Page, spots: Sequence[SpotHeight], part: ContoursPart, interval: float, placer: LabelPlacer
) -> list[tuple[SpotHeight, PlacedLabel]]:
    """Places for the heights, the most prominent first; those without room are left out, dot and all.

    Whole metres where contours are 5 m apart or more, otherwise decimetres.

    Parameters
    ----------
    page : Page
    spots : sequence of SpotHeight
    part : ContoursPart
    interval : float, of the contours, metres
    placer : LabelPlacer
    """
    digits = 0 if interval >= 5.0 else 1
    found = []
    for spot, (x, y) in zip(spots, _dots(page, spots).tolist(), strict=True):
        if not placer.inside(x, y):
            continue
        text = f"{spot.height + 0.0:.{digits}f}".replace("-", "−")
        width, height = text_size(text, part.size, True)
        placed = placer.place(text, width, height, around_point(x, y, width, height, _DOT / 2 + placer.gap + 0.2))
        if placed is not None:
            found.append((spot, placed))
    return found


def draw_spots(
    canvas: Canvas, page: Page, placed: Sequence[tuple[SpotHeight, PlacedLabel]], part: ContoursPart
) -> None:
    """Dots and heights in the colour of the contours, with halo.

    Parameters
    ----------
    canvas : Canvas
    page : Page
    placed : sequence of (SpotHeight, PlacedLabel)
    part : ContoursPart
    """
    halo = halo_of(part.color)
    canvas.markers(_dots(page, [spot for spot, _ in placed]), "circle", _DOT, part.color, halo, 0.15)
    for _, item in placed:
        canvas.pieces(item.pieces, part.size, color=part.color, halo=halo, halo_width=0.35, bold=True)
