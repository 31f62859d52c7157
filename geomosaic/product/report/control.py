"""The control report as one HTML file that needs nothing else."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from geomosaic.errors import counted
from geomosaic.product.report.control_figure import control_figure
from geomosaic.product.report.numbers import decimals, number
from geomosaic.product.report.page import environment

MOST_ROWS = 300
"""Rows of a table; the JSON twin has them all."""
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


def render_control(data: Mapping[str, Any], image: Path) -> str:
    """Make the page.

    Parameters
    ----------
    data : mapping
        The facts of the JSON report, see `geomosaic.product.georeference.report`.
    image : Path
        For the picture.

    Returns
    -------
    str
        HTML; text from files is escaped, and nothing is loaded from elsewhere.
    """
    from geomosaic import __version__

    size = (data["image"]["width"], data["image"]["height"])
    through = data["accuracy"]["headline"] == "leave_one_out"
    key = "leave_one_out_px" if through else "residual_px"
    points = sorted(data["points"], key=lambda point: _length(point[key] or point["residual_px"]), reverse=True)
    drawn = [{**point, "residual_px": point[key] or point["residual_px"]} for point in data["points"]]
    metre = max(data["accuracy"][data["accuracy"]["headline"]]["m"]["rms_total"] or 0.0, 1e-6)
    # Residuals in metres with as many decimals as their RMS asks for, millimetres at least.
    return (
        environment()
        .get_template("control.html.j2")
        .render(
            **data,
            geomosaic=__version__,
            figure=control_figure(drawn, size, image),
            through=through,
            sorted_points=points,
            cards=cards(data),
            digits=min(decimals(metre, 2), 6),
            colours=COLOURS,
            words_of=WORDS,
            states=[state for state in WORDS if any(point["state"] == state for point in points)],
            most=MOST_ROWS,
        )
    )


def cards(data: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Key figures: title, value, unit, explanation, and whether it is good news (None where it is neither)."""
    accuracy, check, robust = data["accuracy"], data["check"], data["robust"]
    pixels, metres = accuracy["residuals"]["px"], accuracy["residuals"]["m"]

    def both(what: Mapping[str, Any], where: Mapping[str, Any], key: str) -> str:
        digits = min(decimals(where[key], 2), 6)
        return f"{number(where[key], digits)} m" if where[key] is not None and what[key] is not None else ""

    if accuracy["headline"] == "leave_one_out":  # zero residuals are no figure
        residual = []
        pixels, metres = accuracy["leave_one_out"]["px"], accuracy["leave_one_out"]["m"]
        of = f"{both(pixels, metres, 'figure95')}: 2.5 × RMS of one axis, of leave-one-out errors."
    else:
        text = f"{both(pixels, metres, 'rms_total')}, total of both axes, over {accuracy['points']} points."
        residual = [_card("Control points, RMS", number(pixels["rms_total"], 2), "px", text)]
        of = f"{both(pixels, metres, 'figure95')}: 2.5 × RMS of one axis."
    left_out = number(accuracy["leave_one_out"]["px"]["rms_total"], 2)
    text = "Errors of points under the fit to all others: what places between the points may expect."
    found = [
        *residual,
        _card("Leave-one-out, RMS", left_out, "px", text),
        _card("95 % of points within", number(pixels["figure95"], 2), "px", of),
    ]
    if check is not None:
        text = f"{check['rms_total']:.3g} {check['unit']}, total, over {counted(check['check_points'], 'point')}."
        rms = number(check["px"]["rms_total"], 2)
        found.append(_card("Check points, RMS", rms, "px", text, passed=not check["shifted"]))
    text = "Observations more than the fit has parameters."
    redundancy = accuracy["redundancy"]
    found.append(_card("Redundancy", str(redundancy), "", text, passed=redundancy > 0))
    count = len(robust["blunders"])
    if "agree" in robust or "without_model" in robust:
        inside = {point["id"] for point in data["points"] if point["state"] == "control"} & set(robust["blunders"])
        left = "" if inside or not count else ", and left out"
        how = "by data snooping and by the M-estimator" if "agree" in robust else "by what the other points say"
        found.append(_card("Blunders", str(count), "", f"Found {how}{left}.", passed=not inside))
    return found


def _card(title: str, value: str, unit: str, text: str, *, passed: bool | None = None) -> dict[str, Any]:
    return {"title": title, "value": value, "unit": unit, "text": text, "passed": passed}


def _length(pair: Sequence[float | None]) -> float:
    known = [value for value in pair if value is not None]
    return math.hypot(*known) if len(known) == len(pair) else -1.0
