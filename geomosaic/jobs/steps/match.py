"""Step "match": tie points measured in the images, control points found in a reference."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from geomosaic.errors import InputError
from geomosaic.inputs.vertical_datums import positions_crs
from geomosaic.jobs.manifest import Layout, recorded_warnings, write_json
from geomosaic.jobs.step import Context, Machine
from geomosaic.options.naming import keys_in_errors
from geomosaic.options.tie_points import TiePointOptions
from geomosaic.project.load import Project
from geomosaic.types import Progress
from geomosaic.whole_files import write_atomic

if TYPE_CHECKING:
    from geomosaic.block_adjustment.start import StartBlock
    from geomosaic.tie_points.control import ReferenceControl


def match(project: Project, machine: Machine, context: Context) -> Mapping[str, Any]:
    """Step "match": the table of tie points, the page that shows them, and what was found in each image and pair.

    Parameters
    ----------
    project : Project
    machine : Machine
    context : Context

    Returns
    -------
    dict
        Number of `images`, tie `points`, image `positions` and `pairs`.

    Raises
    ------
    InputError
        An input is missing or wrong.
    SolveError
        No two images show anything in common.
    """
    from geomosaic.block_adjustment.start import start_block
    from geomosaic.tie_points.diagnostics import nothing_in_common
    from geomosaic.tie_points.run import match_start

    layout, options = Layout(project), replace(project.matching or TiePointOptions(), **machine.options)
    with recorded_warnings() as notes, keys_in_errors(project.path.name, "match"):
        start = start_block(project.blocks)
        control = None if options.reference is None else _found_control(project, start, options, context.progress)
        found = match_start(start, options, context.progress)
        if not len(found.ties) and control is None:
            raise nothing_in_common(found.images, found.features)
    table, page = layout.ties
    if control is not None:
        for file in layout.reference_page:
            write_atomic(file, control.page(project.name, notes))
    found.ties.write(table)
    write_atomic(page, found.page(project.name, notes))
    facts = {**found.facts, "control": None if control is None else control.facts, "warnings": notes}
    write_json(layout.facts("match"), facts)
    return {
        "images": len(found.images), "points": len(found.rays), "positions": len(found.ties), "pairs": len(found.pairs)
    }  # fmt: skip


def _found_control(
    project: Project, start: StartBlock, options: TiePointOptions, progress: Progress
) -> ReferenceControl:
    """Control points found in the reference, and their table."""
    from geomosaic.tie_points.control import reference_control

    given = next((part for part in project.blocks if part.control is not None), None)
    if given is not None:
        raise InputError(
            "control points are given, and others are to be found in a reference",
            where="`reference`",
            hint="leave out one of both; `geomosaic match` writes those found as a table",
        )
    found = reference_control(start, options, progress)
    for file in project.found_control:
        found.write(file, positions_crs(project.inputs.crs or start.ground.to_wkt(), project.inputs.heights))
    return found
