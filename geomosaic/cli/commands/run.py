"""`geomosaic run`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from geomosaic.cli.memory import note_memory
from geomosaic.cli.options import FILE, machine_options
from geomosaic.cli.outcome import outcome_words, verdict
from geomosaic.cli.talk import answer, notes, progress


@click.command()
@click.argument("project", type=FILE)
@click.argument("steps", nargs=-1, metavar="[STEP...]")
@click.option("--force", is_flag=True, help="Run the steps whether stale or not.")
@machine_options
def command(
    project: Path, steps: tuple[str, ...], force: bool, threads: int | None, mem_limit: int | None, as_json: bool
) -> int:
    """Run what is stale in a project: orient, mosaic, orthos, check, report.

    With STEP, run that step and what it reads from. A run that was stopped goes on with the step it was in.
    """
    from geomosaic.jobs.project import run_project
    from geomosaic.jobs.step import Machine
    from geomosaic.project.load import load_project

    loaded, machine = load_project(project), Machine(threads, mem_limit)
    note_memory(mem_limit, threads)
    with notes(), progress(as_json) as report:
        done = run_project(loaded, only=steps, force=force, machine=machine, progress=report)
    answer({"steps": [asdict(state) for state in done.states], **done.facts}, outcome_words(done), as_json)
    return verdict(done.failure, as_json)
