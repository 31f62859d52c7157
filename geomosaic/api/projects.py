"""Projects that can be rerun, and the sensors that are installed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from geomosaic.errors import InputError
from geomosaic.inputs.declarations import Block, as_block
from geomosaic.jobs.project import Outcome, status_of
from geomosaic.jobs.project import run_project as run_loaded
from geomosaic.jobs.run_control import Stop
from geomosaic.jobs.step import Machine
from geomosaic.products import refuse_existing
from geomosaic.project.drafts import Draft, copy_sample, draft_project, write_project
from geomosaic.project.image_metadata import Carried, carried_by, images_of, with_proposals, write_tables
from geomosaic.project.load import load_project
from geomosaic.sensor.registry import SensorEntry, embedded_sensors, installed, photo_sensor, plane_sensor
from geomosaic.types import PathLike, Progress
from geomosaic.whole_files import path_of


def new_project(
    path: PathLike,
    images: Block | Sequence[PathLike] | PathLike,
    *,
    from_images: bool = True,
    angles: str | None = None,
    overwrite: bool = False,
) -> Draft:
    """Project file of images, with what is understood of the inputs and what is still needed.

    Parameters
    ----------
    path : path
        Ends in .toml; paths in the file start from its folder.
    images : Block, sequence of path or path
        A block whose inputs are files, or images; a folder stands for the images in it.
    from_images : bool
        Where no sensor is named, take what the images carry: RPC, DIMAP or a georeference in or beside them, position
        and attitude in EXIF and XMP, which go to a table beside the project. Of a frame sensor without orientation,
        EXIF and XMP are always read.
    angles : str, optional
        Angle system of the orientation table; that of the block, or read off the columns of the table unless given.
    overwrite : bool
        Replace an existing file.

    Returns
    -------
    Draft

    Raises
    ------
    InputError, OutputExistsError
    """
    file = path_of(path, "path")
    if file.suffix.lower() != ".toml":
        raise InputError("a project file ends in .toml", where=str(file), hint="such as project.toml")
    block = as_block(images)
    block = replace(block, images=images_of(block.images))
    refuse_existing(file, overwrite, block)
    carried = Carried(block)
    unoriented = block.sensor == photo_sensor() and block.exterior is None
    if unoriented or (from_images and block.sensor == plane_sensor() and block.planar is None):
        carried = carried_by(block, file)
        write_tables(carried, overwrite=overwrite)
        block = carried.inputs
    if block.sensor in embedded_sensors():
        block, proposed = with_proposals(block)
        carried = replace(carried, lines=[*carried.lines, *proposed])
    if angles is None and block.angles != Block.angles:
        angles = block.angles
    draft = draft_project(file, block, angles)
    draft = replace(draft, understood=[*carried.lines, *draft.understood], needed=[*carried.needed, *draft.needed])
    write_project(draft, overwrite=overwrite)
    return draft


def run_project(
    path: PathLike,
    *,
    steps: Sequence[str] = (),
    force: bool = False,
    dry_run: bool = False,
    sample: bool = False,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
    stop: Stop | None = None,
) -> Outcome:
    """Run of what is stale in a project.

    Parameters
    ----------
    path : path
        Project file; of the sample a folder, which gets it where it does not have it yet.
    steps : sequence of str
        'orient', 'mosaic', 'orthos', 'check', 'report'; each with what it reads from. All unless given.
    force : bool
        Run them whether stale or not.
    dry_run : bool
        Run nothing: the state of each step alone.
    sample : bool
        Run the sample block: twelve photos over relief, whose mosaic is compared with the truth.
    threads : int, optional
        All processors unless given.
    memory_limit : int, optional
        Bytes.
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
    machine = Machine(threads, memory_limit)
    return run_loaded(project, only=only, force=force, machine=machine, progress=progress, stop=stop)


def sensors() -> list[SensorEntry]:
    """Sensors that are installed, by name; none of them is loaded."""
    return installed()
