"""Results of a fit to control points: JSON values, residual vectors, and the control report."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.control.coordinate_diagnostics import Diagnostic
from geomosaic.control.parsing import Reading
from geomosaic.estimation.expected_errors import ExpectedErrors, expected_text
from geomosaic.estimation.statistics import axis_rms, total_rms
from geomosaic.geo.crs import crs_label, horizontal
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import length_unit, metres_per_unit, unit_name
from geomosaic.georeferencing.blunder_check import BlunderCheck
from geomosaic.georeferencing.model_trial import kind_order
from geomosaic.georeferencing.solution import Solution
from geomosaic.options.control import FitOptions
from geomosaic.orientation.single.check_points import CheckStatistics
from geomosaic.orientation.single.fit import ControlBlunders, ControlFit, circular_error_95
from geomosaic.orientation.single.model_selection import Deletion, ModelChoice
from geomosaic.raster.files import write_text
from geomosaic.raster.vector import Layer, write_layers
from geomosaic.render.ortho import OrthoResult
from geomosaic.report.control import Picture, render_control
from geomosaic.sensor.corrected import model_to_dict
from geomosaic.sensor.registry import plane_sensor
from geomosaic.sensor.solve import expected_errors
from geomosaic.types import FloatArray
from geomosaic.whole_files import finite, plain

# Drawn length of the longest residual, as a share of the diagonal of the points' extent.
LONGEST = 0.05

# Columns of the layers, each with the key and the axis of the report's points that it holds.
FIELDS = {
    "residual_col": ("residual_px", 0),
    "residual_row": ("residual_px", 1),
    "residual_x": ("residual_map", 0),
    "residual_y": ("residual_map", 1),
    "standardised_col": ("standardised", 0),
    "standardised_row": ("standardised", 1),
    "redundancy_col": ("redundancy_numbers", 0),
    "redundancy_row": ("redundancy_numbers", 1),
    "left_out_col": ("leave_one_out_px", 0),
    "left_out_row": ("leave_one_out_px", 1),
}


def _write_residuals(
    path: Path, points: Sequence[Mapping[str, Any]], source: CRS, crs: CRS, *, overwrite: bool
) -> float:
    """GeoPackage with the layers `points` and `residuals`.

    A residual runs from the control point to the map position of the measured image point, enlarged by the factor in
    the column `enlarged`.
    """
    from shapely import LineString, Point

    places = np.array([[point["x"], point["y"]] for point in points], dtype=np.float64).reshape(-1, 2)
    steps = np.array([_pair(point["residual_map"]) for point in points], dtype=np.float64).reshape(-1, 2)
    factor = _enlargement(places, steps)
    to_crs = Transform(horizontal(source), horizontal(crs))
    starts, ends = to_crs(places), to_crs(places + factor * np.nan_to_num(steps))
    drawn = np.isfinite(steps).all(axis=1)
    layers = {"points": Layer(crs, "Point", [Point(*xy) for xy in starts], _columns(points))}
    kept = np.flatnonzero(drawn).tolist()
    lines = [LineString([starts[i], ends[i]]) for i in kept]
    columns = {**_columns([points[i] for i in kept]), "enlarged": [factor] * len(kept)}
    layers["residuals"] = Layer(crs, "LineString", lines, columns)
    write_layers(path, layers, overwrite=overwrite)
    return factor


def _enlargement(places: FloatArray, steps: FloatArray) -> float:
    """Round factor (1, 2 or 5 times a power of ten) that draws the longest vector at about `LONGEST`."""
    lengths = np.hypot(*steps.T)
    longest = float(np.nanmax(lengths)) if np.isfinite(lengths).any() else 0.0
    if not longest > 0.0:
        return 1.0
    limit = max(1e-9, LONGEST * float(np.hypot(*np.ptp(places, axis=0)))) / longest
    power = 10.0 ** math.floor(math.log10(limit))
    return float(max(step * power for step in (1, 2, 5) if step * power <= limit * (1 + 1e-9)))


def _pair(values: Sequence[float | None] | None) -> list[float]:
    return [float("nan")] * 2 if values is None else [float("nan") if v is None else v for v in values]


def _columns(points: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    columns: dict[str, list[Any]] = {name: [point[name] for point in points] for name in ("id", "state", "col", "row")}
    for name, (key, axis) in FIELDS.items():
        columns[name] = [_pair(point[key])[axis] for point in points]
    lengths = zip(columns["residual_col"], columns["residual_row"], strict=True)
    columns["residual_px"] = [math.hypot(*pair) for pair in lengths]
    return columns


def diagnostic_facts(diagnostics: Sequence[Diagnostic]) -> list[dict[str, Any]]:
    """JSON values of findings.

    Parameters
    ----------
    diagnostics : sequence of Diagnostic
    """
    return [
        {"code": a.code, "severity": a.severity, "what": a.what, "points": list(a.points), "hint": a.hint}
        for a in diagnostics
    ]


def statistics_facts(found: CheckStatistics) -> dict[str, Any]:
    """JSON values of check point statistics, in the unit of the map.

    Parameters
    ----------
    found : CheckStatistics
    """
    return {
        "check_points": len(found),
        "unit": found.unit,
        "rms": plain(found.rms),
        "rms_total": finite(found.rms_total),
        "circular_error_95": finite(found.circular_error_95),
        "mean_shift": plain(found.mean),
        "spread": plain(found.spread),
        "shift_probability": finite(found.shift_probability),
        "shifted": bool(found.shifted),
        "shift_statement": found.shift_statement,
        "nssda": finite(found.nssda),
        "nssda_statement": found.nssda_statement,
        "survey_rms": found.survey_rms,
        "rms_with_survey": finite(found.rms_with_survey),
        "asprs_statement": found.asprs_statement,
    }


def _error_facts(errors: FloatArray) -> dict[str, Any]:
    """RMS per axis and total, 95 % figure and largest length of errors (N, 2), in their unit."""
    return {
        "rms": plain(axis_rms(errors)),
        "rms_total": finite(total_rms(errors)),
        "circular_error_95": finite(circular_error_95(errors)),
        "largest": finite(float(np.nanmax(np.hypot(*errors.T))) if np.isfinite(errors).any() else float("nan")),
    }


def _accuracy_facts(fit: ControlFit, metres: FloatArray) -> dict[str, Any]:
    """Accuracy from residuals and leave-one-out errors: pixels, map units, metres (`metres` (2,): metres per unit)."""
    return {
        "points": len(fit.ids),
        "headline": "residuals" if fit.redundancy > 0 else "leave_one_out",
        "residuals": {
            "px": _error_facts(fit.residuals),
            "map": _error_facts(fit.map_residuals),
            "m": _error_facts(fit.map_residuals * metres),
        },
        "leave_one_out": {
            "points": int(np.isfinite(fit.leave_one_out).all(axis=1).sum()),
            "px": _error_facts(fit.leave_one_out),
            "map": _error_facts(fit.map_leave_one_out),
            "m": _error_facts(fit.map_leave_one_out * metres),
        },
        "redundancy": fit.redundancy,
        "sigma0": finite(fit.sigma0),
        "expected": _expected_facts(fit),
    }


def _expected_facts(fit: ControlFit) -> dict[str, Any]:
    """Expected errors at the corners and in the middle of the image, see `ExpectedErrors.facts`; `said` in words."""
    covariance = fit.cofactors.parameters * fit.variance_factor
    places, sigmas = expected_errors(fit.model, covariance, 0.0, fit.model.crs)
    fits = [(fit.redundancy, 2 * len(fit.ids))]
    facts = ExpectedErrors.of(["the image"], places[None], sigmas[None], fits, left_out=fit.errs_by_omission).facts
    return {**facts, "said": expected_text(facts, "image")}


def _parameter_facts(fit: ControlFit, most: int = 60) -> list[dict[str, Any]]:
    """Parameters with standard deviations; none for a fit of more than `most` parameters, such as a spline."""
    found = fit.model.parameters
    if len(found) > most:
        return []
    covariance = fit.covariance
    sigmas = np.sqrt(np.maximum(covariance if covariance.ndim == 1 else np.diagonal(covariance), 0.0))
    return [
        {"name": name, "unit": unit, "value": float(value), "sigma": finite(float(sigma))}
        for name, unit, value, sigma in zip(found.names, found.units, found.values, sigmas, strict=True)
    ]


def write_control_report(
    facts: Mapping[str, Any], picture: Picture, source: CRS, crs: CRS, files: Mapping[str, Path], *, overwrite: bool
) -> None:
    """Files of the control report: facts, page and residual vectors.

    Parameters
    ----------
    facts : mapping
        See `report.report_facts`.
    picture : Picture
        Of the image, to be shown on the page.
    source, crs : CRS
        CRS of the points in the facts, and of the vectors.
    files : mapping of str to Path
        Paths by suffix: '.json', '.html' and '.gpkg'.
    overwrite : bool

    Raises
    ------
    OutputError, OutputExistsError
        A file cannot be written, or exists.
    """
    text = json.dumps(facts, indent=1, ensure_ascii=False, allow_nan=False)
    write_text(files[".json"], text + "\n", overwrite=overwrite)
    write_text(files[".html"], render_control(facts, picture), overwrite=overwrite)
    _write_residuals(files[".gpkg"], facts["points"], source, crs, overwrite=overwrite)


def report_facts(
    image: Path,
    size: tuple[int, int],
    reading: Reading,
    request: FitOptions,
    solution: Solution,
    product: Mapping[str, Any],
) -> dict[str, Any]:
    """Facts of the control report: image, control, fit, accuracy, checks, findings, points and product.

    Parameters
    ----------
    image : Path
    size : tuple of int
        Width and height of the image, pixels.
    reading : Reading
    request : FitOptions
    solution : Solution
    product : mapping
        Of `ortho_facts`, or those of a vector file.
    """
    fit, states = solution.fit, solution.states
    kind, order = kind_order(solution.model)
    metres = metres_per_unit(solution.crs, fit.xyz[:, :2].mean(axis=0))
    counts = {state: states.count(state) for state in ("control", "check", "deleted", "suspect", "disabled")}
    return {
        "image": {"path": str(image), "name": image.name, "width": size[0], "height": size[1]},
        "control": {
            "path": reading.control.origins[0].path,
            "format": reading.format,
            "crs": crs_label(reading.control.crs),
            "heights": "not used: the fit is plane" if reading.control.ground.shape[1] == 3 else "none",
            "notes": list(reading.notes),
            "points": len(states),
            **counts,
        },
        "fit": {
            "model": solution.model,
            "kind": kind,
            "order": order,
            "asked": request.model,
            "why": solution.why,
            "crs": crs_label(solution.crs),
            "unit": unit_name(solution.crs),
            "length_unit": length_unit(solution.crs),
            "metres_per_unit": plain(metres),
            "mirrored": bool(fit.mirrored),
            "parameters": _parameter_facts(fit),
            "state": model_to_dict(plane_sensor(), fit.model),
        },
        "accuracy": _accuracy_facts(fit, metres),
        "check": None if solution.check is None else _check_facts(solution),
        "choice": _choice_facts(solution.choice),
        "deletion": _deletion_facts(solution.deletion),
        "robust": _blunder_facts(solution.robust, solution.blunder_summary, solution.blunder_check),
        "diagnostics": diagnostic_facts(solution.diagnostics),
        "points": _point_facts(solution, metres),
        "product": dict(product),
    }


def ortho_facts(product: OrthoResult, resampling: str) -> dict[str, Any]:
    """JSON values of the raster that a fit draws.

    Parameters
    ----------
    product : OrthoResult
    resampling : str
    """
    grid = product.grid
    return {
        "path": str(product.path),
        "crs": crs_label(grid.crs),
        "width": grid.width,
        "height": grid.height,
        "resolution": list(grid.resolution),
        "unit": unit_name(grid.crs),
        "bounds": list(grid.bounds),
        "valid_pixels": product.valid_pixels,
        "resampling": resampling,
        "lattice_error_px": finite(product.lattice_error),
        "tolerance_px": product.tolerance,
        "image_pixels_per_output_pixel": finite(product.scale),
    }


def _check_facts(solution: Solution) -> dict[str, Any]:
    judges = np.array([state == "check" for state in solution.states])
    found = statistics_facts(solution.check) if solution.check is not None else {}
    return {**found, "px": _error_facts(solution.residuals[judges])}


def _choice_facts(found: ModelChoice | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "model": found.name,
        "why": found.summary.removeprefix(f"{found.name}: "),
        "odd": list(found.outliers),
        "tried": [
            {
                "model": row.name,
                "parameters": row.parameters,
                "redundancy": row.redundancy,
                "rms_px": finite(row.rms),
                "leave_one_out_px": finite(row.leave_one_out),
                "chance": finite(row.gain),
                "refused": row.refused,
            }
            for row in found.table
        ],
    }


def _deletion_facts(found: Deletion | None) -> dict[str, Any] | None:
    if found is None:
        return None
    first = found.deleted[0].rms_before if found.deleted else found.fit.rms_total
    return {
        "threshold_px": found.threshold,
        "limits_px": None if found.limits is None else list(found.limits),
        "reached": found.reached,
        "said": found.summary,
        "rms_all_px": first,
        "rms_left_px": found.fit.rms_total,
        "deleted": [
            {
                "order": row.order,
                "id": row.id,
                "residual_px": plain(row.residual),
                "rms_before_px": row.rms_before,
                "rms_after_px": row.rms_after,
                "left": row.left,
            }
            for row in found.deleted
        ],
    }


def _blunder_facts(found: ControlBlunders | None, summary: str, check: BlunderCheck | None) -> dict[str, Any]:
    if check is None:
        return _search_facts(found, summary)
    first = {
        "said": check.summary,
        "blunders": list(check.blunders),
        "suspicious": list(check.suspicious),
        "rms_px": finite(check.rms),
        "errors_px": {name: finite(length) for name, length in check.lengths.items()},
    }
    facts = _search_facts(found, summary)
    return {**facts, "without_model": first, "blunders": list(dict.fromkeys([*facts["blunders"], *check.blunders]))}


def _search_facts(found: ControlBlunders | None, summary: str) -> dict[str, Any]:
    if found is None:
        return {"said": summary, "blunders": []}
    good = found.estimate.fit
    return {
        "said": summary,
        "agree": found.agree,
        "blunders": list(found.blunders),
        "breakdown_point": found.breakdown_point,
        "snooping": {
            "blunders": list(found.snooping.blunders),
            "readmitted": list(found.snooping.readmitted),
            "alpha": found.snooping.alpha,
            "scale": finite(found.snooping.scale),
            "rms_total_px": finite(found.snooping.fit.rms_total),
        },
        "m_estimator": {
            "blunders": list(found.estimate.blunders),
            "scale": finite(found.estimate.scale),
            "rounds": found.estimate.rounds,
            "settled": found.estimate.settled,
            "rms_total_px": finite(good.rms_total),
            "leave_one_out_rms_px": finite(good.leave_one_out_rms),
            "points": len(good.ids),
        },
    }


def _point_facts(solution: Solution, metres: FloatArray) -> list[dict[str, Any]]:
    control, fit = solution.control, solution.fit
    rows = {name: i for i, name in enumerate(fit.ids)}
    found = []
    for i, name in enumerate(control.names):
        k = rows.get(name)
        moved = solution.map_residuals[i]
        found.append(
            {
                "id": name,
                "state": solution.states[i],
                "origin": str(control.origins[i]),
                "col": float(control.colrow[i, 0]),
                "row": float(control.colrow[i, 1]),
                "x": float(control.xy[i, 0]),
                "y": float(control.xy[i, 1]),
                "sigma_px": float(control.sigma[i]),
                "residual_px": plain(solution.residuals[i]),
                "residual_map": plain(moved),
                "residual_m": plain(moved * metres),
                "standardised": None if k is None else plain(fit.standardised[k]),
                "redundancy_numbers": None if k is None else plain(fit.redundancy_numbers[k]),
                "leave_one_out_px": None if k is None else plain(fit.leave_one_out[k]),
                "leave_one_out_m": None if k is None else plain(fit.map_leave_one_out[k] * metres),
            }
        )
    return found
