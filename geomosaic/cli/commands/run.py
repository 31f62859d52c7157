"""Run what is stale in a project.

Help group: Projects
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import NoReturn

import click

from geomosaic.cli.options import FILE, chosen, options_of, running_options
from geomosaic.cli.output import answer, notes, progress, say
from geomosaic.cli.process import check_stopped, on_sigterm
from geomosaic.cli.results import outcome_text, verdict
from geomosaic.errors import GeomosaicError, Interrupted, listed
from geomosaic.options.render import RenderOptions


@click.command()
@click.argument("project", type=FILE)
@click.argument("steps", nargs=-1, metavar="[STEP...]")
@click.option("--force", is_flag=True, help="Run the steps whether stale or not.")
@click.option("--watch", is_flag=True, help="Stay, and run again when a file that the project reads has changed.")
@options_of(RenderOptions, made=True, only=("threads", "memory_limit", "workers"))
@running_options
def command(
    project: Path,
    steps: tuple[str, ...],
    force: bool,
    watch: bool,
    as_json: bool,
    options: RenderOptions,
) -> int:
    """Run what is stale in a project: match, orient, mosaic, orthos, check, report.

    With STEP, run that step and what it reads from. A run that was stopped goes on with the step it was in.

    With --watch, each edit that is saved elsewhere - a seam in QGIS, a setting in the project file - is in the outputs
    seconds later, sooner than by a new run, which would have to start everything anew. Ctrl-C ends it. With --json
    every run answers with a line of its own.
    """
    from geomosaic.jobs.project import run_project
    from geomosaic.jobs.run_control import Stop

    threads, limit = chosen("threads", options), chosen("memory_limit", options)

    def once(force: bool) -> int:
        stop = Stop()
        with notes(), progress(as_json) as report, on_sigterm(stop.ask):
            done = run_project(
                project, steps=steps, force=force, threads=threads, memory_limit=limit, workers=options.workers,
                progress=report, stop=stop,
            )  # fmt: skip
        answer({"steps": [asdict(state) for state in done.states], **done.facts}, outcome_text(done), as_json)
        return verdict(done.failure, as_json)

    if watch:
        _watch(project, once, force, as_json)
    return once(force)


def _watch(project: Path, once: Callable[[bool], int], force: bool, as_json: bool) -> NoReturn:
    """Runs of a project, one after each change; errors are told, and the next change may mend them."""
    from geomosaic.cli.output import failed
    from geomosaic.jobs.run_control import FileStates, file_states, make_ready, wait_for_change

    before: FileStates = {}
    while True:
        before = file_states(_read(project)) | before  # what is read by now; the rest as it was when it was last seen
        try:
            once(force)
        except Interrupted:
            raise
        except Exception as error:
            failed(error, as_json=as_json, debug="--debug" in sys.argv)
        # Only the first run is forced; the later ones answer to changes.
        force = False
        say(f"waiting for changes of {project.name} and of what it reads; Ctrl-C ends")
        # Loading takes seconds that the next run, which someone waits for, then saves.
        make_ready()
        check_stopped()
        now = wait_for_change(before)
        changed = [path.name for path in now if now[path] != before[path]]
        say(f"changed: {listed(changed, 3)}")
        before = now


def _read(project: Path) -> list[Path]:
    """Files that a project reads; the project file alone, where that is wrong."""
    from geomosaic.jobs.project import job_of
    from geomosaic.jobs.run_control import read_by
    from geomosaic.project.load import is_pattern, load_project

    with suppress(GeomosaicError, OSError), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the run says them
        loaded = load_project(project)
        patterns = any(map(is_pattern, loaded.settings.project.images))
        folders = {image.parent for image in loaded.images} if patterns else set()  # where photos may come
        return [*read_by(job_of(loaded)), *sorted(folders)]
    return [project.resolve()]
