"""Points of an image and their solution as values for the page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from geomosaic.control.edit import TableRow
from geomosaic.geo.units import metres_per_unit
from geomosaic.georeferencing.live_control import LiveControl
from geomosaic.options.control import MODELS
from geomosaic.studio.control.station import Station


def live_facts(station: Station, rows: Sequence[TableRow], live: LiveControl) -> dict[str, Any]:
    """JSON values of the points and their solution.

    Parameters
    ----------
    station : Station
        Image with its table, model and surface.
    rows : sequence of TableRow
        Of the image's table.
    live : LiveControl

    Returns
    -------
    dict
        Residuals in pixels, and in metres where the model has a map.
    """
    solution, planar = live.solution, isinstance(station.model, str)
    blamed = {name for one in live.diagnostics for name in one.points if one.severity == "error"}
    metres = np.ones((len(live.control), 2))
    if solution is not None and live.model is not None and not live.model.crs.is_geocentric:
        metres = metres_per_unit(live.model.crs, live.control.ground)[:, :2]
    texts = {row.values.get("id", ""): row.values for row in rows}
    points = []
    for index, name in enumerate(live.control.names):
        point: dict[str, Any] = {
            "id": name,
            "state": live.states[index],
            "role": live.control.roles[index],
            "enabled": bool(live.control.enabled[index]),
            "col": live.control.colrow[index, 0],
            "row": live.control.colrow[index, 1],
            "ground": [texts.get(name, {}).get(axis, "") for axis in ("x", "y", "z")],
            "blamed": name in blamed,
        }
        if solution is not None:
            point |= {
                "residual": solution.residuals[index].tolist(),
                "residual_m": (solution.map_residuals[index] * metres[index]).tolist(),
                "left_out": solution.leave_one_out[index].tolist(),
                "redundancy": solution.redundancy_numbers[index].tolist(),
                "toggled": {"sigma0": solution.toggled_sigma0[index], "rms": solution.toggled_rms[index]},
            }
        points.append(point)
    return {
        "image": station.path.name,
        "size": list(station.size),
        "table": station.table.name,
        "model": station.model if planar else "sensor",
        "models": [name for name in MODELS if name != "auto"] if planar else [],
        "points": points,
        "solution": None if solution is None else _solution_facts(live),
        "predicts": live.model is not None,
        "reason": live.reason,
        "messages": [
            {"code": one.code, "severity": one.severity, "what": one.what, "points": list(one.points), "hint": one.hint}
            for one in live.diagnostics
        ],
    }


def _solution_facts(live: LiveControl) -> dict[str, Any]:
    assert live.solution is not None
    solution, fit = live.solution, live.solution.fit
    lengths = np.hypot(*solution.leave_one_out[solution.used].T)
    known = lengths[np.isfinite(lengths)]
    residuals = fit.residuals
    return {
        "points": len(fit.ids),
        "rms": fit.rms_total,
        "rms_axes": np.sqrt((residuals**2).mean(axis=0)).tolist(),
        "sigma0": fit.sigma0,
        "redundancy": fit.redundancy,
        "leave_one_out": float(np.sqrt((known**2).mean())) if len(known) else None,
        "check_rms": live.check_rms,
        "clean_rms": solution.clean_rms,
    }
