"""Steps of a project and their dependencies: match, orient, mosaic, orthos, check, report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geomosaic.errors import GeomosaicError, InputError, QualityError
from geomosaic.execution.units import workers_for
from geomosaic.geo.crs import is_local, parse_crs
from geomosaic.jobs import engine
from geomosaic.jobs.manifest import Layout, read_json, write_json
from geomosaic.jobs.run_control import Stop
from geomosaic.jobs.step import (
    KEYS_OF_IMAGES,
    Job,
    Machine,
    State,
    Step,
    plugin_versions,
    sensor_files,
    with_companions,
)
from geomosaic.jobs.steps.match import match
from geomosaic.jobs.steps.mosaic import mosaic, orthos
from geomosaic.jobs.steps.orient import orient
from geomosaic.jobs.steps.report import check, failure, report
from geomosaic.options.declaration import paths_of
from geomosaic.options.inputs import CRS_FILES
from geomosaic.options.memory import threads_within
from geomosaic.options.naming import keys_in_errors
from geomosaic.options.render import RenderOptions
from geomosaic.project.load import Project, load_project
from geomosaic.project.sample_block import copy_sample
from geomosaic.raster.files import companion
from geomosaic.raster.info import inspect
from geomosaic.sensor.registry import capabilities
from geomosaic.stores.path import to_path
from geomosaic.types import PathLike, Progress
from geomosaic.whole_files import path_of

if TYPE_CHECKING:
    from geomosaic.execution.run_report import RunReport


def job_of(project: Project, machine: Machine | None = None) -> Job:
    """Job of a project: match (where wanted), orient, mosaic, orthos (where wanted), check, report.

    Parameters
    ----------
    project : Project
    machine : Machine, optional
        Threads and memory; they change no result and are no part of what makes a step stale.
    """
    machine = machine or Machine()
    layout, settings, blocks = Layout(project), project.settings, project.blocks
    against = project.quality.quality_reference
    images, said_of_images = _together(with_companions(project, part.images, part.bands) for part in blocks)
    ground, said_of_ground = _together(with_companions(project, part.ground) for part in blocks)
    reference, said_of_reference = with_companions(project, (against,) if against is not None else ())
    options = project.options
    reference_raster = options.colours.reference
    master, said_of_master = with_companions(project, () if reference_raster is None else (reference_raster,))
    drawn = tuple(path for path in paths_of(options) if path != reference_raster)
    named = project.area.dst_crs or ""
    frame = (to_path(named),) if named.lower().endswith(CRS_FILES) else ()
    masks = tuple(dict.fromkeys(file for part in blocks for file in part.masks))
    tables = tuple(
        dict.fromkeys(
            file for part in blocks for file in (*part.tables, *sensor_files(part.sensor, (*part.images, *part.tables)))
        )
    )
    keys = _keys_of(project)
    orientation: dict[str, Any] = {
        **{name: keys[name] for name in keys if name.startswith(_ORIENTATION)},
        **{f"[project] {name}": keys[f"[project] {name}"] for name in KEYS_OF_IMAGES},
        # Images count by content among the inputs; their names and order count too, since tables name images.
        "images": [path.name for path in project.images],
        **plugin_versions(*(part.sensor for part in blocks)),
        **said_of_images,
        **said_of_ground,
    }
    place: dict[str, Any] = {name: keys[name] for name in keys if name.startswith("[output]")}
    # Where outputs lie, and whether there are orthos, shows in the outputs of the steps.
    del place["[output] folder"], place["[output] orthos"]
    blend: dict[str, Any] = {**{name: keys[name] for name in keys if name.startswith("[mosaic]")}, **said_of_master}
    wants_labels = (layout.labels,) if options.writes_labels else ()
    # A STAC item needs a place on Earth.
    with keys_in_errors(project.path.name):
        nowhere = _in_local_frame(project)
    relief = options.records.displacement is not None
    wants_views = (*((layout.views,) if options.records.views else ()), *((layout.displacement,) if relief else ()))
    accuracy = (layout.accuracy,) if options.uncertainty.accuracy else ()
    beside = (*wants_labels, *wants_views, *accuracy, layout.vectors)
    index = () if options.records.tiling is None else (companion(layout.mosaic, "", ".gti.gpkg"),)
    rasters = (layout.mosaic, *index, *beside, *(() if nowhere else (layout.item,)))
    every_ortho = layout.orthos if settings.output.orthos else ()
    every_ortho += layout.ortho_accuracies if every_ortho and accuracy else ()
    of_errors = paths_of(options.uncertainty)
    exterior = () if layout.exterior is None else (layout.exterior,)
    adjusted = layout.adjustment if layout.tie_section is None else (*layout.adjustment, layout.tie_section)
    measured = project.measurements
    oriented = (*layout.models, layout.facts("orient"), *exterior, *adjusted, *layout.surface)

    steps = []
    if project.matching is not None:
        said = project.matching.reference, project.matching.leave_out
        looked_in = tuple(path for path in said if path is not None)
        steps.append(
            Step(
                "match",
                partial(match, project, machine),
                _without_adjustment(orientation) | {name: keys[name] for name in keys if name.startswith("[match]")},
                (*images, *tables, *masks, *ground, *looked_in),
                (*layout.ties, *layout.reference_page, *project.found_control, layout.facts("match")),
            )
        )
    steps += [
        Step(
            "orient",
            partial(orient, project, machine),
            orientation,
            (*images, *tables, *measured, *ground),
            oriented,
        ),
        Step(
            "mosaic",
            partial(mosaic, project, machine),
            {**orientation, **place, **blend},
            (*images, *ground, *layout.surface, *master, *drawn, *masks, *frame, *layout.models),
            (*rasters, layout.facts("mosaic"), layout.places),
            made=lambda: layout.tiles,
        ),
    ]
    if every_ortho:
        steps.append(
            Step(
                "orthos",
                partial(orthos, project, machine),
                {**orientation, **place, "true_ortho": options.render.true_ortho},
                (*images, *ground, *layout.surface, *masks, *frame, *of_errors, *layout.models),
                every_ortho,
                layout.no_orthos,
            )
        )
    steps += [
        Step(
            "check",
            partial(check, project, machine),
            {**{name: keys[name] for name in keys if name.startswith("[quality]")}, **said_of_reference},
            (layout.mosaic, *reference, layout.facts("orient"), layout.facts("mosaic")),
            (layout.facts("check"),),
        ),
        Step(
            "report",
            partial(report, project),
            {"name": project.name},
            (
                project.path, *images, *tables, *measured, *ground, *reference, *rasters, *every_ortho, *exterior,
                *adjusted, *layout.surface,
                *(layout.facts(name) for name in ("orient", "mosaic", "check")), layout.places,
            ),
            (layout.report, layout.report_json),
            layout.no_orthos,
        ),
    ]  # fmt: skip
    return Job(tuple(steps), project.folder, project.state)


def _without_adjustment(orientation: Mapping[str, Any]) -> dict[str, Any]:
    """What decides about the images before their adjustment, of which matching knows nothing."""
    return {name: value for name, value in orientation.items() if not name.startswith("[adjust]")}


def _in_local_frame(project: Project) -> bool:
    """Whether the mosaic lies in a frame that is not tied to the Earth, as far as the inputs tell before any work."""
    inputs = next(part for part in project.blocks if project.images[0] in part.images)  # the first image decides
    if inputs.planar is not None and inputs.planar.is_local(controlled=inputs.control is not None):
        return True
    for named, where in ((project.area.dst_crs, "`dst_crs`"), (inputs.crs, "`crs`")):
        if named is not None:
            return is_local(parse_crs(named, where))
    with suppress(GeomosaicError):  # the step that reads it says what is wrong with it
        own = inspect(project.images[0]).crs
        return capabilities(inputs.sensor).planar and own is not None and is_local(own)
    return False


def _together(
    parts: Iterable[tuple[tuple[Path, ...], dict[str, str]]],
) -> tuple[tuple[Path, ...], dict[str, str]]:
    """Files of several blocks, each once, and what was said of them."""
    every = tuple(parts)
    files = dict.fromkeys(file for found, _ in every for file in found)
    return tuple(files), {name: text for _, said in every for name, text in said.items()}


# Sections that decide about the models of the images.
_ORIENTATION = ("[sensor]", "[[images]]", "[exterior]", "[dem]", "[planar]", "[adjust]")


def _keys_of(project: Project) -> dict[str, Any]:
    """Values of all keys of the project file, defaults included, by section and key as `status` names them."""
    sections = project.settings.model_dump(mode="json")
    found = {name: values for name, values in sections.items() if isinstance(values, dict)}
    tables = {"[[images]]": sections["images"]} if sections["images"] else {}
    return tables | {f"[{name}] {key}": value for name, values in found.items() for key, value in values.items()}


# What each worker of the last run on workers did, in the project's folder of records.
RUN_REPORT = "run.json"


@dataclass(frozen=True)
class Outcome:
    """Outcome of a project run.

    Attributes
    ----------
    project : Project
    states : list of State
        Of the steps that were looked at.
    failure : QualityError or None
        Thresholds that failed; everything is written all the same.
    run : RunReport, optional
        What each worker did; None where threads of the process did everything.
    """

    project: Project
    states: list[State]
    failure: QualityError | None
    run: RunReport | None = None

    def __repr__(self) -> str:
        states = ", ".join(f"{state.name} {'fresh' if state.fresh else 'stale'}" for state in self.states)
        return f"Outcome('{self.project.path}', {states}{f', {self.failure.what}' if self.failure else ''})"

    @property
    def facts(self) -> dict[str, Any]:
        """Facts of the steps, paths of the outputs that exist, and the failed thresholds."""
        layout = Layout(self.project)
        found = {name: layout.facts(name) for name in ("match", "orient", "mosaic", "check")}
        outputs = {"mosaic": layout.mosaic, "vectors": layout.vectors, "report": layout.report}
        outputs |= {} if layout.exterior is None else {"exterior": layout.exterior}
        outputs |= dict(zip(("points", "adjustment", "adjustment_report"), layout.adjustment, strict=False))
        outputs |= dict(zip(("surface", "surface_sigma"), layout.surface, strict=False))
        return {
            **{name: read_json(path) for name, path in found.items() if path.is_file()},
            "outputs": {name: str(path) for name, path in outputs.items() if path.is_file()},
            "quality": self.failure.what if self.failure else None,
            **({} if self.run is None else {"run": self.run.facts}),
        }


def run_project(
    path: PathLike,
    *,
    steps: Sequence[str] = (),
    force: bool = False,
    dry_run: bool = False,
    sample: bool = False,
    threads: int | None = None,
    memory_limit: int | None = None,
    workers: Any = None,
    progress: Progress | None = None,
    stop: Stop | None = None,
) -> Outcome:
    """Run of what is stale in a project.

    Parameters
    ----------
    path : path
        Project file; of the sample a folder, which gets it where it does not have it yet.
    steps : sequence of str
        'match', 'orient', 'mosaic', 'orthos', 'check', 'report'; each with what it reads from. All unless given.
    force : bool
        Run them whether stale or not.
    dry_run : bool
        Run nothing: the state of each step alone.
    sample : bool
        Run the sample block: twelve photos over relief, whose mosaic is compared with the truth.
    threads : int, optional
        Unless given all processors, or as many as a limit that is given has room for.
    memory_limit : int, optional
        Bytes.
    workers : int, str, concurrent.futures.Executor or distributed.Client, optional
        What renders orthos and mosaic in place of threads, see `RenderOptions`.
    progress : callable, optional
        Called with (done, total, stage).
    stop : Stop, optional
        Asked to stop from another thread or by a signal.

    Returns
    -------
    Outcome
        The state of each step; `failure` is set where a quality threshold failed, `facts` has the figures.

    Raises
    ------
    GeomosaicError
    """
    file = path_of(path, "path")
    project = load_project(copy_sample(file) if sample else file)
    if dry_run:
        useless = [name for name, value in (("steps", steps), ("force", force)) if value]
        if useless:
            raise InputError(f"`{useless[0]}` would do nothing with `dry_run`", hint=f"leave out `{useless[0]}`")
        return Outcome(project, status_of(project), None)
    only = (steps,) if isinstance(steps, str) else tuple(steps)
    if memory_limit is not None:
        wanted = project.options
        asked = {"true_ortho": wanted.render.true_ortho, "blend": wanted.blending.blend}
        threads = threads_within("run", memory_limit, {"threads": threads, **asked})
    machine = Machine(threads, memory_limit, workers)
    return run_steps(project, only=only, force=force, machine=machine, progress=progress, stop=stop)


def run_steps(
    project: Project,
    *,
    only: Sequence[str] = (),
    force: bool = False,
    machine: Machine | None = None,
    progress: Progress | None = None,
    stop: Stop | None = None,
) -> Outcome:
    """Run of what is stale in a project, then a verdict on its quality.

    Parameters
    ----------
    project : Project
    only, force, progress, stop
        See `engine.run`.
    machine : Machine, optional
        Threads and memory; all there are unless given.

    Returns
    -------
    Outcome
        Failed thresholds are in `failure`, not raised: all where 'check' or 'report' was looked at, those of the
        orientation where 'orient' was.

    Raises
    ------
    GeomosaicError
        See `engine.run`; options are named by their section and key in the project file.
    """
    job = job_of(project, machine)
    with keys_in_errors(project.path.name), workers_for(RenderOptions(**(machine or Machine()).options)) as run:
        try:
            states = engine.run(job, only=only, force=force, progress=progress, stop=stop)
        finally:
            if run is not None and run.units:  # of a run that ends early, too
                write_json(project.state / RUN_REPORT, run.facts)
    looked_at = {state.name for state in states}
    judged = "check" if looked_at & {"check", "report"} else "orient" if "orient" in looked_at else None
    verdict = changed_inputs(states) or (failure(project, judged) if judged else None)
    return Outcome(project, states, verdict, run)


def changed_inputs(states: Sequence[State]) -> QualityError | None:
    """Failure of a run whose inputs were changed while it was under way; None where none was.

    Parameters
    ----------
    states : sequence of State
    """
    changed = {path: state.name for state in reversed(states) for path in state.changed}
    if not changed:
        return None
    path, step = next(iter(changed.items()))
    more = f"; so were {len(changed) - 1} more" if len(changed) > 1 else ""
    return QualityError(
        f"an input of step '{step}' was changed while the project ran: the outputs may show neither state of it{more}",
        where=str(path),
        hint="run the project again when nothing changes its inputs",
    )


def status_of(project: Project) -> list[State]:
    """State of each step of a project, see `engine.status`.

    Parameters
    ----------
    project : Project
    """
    return engine.status(job_of(project))
