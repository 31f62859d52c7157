"""Step "orient": models of the images, and the block restored from them."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

from geomosaic.accuracy.check_points import control_residuals, rms
from geomosaic.block import OrientedBlock, OrientedImage
from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.inputs.adjusted import adjusted_images, adjustment_facts, write_exterior
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import read_camera
from geomosaic.inputs.exterior_orientation import SYSTEM_NAMES
from geomosaic.inputs.frames import frame_description, positions_crs
from geomosaic.inputs.ground import build_surface
from geomosaic.inputs.images import with_usable
from geomosaic.inputs.summary import control_discrepancies, list_missing_inputs
from geomosaic.jobs.manifest import Layout, read_json, recorded_warnings, write_json
from geomosaic.jobs.step import Context
from geomosaic.project.load import Project
from geomosaic.sensor.corrected import model_from_dict, model_to_dict


def orient(project: Project, context: Context) -> Mapping[str, Any]:
    """Step "orient": the model of each image as `models/<image>.json`, and the facts of the orientation.

    Parameters
    ----------
    project : Project
    context : Context

    Returns
    -------
    dict
        Number of `images`, and of image measurements of `control` and check points.

    Raises
    ------
    InputError
        The project is not complete (everything that is missing is listed), or an input is wrong.
    """
    layout = Layout(project)
    with recorded_warnings() as notes:
        block, planar = _block(project)
        for done, (scene, path) in enumerate(zip(block.scenes, layout.models, strict=True)):
            write_json(path, {"image": scene.name, **model_to_dict(scene.sensor, scene.model)})
            context.progress(done + 1, len(block.scenes), "orient")
        residuals = control_residuals(block)
        images = adjusted_images(project.inputs, block)
        if layout.exterior is not None and block.crs is not None:
            write_exterior(layout.exterior, images, block.crs)
        off = control_discrepancies(project.inputs, block)
        for points in off:
            warnings.warn(points.text, GeomosaicWarning, stacklevel=2)
    inputs = project.inputs
    surface = block.surface
    adjusted = adjustment_facts(images, block.crs) if images and block.crs is not None else None
    facts = {
        "sensor": inputs.sensor,
        "options": dict(inputs.options),
        "positions": frame_description(block.crs) if block.crs is not None else None,
        "positions_heights_declared": inputs.heights,
        "angles": {
            "system": inputs.angles,
            "text": SYSTEM_NAMES.get(inputs.angles, ""),
            "unit": inputs.angle_unit or "deg",
            "frame": inputs.angle_frame,
        }
        if inputs.exterior
        else None,
        "surface": frame_description(surface.crs) if surface is not None else None,
        "surface_heights_declared": inputs.dem_heights,
        "surface_heights_overridden": getattr(surface, "overridden", None),
        "surface_notes": list(getattr(surface, "notes", ())),
        "surface_height": inputs.height,
        "camera": read_camera(inputs.camera) if inputs.camera else None,
        "images": [
            {
                "name": scene.name,
                "width": scene.model.size[0],
                "height": scene.model.size[1],
                "crs": scene.model.crs.name,
                "notes": list(getattr(scene.model, "notes", ())),
            }
            for scene in block.scenes
        ],
        "control": [{"id": r.id, "image": r.image, "role": r.role, "col": r.col, "row": r.row} for r in residuals],
        "measured": {f"{p.id} {p.image}": list(p.colrow) for p in block.control},
        "rms_control_px": rms(residuals, "control"),
        "rms_check_px": rms(residuals, "check"),
        "control_discrepancies": [points.facts for points in off],
        "planar": planar,
        "adjusted": adjusted,
        "accuracy": (adjusted or planar or {}).get("accuracy"),
        "warnings": notes,
    }
    write_json(layout.facts("orient"), facts)
    return {"images": len(block.scenes), "control": len(residuals)}


def _block(project: Project) -> tuple[OrientedBlock, dict[str, Any] | None]:
    """Build the block, and say how plane transformations placed its photos where they did.

    Where that fails for want of something, say all that is wanting, not only the first.
    """
    try:
        inputs = project.inputs
        if inputs.planar is not None:
            from geomosaic.inputs.planar_block import build_planar

            return build_planar(inputs, inputs.planar)
        return build_block(inputs), None
    except InputError as error:
        lacking = list_missing_inputs(project.inputs)
        if not lacking:
            raise
        raise InputError(
            "the project is not complete: it needs\n    " + "\n    ".join(lacking),
            where=project.path.name,
            hint="fill it in; `geomosaic new` marks the places with NEEDED",
        ) from error


def restore_block(project: Project) -> OrientedBlock:
    """Block from the models that "orient" wrote, with images and surface.

    Parameters
    ----------
    project : Project

    Returns
    -------
    OrientedBlock
        Without control points: they have done their work in "orient".
    """
    inputs = project.inputs
    crs = positions_crs(inputs.crs, inputs.heights) if inputs.crs else None
    scenes = []
    for image, path in zip(project.images, Layout(project).models, strict=True):
        state = read_json(path)
        scenes.append(
            OrientedImage(
                image.name, str(image), state["sensor"], model_from_dict(state), inputs.src_nodata, inputs.bands
            )
        )
    return OrientedBlock(with_usable(inputs, scenes), build_surface(inputs, crs), (), crs)
