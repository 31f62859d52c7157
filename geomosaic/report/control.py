"""Control report as one HTML file, with the image, its control points and residual vectors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from geomosaic.errors import counted
from geomosaic.numbers import round_below
from geomosaic.options.naming import flag, renamed_values
from geomosaic.raster.pictures import jpeg_bytes
from geomosaic.report.figures import Vector, data_uri, residual_length
from geomosaic.report.page import card, decimals, number, rendered
from geomosaic.types import ByteArray

# Colours (rows, cols, 3) of an image reduced to a small picture, and where there is one (rows, cols).
Picture = tuple[ByteArray, ByteArray]
# Length of the longest residual of the fit as it is drawn, as a share of the picture's longer side.
SHARE = 0.06
# Times as long as that a vector of another point is drawn at most; beyond, it is cut.
MOST = 4.0
# Points that are still called by name in the picture: names of more would cover it.
NAMED = 80
# Points from which on vectors are drawn shorter, so that they leave each other room.
CROWD = 40


@dataclass(frozen=True)
class ControlFigure:
    """Image with its control points and enlarged residual vectors, in pixels of its preview.

    Attributes
    ----------
    width, height : int
        Of the preview.
    margin : float
        Around it, for points beyond the edges.
    picture : str
        Preview as a data URI.
    marks : list of Vector
        Their states are those of `WORDS`.
    bar : float
        Length of the scale bar of the residuals, in pixels of the preview.
    bar_text : str
        Its length in image pixels.
    enlarged : float
        Times as long as in the image the vectors are drawn.
    named : bool
        Whether points are few enough to be labelled with their ids.
    """

    width: int
    height: int
    margin: float
    picture: str
    marks: list[Vector]
    bar: float
    bar_text: str
    enlarged: float
    named: bool


def _control_figure(points: Sequence[Mapping[str, Any]], size: tuple[int, int], picture: Picture) -> ControlFigure:
    """Figure of a control report: points and enlarged residual vectors on the image."""
    rgb, valid = picture
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
        place = (point["col"] * shrink, point["row"] * shrink)
        marks.append(Vector(*place, dx, dy, point["state"], title, point["id"], cut))
    bar = round_below(longest)
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


# Rows of a table; the JSON twin has them all.
MOST_ROWS = 300
COLOURS = {
    "control": "#35d0ff",
    "check": "#ffb347",
    "deleted": "#ff5f52",
    "suspect": "#ff5f52",
    "disabled": "#c7d0d8",
}
WORDS = {
    "control": "in the fit",
    "check": "check point",
    "deleted": "deleted by the threshold",
    "suspect": "left out as a blunder",
    "disabled": "not enabled",
}


def render_control(data: Mapping[str, Any], picture: Picture) -> str:
    """HTML page of a control report.

    Parameters
    ----------
    data : mapping
        The facts of the JSON report, see `geomosaic.georeferencing.report`.
    picture : Picture
        Of the image.

    Returns
    -------
    str
        HTML; text from files is escaped, and nothing is loaded from elsewhere.
    """
    size = (data["image"]["width"], data["image"]["height"])
    through = data["accuracy"]["headline"] == "leave_one_out"
    key = "leave_one_out_px" if through else "residual_px"
    points = sorted(data["points"], key=lambda point: residual_length(point[key] or point["residual_px"]), reverse=True)
    drawn = [{**point, "residual_px": point[key] or point["residual_px"]} for point in data["points"]]
    metre = max(data["accuracy"][data["accuracy"]["headline"]]["m"]["rms_total"] or 0.0, 1e-6)
    # Residuals in metres with as many decimals as their RMS asks for, millimetres at least.
    return rendered(
        "control",
        **renamed_values(data, flag),
        figure=_control_figure(drawn, size, picture),
        through=through,
        sorted_points=points,
        cards=_cards(data),
        digits=min(decimals(metre, 2), 6),
        colours=COLOURS,
        words_of=WORDS,
        states=[state for state in WORDS if any(point["state"] == state for point in points)],
        most=MOST_ROWS,
    )


def _cards(data: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Key figures of a control report."""
    accuracy, check, robust = data["accuracy"], data["check"], data["robust"]
    pixels, metres = accuracy["residuals"]["px"], accuracy["residuals"]["m"]

    def both(what: Mapping[str, Any], where: Mapping[str, Any], key: str) -> str:
        digits = min(decimals(where[key], 2), 6)
        return (
            f"{number(where[key], digits)} {data['fit']['length_unit']}"
            if where[key] is not None and what[key] is not None
            else ""
        )

    if accuracy["headline"] == "leave_one_out":  # zero residuals are no figure
        residual = []
        pixels, metres = accuracy["leave_one_out"]["px"], accuracy["leave_one_out"]["m"]
        of = f"{both(pixels, metres, 'circular_error_95')}: 2.5 × RMS of one axis, of leave-one-out errors."
    else:
        text = f"{both(pixels, metres, 'rms_total')}, total of both axes, over {accuracy['points']} points."
        residual = [card("Control points, RMS", number(pixels["rms_total"], 2), "px", text)]
        of = f"{both(pixels, metres, 'circular_error_95')}: 2.5 × RMS of one axis."
    left_out = number(accuracy["leave_one_out"]["px"]["rms_total"], 2)
    text = "Errors of points under the fit to all others: what places between the points may expect."
    found = [
        *residual,
        card("Leave-one-out, RMS", left_out, "px", text),
        card("95 % of points within", number(pixels["circular_error_95"], 2), "px", of),
    ]
    if check is not None:
        text = f"{check['rms_total']:.3g} {check['unit']}, total, over {counted(check['check_points'], 'point')}."
        rms = number(check["px"]["rms_total"], 2)
        found.append(card("Check points, RMS", rms, "px", text, passed=not check["shifted"]))
    text = "Observations more than the fit has parameters."
    redundancy = accuracy["redundancy"]
    found.append(card("Redundancy", str(redundancy), "", text, passed=redundancy > 0))
    count = len(robust["blunders"])
    if "agree" in robust or "without_model" in robust:
        inside = {point["id"] for point in data["points"] if point["state"] == "control"} & set(robust["blunders"])
        left = "" if inside or not count else ", and left out"
        how = "by data snooping and by the M-estimator" if "agree" in robust else "by what the other points say"
        found.append(card("Blunders", str(count), "", f"Found {how}{left}.", passed=not inside))
    return found
