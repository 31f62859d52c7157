"""Text of a project file: the sections of a draft, with what is still needed as comments."""

from __future__ import annotations

import glob
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError
from geomosaic.image_names import stem
from geomosaic.inputs.declarations import Block, file_of
from geomosaic.inputs.exterior_orientation import (
    RECONSTRUCTION_SYSTEM,
    RECONSTRUCTIONS,
    undeclared_reconstruction,
)
from geomosaic.inputs.summary import known_capabilities, takes_positions, undeclared_heights
from geomosaic.options.inputs import ANGLE_SYSTEMS, CORNER_SIGMA_PX, CRS_FILES, GEOID_FILES, PlanarInputs
from geomosaic.options.mosaic import TERMS
from geomosaic.project.photo_block import NOWHERE, EmbeddedInputs
from geomosaic.sensor.plausibility import DATUMS
from geomosaic.whole_files import relative_path

_MOSAIC = f"""
[mosaic]
balance = true               # gain and offset per image, solved over the overlaps
# colour = "auto"             # what else is solved: {", ".join(TERMS)}
# mask = "clouds.gpkg"        # areas that say nothing of colours
# histogram = "overlap"      # match histograms instead: overlap, whole or sequence
# master = "photo_07.tif"    # image all are brought to; or: reference = "ortho.tif"
# stretch = "2,98"           # to 8 bits, between these percentiles
# seams = "graph-cut"            # seams of least cost; "nearest" unless given
# follow = ["roads.gpkg"]    # what such seams run along; avoid = ["buildings.gpkg"]: what they keep out of
# cutlines = "mine.gpkg"     # shares drawn by hand: they win
# exclude = ["photo_07.tif"] # images that are to show nothing
# true_ortho = true          # nothing that the surface model hides; other images fill it
# feather = 10.0             # width of seams in map units; 32 pixels unless given"""


def project_text(path: Path, carried: EmbeddedInputs, read: bool) -> str:
    """Text of a project file.

    Parameters
    ----------
    path : Path
        Where the project file will be; paths in it start there.
    carried : EmbeddedInputs
        What is known.
    read : bool
        Whether the angle system was read off the orientation table.

    Raises
    ------
    InputError
        An input is a value, not a file.
    """
    folder, inputs, tied = path.absolute().parent, carried.inputs, carried.adjust is not None
    lines = [
        *_project(stem(path.name), carried, folder),
        "",
        *_sensor(inputs, folder),
        "",
        *_exterior(carried, folder, read),
        *(["", *_planar(inputs.planar, folder)] if inputs.planar is not None else []),
        "",
        *_ground(inputs, folder, tied),
        *(["", "[control]", f"file = {_near(inputs.control, folder)}"] if inputs.control is not None else []),
        *_adjust(carried, folder),
        "",
        *_output(carried.output_crs, tied and inputs.dem is None and inputs.height is None and inputs.crs != NOWHERE),
        *_MOSAIC.splitlines(),
        "",
        *_quality(carried.corner_sigma),
    ]
    return "\n".join(lines) + "\n"


def _project(name: str, carried: EmbeddedInputs, folder: Path) -> list[str]:
    """Head of the file and section of the images."""
    inputs = carried.inputs
    lines = [
        "# geomosaic project. Paths start from this file's folder; lines that start with # are to be filled in.",
        "format = 1",
        "",
        "[project]",
        f"name = {_string(name)}",
        f'images = {_images(inputs.images, folder, carried.aside)}    # or patterns, such as "photos/*.tif"',
    ]
    if inputs.bands:
        lines.append(f"bands = {list(inputs.bands)}    # counted from 1")
    if carried.notes:
        lines += ["notes = [    # what the report repeats", *(f"    {_string(note)}," for note in carried.notes), "]"]
    return lines


def _sensor(inputs: Block, folder: Path) -> list[str]:
    """Sections of the sensor, and of images with inputs of their own."""
    lines = [
        "[sensor]",
        f"name = {_string(inputs.sensor)}    # `geomosaic sensors {inputs.sensor}` lists what may stand here",
    ]
    if inputs.camera is not None:
        lines.append(f"camera = {_near(inputs.camera, folder)}")
    elif known_capabilities(inputs.sensor).needs_camera and not _reconstruction(inputs):
        lines.append('# camera = "camera.toml"    # NEEDED')
    if inputs.corrections is not None:
        lines.append(f"corrections = {_near(Path(inputs.corrections), folder)}")
    if inputs.fiducials is not None:
        lines.append(f"fiducials = {_near(inputs.fiducials, folder)}")
    lines += [f"{key} = {_value(value)}" for key, value in inputs.options.items()]
    for options, paths in _alike(inputs):
        lines += ["", "[[images]]    # inputs of these images alone", f"path = {_images(paths, folder)}"]
        camera = {"camera": relative_path(Path(options["camera"]), folder)} if "camera" in options else {}
        lines += [f"{key} = {_value(value)}" for key, value in {**options, **camera}.items()]
    return lines


def _reconstruction(inputs: Block) -> bool:
    """Whether camera and orientation come from another program's file."""
    return undeclared_reconstruction(inputs.exterior, inputs.angles) or inputs.angles in RECONSTRUCTIONS


def _exterior(carried: EmbeddedInputs, folder: Path, read: bool) -> list[str]:
    """Section of positions and attitudes, with CRS, vertical datum and angle system."""
    inputs, said = carried.inputs, carried.said
    undeclared = undeclared_reconstruction(inputs.exterior, inputs.angles)
    power = known_capabilities(inputs.sensor)
    lines = ["[exterior]"]
    if inputs.exterior is not None:
        lines.append(f"file = {_near(inputs.exterior, folder)}")
    elif power.needs_exterior and carried.adjust is None:
        mark = "" if inputs.control is not None else "NEEDED: "
        lines.append(f'# file = "exterior.csv"    # {mark}image, x, y, z, omega, phi, kappa')
    frames = "x and y here and of the control points"
    needed = "NEEDED with odm: " if undeclared else "NEEDED: " if takes_positions(inputs, power) else ""
    if inputs.crs:
        lines.append(f"crs = {_string(_declared(inputs.crs, folder))}    # {said.get('crs') or f'of {frames}'}")
    else:
        lines.append(f'# crs = "EPSG:32633"    # {needed}of {frames}')
    if inputs.heights:
        remark = said.get("heights") or "vertical datum of z"
        lines.append(f"heights = {_string(_declared(inputs.heights, folder))}    # {remark}")
    elif inputs.crs != NOWHERE:
        lines.append(f'# heights = "egm96"    # {needed}vertical datum of z: {DATUMS}')
    if undeclared:
        lines.append(f'# angles = "odm"    # NEEDED: {RECONSTRUCTION_SYSTEM}')
    elif inputs.exterior is not None:
        lines += _angles(inputs, read)
    return lines


def _angles(inputs: Block, read: bool) -> list[str]:
    """Keys of the angle system, with its unit, frame and matrix."""
    source = "name of the file" if _reconstruction(inputs) else "columns"
    off = f"read off the {source}; " if read else ""
    lines = [f"angles = {_string(inputs.angles)}    # {off}{ANGLE_SYSTEMS.get(inputs.angles, '')}"]
    if not _reconstruction(inputs) and inputs.angles != "none":
        unit = inputs.angle_unit
        lines.append(f"angle_unit = {_string(unit)}" if unit else '# angle_unit = "deg"    # deg, gon or rad')
    named = {"angle_frame": inputs.angle_frame, "matrix": inputs.matrix}
    return [*lines, *(f"{key} = {_string(value)}" for key, value in named.items() if value)]


def _adjust(carried: EmbeddedInputs, folder: Path) -> list[str]:
    """Sections of tie points and block adjustment; none of a planar block."""
    if carried.adjust is not None:
        start = ["", "[match]                      # tie points are measured in the photos"]
        if carried.reference is not None:
            start.append(f"reference = {_near(carried.reference, folder)}    # where control points are found")
        if carried.height_sigma is not None:
            start.append(
                f"height_sigma = {carried.height_sigma:g}          # ASSUMED: metres of relief about one height"
            )
        return [*start, "", "[adjust]", *carried.adjust]
    if carried.inputs.planar is not None:
        return []
    return [
        "",
        "# [adjust]                   # all images in one solution: geomosaic adjust",
        '# ties = "ties.csv"          # id, image, col, row; a section [match] measures them instead',
        "# position_sigma = 0.1       # metres; the positions of [exterior] are then observations",
        "# attitude_sigma = 0.01      # degrees; and its angles",
    ]


def _output(crs: str | None, own_surface: bool) -> list[str]:
    """Section of the map that the outputs are made in, with an accuracy raster where tie points give the ground."""
    accuracy = "# accuracy = true            # raster of expected errors"
    if own_surface:
        accuracy = "accuracy = true              # what the ground from tie points costs in metres"
    return [
        "[output]",
        'folder = "output"',
        f"crs = {_string(crs)}           # the UTM zone of the block"
        if crs
        else '# crs = "EPSG:32633"         # that of the DEM or of the positions unless given',
        "# resolution = 0.5           # map units; that of the images unless given",
        "# bounds = [left, bottom, right, top]",
        'resampling = "bilinear"      # nearest, bilinear, cubic, lanczos, average, rms',
        "tolerance = 0.02             # largest geometric error of the lattice, image pixels",
        accuracy,
        "# orthos = true              # write an ortho of each image too",
    ]


def _quality(corner_sigma: float | None) -> list[str]:
    """Section of limits; `corner_sigma` in pixels where the default does not serve."""
    return [
        "[quality]                    # exit code 3 where one fails",
        "# max_check_rms_px = 1.0",
        f"# max_corner_sigma_px = {CORNER_SIGMA_PX:g}    # expected error of what is adjusted; this is the default"
        if corner_sigma is None
        else f"max_corner_sigma_px = {corner_sigma:g}    # positions of the cameras tell the place no better",
        '# reference = "reference.tif"',
        "# max_registration_px = 1.0",
        "# max_seam_mismatch_px = 2.0",
        "# max_clipped_percent = 1.0    # by colours; also max_gain_spread_percent, max_colour_trend_percent",
    ]


def _planar(planar: PlanarInputs, folder: Path) -> list[str]:
    """Section of photos of flat ground that tie and control points place."""
    lines = ["[planar]", f"kind = {_string(planar.kind)}    # uncontrolled, semicontrolled, controlled, grown"]
    if planar.ties is not None:
        lines.append(f"ties = {_near(planar.ties, folder)}")
    elif planar.kind != "controlled":
        lines.append('# ties = "ties.csv"    # NEEDED: id, image, col, row')
    return [*lines, '# model = "conformal"    # conformal, affine, projective; as is usual for the kind unless given']


def _ground(inputs: Block, folder: Path, tied: bool) -> list[str]:
    """Section of the heights of the ground."""
    if inputs.dem is not None:
        lines = ["[dem]", f"file = {_near(inputs.dem, folder)}"]
    elif inputs.height is not None:
        of = "of the control points" if inputs.dem_from_tie_points else "for all the ground"
        lines = ["[dem]", f"height = {inputs.height!r}    # metres, one {of}"]
        lines += ["from_tie_points = true    # the ground of the mosaic"] if inputs.dem_from_tie_points else []
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
    return glob.escape(relative_path(image, folder))


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


def _declared(text: str, folder: Path) -> str:
    """CRS or vertical datum as the project writes it: a file by its path from the project's folder."""
    return relative_path(Path(text), folder) if text.lower().endswith((*GEOID_FILES, *CRS_FILES)) else text


def _near(given: object, folder: Path) -> str:
    """Path of a file as the project writes it, from the project's folder."""
    file = file_of(given)
    if file is None:
        raise InputError("a project names files, and a value is given", hint="write it to a file first")
    return _string(relative_path(file, folder))


def _string(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_string(str(k))} = {_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    return json.dumps(value, ensure_ascii=False)
