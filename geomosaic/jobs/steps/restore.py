"""The block as step 'orient' left it."""

from __future__ import annotations

from geomosaic.block.block import Block
from geomosaic.block.scene import Scene
from geomosaic.jobs.facts import read_json
from geomosaic.jobs.layout import Layout
from geomosaic.jobs.step import Machine, Progress
from geomosaic.product.options import RenderOptions
from geomosaic.project.area import Area
from geomosaic.project.frames import named
from geomosaic.project.ground import build_surface
from geomosaic.project.load import Project
from geomosaic.project.usable import with_usable
from geomosaic.sensor.state import from_dict


def restore_block(project: Project) -> Block:
    """Read the models that 'orient' wrote, with images and surface."""
    inputs = project.inputs
    crs = named(inputs.crs, inputs.heights) if inputs.crs else None
    scenes = []
    for image, path in zip(project.images, Layout(project).models, strict=True):
        state = read_json(path)
        scenes.append(Scene(image.name, str(image), state["sensor"], from_dict(state), inputs.nodata, inputs.bands))
    return Block(with_usable(inputs, scenes), build_surface(inputs, crs), (), crs)


def area_of(project: Project) -> Area:
    """Where the project's output lies."""
    output = project.settings.output
    return Area(output.crs, output.resolution, output.bounds)


def render_options(project: Project, machine: Machine, progress: Progress) -> RenderOptions:
    """How the project's rasters are written; they are ours to replace."""
    output = project.settings.output
    return RenderOptions(
        resampling=output.resampling,
        tolerance=output.tolerance,
        nodata=output.nodata,
        driver=output.driver,
        creation={name: str(value) for name, value in output.creation.items()},
        overwrite=True,
        progress=progress,
        true_ortho=False,  # of the mosaic only, which sets it
        **machine.options,
    )
