"""The image with its control points on it, and the residuals as vectors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geomosaic.product.report.figures import LONGEST, data_uri, nice_length
from geomosaic.raster.preview import jpeg_bytes, preview

SHARE = 0.06
"""Length of the longest residual of the fit as it is drawn, as a share of the picture's longer side."""
MOST = 4.0
"""Times as long as that a vector of another point is drawn at most; beyond, it is cut."""
NAMED = 80
"""Points that are still called by name in the picture."""
CROWD = 40
"""Points from which on vectors are drawn shorter, so that they leave each other room."""


@dataclass(frozen=True)
class Mark:
    """A point in the picture: place and vector in its pixels."""

    name: str
    state: str
    x: float
    y: float
    dx: float
    dy: float
    cut: bool
    title: str


@dataclass(frozen=True)
class ControlFigure:
    """The image with its points, in pixels of its preview, `margin` around it for points beyond the edges.

    `enlarged` says how many times as long as in the image the vectors are drawn.
    """

    width: int
    height: int
    margin: float
    picture: str
    marks: list[Mark]
    bar: float
    bar_text: str
    enlarged: float
    named: bool


def control_figure(points: Sequence[Mapping[str, Any]], size: tuple[int, int], image: Path) -> ControlFigure:
    """Draw the points of a control report.

    Parameters
    ----------
    points : sequence of mapping
        id, state, col, row, residual_px.
    size : tuple of int
        Width and height of the image.
    image : Path
    """
    rgb, valid = preview(image, LONGEST)
    height, width = valid.shape
    shrink = width / size[0]
    lengths = {point["id"]: math.hypot(*point["residual_px"]) for point in points if None not in point["residual_px"]}
    own = [lengths[point["id"]] for point in points if point["state"] == "control" and point["id"] in lengths]
    # A fit that passes through its points has residuals of 1e-10: they are drawn as nothing, not enlarged to arrows.
    longest = max([*own, 1e-3])
    drawn = SHARE * max(width, height) * max(0.4, min(1.0, math.sqrt(CROWD / max(1, len(points)))))
    scale = drawn / longest
    marks = []
    for point in points:
        col, row = (0.0 if value is None else value for value in point["residual_px"])
        dx, dy = col * scale, row * scale
        length = math.hypot(dx, dy)
        cut = length > MOST * drawn
        if cut:
            dx, dy = dx * MOST * drawn / length, dy * MOST * drawn / length
        title = f"{point['id']} ({point['state']}): {col:+.2f}, {row:+.2f} px"
        mark = Mark(point["id"], point["state"], point["col"] * shrink, point["row"] * shrink, dx, dy, cut, title)
        marks.append(mark)
    bar = nice_length(longest)
    beyond = [max(-m.x, m.x - width, -m.y, m.y - height, 0.0) for m in marks]
    margin = min(max([0.0, *beyond]) + 0.03 * max(width, height), 0.5 * max(width, height))
    return ControlFigure(
        width,
        height,
        margin,
        data_uri(jpeg_bytes(rgb, valid), "image/jpeg"),
        marks,
        bar * scale,
        f"{bar:g} px",
        scale / shrink,
        len(marks) <= NAMED,
    )
