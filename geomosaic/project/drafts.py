"""Drafts of project files for a block's inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from geomosaic.errors import InputError, OutputExistsError, listed
from geomosaic.inputs.declarations import Block, as_block, file_of
from geomosaic.inputs.exterior_orientation import (
    HEADLESS,
    RECONSTRUCTIONS,
    SYSTEMS,
    orientation_table,
    systems_of,
)
from geomosaic.inputs.summary import (
    list_missing_inputs,
    summarise_inputs,
)
from geomosaic.interchange.files import program_of
from geomosaic.project.draft_text import project_text
from geomosaic.project.folders import images_of
from geomosaic.project.image_metadata import embedded_inputs, with_proposals, write_tables
from geomosaic.project.photo_block import EmbeddedInputs
from geomosaic.project.reference_draft import found_in, on_map_of
from geomosaic.raster.files import check_output
from geomosaic.sensor.registry import embedded_sensors, photo_sensor, plane_sensor
from geomosaic.types import PathLike
from geomosaic.whole_files import path_of, write_atomic


@dataclass(frozen=True)
class Draft:
    """Draft of a project file.

    Attributes
    ----------
    path : Path
    text : str
    recognised : list of str
        What was read from the inputs, for people.
    needed : list of str
        What is missing.
    misfit : str or None
        What speaks against the inputs as a whole, such as an orientation that does not fit the ground.
    aside : mapping of str to str
        Pictures of folders that are not used, by name, each with the reason; they stand in the project as comments.
    """

    path: Path
    text: str
    recognised: list[str]
    needed: list[str]
    misfit: str | None
    aside: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"Draft('{self.path}', needed: {'; '.join(self.needed) or 'nothing'})"


def new_project(
    path: PathLike,
    images: Block | Sequence[PathLike] | PathLike,
    *,
    from_images: bool = True,
    angles: str | None = None,
    reference: PathLike | None = None,
    overwrite: bool = False,
) -> Draft:
    """Project file of images, with what is recognised of the inputs and what is still needed.

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
    reference : path, optional
        Georeferenced ortho or mosaic, however old, in which the control points of photos are to be found.
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
    old = None if reference is None else path_of(reference, "reference")
    named = [*(path for path in block.files if path not in block.images), *([] if old is None else [old])]
    found = images_of(block.images, named)
    block = replace(block, images=found.images)
    if old is not None:
        block = on_map_of(block, old)
    check_output(file, overwrite=overwrite, inputs=block.files)
    carried = EmbeddedInputs(block, lines=list(found.lines), aside=found.aside)
    unoriented = block.sensor == photo_sensor() and block.exterior is None
    if unoriented or (from_images and block.sensor == plane_sensor() and block.planar is None):
        carried = embedded_inputs(block, file, found)
    if old is not None:
        carried = found_in(carried, old)
    write_tables(carried, overwrite=overwrite)
    if carried.inputs.sensor in embedded_sensors():
        block, proposed = with_proposals(carried.inputs)
        carried = replace(carried, inputs=block, lines=[*carried.lines, *proposed])
    if angles is None and carried.inputs.angles != Block.angles:
        angles = carried.inputs.angles
    draft = draft_project(file, carried, angles)
    _write_project(draft, overwrite=overwrite)
    return draft


def draft_project(path: Path, carried: EmbeddedInputs, angles: str | None) -> Draft:
    """Draft of a project file.

    Parameters
    ----------
    path : Path
        Where the project file will be; paths in it start there.
    carried : EmbeddedInputs
        What is known.
    angles : str or None
        Angle system as declared; read off the columns of the table where it is not. A reconstruction does not say
        whose it is: its system stays open unless the names of the files tell.

    Raises
    ------
    InputError
        A file that was given cannot be read.
    """
    inputs, read, tied = carried.inputs, None, carried.adjust is not None
    exterior = file_of(inputs.exterior)
    if exterior is not None and angles is None:
        read = _system(exterior)
        inputs = replace(inputs, angles=read or inputs.angles)
        carried = replace(carried, inputs=inputs)
    needed = list_missing_inputs(inputs, tied=tied)
    if carried.aside:
        names = listed((f"{file.name} ({why})" for file, why in carried.aside.items()), 6, "; ")
        carried = replace(carried, notes=[*carried.notes, f"not used: {names}"])
    text = project_text(path, carried, read is not None)
    lines, misfit = summarise_inputs(inputs, tied=tied)
    aside = {file.name: why for file, why in carried.aside.items()}
    recognised = [*carried.lines, *lines, *_angles(inputs, read)]
    return Draft(path, text, recognised, [*carried.needed, *needed], misfit, aside)


def _write_project(draft: Draft, *, overwrite: bool = False) -> None:
    """Write a draft to its project file."""
    if draft.path.exists() and not overwrite:
        raise OutputExistsError("the project exists", where=str(draft.path), hint="give another name, or `overwrite`")
    write_atomic(draft.path, draft.text)


def _system(table: Path) -> str | None:
    """Angle system whose columns a table has, omega-phi-kappa where none fits, for its error; None if nothing tells."""
    program = program_of(table)
    if program is not None:
        return program
    if table.suffix.lower() == ".json":
        # OpenDroneMap keeps OpenSfM's own, under this name, beside the one that it has brought to its map.
        own = "reconstruction.topocentric.json"
        if table.name == own:
            return "opensfm"
        return "odm" if table.with_name(own).is_file() else None
    fitting = systems_of(orientation_table(table))
    return fitting[0] if fitting else "opk"


def _angles(inputs: Block, read: str | None) -> list[str]:
    """Lines on the angle system that was read off the table, and on others that it could be."""
    if read is None:
        return []
    if read in RECONSTRUCTIONS:
        own = "the name of OpenDroneMap's reconstruction.topocentric.json"
        return [f"angle system: {read}, by {own if read in ('opensfm', 'odm') else 'the name and the first lines'}"]
    if file_of(inputs.exterior) and Path(str(inputs.exterior)).name == HEADLESS:
        return [f"angle system: {read}, by the name of the table, which has no header"]
    others = [name for name, columns in SYSTEMS.items() if name != read and {*columns} == {*SYSTEMS[read]}]
    doubt = f"; the columns would also fit {', '.join(others)}: say `angles` if so" if others else ""
    return [f"angle system: {read}, from the columns of the table{doubt}"]
