"""Step 'report': gather what all steps found and hand it to the report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import geomosaic
from geomosaic.jobs.digest import versions
from geomosaic.jobs.facts import plain, read_json, write_json
from geomosaic.jobs.layout import Layout
from geomosaic.jobs.step import Context
from geomosaic.project.atomic import write_atomic
from geomosaic.project.load import Project


def report(project: Project, context: Context) -> Mapping[str, Any]:
    """Write report.html and report.json."""
    from geomosaic.product.report.report import render_html

    layout = Layout(project)
    data = plain(gather(project, context.digests))
    context.progress(0, 1, "report")
    write_atomic(layout.report, render_html(data, layout.mosaic, layout.vectors, read_json(layout.places)))
    write_json(layout.report_json, data)
    context.progress(1, 1, "report")
    return {"report": layout.report.name}


def gather(project: Project, digests: Mapping[Path, str]) -> dict[str, Any]:
    """Everything that was done, with its numbers."""
    layout, inputs = Layout(project), project.inputs
    facts = {step: read_json(layout.facts(step)) for step in ("orient", "mosaic", "check")}
    roles = {
        inputs.camera: "camera",
        inputs.fiducials: "fiducials",
        inputs.exterior: "orientations",
        inputs.dem: "DEM",
        inputs.control: "control points",
        project.file(project.settings.quality.reference): "reference",
        project.path: "project",
    }
    read = [*project.images, *(path for path in roles if path is not None)]
    written = {
        layout.mosaic: "mosaic",
        layout.labels: "source image of each pixel",
        layout.views: "view angle and resolution of each pixel",
        layout.displacement: "relief displacement of each pixel",
        layout.vectors: "footprints and seamlines",
        layout.item: "STAC item",
        **dict.fromkeys(layout.orthos if project.settings.output.orthos else (), "ortho"),
    }
    return {
        "format": 1,
        "name": project.name,
        "geomosaic": geomosaic.__version__,
        "versions": versions(),
        "inputs": [_file(path, roles.get(path, "image"), project, digests) for path in read],
        "outputs": [_file(path, role, project, digests) for path, role in written.items() if path.is_file()],
        "warnings": [*facts["orient"]["warnings"], *facts["mosaic"]["warnings"]],
        **facts,
    }


def _file(path: Path, role: str, project: Project, digests: Mapping[Path, str]) -> dict[str, Any]:
    name = path.relative_to(project.folder).as_posix() if path.is_relative_to(project.folder) else str(path)
    return {"path": name, "role": role, "bytes": path.stat().st_size, "sha256": digests.get(path)}
