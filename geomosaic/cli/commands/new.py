"""Write a project file from images and tables.

Help group: Projects
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import CHOSEN, FILE, block_of, options_of, running_options
from geomosaic.cli.output import answer, notes, translated
from geomosaic.options.inputs import BlockInputs
from geomosaic.options.tie_points import TiePointOptions

# Inputs that drafts of projects do not write.
UNWRITTEN = (*CHOSEN, "model", "scale", "azimuth", "rectify", "robust", "insist")


def _project_file(ctx: click.Context, param: click.Parameter, value: Path) -> Path:
    """Callback of click that refuses a name that is no project file's."""
    # A forgotten first word must not cost the first photo.
    if value.suffix.lower() != ".toml":
        raise click.BadParameter(
            f"'{value}' does not end in .toml; the project file comes first: geomosaic new project.toml IMAGE..."
        )
    return value


@click.command()
@click.argument("project", type=FILE, callback=_project_file, metavar="PROJECT.toml")
@click.argument("images", type=FILE, nargs=-1, required=True, metavar="IMAGE_OR_FOLDER...")
@options_of(BlockInputs, "inputs", without=UNWRITTEN)
@options_of(TiePointOptions, "matching", only=("reference",))
@click.option("--overwrite", is_flag=True, help="Replace the project file if it exists.")
@running_options
def command(
    project: Path,
    images: tuple[Path, ...],
    overwrite: bool,
    as_json: bool,
    inputs: dict[str, Any],
    matching: dict[str, Any],
) -> None:
    """Write a readable project file; say what was recognised, and what it still needs.

    A folder of photos is enough: what is in it is sorted and told, and the project measures tie points, adjusts and
    finds the ground by itself. Without --sensor the images are asked: RPC, DIMAP or a georeference in or beside them,
    position and attitude in EXIF and XMP; folders of scenes stand for their images. Without --angles the angle system
    is read off the columns of the table or off what the program that wrote it calls it, and said. With --reference
    photos and scans that nothing places get their control points from an ortho or a mosaic of the land.
    """
    from geomosaic.project.drafts import new_project

    with notes():
        block = block_of(images, {"kind": "uncontrolled", **inputs} if "ties" in inputs else inputs)
        declared: dict[str, Any] = {"from_images": "sensor" not in inputs, "angles": inputs.get("angles")}
        draft = new_project(project, block, **declared, **matching, overwrite=overwrite)
    lines = [*draft.recognised, *(f"needs {text}" for text in draft.needed)]
    following = "fill in what it needs" if draft.needed else f"run it: geomosaic run {project}"
    if draft.misfit is not None:
        lines.append(f"but it does not fit together: {draft.misfit}")
        following = "correct that first"
    lines.append(f"{project} written; {following}")
    result = {
        "project": str(project), "recognised": draft.recognised, "needed": draft.needed, "misfit": draft.misfit,
        "set_aside": dict(draft.aside),
    }  # fmt: skip
    answer(result, translated("\n".join(lines)), as_json)
