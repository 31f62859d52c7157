"""Neatline, grid, graticule and the coordinates around them; neighbours of a sheet in its series."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from geomosaic.sheets.drawing.canvas import CAP, POINT, Canvas, text_size
from geomosaic.sheets.grid_lines import GridLine, MapGrid
from geomosaic.sheets.label_placement import LabelPart, LabelPlacer, LabelPosition, labels_that_fit
from geomosaic.sheets.layout import GridPart
from geomosaic.sheets.page import Box, Page
from geomosaic.sheets.series.regular import DIRECTIONS, SheetPlace
from geomosaic.sheets.style import halo_of, on_paper
from geomosaic.types import FloatArray

# Arm to arm of a grid cross, mm.
_CROSS = 3.0
# Length of a tick outside the neatline, mm; inside it is longer where there are no lines.
TICK = 2.0
# Distance in mm from the neatline within which both rows of labels stand.
_OUTER = 7.45
# Length in mm beyond which a line outside the neatline is no end of one that crosses it.
_LONGEST_GAP = 12.0
_NEATLINE, BORDER = 0.3, 0.6
# Sides of the neatline in the order of its coordinates, with the way out of the map.
_OUTWARDS = {"left": (-1, 0), "bottom": (0, -1), "right": (1, 0), "top": (0, 1)}


def draw_grid(canvas: Canvas, page: Page, grid: MapGrid, part: GridPart) -> None:
    """Lines or crosses inside the neatline.

    Parameters
    ----------
    canvas : Canvas
    page : Page
    grid : MapGrid
    part : GridPart
    """
    if part.style == "lines":
        paths = [page.to_page(piece) for line in grid.lines for piece in line.pieces]
        canvas.lines(paths, halo_of(part.color), 2.2 * part.width, opacity=0.45)
        canvas.lines(paths, part.color, part.width)
        for piece in around_pole(page, grid, part.size) if part.labels else ():
            canvas.pieces([piece], part.size, color=part.color, halo=halo_of(part.color), halo_width=0.4, bridge=True)
        return
    if part.style == "crosses":
        at = page.to_page(grid.crossings)
        arms = [one for step in np.eye(2) * _CROSS / 2 for one in at[:, None, :] + np.array([-step, step])]
    else:
        arms = [_tick(page, side, x, y, -_CROSS) for _, side, x, y in _marks(grid)]
    canvas.lines(arms, halo_of(part.color), 3.0 * part.width, opacity=0.6)
    canvas.lines(arms, part.color, 1.5 * part.width)


def draw_crop_marks(canvas: Canvas, page: Page) -> None:
    """Two marks outside the bleed at each corner of the trim; nothing without bleed.

    Parameters
    ----------
    canvas : Canvas
    page : Page
    """
    if page.bleed <= 0:
        return
    left, bottom, right, top = page.paper
    bleed, marks = page.bleed, []
    for y in (0.0, page.height):
        marks += [[(left, y), (-bleed, y)], [(page.width + bleed, y), (right, y)]]
    for x in (0.0, page.width):
        marks += [[(x, bottom), (x, -bleed)], [(x, page.height + bleed), (x, top)]]
    canvas.lines(marks, "#000000", 0.1)


def draw_edge(canvas: Canvas, page: Page) -> None:
    """Neatline and border.

    Parameters
    ----------
    canvas : Canvas
    page : Page
    """
    outline = page.outline_mm
    if outline is None:
        canvas.rectangle(page.neatline, edge="#000000", width=_NEATLINE)
    else:
        canvas.area([np.vstack([outline, outline[:1]])], None, edge="#000000", width=_NEATLINE)
    canvas.rectangle(page.border, edge="#000000", width=BORDER)


def draw_labels(
    canvas: Canvas, page: Page, grids: Sequence[tuple[MapGrid | None, GridPart]], placer: LabelPlacer
) -> None:
    """Ticks outside the neatline and coordinates on all sides; each grid has its row, the first the inner one.

    Parameters
    ----------
    canvas : Canvas
    page : Page
    grids : sequence of (MapGrid or None, GridPart), the inner row first
    placer : LabelPlacer, of the page; takes what is written
    """
    for side in _OUTWARDS:
        axis = _axis(side)
        taken: list[tuple[float, float]] = []
        for row, (grid, part) in enumerate(grids):
            if grid is None:
                continue
            marks = [(line, x, y) for line, s, x, y in _marks(grid) if s == side]
            if not marks:
                continue
            along = [float(v) for v in page.to_page(np.array([place for _, *place in marks]))[:, axis]]
            labels = _row_labels(page, side, [grid.label(line) for line, _, _ in marks], along, part, row)
            placer.take(labels)
            for item in labels:
                x, y = item.spot.x, item.spot.y
                canvas.centred(x, y, item.text, part.size, angle=item.spot.angle, color=on_paper(part.color))
            # A tick of the outer row reaches to its label where no label of the inner row is in its way.
            blocked = [any(low - 0.5 < at < high + 0.5 for low, high in taken) for at in along]
            long = _aside(part.size, row) - part.size * CAP * POINT / 2 - 0.3 if row and part.labels else TICK
            ticks = [
                _tick(page, side, x, y, TICK if stop else long) for (_, x, y), stop in zip(marks, blocked, strict=True)
            ]
            canvas.lines(ticks, on_paper(part.color), max(part.width, 0.12))
            middles = [(item.spot.x, item.spot.y)[axis] for item in labels]
            taken += [(at - item.width / 2, at + item.width / 2) for at, item in zip(middles, labels, strict=True)]
    for grid, part in grids:
        if grid is not None and page.outline_mm is not None:
            canvas.lines(_gaps(page, grid), on_paper(part.color), max(part.width, 0.12))


def _gaps(page: Page, grid: MapGrid) -> list[FloatArray]:
    """Ends of grid lines between a neatline that is no rectangle and the ticks on the rectangle around it."""
    pieces = [shapely.LineString(page.to_page(piece)) for line in grid.lines for piece in line.pieces]
    outside = shapely.difference(np.array(pieces, dtype=object), page.outline_area)
    parts = shapely.get_parts(outside).tolist()
    return [np.asarray(part.coords) for part in parts if part.geom_type == "LineString" and part.length < _LONGEST_GAP]


def _row_labels(
    page: Page, side: str, texts: Sequence[str], along: Sequence[float], part: GridPart, row: int
) -> list[LabelPart]:
    """Labels of one side that fit beside each other."""
    if not part.labels:
        return []
    axis = _axis(side)
    sizes = [text_size(text, part.size) for text in texts]
    widths = [width for width, _ in sizes]
    # At the corners the labels above and below have the room.
    low, high = (page.border[0] + 1.0, page.border[2] - 1.0) if axis == 0 else (page.neatline[1], page.neatline[3])
    number = tuple(_OUTWARDS).index(side)
    across = page.neatline[number] + sum(_OUTWARDS[side]) * _aside(part.size, row)
    kept = []
    for i in labels_that_fit(along, widths, 2.0):
        first, last = along[i] - widths[i] / 2, along[i] + widths[i] / 2
        if first >= low and last <= high:
            x, y = (along[i], across) if axis == 0 else (across, along[i])
            kept.append(LabelPart(texts[i], LabelPosition(x, y, 90.0 if axis else 0.0), *sizes[i]))
    return kept


def _axis(side: str) -> int:
    """Axis along a side: 0 at the bottom and top."""
    return 0 if side in ("bottom", "top") else 1


def _aside(size: float, row: int) -> float:
    """Distance in mm of the middle of labels from the neatline."""
    # The inner row begins at the ticks, the outer one ends where the names of neighbouring sheets begin.
    half = size * CAP * POINT / 2
    return _OUTER - half if row else TICK + 0.15 + half


def _marks(grid: MapGrid) -> list[tuple[GridLine, str, float, float]]:
    """Ends on the sides that their lines cross: x at bottom and top, y at left and right, unless the grid is turned."""
    # Around a pole all lines cross all sides.
    turned = grid.turned
    return [
        (line, *end)
        for line in grid.lines
        for end in line.ends
        if grid.pole is not None or (_axis(end[0]) == line.axis) != turned
    ]


def around_pole(page: Page, grid: MapGrid, size: float) -> list[LabelPart]:
    """Latitudes of the parallels around a pole that do not reach the neatline, on the parallels between meridians.

    Parameters
    ----------
    page : Page
    grid : MapGrid
    size : float, points
    """
    if grid.pole is None:
        return []
    (centre,) = page.to_page(grid.pole[None])
    found = []
    for line in grid.lines:
        if line.axis == 1 and not line.ends:
            path = page.to_page(np.concatenate(line.pieces)) - centre
            # Below the pole, half-way between two meridians.
            longitude = np.linspace(-180.0, 180.0, len(path))
            from_meridian = np.abs(longitude / grid.intervals[0] % 1.0 - 0.5)
            turns = np.abs(np.arctan2(path[:, 0], -path[:, 1])) + 10.0 * (from_meridian > from_meridian.min() + 0.03)
            at = path[np.argmin(turns)] + centre
            text = grid.label(line)
            found.append(LabelPart(text, LabelPosition(float(at[0]), float(at[1])), *text_size(text, size)))
    return found


def _tick(page: Page, side: str, x: float, y: float, reach: float) -> FloatArray:
    """From the neatline outwards by `reach` mm, inwards where negative: both ends (2, 2)."""
    (foot,) = page.to_page(np.array([[x, y]]))
    return np.array([foot, foot + reach * np.array(_OUTWARDS[side])])


# Height in mm of the index map with its heading.
INDEX = 24.0


# Of the names on the frame, points.
SIZE = 5.5


def draw_neighbour_names(canvas: Canvas, page: Page, series: SheetPlace, placer: LabelPlacer) -> list[str]:
    """Names of the four neighbours in gaps of the border, as near to the middle of its sides as coordinates allow.

    Parameters
    ----------
    canvas : Canvas
    page : Page
    series : SheetPlace
    placer : LabelPlacer, of the page

    Returns
    -------
    list of str, names for which there was no room
    """
    lost = []
    for way in ("N", "S", "W", "E"):
        name = series.neighbours.get(way)
        if name is None:
            continue
        width, height = text_size(name, SIZE)
        placed = placer.place(name, width, height, _places_on_border(page.border, way, width))
        if placed is None:
            lost.append(name)
            continue
        x, y, angle = placed.spot.x, placed.spot.y, placed.spot.angle
        long, high = width / 2 + 1.0, height / 2 + 0.3
        wide, tall = (high, long) if angle else (long, high)
        canvas.rectangle((x - wide, y - tall, x + wide, y + tall), fill="#ffffff")
        canvas.centred(x, y, name, SIZE, angle=angle)
    return lost


def _places_on_border(border: Box, way: str, width: float) -> list[LabelPosition]:
    """Places for a text on one side of the border, from the middle outwards by millimetres."""
    left, bottom, right, top = border
    reach = ((right - left if way in "NS" else top - bottom) - width) / 2 - 2.0
    steps = sorted(np.arange(-int(max(reach, 0.0)), int(max(reach, 0.0)) + 1).tolist(), key=abs)
    if way in "NS":
        return [LabelPosition((left + right) / 2 + step, top if way == "N" else bottom) for step in steps]
    return [LabelPosition(left if way == "W" else right, (bottom + top) / 2 + step, 90.0) for step in steps]


def draw_index(canvas: Canvas, series: SheetPlace, box: Box) -> None:
    """Three by three sheets with their names, this one in the middle; those that do not exist stay empty.

    Parameters
    ----------
    canvas : Canvas
    series : SheetPlace
    box : Box, mm
    """
    left, bottom, right, top = box
    canvas.text(left, top - 6.2 * CAP * POINT, "Neighbouring sheets", 6.2, bold=True)
    top -= 3.4
    wide, high = (right - left) / 3, (top - bottom) / 3
    names = {(0, 0): series.name} | {DIRECTIONS[way]: name for way, name in series.neighbours.items()}
    longest = max(text_size(name, 1.0)[0] for name in names.values())
    size = min(5.5, (wide - 1.0) / longest)
    # Names that would be too small to read are broken before their last parts.
    broken = size < 4.2
    for (east, north), name in names.items():
        x, y = left + (1 + east) * wide, bottom + (1 + north) * high
        own = (east, north) == (0, 0)
        canvas.rectangle((x, y, x + wide, y + high), fill="#d9d9d9" if own else None, edge="#000000", width=0.12)
        lines = _halves(name) if broken else [name]
        points = min([5.5, *((wide - 1.0) / text_size(line, 1.0)[0] for line in lines)])
        for k, line in enumerate(lines):
            down = (k - (len(lines) - 1) / 2) * points * POINT * 1.3
            canvas.centred(x + wide / 2, y + high / 2 - down, line, points, bold=own)


def _halves(name: str) -> list[str]:
    """A name in two lines, broken after the hyphen or blank nearest to its middle."""
    cuts = [k + 1 for k, letter in enumerate(name[:-1]) if letter in "- "]
    if not cuts:
        return [name]
    cut = min(cuts, key=lambda k: abs(2 * k - len(name)))
    return [name[:cut], name[cut:].strip()]
