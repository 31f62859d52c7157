"""Find places on the ground from pixels, or draw map vectors into a photo.

Help group: Orientation and accuracy
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geomosaic.cli.options import FILE, block_of, image_options, options_of, overwrite_option, running_options, stack
from geomosaic.cli.output import answer, notes
from geomosaic.cli.values import Number
from geomosaic.errors import InputError, did_you_mean
from geomosaic.options.control import DrawOptions, LocateOptions, PixelOptions
from geomosaic.options.declaration import declared

if TYPE_CHECKING:
    from geomosaic.inputs.declarations import Block

COMMON = tuple(one.name for one in declared(PixelOptions))

locate_options = stack(
    click.option("--image", "name", metavar="NAME", help="Image of the project, where IMAGE is a project file."),
    click.option("--pixel", "pixels", type=Number(), nargs=2, multiple=True, metavar="COL ROW", help="An image point."),
    click.option("--inverse", is_flag=True, help="Draw vectors of the map into the photo."),
    options_of(PixelOptions, "common"),
    options_of(LocateOptions, "own", without=COMMON),
    options_of(DrawOptions, "drawing", without=COMMON),
    click.option("-o", "--output", type=FILE, help="GeoPackage, GeoJSON, FlatGeobuf or CSV to write."),
    overwrite_option,
)


@click.command()
@click.argument("image", type=FILE)
@click.argument("source", type=FILE, required=False)
@stack(locate_options, image_options, running_options)
def command(
    image: Path,
    source: Path | None,
    inverse: bool,
    as_json: bool,
    name: str | None,
    inputs: dict[str, Any],
    common: dict[str, Any],
    own: dict[str, Any],
    drawing: dict[str, Any],
    **flags: Any,
) -> None:
    """Find places on the ground from pixels of one image, or draw map vectors into it.

    IMAGE is an image, or a project file with --image NAME: then the project's inputs hold.
    SOURCE is a table (id, col, row) or vectors digitized on the raw image; with --inverse vectors of the map.

    \b
    Examples:
      geomosaic locate photo.tif --sensor frame --camera camera.toml \\
        --exterior exterior.csv --exterior-crs EPSG:32633 --heights egm96 \\
        --dem dem.tif --pixel 812.5 640 --sigma-px 0.5 --sigma-dem 2
      geomosaic locate scene.tif roads.gpkg --inverse --sensor rpc \\
        --dem dem.tif --dem-heights egm96 --rows negative -o roads-in-scene.gpkg
    """
    if bool(flags["pixels"]) == (source is not None):
        raise click.UsageError("give either --pixel COL ROW or a file SOURCE")
    if inverse and source is None:
        raise click.UsageError("--inverse draws vectors of the map: name their file")
    for flag in own if inverse else drawing:
        raise click.UsageError(f"--{flag.replace('_', '-')} means nothing {'with' if inverse else 'without'} --inverse")
    if inverse and flags["output"] is None:
        raise click.UsageError("--inverse needs a file to write: -o")
    import numpy as np

    from geomosaic.cli.measured_results import drawn_facts, drawn_text, located_facts, located_text
    from geomosaic.monoplotting.run import draw_vectors, locate

    output = flags["output"]
    common["overwrite"] = flags["overwrite"]
    with notes():
        scene = _scene(image, name, inputs)
        if inverse and source is not None:
            drawn = draw_vectors(scene, source, output, **drawing, **common)
            answer(drawn_facts(drawn, output), drawn_text(drawn, output), as_json)
            return
        pixels = np.array(flags["pixels"]) if source is None else source
        found = locate(scene, pixels, output=output, **own, **common)
        answer(located_facts(found, output), located_text(found, output), as_json)


def _scene(image: Path, name: str | None, inputs: dict[str, Any]) -> Block:
    """Image with its inputs, those of the command or of the project that it is in."""
    if image.suffix.lower() != ".toml":
        if name is not None:
            raise click.UsageError("--image NAME chooses an image of a project: name the project file first")
        return block_of((image,), inputs)
    if inputs:
        raise click.UsageError("the project file says the inputs: leave out the options of the sensor and the ground")
    from geomosaic.image_names import find_by_name
    from geomosaic.project.load import load_project
    from geomosaic.project.scenes import project_scene

    project = load_project(image)
    paths = {path.name: path for path in project.images}
    if name is None and len(paths) > 1:
        first = next(iter(paths))
        raise InputError(f"the project has {len(paths)} images", where=str(image), hint=f"name one: --image {first}")
    found = next(iter(paths.values())) if name is None else find_by_name(paths, name)
    if found is None:
        hint = did_you_mean(name or "", paths) or f"one of {', '.join(list(paths)[:5])}"
        raise InputError(f"the project has no image '{name}'", where=str(image), hint=hint)
    return project_scene(project, found)
