"""`geomosaic new`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import FILE, debug_option, image_options, json_option
from geomosaic.cli.talk import answer, notes


def project_file(ctx: click.Context, param: click.Parameter, value: Path) -> Path:
    """Refuse a name that is no project file's: a forgotten first word must not cost the first photo."""
    if value.suffix.lower() != ".toml":
        raise click.BadParameter(
            f"'{value}' does not end in .toml; the project file comes first: geomosaic new project.toml IMAGE..."
        )
    return value


@click.command()
@click.argument("project", type=FILE, callback=project_file, metavar="PROJECT.toml")
@click.argument("images", type=FILE, nargs=-1, required=True, metavar="IMAGE...")
@image_options
@click.option("--gcps", type=FILE, help="Control and check points: id, x, y, z, image, col, row.")
@click.option("--overwrite", is_flag=True, help="Replace the project file if it exists.")
@json_option
@debug_option
def command(
    project: Path, images: tuple[Path, ...], gcps: Path | None, overwrite: bool, as_json: bool, **flags: Any
) -> None:
    """Write a readable project file; say what was understood, and what it still needs.

    Without --angles the angle system is read off the columns of the table, and said.
    """
    from geomosaic.cli.request import block_inputs
    from geomosaic.project.draft import draft_project, write_project
    from geomosaic.project.make import refuse_existing

    with notes():
        inputs = block_inputs(images, flags, control=gcps)
        refuse_existing(project, overwrite, inputs)
        context = click.get_current_context()
        declared = context.get_parameter_source("angles") is click.core.ParameterSource.COMMANDLINE
        draft = draft_project(project, inputs, flags["angles"] if declared else None)
        write_project(draft, overwrite=overwrite)
    lines = [*draft.understood, *(f"needs {text}" for text in draft.needed)]
    following = "fill in what it needs" if draft.needed else f"run it: geomosaic run {project}"
    if draft.misfit is not None:
        lines.append(f"but it does not fit together: {draft.misfit}")
        following = "mend that first"
    lines.append(f"{project} written; {following}")
    result = {
        "project": str(project), "understood": draft.understood, "needed": draft.needed, "misfit": draft.misfit,
    }  # fmt: skip
    answer(result, "\n".join(lines), as_json)
