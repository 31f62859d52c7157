"""Steps "check" and "report": accuracy against limits, and the report of the project."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import geomosaic
from geomosaic.accuracy.check_points import expectation_verdicts, orientation_verdicts, quality_failure, verdict_on
from geomosaic.errors import QualityError
from geomosaic.inputs.declarations import file_of
from geomosaic.jobs.manifest import Layout, read_json, write_json
from geomosaic.jobs.step import Context, Machine, versions
from geomosaic.options.render import RunningOptions
from geomosaic.project.load import Project
from geomosaic.whole_files import plain, relative_path, write_atomic


def report(project: Project, context: Context) -> Mapping[str, Any]:
    """Step "report": report.html for people and report.json for programs.

    Parameters
    ----------
    project : Project
    context : Context

    Returns
    -------
    dict
        Name of the `report`.
    """
    from geomosaic.report.report import render_html

    layout = Layout(project)
    data = plain(_gather(project, context.digests))
    context.progress(0, 1, "report")
    ties = "" if layout.tie_section is None else layout.tie_section.read_text(encoding="utf-8")
    write_atomic(layout.report, render_html(data, layout.mosaic, layout.vectors, read_json(layout.places), ties))
    write_json(layout.report_json, data)
    context.progress(1, 1, "report")
    return {"report": layout.report.name}


def _gather(project: Project, digests: Mapping[Path, str]) -> dict[str, Any]:
    """Record of a project's result: inputs, outputs, versions, warnings and the facts of all steps."""
    layout = Layout(project)
    facts = {step: read_json(layout.facts(step)) for step in ("orient", "mosaic", "check")}
    exterior = layout.exterior
    named = (("camera", "camera"), ("fiducials", "fiducials"), ("exterior", "orientations"), ("dem", "DEM"))
    roles: dict[Path | None, str] = {
        **{
            file_of(getattr(part, name)): role
            for part in project.blocks
            for name, role in (*named, ("control", "control points"))
        },
        **dict.fromkeys(project.measurements, "measurements"),
        project.quality.quality_reference: "reference",
        project.path: "project",
    }
    read = [*project.images, *(path for path in roles if path is not None)]
    written = {
        layout.mosaic: "mosaic",
        layout.labels: "source image of each pixel",
        layout.views: "view angle and resolution of each pixel",
        layout.displacement: "relief displacement of each pixel",
        layout.accuracy: "standard deviation of position of each cell",
        layout.vectors: "footprints and seamlines",
        layout.item: "STAC item",
        **({} if exterior is None else {exterior: "exterior orientation"}),
        **dict(zip(layout.ties, ("tie points", "report of the tie points"), strict=False)),
        **dict.fromkeys(layout.reference_page, "report of the control from a reference"),
        **dict(
            zip(
                layout.adjustment,
                ("adjusted points", "block adjustment", "report of the block adjustment"),
                strict=False,
            )
        ),
        **dict(zip(layout.surface, ("ground from tie points", "standard deviation of the ground"), strict=False)),
        **dict.fromkeys(layout.orthos if project.settings.output.orthos else (), "ortho"),
        **dict.fromkeys(layout.ortho_accuracies if project.settings.output.orthos else (), "accuracy of an ortho"),
    }
    return {
        "format": 1,
        "name": project.name,
        "geomosaic": geomosaic.__version__,
        "versions": versions(),
        "inputs": [_file(path, roles.get(path, "image"), project, digests) for path in read],
        "outputs": [_file(path, role, project, digests) for path, role in written.items() if path.is_file()],
        "warnings": [*project.settings.project.notes, *facts["orient"]["warnings"], *facts["mosaic"]["warnings"]],
        **facts,
    }


def _file(path: Path, role: str, project: Project, digests: Mapping[Path, str]) -> dict[str, Any]:
    name = path.relative_to(project.folder).as_posix() if path.is_relative_to(project.folder) else str(path)
    return {"path": name, "role": role, "bytes": path.stat().st_size, "sha256": digests.get(path)}


def check(project: Project, machine: Machine, context: Context) -> Mapping[str, Any]:
    """Step "check": comparison with the reference image, where there is one, and verdicts on all limits.

    Parameters
    ----------
    project : Project
    machine : Machine
    context : Context

    Returns
    -------
    dict
        `passed`: whether all limits hold.
    """
    layout, quality = Layout(project), project.quality
    orientation, made = read_json(layout.facts("orient")), read_json(layout.facts("mosaic"))
    path = quality.quality_reference
    reference = None
    if path is not None:
        from geomosaic.accuracy.product_check import against_reference  # few projects have one, and all would load it

        running = RunningOptions(**machine.options)
        reference = against_reference(layout.mosaic, path, running=running, progress=context.progress)
    context.progress(1, 1, "check")
    found = {
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
    change = made["colour"].get("radiometric_change") or {}
    found |= {
        "max_clipped_percent": ("pixels clipped by colour corrections", change.get("clipped_percent"), "%"),
        "max_gain_spread_percent": ("spread of gains", change.get("gain_spread_percent"), "%"),
        "max_colour_trend_percent": ("trend of colour corrections", change.get("trend_percent"), "%"),
        "max_colour_difference": ("colour corrections, RMS", change.get("rms_difference"), "grey values"),
    }
    limits = {name: getattr(quality, name) for name in found}
    verdicts = orientation_verdicts(orientation, quality)
    verdicts += [verdict_on(name, *found[name][:2], limit, found[name][2]) for name, limit in limits.items() if limit]
    verdicts += expectation_verdicts(made.get("accuracy"))
    shown = None if path is None else relative_path(path, project.folder)
    facts = {"reference": reference, "reference_path": shown, "verdicts": verdicts}
    write_json(layout.facts("check"), facts)
    return {"passed": all(verdict["passed"] for verdict in verdicts)}


def failure(project: Project, step: str = "check") -> QualityError | None:
    """Error that names the limits a project failed.

    Parameters
    ----------
    project : Project
    step : str
        'check', or 'orient' for what its step found alone.

    Returns
    -------
    QualityError or None
        None where none failed, or nothing was checked yet.
    """
    layout = Layout(project)
    path = layout.facts(step)
    if not path.is_file():
        return None
    facts = read_json(path)
    verdicts = facts["verdicts"] if step == "check" else orientation_verdicts(facts, project.quality)
    hint = f"all outputs are written; look at {layout.report}" if step == "check" else "the orientation is written"
    return quality_failure(verdicts, f"{project.path.name}, [quality]", hint)
