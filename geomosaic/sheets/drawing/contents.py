"""Contents of a sheet as values: what is drawn, and the entries of its legend."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from geomosaic.relief.contours import Contour
from geomosaic.relief.spot_heights import SpotHeight
from geomosaic.sheets.drawing.labels import kinds_of
from geomosaic.sheets.grid_lines import MapGrid
from geomosaic.sheets.layout import Declination, Layout
from geomosaic.sheets.notes import grid_line
from geomosaic.sheets.page import Page
from geomosaic.sheets.series.regular import SheetPlace
from geomosaic.sheets.style import Marker, Symbol, halo_of, legend_line
from geomosaic.sheets.vector_layers import Overlay


@dataclass(frozen=True)
class SheetParts:
    """Everything that is on a sheet.

    Attributes
    ----------
    page : Page
    layout : Layout
    grids : tuple of MapGrid or None, map grid and graticule, None where not wanted
    layers : tuple of Overlay, lowest first
    contours : tuple of Contour
    interval : float, of the contours in metres, 0 without
    spots : tuple of SpotHeight, the most prominent first
    blocks : tuple of (heading, lines), notes
    convergence : float, degrees, at the centre; None in a local frame, which has no north
    series : SheetPlace, optional, the sheet's place in its series
    magnetic : Declination, optional, at the centre
    """

    page: Page
    layout: Layout
    grids: tuple[MapGrid | None, MapGrid | None]
    layers: tuple[Overlay, ...]
    contours: tuple[Contour, ...]
    interval: float
    spots: tuple[SpotHeight, ...]
    blocks: tuple[tuple[str, list[str]], ...]
    convergence: float | None
    series: SheetPlace | None = None
    magnetic: Declination | None = None


@dataclass(frozen=True)
class Entry:
    """A line of the legend; without symbol a heading."""

    text: str
    symbol: Symbol | None = None
    kinds: frozenset[str] = frozenset()


def legend(parts: SheetParts) -> list[Entry]:
    """Entries in the order in which layers lie, the uppermost first.

    Parameters
    ----------
    parts : SheetParts
    """
    entries: list[Entry] = []
    for layer in reversed(parts.layers):
        if len(layer.groups) > 1 and layer.title:
            entries.append(Entry(layer.title))
        for group in layer.groups:
            text = layer.title if len(layer.groups) == 1 and not layer.style.rules else group.title
            entries.append(Entry(text, group.symbol, frozenset(kinds_of(group.geometries))))
    part = parts.layout.contours
    line = frozenset({"line"})
    if parts.contours:
        shown: Sequence[tuple[bool, str, float]] = (
            (True, f"Index contours, every {parts.interval * part.index:g}\u00a0m", part.index_width),
            (False, f"Contours, every {parts.interval:g}\u00a0m", part.width),
        )
        for main, text, width in shown:
            if any(c.index == main for c in parts.contours):
                entries.append(Entry(text, Symbol(line=legend_line(part.color, width)), line))
    if parts.spots:
        dot = Marker("circle", 1.0, part.color, halo_of(part.color), 0.15)
        entries.append(Entry("Spot heights, metres", Symbol(marker=dot), frozenset({"point"})))
    for grid, looks in zip(parts.grids, (parts.layout.grid, parts.layout.graticule), strict=True):
        if grid is not None:
            entries.append(Entry(grid_line(grid), Symbol(line=legend_line(looks.color, max(looks.width, 0.15))), line))
    return entries
