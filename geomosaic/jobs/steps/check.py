"""Step 'check': hold the mosaic against what is known better, and the numbers against their thresholds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from geomosaic.errors import QualityError
from geomosaic.jobs.facts import read_json, write_json
from geomosaic.jobs.layout import Layout
from geomosaic.jobs.step import Context
from geomosaic.project.load import Project


def check(project: Project, context: Context) -> Mapping[str, Any]:
    """Compare with the reference, where there is one, and judge."""
    from geomosaic.product.checks.check import against_reference

    layout, quality = Layout(project), project.settings.quality
    orientation, made = read_json(layout.facts("orient")), read_json(layout.facts("mosaic"))
    path = project.file(quality.reference)
    reference = against_reference(layout.mosaic, path, progress=context.progress) if path is not None else None
    context.progress(1, 1, "check")
    found = {
        "max_control_rms_px": ("control points, RMS", orientation["rms_control_px"], "px"),
        "max_check_rms_px": ("check points, RMS", orientation["rms_check_px"], "px"),
        "max_lattice_error_px": ("interpolation of the geometry, largest error", made["lattice_error_px"], "px"),
        "max_seam_mismatch_px": (
            "mismatch of images along seams, largest",
            (made.get("seam_quality") or {}).get("worst_mismatch_px"),
            "px of the mosaic",
        ),
        "max_registration_px": (
            "registration on the reference, RMS",
            reference["registration_rms_px"] if reference else None,
            "px of the reference",
        ),
    }
    verdicts = []
    for name, (what, value, unit) in found.items():
        limit = getattr(quality, name)
        if limit is not None:
            passed = value is not None and value <= limit
            verdicts.append(
                {"name": name, "what": what, "value": value, "limit": limit, "unit": unit, "passed": passed}
            )
    for points in orientation["astray"]:
        if getattr(quality, f"max_{points['role']}_rms_px") is None:  # a limit of the user's own is the one that counts
            verdicts.append(
                {
                    "name": f"{points['role']}_median_px", "what": f"{points['role']} points, median distance",
                    "value": points["median"], "limit": points["limit"], "unit": "px", "passed": False,
                    "text": points["text"],
                }
            )  # fmt: skip
    facts = {"reference": reference, "reference_path": quality.reference, "verdicts": verdicts}
    write_json(layout.facts("check"), facts)
    return {"passed": all(verdict["passed"] for verdict in verdicts)}


def failure(project: Project) -> QualityError | None:
    """Make the error that says which thresholds failed; None where none did."""
    path = Layout(project).facts("check")
    if not path.is_file():
        return None
    failed = [verdict for verdict in read_json(path)["verdicts"] if not verdict["passed"]]
    if not failed:
        return None
    words = [
        f"{v['what']}: {'not measured' if v['value'] is None else format(v['value'], '.3g')}, "
        f"limit {v['limit']:g} {v['unit']}"
        for v in failed
    ]
    why = "".join(f"; {verdict['text']}" for verdict in [v for v in failed if "text" in v][:1])
    return QualityError(
        "; ".join(words),
        where=f"{project.path.name}, [quality]",
        mend=f"all outputs are written; look at {Layout(project).report}{why}",
    )
