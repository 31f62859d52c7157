"""Runs of a job: which steps are stale and why, and running those in order."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError, OutputError, OutputExistsError
from geomosaic.jobs.manifest import Manifest, Record
from geomosaic.jobs.run_control import Stop, project_lock
from geomosaic.jobs.step import Context, Job, State, Step, ingredients
from geomosaic.raster.files import Hashes
from geomosaic.types import Progress, no_progress

MANIFEST, LOCK = "manifest.json", "lock"


def status(job: Job) -> list[State]:
    """State of each step of a job: fresh, or stale with the first reason.

    Nothing is run or written.

    Parameters
    ----------
    job : Job

    Returns
    -------
    list of State
        In the order of the steps; a step that reads an output of a stale one is stale too.
    """
    manifest = Manifest.load(job.state / MANIFEST)
    hashes = Hashes(manifest.hashes)
    states: list[State] = []
    stale: dict[Path, str] = {}
    for step in (each.settled() for each in job.steps):
        state = _state(job, step, manifest, hashes, stale)
        if not state.fresh:
            stale |= dict.fromkeys(step.outputs, step.name)
        states.append(state)
    return states


def run(
    job: Job,
    *,
    only: Sequence[str] = (),
    force: bool = False,
    progress: Progress | None = None,
    executor: Executor | None = None,
    stop: Stop | None = None,
) -> list[State]:
    """Run of the stale steps of a job.

    Parameters
    ----------
    job : Job
    only : sequence of str
        Names of the steps wanted; the steps they read from run too where stale.
    force : bool
        Run the wanted steps whether stale or not.
    progress : callable, optional
        Called with (done, total, stage); reaches the steps where they run in this process.
    executor : concurrent.futures.Executor, optional
        Where steps run; in this thread unless given.
    stop : Stop, optional
        A flag by which another thread or a signal handler asks the run to stop.

    Returns
    -------
    list of State
        One per step that was looked at; `reason` says why it ran, or 'fresh'.

    Raises
    ------
    InputError
        No step of that name, or another run is under way.
    OutputExistsError
        An output exists that no run of this job has made.
    Interrupted
        `stop` was asked for; what is done stays done.
    """
    wanted = _wanted(job.steps, only)
    stop = stop or Stop()
    with project_lock(job.state / LOCK):
        manifest = Manifest.load(job.state / MANIFEST)
        hashes = Hashes(manifest.hashes)
        _refuse_foreign(job, wanted, manifest)
        states: list[State] = []
        taken: list[dict[Path, str]] = []
        for each in wanted:  # one by one: earlier ones decide
            step = each.settled()
            stop.check()
            state = _state(job, step, manifest, hashes, {})
            forced = force and (not only or step.name in only)
            digests: dict[Path, str] = {}
            if forced or not state.fresh:
                _claim(job, step, manifest)
                # Taken before the step runs: an input changed meanwhile then makes the step stale next time.
                parts = _dependency_digests(job, step, hashes)
                started = time.perf_counter()
                digests = {path: hashes.of(path) for path in step.inputs}
                try:
                    facts = _execute(step, Context(stop.watching(progress), digests, forced, hashes.of), executor)
                except BaseException:
                    _disclaim(job, manifest)
                    raise
                step = each.settled()  # with the outputs that only now are known
                _claim_made(job, step, manifest)
                record = _record(job, step, parts, facts, time.perf_counter() - started, hashes)
                manifest.records[step.name] = record
                manifest.save()
                reason = "forced" if state.fresh else state.reason
                state = State(step.name, False, reason, record.seconds, record.finished)
            states.append(state)
            taken.append({path: digest for path, digest in digests.items() if path not in step.outputs})
        states = [
            replace(state, changed=tuple(path for path in digests if _is_changed(path, digests[path], hashes)))
            for state, digests in zip(states, taken, strict=True)
        ]
        manifest.save()
        stop.check()
    return states


def _is_changed(path: Path, digest: str, hashes: Hashes) -> bool:
    try:
        return hashes.of(path) != digest
    except InputError:  # it is gone
        return True


def _dependency_digests(job: Job, step: Step, hashes: Hashes) -> dict[str, str]:
    """Everything the step's result depends on, as it is now."""
    files = {job.name(path): hashes.of(path) for path in step.inputs}
    return ingredients(step, files)


def _refuse_foreign(job: Job, steps: Sequence[Step], manifest: Manifest) -> None:
    """Check, before any work, that no output is a file that this job has not made."""
    for step in steps:
        for path in step.outputs:
            if path.exists() and job.name(path) not in manifest.owned:
                raise OutputExistsError(
                    f"step '{step.name}' would write over a file that this project has not made",
                    where=str(path),
                    hint="move it away, or give the project another output folder",
                )


def _claim(job: Job, step: Step, manifest: Manifest) -> None:
    """Outputs of a step entered in the manifest as the job's own."""
    _refuse_foreign(job, [step], manifest)  # a file may have come while other steps ran
    # Saved before the step writes: what a run that was killed has left half made is still ours to replace.
    manifest.owned.update(map(job.name, step.outputs))
    manifest.save()


def _claim_made(job: Job, step: Step, manifest: Manifest) -> None:
    """Outputs that a run has found to be its own."""
    manifest.owned.update(map(job.name, step.outputs))


def _disclaim(job: Job, manifest: Manifest) -> None:
    """Manifest removed of a project in which nothing was ever made."""
    made = (path for step in job.steps for path in step.outputs if job.name(path) in manifest.owned)
    if not manifest.records and not any(path.exists() for path in made):
        manifest.path.unlink(missing_ok=True)


def _execute(step: Step, context: Context, executor: Executor | None) -> Mapping[str, Any]:
    if executor is None:
        return step.run(context)
    # The caller's progress function closes over its terminal and flags and need not be picklable.
    return executor.submit(step.run, replace(context, progress=no_progress)).result()


def _record(
    job: Job, step: Step, parts: Mapping[str, str], facts: Mapping[str, Any], seconds: float, hashes: Hashes
) -> Record:
    missing = [path for path in step.outputs if not path.is_file()]
    if missing:
        raise OutputError(f"step '{step.name}' ended without its output", where=str(missing[0]))
    outputs = {job.name(path): hashes.of(path) for path in step.outputs}
    finished = datetime.now(UTC).isoformat(timespec="seconds")
    return Record(parts, outputs, facts, round(seconds, 3), finished)


def _wanted(steps: Sequence[Step], only: Sequence[str]) -> list[Step]:
    """Steps asked for, and before them those whose outputs they read."""
    names = [step.name for step in steps]
    for name in only:
        if name not in names:
            raise InputError(f"no step named '{name}'", hint=f"steps of this project are: {', '.join(names)}")
    if not only:
        return list(steps)
    maker = {path: step for step in steps for path in step.outputs}
    needed: set[str] = set()
    queue = [step for step in steps if step.name in only]
    while queue:
        step = queue.pop()
        if step.name not in needed:
            needed.add(step.name)
            # Files that no step makes are inputs from outside.
            queue += [maker[path] for path in step.inputs if path in maker]
    return [step for step in steps if step.name in needed]


def _state(job: Job, step: Step, manifest: Manifest, hashes: Hashes, stale: Mapping[Path, str]) -> State:
    record = manifest.records.get(step.name)
    if record is None:
        return State(step.name, False, "never run")
    because = _because(job, step, record, hashes, stale)
    return State(step.name, because is None, because or "fresh", record.seconds, record.finished)


def _because(job: Job, step: Step, record: Record, hashes: Hashes, stale: Mapping[Path, str]) -> str | None:
    """First reason for running again."""
    for path in step.inputs:
        # A reader of a stale step is stale whatever its inputs hold now: they will be written anew.
        if path in stale:
            return f"step '{stale[path]}' is stale"
        if not path.is_file():
            return f"{path.name} is missing"
    now = _dependency_digests(job, step, hashes)
    changed = [name for name in {**record.ingredients, **now} if record.ingredients.get(name) != now.get(name)]
    if changed:
        return _change(changed)
    for path in step.outputs:
        if not path.is_file():
            return f"output {path.name} is missing"
        # An output edited by hand is made again: the record would otherwise vouch for a file it does not know.
        if record.outputs.get(job.name(path)) != hashes.of(path):
            return f"output {path.name} was changed"
    return None


def _change(names: list[str]) -> str:
    kind, _, rest = names[0].partition(" ")
    shown = {
        "file": f"{Path(rest).name} changed",
        "parameter": f"{rest} changed" if rest.startswith("[") else f"'{rest}' changed",
        "library": f"{rest} has another version",
        "step": "geomosaic computes it differently now",
    }.get(kind, "its ingredients changed")
    return shown if len(names) == 1 else f"{shown}, and {len(names) - 1} more"
