"""Control report as JSON values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.control.parsing import Reading
from geomosaic.geo.crs import authority_code
from geomosaic.geo.units import metres_per_unit, unit_name
from geomosaic.georeferencing.blunder_check import BlunderCheck
from geomosaic.georeferencing.facts import (
    accuracy_facts,
    advice_facts,
    error_facts,
    finite_or_none,
    json_values,
    parameter_facts,
    statistics_facts,
)
from geomosaic.georeferencing.request import FitRequest, kind_order
from geomosaic.georeferencing.solution import Solution
from geomosaic.orientation.single.fit import ControlBlunders
from geomosaic.orientation.single.model_selection import ModelChoice
from geomosaic.orientation.single.point_deletion import Deletion
from geomosaic.render.ortho import OrthoResult
from geomosaic.sensor.corrected import model_to_dict
from geomosaic.sensor.registry import plane_sensor
from geomosaic.types import FloatArray


def report_facts(
    image: Path,
    size: tuple[int, int],
    reading: Reading,
    request: FitRequest,
    solution: Solution,
    product: OrthoResult,
    resampling: str,
) -> dict[str, Any]:
    """Facts of the control report: image, control, fit, accuracy, checks, findings, points and product."""
    fit, states = solution.fit, solution.states
    kind, order = kind_order(solution.model)
    metres = metres_per_unit(solution.crs, fit.xyz[:, :2].mean(axis=0))
    counts = {state: states.count(state) for state in ("control", "check", "deleted", "suspect", "disabled")}
    grid = product.grid
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
            "metres_per_unit": json_values(metres),
            "mirrored": bool(fit.mirrored),
            "parameters": parameter_facts(fit),
            "state": model_to_dict(plane_sensor(), fit.model),
        },
        "accuracy": accuracy_facts(fit, metres),
        "check": None if solution.check is None else _check_facts(solution),
        "choice": _choice_facts(solution.choice),
        "deletion": _deletion_facts(solution.deletion),
        "robust": _blunder_facts(solution.robust, solution.blunder_summary, solution.blunder_check),
        "advice": advice_facts(solution.advice),
        "points": _point_facts(solution, metres),
        "product": {
            "path": str(product.path),
            "crs": crs_label(grid.crs),
            "width": grid.width,
            "height": grid.height,
            "resolution": list(grid.resolution),
            "unit": unit_name(grid.crs),
            "bounds": list(grid.bounds),
            "valid_pixels": product.valid_pixels,
            "resampling": resampling,
            "lattice_error_px": finite_or_none(product.lattice_error),
            "tolerance_px": product.tolerance,
            "image_pixels_per_output_pixel": finite_or_none(product.scale),
        },
    }


def crs_label(crs: CRS) -> str:
    """Name of a CRS with its code."""
    code = authority_code(crs)
    return f"{crs.name} ({code})" if code else crs.name


def _check_facts(solution: Solution) -> dict[str, Any]:
    judges = np.array([state == "check" for state in solution.states])
    found = statistics_facts(solution.check) if solution.check is not None else {}
    return {**found, "px": error_facts(solution.residuals[judges])}


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
                "rms_px": finite_or_none(row.rms),
                "leave_one_out_px": finite_or_none(row.leave_one_out),
                "chance": finite_or_none(row.gain),
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
        "reached": found.reached,
        "said": found.summary,
        "rms_all_px": first,
        "rms_left_px": found.fit.rms_total,
        "deleted": [
            {
                "order": row.order,
                "id": row.id,
                "residual_px": json_values(row.residual),
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
        "rms_px": finite_or_none(check.rms),
        "errors_px": {name: finite_or_none(length) for name, length in check.lengths.items()},
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
            "scale": finite_or_none(found.snooping.scale),
            "rms_total_px": finite_or_none(found.snooping.fit.rms_total),
        },
        "m_estimator": {
            "blunders": list(found.estimate.blunders),
            "scale": finite_or_none(found.estimate.scale),
            "rounds": found.estimate.rounds,
            "settled": found.estimate.settled,
            "rms_total_px": finite_or_none(good.rms_total),
            "leave_one_out_rms_px": finite_or_none(good.leave_one_out_rms),
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
                "residual_px": json_values(solution.residuals[i]),
                "residual_map": json_values(moved),
                "residual_m": json_values(moved * metres),
                "standardised": None if k is None else json_values(fit.standardised[k]),
                "redundancy_numbers": None if k is None else json_values(fit.redundancy_numbers[k]),
                "leave_one_out_px": None if k is None else json_values(fit.leave_one_out[k]),
                "leave_one_out_m": None if k is None else json_values(fit.map_leave_one_out[k] * metres),
            }
        )
    return found
