"""Run the sample block from photos to mosaic, with its accuracy.

Help group: Projects
"""

from __future__ import annotations

from pathlib import Path

import click

from geomosaic.cli.options import FILE, chosen, options_of, running_options
from geomosaic.cli.output import answer, notes, progress, say
from geomosaic.cli.process import on_sigterm
from geomosaic.cli.results import accuracy_lines, verdict
from geomosaic.options.render import RenderOptions


@click.command()
@click.argument("folder", type=FILE, default="geomosaic-demo")
@options_of(RenderOptions, made=True, only=("threads", "memory_limit"))
@running_options
def command(folder: Path, as_json: bool, options: RenderOptions) -> int:
    """Make a mosaic of the sample block in FOLDER, and compare it with the truth it was made from.

    Twelve raw photos with known orientation over relief: from the orientation table to one balanced mosaic with its
    report, as `geomosaic run` does it.
    """
    from geomosaic.jobs.project import run_project
    from geomosaic.jobs.run_control import Stop

    say(f"the sample block and its mosaic are made in {folder}")
    stop = Stop()
    with notes(), progress(as_json) as report, on_sigterm(stop.ask):
        threads, limit = chosen("threads", options), chosen("memory_limit", options)
        done = run_project(folder, sample=True, threads=threads, memory_limit=limit, progress=report, stop=stop)
    facts = done.facts
    seconds = sum(state.seconds or 0.0 for state in done.states if not state.fresh)
    lines = [
        *accuracy_lines(facts),
        f"{seconds:.1f} s",
        *(f"{name}: {path}" for name, path in facts["outputs"].items()),
    ]
    answer({"folder": str(folder), "seconds": seconds, **facts}, "\n".join(lines), as_json)
    return verdict(done.failure, as_json)
