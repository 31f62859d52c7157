"""Spot heights on the map: a dot and its height, where there is room for both."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomosaic.carto.contrast import halo_of
from geomosaic.carto.draw.canvas import Canvas
from geomosaic.carto.draw.letters import text_size
from geomosaic.carto.layout import ContoursPart
from geomosaic.carto.page import Page
from geomosaic.carto.place import Placed, Placer, around_point
from geomosaic.carto.spots import SpotHeight
from geomosaic.types import FloatArray

DOT = 0.7
"""Diameter in mm."""


def dots(page: Page, spots: Sequence[SpotHeight]) -> FloatArray:
    """Places (N, 2) in mm on the page."""
    return page.to_page(np.array([(spot.x, spot.y) for spot in spots]).reshape(-1, 2))


def keep_free(page: Page, spots: Sequence[SpotHeight], placer: Placer) -> None:
    """Keep names off the dots."""
    for x, y in dots(page, spots).tolist():
        placer.block(x, y, DOT)


def place_spots(
    page: Page, spots: Sequence[SpotHeight], part: ContoursPart, interval: float, placer: Placer
) -> list[tuple[SpotHeight, Placed]]:
    """Find places for the heights, the most prominent first; those without room are left out, dot and all.

    Whole metres where contours are 5 m apart or more, otherwise decimetres.
    """
    digits = 0 if interval >= 5.0 else 1
    found = []
    for spot, (x, y) in zip(spots, dots(page, spots).tolist(), strict=True):
        if not placer.inside(x, y):
            continue
        text = f"{spot.height + 0.0:.{digits}f}".replace("-", "−")
        width, height = text_size(text, part.size, True)
        placed = placer.place(text, width, height, around_point(x, y, width, height, DOT / 2 + placer.gap + 0.2))
        if placed is not None:
            found.append((spot, placed))
    return found


def draw_spots(canvas: Canvas, page: Page, placed: Sequence[tuple[SpotHeight, Placed]], part: ContoursPart) -> None:
    """Dots and heights in the colour of the contours, with halo."""
    halo = halo_of(part.color)
    canvas.markers(dots(page, [spot for spot, _ in placed]), "circle", DOT, part.color, halo, 0.15)
    for _, item in placed:
        canvas.pieces(item.pieces, part.size, color=part.color, halo=halo, halo_width=0.35, bold=True)
