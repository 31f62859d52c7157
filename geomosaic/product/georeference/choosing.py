"""Which fit suits the control, by the errors of points left out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from geomosaic.adjust.fit import fit_control
from geomosaic.control.points import ImageControl
from geomosaic.errors import SolveError
from geomosaic.product.georeference.request import MODELS


@dataclass(frozen=True)
class Choice:
    model: str
    why: str
    tried: tuple[dict[str, Any], ...]

    def facts(self):
        return {"why": self.why, "tried": list(self.tried)}


def choose_model(image: str, size: tuple[int, int], points: ImageControl) -> Choice:
    from geomosaic.product.georeference.solution import builder
    tried = []
    for name in MODELS:
        try:
            fit = fit_control(builder(name, image, size, points), points.names, points.xy, points.colrow, points.sigma)
            tried.append({"model": name, "rms_px": fit.rms_total, "leave_one_out_px": fit.leave_one_out_rms, "redundancy": fit.redundancy, "said": ""})
        except SolveError as error:
            tried.append({"model": name, "rms_px": None, "leave_one_out_px": None, "redundancy": None, "said": error.what})
    ok = [t for t in tried if t["leave_one_out_px"] == t["leave_one_out_px"] and t["leave_one_out_px"] is not None]
    best = min(t["leave_one_out_px"] for t in ok)
    one = next(t for t in ok if t["leave_one_out_px"] <= 1.05 * best)
    return Choice(one["model"], "x", tuple(tried))
