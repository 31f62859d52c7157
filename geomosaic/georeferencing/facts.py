"""Facts of a fit of control as plain values, and the files of the control report."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.control.findings import Advice
from geomosaic.estimation.statistics import axis_rms, total_rms
from geomosaic.georeferencing.residual_vectors import write_residuals
from geomosaic.orientation.single.check_points import CheckStatistics
from geomosaic.orientation.single.fit import ControlFit, textbook95
from geomosaic.raster.output_files import write_text
from geomosaic.report.control import render_control
from geomosaic.types import AnyArray, FloatArray


def plain(values: AnyArray | Sequence[float]) -> list[Any]:
    """Return numbers as lists; what is not finite is None, since JSON knows no NaN."""
    found: list[Any] = []
    for value in np.asarray(values, dtype=np.float64).tolist():
        found.append(plain(value) if isinstance(value, list) else value if math.isfinite(value) else None)
    return found


def number(value: float) -> float | None:
    """Return a finite number, or None."""
    return float(value) if math.isfinite(value) else None


def advice_facts(advice: Sequence[Advice]) -> list[dict[str, Any]]:
    """Plain values of findings."""
    return [
        {"code": a.code, "severity": a.severity, "what": a.what, "points": list(a.points), "hint": a.hint}
        for a in advice
    ]


def statistics_facts(found: CheckStatistics) -> dict[str, Any]:
    """Plain values of check points' statistics, in the map's unit."""
    return {
        "check_points": len(found),
        "unit": found.unit,
        "rms": plain(found.rms),
        "rms_total": number(found.rms_total),
        "figure95": number(found.figure95),
        "mean_shift": plain(found.mean),
        "spread": plain(found.spread),
        "shift_probability": number(found.shift_probability),
        "shifted": bool(found.shifted),
        "shift_statement": found.shift_statement,
        "nssda": number(found.nssda),
        "nssda_statement": found.nssda_statement,
        "survey_rms": found.survey_rms,
        "rms_with_survey": number(found.rms_with_survey),
        "asprs_statement": found.asprs_statement,
    }


def error_facts(errors: FloatArray) -> dict[str, Any]:
    """RMS per axis and total, and the 95 % figure, of errors (N, 2)."""
    return {
        "rms": plain(axis_rms(errors)),
        "rms_total": number(total_rms(errors)),
        "figure95": number(textbook95(errors)),
        "largest": number(float(np.nanmax(np.hypot(*errors.T))) if np.isfinite(errors).any() else float("nan")),
    }


def headline(fit: ControlFit) -> str:
    """Which errors tell how good a fit is: 'residuals', or 'leave_one_out' where it passes through its points."""
    return "residuals" if fit.redundancy > 0 else "leave_one_out"


def accuracy_facts(fit: ControlFit, metres: FloatArray) -> dict[str, Any]:
    """What residuals and leave-one-out errors come to, in pixels, map units and metres (factors (2,) of x and y)."""
    return {
        "points": len(fit.ids),
        "headline": headline(fit),
        "residuals": {
            "px": error_facts(fit.residuals),
            "map": error_facts(fit.map_residuals),
            "m": error_facts(fit.map_residuals * metres),
        },
        "leave_one_out": {
            "points": int(np.isfinite(fit.leave_one_out).all(axis=1).sum()),
            "px": error_facts(fit.leave_one_out),
            "map": error_facts(fit.map_leave_one_out),
            "m": error_facts(fit.map_leave_one_out * metres),
        },
        "redundancy": fit.redundancy,
        "sigma0": number(fit.sigma0),
    }


def parameter_facts(fit: ControlFit, most: int = 60) -> list[dict[str, Any]]:
    """Parameters with their standard deviations; none for a fit of more than `most`, such as a spline."""
    found = fit.model.parameters
    if len(found) > most:
        return []
    sigmas = np.sqrt(np.maximum(np.diagonal(fit.covariance), 0.0))
    return [
        {"name": name, "unit": unit, "value": float(value), "sigma": number(float(sigma))}
        for name, unit, value, sigma in zip(found.names, found.units, found.values, sigmas, strict=True)
    ]


def write_files(
    facts: Mapping[str, Any], image: Path, source: CRS, crs: CRS, files: Mapping[str, Path], *, overwrite: bool
) -> None:
    """Write the three files of `files`, by ending.

    Parameters
    ----------
    facts : mapping
        See `report.report_facts`.
    image : Path
        For the picture.
    source, crs : CRS
        Of the points in the facts, and of the vectors.
    files : mapping of str to Path
        '.json', '.html' and '.gpkg'.
    overwrite : bool

    Raises
    ------
    OutputError, OutputExistsError
    """
    text = json.dumps(facts, indent=1, ensure_ascii=False, allow_nan=False)
    write_text(files[".json"], text + "\n", overwrite=overwrite)
    write_text(files[".html"], render_control(facts, image), overwrite=overwrite)
    write_residuals(files[".gpkg"], facts["points"], source, crs, overwrite=overwrite)
