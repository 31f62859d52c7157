"""Step "match": tie points measured in the images."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from geomosaic.jobs.manifest import Layout, recorded_warnings, write_json
from geomosaic.jobs.step import Context
from geomosaic.options.naming import keys_in_errors
from geomosaic.options.tie_points import TiePointOptions
from geomosaic.project.load import Project
from geomosaic.whole_files import write_atomic


def match(project: Project, context: Context) -> Mapping[str, Any]:
    """Step "match": the table of tie points, the page that shows them, and what was found in each image and pair.

    Parameters
    ----------
    project : Project
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
    from geomosaic.tie_points.doubts import nothing_in_common
    from geomosaic.tie_points.run import match_start

    layout, options = Layout(project), project.matching or TiePointOptions()
    with recorded_warnings() as notes, keys_in_errors(project.path.name, "match"):
        found = match_start(start_block(project.blocks), options, context.progress)
    if not len(found.ties):
        with keys_in_errors(project.path.name, "match"):
            raise nothing_in_common(found.images, found.features)
    table, page = layout.ties
    found.ties.write(table)
    write_atomic(page, found.page(project.name, notes))
    facts = {**found.facts, "warnings": notes}
    write_json(layout.facts("match"), facts)
    return {
        "images": len(found.images), "points": len(found.rays), "positions": len(found.ties), "pairs": len(found.pairs)
    }  # fmt: skip
