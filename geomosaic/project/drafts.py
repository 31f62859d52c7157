"""Drafts of project files for a block's inputs, and the sample block that comes with the program."""

from __future__ import annotations

import glob
import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError, OutputError, OutputExistsError, listed
from geomosaic.inputs.declarations import Block, as_block, file_of
from geomosaic.inputs.exterior_orientation import (
    HEADLESS,
    RECONSTRUCTION_SYSTEM,
    RECONSTRUCTIONS,
    SYSTEM_NAMES,
    SYSTEMS,
    orientation_table,
    systems_of,
    undeclared_reconstruction,
)
from geomosaic.inputs.summary import (
    known_capabilities,
    list_missing_inputs,
    summarise_inputs,
    takes_positions,
    undeclared_heights,
)
from geomosaic.inputs.tables import stem
from geomosaic.interchange.files import program_of
from geomosaic.options.inputs import CORNER_SIGMA_PX, CRS_FILES, GEOID_FILES, PlanarInputs
from geomosaic.options.mosaic import TERMS
from geomosaic.project.folders import images_of
from geomosaic.project.image_metadata import carried_by, with_proposals, write_tables
from geomosaic.project.photo_block import NOWHERE, Carried
from geomosaic.raster.files import check_output
from geomosaic.sensor.plausibility import DATUMS
from geomosaic.sensor.registry import embedded_sensors, photo_sensor, plane_sensor
from geomosaic.types import PathLike
from geomosaic.whole_files import path_of, write_atomic

PROJECT = "project.toml"


def sample_folder() -> Path:
    """Folder of the sample: in the installed package, or in a checkout of the repository.

    Raises
    ------
    InputError
        The installation has none.
    """
    package = Path(str(files("geomosaic")))
    for folder in (package / "sample", package.parent / "data" / "sample"):
        if (folder / PROJECT).is_file():
            return folder
    raise InputError("this installation has no sample block", hint="reinstall geomosaic, or run from its repository")


def copy_sample(target: Path) -> Path:
    """Copy of the sample block in a folder of the user's.

    A folder that holds the sample already is used as it is; any other that is not empty is left alone.

    Parameters
    ----------
    target : Path

    Returns
    -------
    Path
        The project file in it.

    Raises
    ------
    InputError
        The folder holds something else, or the installation has no sample.
    OutputError
        The folder cannot be written.
    """
    source = sample_folder()
    project = target / PROJECT
    if project.is_file() and project.read_bytes() == (source / PROJECT).read_bytes():
        return project
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InputError("the folder exists and is not empty", where=str(target), hint="name another folder")
    partial = target / f".partial-{os.getpid()}"
    made = not target.exists()
    try:
        shutil.copytree(source, partial, ignore=shutil.ignore_patterns("output", ".*"))
        for entry in sorted(partial.iterdir(), key=lambda entry: entry.name == PROJECT):  # last what says it is whole
            entry.rename(target / entry.name)
    except OSError as error:
        # copytree goes on after a failure and lists them all as source, target, reason; they have one cause.
        reason = error.args[0][0][2] if isinstance(error, shutil.Error) else error.strerror
        raise OutputError(
            f"the sample cannot be copied: {reason}", where=str(target), hint="check free space and permissions"
        ) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        if made and not project.exists():
            with suppress(OSError):
                target.rmdir()
    return project


@dataclass(frozen=True)
class Draft:
    """Draft of a project file.

    Attributes
    ----------
    path : Path
    text : str
    understood : list of str
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
    understood: list[str]
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
    named = [path for path in block.files if path not in block.images]
    found = images_of(block.images, named)
    block = replace(block, images=found.images)
    check_output(file, overwrite=overwrite, inputs=block.files)
    carried = Carried(block, lines=list(found.lines), aside=found.aside)
    unoriented = block.sensor == photo_sensor() and block.exterior is None
    if unoriented or (from_images and block.sensor == plane_sensor() and block.planar is None):
        carried = carried_by(block, file, found)
        write_tables(carried, overwrite=overwrite)
    if carried.inputs.sensor in embedded_sensors():
        block, proposed = with_proposals(carried.inputs)
        carried = replace(carried, inputs=block, lines=[*carried.lines, *proposed])
    if angles is None and carried.inputs.angles != Block.angles:
        angles = carried.inputs.angles
    draft = draft_project(file, carried, angles)
    write_project(draft, overwrite=overwrite)
    return draft


def draft_project(path: Path, carried: Carried, angles: str | None) -> Draft:
    """Draft of a project file.

    Parameters
    ----------
    path : Path
        Where the project file will be; paths in it start there.
    carried : Carried
        What is known.
    angles : str or None
        Angle system as declared; read off the columns of the table where it is not. A reconstruction does not say
        whose it is: its system stays open unless the names of the files tell.

    Returns
    -------
    Draft

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
    text = _text(path, carried, read is not None)
    lines, misfit = summarise_inputs(inputs, tied=tied)
    aside = {file.name: why for file, why in carried.aside.items()}
    told = [*carried.lines, *lines, *_angles(inputs, read)]
    return Draft(path, text, told, [*carried.needed, *needed], misfit, aside)


def write_project(draft: Draft, *, overwrite: bool = False) -> None:
    """Write a draft to its project file.

    Parameters
    ----------
    draft : Draft
    overwrite : bool
        Replace an existing file.

    Raises
    ------
    OutputExistsError
        The file exists.
    OutputError
        Writing failed.
    """
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


def _text(path: Path, carried: Carried, read: bool) -> str:
    folder, inputs, tied = path.absolute().parent, carried.inputs, carried.adjust is not None
    undeclared = undeclared_reconstruction(inputs.exterior, inputs.angles)
    reconstruction = undeclared or inputs.angles in RECONSTRUCTIONS
    power = known_capabilities(inputs.sensor)

    def near(given: object) -> str:
        file = file_of(given)
        if file is None:
            raise InputError("a project names files, and a value is given", hint="write it to a file first")
        return _string(relative(file, folder))

    lines = [
        "# geomosaic project. Paths start from this file's folder; lines that start with # are to be filled in.",
        "format = 1",
        "",
        "[project]",
        f"name = {_string(stem(path.name))}",
        f'images = {_images(inputs.images, folder, carried.aside)}    # or patterns, such as "photos/*.tif"',
        *([f"bands = {list(inputs.bands)}    # counted from 1"] if inputs.bands else []),
        *(
            ["notes = [    # what the report repeats", *(f"    {_string(note)}," for note in carried.notes), "]"]
            if carried.notes
            else []
        ),
        "",
        "[sensor]",
        f"name = {_string(inputs.sensor)}    # `geomosaic sensors {inputs.sensor}` lists what may stand here",
    ]
    if inputs.camera is not None:
        lines.append(f"camera = {near(inputs.camera)}")
    elif power.needs_camera and not reconstruction:
        lines.append('# camera = "camera.toml"    # NEEDED')
    if inputs.corrections is not None:
        lines.append(f"corrections = {near(Path(inputs.corrections))}")
    if inputs.fiducials is not None:
        lines.append(f"fiducials = {near(inputs.fiducials)}")
    lines += [f"{key} = {_value(value)}" for key, value in inputs.options.items()]
    for options, paths in _alike(inputs):
        lines += ["", "[[images]]    # inputs of these images alone", f"path = {_images(paths, folder)}"]
        own = {**options, **({"camera": relative(Path(options["camera"]), folder)} if "camera" in options else {})}
        lines += [f"{key} = {_value(value)}" for key, value in own.items()]
    lines += ["", "[exterior]"]
    if inputs.exterior is not None:
        lines.append(f"file = {near(inputs.exterior)}")
    elif power.needs_exterior and not tied:
        mark = "" if inputs.control is not None else "NEEDED: "
        lines.append(f'# file = "exterior.csv"    # {mark}image, x, y, z, omega, phi, kappa')
    frames, said = "x and y here and of the control points", carried.said
    needed = "NEEDED with odm: " if undeclared else "NEEDED: " if takes_positions(inputs, power) else ""
    lines.append(
        f"crs = {_string(_declared(inputs.crs, folder))}    # {said.get('crs') or f'of {frames}'}"
        if inputs.crs
        else f'# crs = "EPSG:32633"    # {needed}of {frames}'
    )
    if inputs.heights:
        remark = said.get("heights") or "vertical datum of z"
        lines.append(f"heights = {_string(_declared(inputs.heights, folder))}    # {remark}")
    elif inputs.crs != NOWHERE:
        lines.append(f'# heights = "egm96"    # {needed}vertical datum of z: {DATUMS}')
    if undeclared:
        lines.append(f'# angles = "odm"    # NEEDED: {RECONSTRUCTION_SYSTEM}')
    elif inputs.exterior is not None:
        off = f"read off the {'name of the file' if reconstruction else 'columns'}; " if read else ""
        lines.append(f"angles = {_string(inputs.angles)}    # {off}{SYSTEM_NAMES.get(inputs.angles, '')}")
        if not reconstruction and inputs.angles != "none":
            unit = inputs.angle_unit
            lines.append(f"angle_unit = {_string(unit)}" if unit else '# angle_unit = "deg"    # deg, gon or rad')
        lines += [
            f"{k} = {_string(v)}" for k, v in (("angle_frame", inputs.angle_frame), ("matrix", inputs.matrix)) if v
        ]
    if inputs.planar is not None:
        lines += ["", *_planar(inputs.planar, near)]
    lines += ["", *_ground(inputs, near, folder, tied)]
    if inputs.control is not None:
        lines += ["", "[control]", f"file = {near(inputs.control)}"]
    if carried.adjust is not None:
        lines += ["", "[match]                      # tie points are measured in the photos", "", "[adjust]"]
        lines += carried.adjust
    elif inputs.planar is None:
        lines += [
            "",
            "# [adjust]                   # all images in one solution: geomosaic adjust",
            '# ties = "ties.csv"          # id, image, col, row; a section [match] measures them instead',
            "# position_sigma = 0.1       # metres; the positions of [exterior] are then observations",
            "# attitude_sigma = 0.01      # degrees; and its angles",
        ]
    lines += [
        "",
        "[output]",
        'folder = "output"',
        f"crs = {_string(carried.output_crs)}           # the UTM zone of the block"
        if carried.output_crs
        else '# crs = "EPSG:32633"         # that of the DEM or of the positions unless given',
        "# resolution = 0.5           # map units; that of the images unless given",
        "# bounds = [left, bottom, right, top]",
        'resampling = "bilinear"      # nearest, bilinear, cubic, lanczos, average',
        "tolerance = 0.02             # largest geometric error of the lattice, image pixels",
        "# orthos = true              # write an ortho of each image too",
        "",
        "[mosaic]",
        "balance = true               # gain and offset per image, solved over the overlaps",
        f'# colour = "auto"             # what else is solved: {", ".join(TERMS)}',
        '# mask = "clouds.gpkg"        # areas that say nothing of colours',
        '# histogram = "overlap"      # match histograms instead: overlap, whole or sequence',
        '# master = "photo_07.tif"    # image all are brought to; or: reference = "ortho.tif"',
        '# stretch = "2,98"           # to 8 bits, between these percentiles',
        '# seams = "graph-cut"            # seams of least cost; "nearest" unless given',
        '# follow = ["roads.gpkg"]    # what such seams run along; avoid = ["buildings.gpkg"]: what they keep out of',
        '# cutlines = "mine.gpkg"     # shares drawn by hand: they win',
        '# exclude = ["photo_07.tif"] # images that are to show nothing',
        "# true_ortho = true          # nothing that the surface model hides; other images fill it",
        "# feather = 10.0             # width of seams in map units; 32 pixels unless given",
        "",
        "[quality]                    # exit code 3 where one fails",
        "# max_check_rms_px = 1.0",
        f"# max_corner_sigma_px = {CORNER_SIGMA_PX:g}    # expected error of what is adjusted; this is the default"
        if carried.corner_sigma is None
        else f"max_corner_sigma_px = {carried.corner_sigma:g}    # positions of the cameras tell the place no better",
        '# reference = "reference.tif"',
        "# max_registration_px = 1.0",
        "# max_seam_mismatch_px = 2.0",
        "# max_clipped_percent = 1.0    # by colours; also max_gain_spread_percent, max_colour_trend_percent",
    ]
    return "\n".join(lines) + "\n"


def _planar(planar: PlanarInputs, near: Callable[[Path], str]) -> list[str]:
    """Section of photos of flat ground that tie and control points place."""
    lines = ["[planar]", f"kind = {_string(planar.kind)}    # uncontrolled, semicontrolled, controlled, grown"]
    if planar.ties is not None:
        lines.append(f"ties = {near(planar.ties)}")
    elif planar.kind != "controlled":
        lines.append('# ties = "ties.csv"    # NEEDED: id, image, col, row')
    return [*lines, '# model = "conformal"    # conformal, affine, projective; as is usual for the kind unless given']


def _ground(inputs: Block, near: Any, folder: Path, tied: bool) -> list[str]:
    if inputs.dem is not None:
        lines = ["[dem]", f"file = {near(inputs.dem)}"]
    elif inputs.height is not None:
        lines = ["[dem]", f"height = {inputs.height!r}    # metres, one for all the ground"]
    elif known_capabilities(inputs.sensor).planar:
        return ["# [dem]"]
    elif tied:
        return ["[dem]", 'from_tie_points = true       # or: file = "dem.tif"; or: height = 120.0']
    else:
        return ["# [dem]    # NEEDED", '# file = "dem.tif"    # or: height = 120.0']
    if inputs.dem_heights:
        lines.append(f"heights = {_string(_declared(inputs.dem_heights, folder))}    # overrides what the file says")
    else:
        said = inputs.height is None and not undeclared_heights(file_of(inputs.dem))
        mark = "overrides what the file says" if said else f"NEEDED: {DATUMS}"
        lines.append(f'# heights = "egm96"    # vertical datum; {mark}')
    return lines


def _alike(inputs: Block) -> list[tuple[Mapping[str, Any], list[Path]]]:
    """Inputs of single images, each with the images that have them."""
    found: list[tuple[Mapping[str, Any], list[Path]]] = []
    for path in inputs.images:
        options = inputs.image_options.get(path.name)
        paths = next((paths for known, paths in found if known == options), None)
        if paths is not None:
            paths.append(path)
        elif options:
            found.append((options, [path]))
    return found


def _image(image: Path, folder: Path) -> str:
    return glob.escape(relative(image, folder))


def _images(images: Sequence[Path], folder: Path, aside: Mapping[Path, str] | None = None) -> str:
    """Images by their names, so that a file that comes later does not join them; marks of patterns are escaped."""
    names = [_string(_image(image, folder)) for image in images]
    if len(names) < 3 and not aside:
        return f"[{', '.join(names)}]"
    lines = [f"    {name}," for name in names]
    if aside:
        lines.append("    # set aside; a line without its # takes a picture back")
        lines += [f"    # {_string(_image(image, folder))},    # {why}" for image, why in aside.items()]
    return "\n".join(["[", *lines, "]"])


def relative(path: Path, folder: Path) -> str:
    """Path as seen from a folder, with forward slashes.

    Parameters
    ----------
    path, folder : Path

    Returns
    -------
    str
        Absolute where there is no way from one to the other, as between drives.
    """
    try:
        return Path(os.path.relpath(path.absolute(), folder)).as_posix()
    except ValueError:
        return path.absolute().as_posix()


def _declared(text: str, folder: Path) -> str:
    """CRS or vertical datum as the project writes it: a file by its path from the project's folder."""
    return relative(Path(text), folder) if text.lower().endswith((*GEOID_FILES, *CRS_FILES)) else text


def _string(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_string(str(k))} = {_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    return json.dumps(value, ensure_ascii=False)
