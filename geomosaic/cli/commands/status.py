"""Show which steps of a project are stale, and why.

Help group: Projects
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from geomosaic.cli.options import FILE, running_options
from geomosaic.cli.output import answer, notes
from geomosaic.cli.results import status_text


@click.command()
@click.argument("project", type=FILE)
@running_options
def command(project: Path, as_json: bool) -> None:
    """Show each step of a project: fresh, stale and why, or never run."""
    from geomosaic.jobs.project import run_project

    with notes():
        states = run_project(project, dry_run=True).states
    answer({"steps": [asdict(state) for state in states]}, status_text(states), as_json)
