"""Projects that can be rerun, the sensors that are installed, and the planning of flights and products."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from geomosaic.errors import InputError, did_you_mean
from geomosaic.inputs.declarations import Block
from geomosaic.jobs.project import Outcome
from geomosaic.jobs.project import run_project as run_loaded
from geomosaic.jobs.step import Machine
from geomosaic.planning.relations import TOPICS
from geomosaic.planning.solve import Derived, derive
from geomosaic.products import refuse_existing
from geomosaic.project.draft.write import Draft, draft_project, write_project
from geomosaic.project.load import load_project
from geomosaic.sensor.registry import SensorEntry, installed
from geomosaic.types import PathLike


def new_project(path: PathLike, block: Block, *, overwrite: bool = False) -> Draft:
    """Project file of a block, with what is understood of the inputs and what is still needed.

    Parameters
    ----------
    path : path
        Ends in .toml; paths in the file start from its folder.
    block : Block
        Its inputs are files.
    overwrite : bool
        Replace an existing file.

    Returns
    -------
    Draft

    Raises
    ------
    InputError, OutputExistsError
    """
    file = Path(path)
    if file.suffix.lower() != ".toml":
        raise InputError("a project file ends in .toml", where=str(file), hint="such as project.toml")
    refuse_existing(file, overwrite, block)
    draft = draft_project(file, block, block.angles)
    write_project(draft, overwrite=overwrite)
    return draft


def run_project(
    path: PathLike,
    *,
    steps: Sequence[str] = (),
    force: bool = False,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Callable[[int, int, str], None] | None = None,
) -> Outcome:
    """Run of what is stale in a project.

    Parameters
    ----------
    path : path
        Project file.
    steps : sequence of str
        'orient', 'mosaic', 'orthos', 'check', 'report'; each with what it reads from. All unless given.
    force : bool
        Run them whether stale or not.
    threads : int, optional
        All processors unless given.
    memory_limit : int, optional
        Bytes.
    progress : callable, optional
        Called with (done, total, stage).

    Returns
    -------
    Outcome
        The state of each step; `failure` is set where a quality threshold failed.

    Raises
    ------
    GeomosaicError
    """
    machine = Machine(threads, memory_limit)
    return run_loaded(load_project(path), only=tuple(steps), force=force, machine=machine, progress=progress)


def sensors() -> list[SensorEntry]:
    """Sensors that are installed, by name; none of them is loaded."""
    return installed()


def plan(topic: str, **known: float) -> dict[str, Derived]:
    """Quantities of a photo flight, its scans and its maps that follow from known ones.

    Parameters
    ----------
    topic : str
        'photo', 'relief', 'accuracy', 'swath' or 'overlap'.
    **known : float
        Quantities in the units of `geomosaic.planning.relations`: metres on the ground, mm in the camera.

    Returns
    -------
    dict of str to Derived
        Value and formula of what follows, by name.

    Raises
    ------
    InputError
        No such topic or quantity, or numbers that contradict each other.

    Examples
    --------
    >>> plan("photo", height=3000.0, camera_constant=150.0)["photo_scale"].value
    20000.0
    """
    if topic not in TOPICS:
        hint = did_you_mean(topic, TOPICS) or f"one of {', '.join(TOPICS)}"
        raise InputError(f"there is no topic '{topic}'", where="`topic`", hint=hint)
    relations = TOPICS[topic]
    names = {name for relation in relations for name in relation.names}
    unknown = sorted(set(known) - names)
    if unknown:
        hint = did_you_mean(unknown[0], names) or f"one of {', '.join(sorted(names))}"
        raise InputError(f"the topic '{topic}' has no quantity '{unknown[0]}'", hint=hint)
    return {item.name: item for item in derive(relations, known)}
