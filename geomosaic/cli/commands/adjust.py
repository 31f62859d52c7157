"""Adjust the block of a project: tie points, control, camera positions in one solution.

Help group: Orientation and accuracy
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from geomosaic.cli.options import FILE, running_options
from geomosaic.cli.output import answer, notes, progress
from geomosaic.cli.process import on_sigterm
from geomosaic.cli.results import adjusted_text, verdict
from geomosaic.errors import InputError


@click.command()
@click.argument("project", type=FILE)
@click.option("--force", is_flag=True, help="Adjust again where nothing has changed.")
@running_options
def command(project: Path, force: bool, as_json: bool) -> int:
    """Adjust the block of a project, and say how good it is, and which measurements are wrong.

    What is to be adjusted stands in [adjust] of the project. It is the step `orient` of `geomosaic run`, whose mosaic
    takes the adjusted orientations. Written are the models of the images with their covariances, the orientations as a
    table, the adjusted points with theirs as a GeoPackage, and all facts as JSON.

    \b
    Example:
      geomosaic adjust block.toml
      geomosaic run block.toml
    """
    from geomosaic.jobs.project import run_project
    from geomosaic.jobs.run_control import Stop
    from geomosaic.project.load import load_project

    if load_project(project).adjustment is None:
        raise InputError(
            "the project has no section [adjust]",
            where=str(project),
            hint='add it with what was measured, such as\n    [adjust]\n    ties = "ties.csv"',
        )
    stop = Stop()
    with notes(), progress(as_json) as report, on_sigterm(stop.ask):
        done = run_project(project, steps=("orient",), force=force, progress=report, stop=stop)
    answer({"steps": [asdict(state) for state in done.states], **done.facts}, adjusted_text(done), as_json)
    return verdict(done.failure, as_json)
