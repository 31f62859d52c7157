"""A village through whose houses a seam runs: four photos of the sample, a mosaic of 2 x 2 tiles."""

from __future__ import annotations

import re
from pathlib import Path

import shapely

from geomosaic.jobs.project import run_project
from geomosaic.studio.toml_edit import with_value

BOUNDS = (400020.0, 5500080.0, 400420.0, 5500340.0)
# Well within it.
PLACE = shapely.box(*BOUNDS).buffer(-20)
# A house that the seam between the strips cuts, and a place in the garden before it.
HOUSE, GARDEN = shapely.box(400368, 5500192, 400380, 5500205), (400374.0, 5500182.0)
# Map units to both sides of a seam in which images are blended, and a rim for the weights' coarser cells.
FEATHER = 4.0 / 2 + 4.0


def village(project: Path, pixel: float = 0.5) -> Path:
    """Make a project of the four photos one of the village, and its mosaic."""
    text = re.sub(r"(?m)^bounds = .*$", f"bounds = {list(BOUNDS)}", project.read_text())
    text = with_value(text.replace("resolution = 1.0", f"resolution = {pixel}"), ("mosaic",), "feather", 4.0)
    project.write_text(text)
    run_project(project, steps=["mosaic"])
    return project
