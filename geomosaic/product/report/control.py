"""The control report as one HTML file that needs nothing else."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

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
    points = sorted(data["points"], key=_length, reverse=True)
    metre = max(data["accuracy"]["residuals"]["m"]["rms_total"] or 0.0, 1e-6)
    # Residuals in metres with as many decimals as their RMS asks for, millimetres at least.
    return (
        environment()
        .get_template("control.html.j2")
        .render(
            **data,
            geomosaic=__version__,
            figure=control_figure(data["points"], size, image),
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

    found: list[dict[str, Any]] = [
        {
            "title": "Control points, RMS",
            "value": number(pixels["rms_total"], 2),
            "unit": "px",
            "text": f"{both(pixels, metres, 'rms_total')}, total of both axes, over {accuracy['points']} points.",
            "passed": None,
        },
        {
            "title": "Leave-one-out, RMS",
            "value": number(accuracy["leave_one_out"]["px"]["rms_total"], 2),
            "unit": "px",
            "text": "Errors of points under the fit to all others: what places between the points may expect.",
            "passed": None,
        },
        {
            "title": "95 % of points within",
            "value": number(pixels["figure95"], 2),
            "unit": "px",
            "text": f"{both(pixels, metres, 'figure95')}: 2.5 × RMS of one axis.",
            "passed": None,
        },
    ]
    if check is not None:
        found.append(
            {
                "title": "Check points, RMS",
                "value": number(check["px"]["rms_total"], 2),
                "unit": "px",
                "text": f"{check['rms_total']:.3g} {check['unit']}, total, over {check['check_points']} points.",
                "passed": not check["shifted"],
            }
        )
    found.append(
        {
            "title": "Redundancy",
            "value": str(accuracy["redundancy"]),
            "unit": "",
            "text": "Observations more than the fit has parameters.",
            "passed": accuracy["redundancy"] > 0,
        }
    )
    count = len(robust["blunders"])
    if "agree" in robust:
        inside = {point["id"] for point in data["points"] if point["state"] == "control"} & set(robust["blunders"])
        left = "" if inside or not count else ", and left out"
        text = f"Found by data snooping and by the M-estimator{left}."
        found.append({"title": "Blunders", "value": str(count), "unit": "", "text": text, "passed": not inside})
    return found


def _length(point: Mapping[str, Any]) -> float:
    pair = point["residual_px"]
    return -1.0 if None in pair else math.hypot(*pair)
