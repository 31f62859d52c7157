"""Single images of a project, with the inputs that the project gives them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from geomosaic.inputs.declarations import Block
from geomosaic.project.load import Project


def project_scene(project: Project, image: Path) -> Block:
    """One image of a project as a block of its own.

    Parameters
    ----------
    project : Project
    image : Path
        One of its images.

    Returns
    -------
    Block
        Where the project gives the image an orientation, without control points: they check it, and do not change it.
    """
    if project.inputs.planar is not None:
        from geomosaic.inputs.planar_block import placed_alone

        return placed_alone(project.inputs, project.inputs.planar, image)
    own = next(part for part in project.blocks if image in part.images)
    inputs_of = own.image_options.get(image.name)
    return replace(
        own,
        images=(image,),
        image_options={image.name: inputs_of} if inputs_of else {},
        control=own.control if own.exterior is None else None,
    )
