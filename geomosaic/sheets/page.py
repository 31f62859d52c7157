"""Page of a sheet: paper, neatline, border, panel, scale and area, laid out from what a layout asks for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import is_local
from geomosaic.geo.grid import Bounds
from geomosaic.geo.units import linear_unit
from geomosaic.numbers import nice_scale
from geomosaic.options.sheet import PAPERS, paper_size, scale_text
from geomosaic.sheets.layout import Layout
from geomosaic.types import FloatArray

# Width in mm of the band between neatline and border: two rows of coordinates.
BAND = 8.5
# Height in mm of the title's strip.
HEAD = 15.0
# Width of a panel at the right and height of one at the bottom, in mm.
_PANEL_RIGHT, _PANEL_BOTTOM = 64.0, 62.0
# Height in mm that a panel at the right takes where it can.
LOWEST = 110.0
# Width in mm from which a panel at the bottom has room for its three columns, and which they take where they can.
NARROWEST, COLUMNS = 140.0, 168.0
# Height in mm of the strip for the scale below a map that has no panel there.
FOOT = 16.0
# Length in mm of the marks where bleed is cut off.
_CROP_MARK = 5.0
GAP = 3.0
# Shortest side in mm that the room for a map has: below, its coordinates would not fit beside each other.
SMALLEST = 30.0

# Left, bottom, right, top in mm on the page.
Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class Page:
    """Geometry of a sheet on paper and of its map.

    Attributes
    ----------
    width, height : float, paper in mm
    neatline, border : Box, the map's edge, and the line around its coordinates
    head : Box, title strip above the border
    foot : Box or None, scale strip below the border, where the panel is not there
    panel : Box or None, legend, notes, and the scale where there is no foot
    side : str, where the panel is: 'right', 'bottom' or 'none'
    crs : CRS, of the map: projected, or a local frame
    bounds : Bounds, left, bottom, right, top of the neatline in `crs`
    scale : float, denominator
    outline : tuple of points, optional
        Neatline in `crs` where it is no rectangle, not closed; `bounds` is the box around it.
    bleed : float, paper in mm beyond the trim, which is (0, 0, width, height)
    """

    width: float
    height: float
    neatline: Box
    border: Box
    head: Box
    foot: Box | None
    panel: Box | None
    side: str
    crs: CRS
    bounds: Bounds
    scale: float
    outline: tuple[tuple[float, float], ...] | None = None
    bleed: float = 0.0

    @property
    def paper(self) -> Box:
        """All that is written: the trim, or bleed and crop marks around it."""
        out = self.bleed + _CROP_MARK if self.bleed > 0 else 0.0
        return (-out, -out, self.width + out, self.height + out)

    @property
    def mm_per_unit(self) -> float:
        """Millimetres on paper for one unit of the map CRS."""
        return 1000.0 * linear_unit(self.crs) / self.scale

    def to_page(self, xy: FloatArray) -> FloatArray:
        """Map coordinates (N, 2) to mm on the page (N, 2)."""
        points = np.asarray(xy, dtype=np.float64)[:, :2]
        origin, corner = np.array(self.bounds[:2]), np.array(self.neatline[:2])
        moved: FloatArray = (points - origin) * self.mm_per_unit + corner
        return moved

    @property
    def outline_mm(self) -> FloatArray | None:
        """The neatline on the page (N, 2), where it is no rectangle."""
        return None if self.outline is None else self.to_page(np.array(self.outline))

    @property
    def outline_area(self) -> Any:
        """The same as a shapely Polygon."""
        return None if self.outline is None else shapely.Polygon(self.outline_mm)

    def to_map(self, mm: FloatArray) -> FloatArray:
        """Millimetres on the page (N, 2) to map coordinates (N, 2)."""
        points = np.asarray(mm, dtype=np.float64)[:, :2]
        moved: FloatArray = (points - np.array(self.neatline[:2])) / self.mm_per_unit + np.array(self.bounds[:2])
        return moved


def lay_out(layout: Layout, crs: CRS, extent: Bounds, where: str | None = None) -> Page:
    """Page with the paper, scale and area that a layout asks for.

    What is not given follows: the area is all of `extent` where it fits the paper, otherwise its middle; the scale is
    the largest round one at which the area fits the paper; the paper is the smallest from A4 to A0 on which the area
    fits at the scale, or A3 where neither is given.

    Parameters
    ----------
    layout : Layout
    crs : CRS, of the map: projected, or a local frame in units of length
    extent : Bounds, what there is a picture of, in `crs`
    where : str, optional, named in errors

    Raises
    ------
    InputError
        A map without a scale (geographic CRS), an area beside the picture or larger than the paper.
    """
    if not (crs.is_projected or is_local(crs)):
        raise InputError(
            f"'{crs.name}' is not projected, so a sheet in it has no scale",
            where=where,
            hint="make the raster in a projected CRS (`dst_crs`), such as a UTM zone",
        )
    wanted = _requested_area(layout, extent, where)
    unit = 1000.0 * linear_unit(crs)
    papers = (
        [layout.sheet.paper] if layout.sheet.paper else (["A3"] if layout.map.scale is None else list(PAPERS)[::-1])
    )
    pages: list[Page] = []
    for paper in papers:
        ways = _orientations(layout, paper, wanted)
        tried = [_on_paper(layout, paper, landscape, crs, wanted, unit, where) for landscape in ways]
        pages += filter(None, tried)
        if any(_covers(page, wanted) for page in pages):
            break
    if not pages:
        raise InputError(
            f"the paper {papers[-1]} has no room for a map beside margins, title and legend",
            where=where,
            hint='give a larger `paper`, a smaller [sheet] margin, or panel = "none"',
        )
    # The page that shows the area largest; of those at one scale the one that shows most of it.
    best = max(pages, key=lambda page: (-page.scale, _area(page.bounds)))
    if layout.map.centre is not None and not rectangles_overlap(best.bounds, extent):
        raise InputError(
            f"the map about {list(layout.map.centre or ())} lies beside the picture, which covers "
            f"{[round(v, 3) for v in extent]}",
            where=where,
            hint="give [map] centre in the CRS of the raster",
        )
    if layout.map.bounds is not None and not _covers(best, wanted):
        width, height = ((wanted[i + 2] - wanted[i]) * unit / best.scale for i in (0, 1))
        room = (best.neatline[2] - best.neatline[0], best.neatline[3] - best.neatline[1])
        fits = nice_scale(best.scale * max(width / room[0], height / room[1]))
        raise InputError(
            f"the area is {width:.0f} x {height:.0f} mm at {scale_text(best.scale)}, the paper has room for "
            f"{room[0]:.0f} x {room[1]:.0f} mm",
            where=where,
            hint=f"give {scale_text(fits)} or a smaller scale, a larger paper, or a smaller area",
        )
    return replace(best, bleed=layout.sheet.bleed)


def _requested_area(layout: Layout, extent: Bounds, where: str | None) -> Bounds:
    """Area that the layout asks for, else that of the raster."""
    bounds = layout.map.bounds
    if bounds is None:
        return extent
    if layout.map.centre is not None:
        raise InputError("[map] has bounds and a centre", where=where, hint="leave one of them out")
    if not (bounds[0] < bounds[2] and bounds[1] < bounds[3]):
        raise InputError(f"[map] bounds {list(bounds)} enclose no area", where=where, hint="left, bottom, right, top")
    if not rectangles_overlap(bounds, extent):
        raise InputError(
            f"the area {list(bounds)} lies beside the picture, which covers {[round(v, 3) for v in extent]}",
            where=where,
            hint="give [map] bounds in the CRS of the raster",
        )
    return bounds


def rectangles_overlap(bounds: Bounds, extent: Bounds) -> bool:
    """Whether two rectangles have area in common.

    Parameters
    ----------
    bounds, extent : tuple of float
        Left, bottom, right, top in one frame.
    """
    return bounds[0] < extent[2] and bounds[2] > extent[0] and bounds[1] < extent[3] and bounds[3] > extent[1]


def _orientations(layout: Layout, paper: str, wanted: Bounds) -> tuple[bool, ...]:
    if "x" in paper.lower() or layout.sheet.orientation != "auto":
        return (layout.sheet.orientation == "landscape",)
    wide = wanted[2] - wanted[0] > wanted[3] - wanted[1]
    return (wide, not wide)


def _on_paper(
    layout: Layout, paper: str, landscape: bool, crs: CRS, wanted: Bounds, unit: float, where: str | None
) -> Page | None:
    """Page of the area on one paper size; None where it does not fit."""
    width, height = paper_size(paper, where)
    if layout.sheet.orientation == "landscape" or ("x" not in paper.lower() and landscape):
        width, height = max(width, height), min(width, height)
    elif layout.sheet.orientation == "portrait":
        width, height = min(width, height), max(width, height)
    margin, side = layout.sheet.margin, layout.sheet.panel
    if side == "auto":
        wide = width - 2 * margin
        side = "right" if width > height else "bottom"
        if wide < (NARROWEST if side == "bottom" else _PANEL_RIGHT + GAP + 2 * BAND + 2 * SMALLEST):
            side = "none"
    if side == "bottom" and width - 2 * margin < NARROWEST:
        return None
    names = layout.sheet
    given = any((names.title, names.subtitle, names.number, names.name, names.logo))
    head = HEAD if given and names.head == "auto" else 0.0
    right = _PANEL_RIGHT + GAP if side == "right" else 0.0
    bottom = _PANEL_BOTTOM + GAP if side == "bottom" else FOOT
    room = (width - 2 * margin - 2 * BAND - right, height - 2 * margin - 2 * BAND - bottom - head)
    if min(room) < SMALLEST:
        return None
    extent = (wanted[2] - wanted[0]) * unit, (wanted[3] - wanted[1]) * unit
    scale = layout.map.scale or nice_scale(max(extent[0] / room[0], extent[1] / room[1], 1.0))
    size = [min(space, length / scale) for space, length in zip(room, extent, strict=True)]
    centre = layout.map.centre or ((wanted[0] + wanted[2]) / 2, (wanted[1] + wanted[3]) / 2)
    half = [length * scale / unit / 2 for length in size]
    bounds = (centre[0] - half[0], centre[1] - half[1], centre[0] + half[0], centre[1] + half[1])
    # The map stands in the middle of its room; what it leaves becomes white margin.
    left = margin + BAND + (room[0] - size[0]) / 2
    low = margin + bottom + BAND + (room[1] - size[1]) / 2
    neatline = (left, low, left + size[0], low + size[1])
    border = (neatline[0] - BAND, neatline[1] - BAND, neatline[2] + BAND, neatline[3] + BAND)
    foot: Box | None = (border[0], border[1] - FOOT, border[2], border[1])
    panel: Box | None = None
    if side == "right":
        # Beside a low map the panel reaches further down: its contents do not get lower.
        end = max(margin, min(border[1], border[3] - LOWEST))
        panel = (border[2] + GAP, end, border[2] + GAP + _PANEL_RIGHT, border[3])
    elif side == "bottom":
        wide = max(border[2] - border[0], min(width - 2 * margin, COLUMNS))
        start = (border[0] + border[2] - wide) / 2
        foot, panel = None, (start, border[1] - GAP - _PANEL_BOTTOM, start + wide, border[1] - GAP)
    top = (min(border[0], (panel or border)[0]), border[3], (panel or border)[2], border[3] + head)
    return Page(width, height, neatline, border, top, foot, panel, side, crs, bounds, scale)


def _covers(page: Page, wanted: Bounds) -> bool:
    have = page.bounds
    # Rounding between paper and map must not choose a larger paper.
    hair = 1e-6 * (wanted[2] - wanted[0])
    return have[2] - have[0] >= wanted[2] - wanted[0] - hair and have[3] - have[1] >= wanted[3] - wanted[1] - hair


def _area(bounds: Bounds) -> float:
    return (bounds[2] - bounds[0]) * (bounds[3] - bounds[1])
