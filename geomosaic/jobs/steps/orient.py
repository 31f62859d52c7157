"""Step "orient": models of the images, and the block restored from them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.accuracy.check_points import ControlResidual, control_residuals, rms
from geomosaic.block import OrientedBlock, OrientedImage
from geomosaic.errors import InputError, warn
from geomosaic.geo.crs import is_local
from geomosaic.inputs.adjusted import AdjustedImage, adjusted_images, adjustment_facts, write_exterior
from geomosaic.inputs.build import build_block, join_blocks, refuse_unknown_inputs, refuse_unused_ground
from geomosaic.inputs.declarations import Block, read_camera
from geomosaic.inputs.ground import build_surface
from geomosaic.inputs.images import chosen_bands, with_declared
from geomosaic.inputs.orientation_covariance import with_covariances
from geomosaic.inputs.summary import control_discrepancies, list_missing_inputs
from geomosaic.inputs.vertical_datums import frame_description, positions_crs
from geomosaic.jobs.manifest import Layout, read_json, recorded_warnings, show_note, write_json
from geomosaic.jobs.step import Context, Machine
from geomosaic.options.inputs import ANGLE_SYSTEMS
from geomosaic.options.naming import keys_in_errors
from geomosaic.project.load import Project
from geomosaic.sensor.corrected import model_from_dict, model_to_dict
from geomosaic.surface.dem import Dem
from geomosaic.whole_files import write_atomic

if TYPE_CHECKING:
    from geomosaic.block_adjustment.result import AdjustedBlock


@dataclass(frozen=True, eq=False)
class _Orientation:
    """Oriented images of a project: of its whole block, of each declared part, and how they came by it."""

    block: OrientedBlock
    parts: tuple[tuple[Block, OrientedBlock], ...]
    solved: AdjustedBlock | None
    planar: dict[str, Any] | None

    @cached_property
    def adjusted(self) -> list[list[AdjustedImage]]:
        """Images whose orientation each part adjusted alone; none after an adjustment of the whole block."""
        return [[] if self.solved is not None else adjusted_images(*part) for part in self.parts]

    @cached_property
    def known(self) -> dict[str, OrientedImage]:
        """Images with their covariances, by name."""
        return {
            scene.name: scene
            for (part, each), own in zip(self.parts, self.adjusted, strict=True)
            for scene in (each if self.solved is not None else with_covariances(part, each, {}, own)).scenes
        }

    @property
    def set_aside(self) -> Mapping[str, str]:
        """Images that the adjustment left out, each with the reason."""
        return {} if self.solved is None else self.solved.set_aside


def orient(project: Project, machine: Machine, context: Context) -> Mapping[str, Any]:
    """Step "orient": the model of each image as `models/<image>.json`, and the facts of the orientation.

    Parameters
    ----------
    project : Project
    machine : Machine
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
    layout, exports = Layout(project), dict[str, str]()
    with recorded_warnings() as notes:
        found = _oriented(project, machine, context)
        _write_models(layout, found, context)
        residuals = [each for _, block in found.parts for each in control_residuals(block)]
        if found.solved is not None:
            if found.solved.nowhere:
                show_note(found.solved.nowhere)
            exports = _write_adjustment(layout, found.solved, notes)
        elif layout.exterior is not None and found.parts[0][1].crs is not None:
            write_exterior(layout.exterior, found.adjusted[0], found.parts[0][1].crs)
        off = [points for part in found.parts if found.solved is None for points in control_discrepancies(*part)]
        for points in off:
            warn(points.text)
    adjusted = _adjustment_facts(found, exports)
    facts = {
        **_input_facts(found.parts),
        **_surface_facts(project, found),
        "images": _image_facts(project, found.block),
        "set_aside": dict(found.set_aside),
        **_control_facts(found, residuals),
        "control_discrepancies": [points.facts for points in off],
        "planar": found.planar,
        "adjusted": adjusted,
        "accuracy": (adjusted or found.planar or {}).get("accuracy"),
        "warnings": notes,
    }
    write_json(layout.facts("orient"), facts)
    return {"images": len(found.block.scenes), "control": len(residuals)}


def _oriented(project: Project, machine: Machine, context: Context) -> _Orientation:
    """Orientation of a project's images: by a block adjustment where it has one, else as declared."""
    solved = _adjusted(project, machine, context)
    blocks, planar = (solved.blocks(), None) if solved is not None else _blocks(project)
    block = _in_project_order(project, join_blocks(project.blocks, blocks))
    return _Orientation(block, tuple(zip(project.blocks, blocks, strict=True)), solved, planar)


def _write_models(layout: Layout, found: _Orientation, context: Context) -> None:
    """Model of each image, or why it was set aside."""
    models = {scene.name: scene for scene in found.block.scenes}
    images = layout.project.images
    for done, (image, path) in enumerate(zip(images, layout.models, strict=True)):
        if image.name in found.set_aside:
            write_json(path, {"image": image.name, "set_aside": found.set_aside[image.name]})
        else:
            scene = models[image.name]
            write_json(path, {**_state(found.known[scene.name]), **model_to_dict(scene.sensor, scene.model)})
        context.progress(done + 1, len(images), "orient")


def _input_facts(parts: Sequence[tuple[Block, OrientedBlock]]) -> dict[str, Any]:
    """Declarations of the first part, and under `groups` those of the others."""
    groups = [{"names": [scene.name for scene in each.scenes], **_declared(part, each)} for part, each in parts[1:]]
    return {**_declared(*parts[0]), "groups": groups}


def _surface_facts(project: Project, found: _Orientation) -> dict[str, Any]:
    """What the ground is and what its heights count from."""
    surface, solved, made = found.block.surface, found.solved, None
    notes = list(getattr(surface, "notes", ()))
    if solved is not None and solved.facts["surface"] is not None:
        from geomosaic.block_adjustment.tie_point_surface import surface_lines

        made = solved.facts["surface"]
        notes += surface_lines(made, solved.facts["length_unit"])
    return {
        "surface": frame_description(surface.crs) if surface is not None else None,
        "surface_heights_declared": project.inputs.dem_heights,
        "surface_heights_overridden": getattr(surface, "overridden", None),
        "surface_notes": notes,
        "surface_height": project.inputs.height,
        "surface_datum": None if solved is None else _datum(project, solved),
        "surface_from_tie_points": made,
    }


def _image_facts(project: Project, block: OrientedBlock) -> list[dict[str, Any]]:
    """Size, CRS and own inputs of each image."""
    own = {name: options for part in project.blocks for name, options in part.image_options.items()}
    return [
        {
            "name": scene.name,
            "options": dict(own.get(scene.name, {})),
            "width": scene.model.size[0],
            "height": scene.model.size[1],
            "crs": scene.model.crs.name,
            "notes": list(getattr(scene.model, "notes", ())),
        }
        for scene in block.scenes
    ]


def _control_facts(found: _Orientation, residuals: list[ControlResidual]) -> dict[str, Any]:
    """Residuals of control and check points, and where they were measured."""
    # What an adjustment left out says nothing of how well it fits.
    left_out = set() if found.solved is None else {(each.image, each.point) for each in found.solved.blunders}
    residuals = [
        replace(each, role="rejected")
        if each.role == "control" and left_out & {("", each.id), (each.image, each.id)}
        else each
        for each in residuals
    ]
    return {
        "control": [{"id": r.id, "image": r.image, "role": r.role, "col": r.col, "row": r.row} for r in residuals],
        "measured": {f"{p.id} {p.image}": list(p.colrow) for _, each in found.parts for p in each.control},
        "rms_control_px": rms(residuals, "control"),
        "rms_check_px": rms(residuals, "check"),
    }


def _adjustment_facts(found: _Orientation, exports: Mapping[str, str]) -> dict[str, Any] | None:
    """Facts of what was adjusted: the block as one, or single images; None where nothing was."""
    solved = found.solved
    if solved is None:
        pairs = zip(found.adjusted, (each for _, each in found.parts), strict=True)
        return _joined([adjustment_facts(own, each.crs) for own, each in pairs if own and each.crs is not None])
    summary = solved.summary.splitlines()
    return {"summary": summary, "accuracy": solved.accuracy, "images": [], "block": True, "exports": dict(exports)}


def _datum(project: Project, solved: AdjustedBlock) -> str | None:
    """What heights of the adjusted points count from, as an input names it; None of a local frame."""
    ground = solved.start.ground
    if is_local(ground):
        return None
    given = next((part.heights for part in project.blocks if part.heights is not None), None)
    return given or (None if ground.is_compound else "ellipsoidal")


def _adjusted(project: Project, machine: Machine, context: Context) -> AdjustedBlock | None:
    """Block adjustment of a project; None where it has none."""
    if project.adjustment is None:
        return None
    from geomosaic.block_adjustment.run import adjust_parts

    with keys_in_errors(project.path.name, "adjust"):
        options = project.adjustment
        if project.found_control and not _tied(project):
            options = replace(options, ties=None)
        return adjust_parts(project.controlled_blocks, replace(options, **machine.options), context.progress)


def _tied(project: Project) -> bool:
    """Whether matching found tie points, without which images that a reference controls do as well."""
    return any(image["tie_points"] for image in read_json(Layout(project).facts("match"))["images"])


def _write_adjustment(layout: Layout, solved: AdjustedBlock, notes: Sequence[str]) -> dict[str, str]:
    """Orientations, points, facts and report of a block adjustment; folders of files of other programs by format."""
    points, facts, report = layout.adjustment
    name, folder = layout.project.name, layout.project.output / "exports"
    exports = {format: str(home) for format, home in solved.write_exports(folder, name).items()}
    solved.write_points(points)
    if layout.surface:
        solved.write_surface(*layout.surface)
    write_json(facts, solved.facts)
    write_atomic(report, solved.page(name, notes))
    if layout.tie_section is not None:
        write_atomic(layout.tie_section, solved.tie_section)
    if layout.exterior is not None:
        solved.write_exterior(layout.exterior)
    return exports


def _state(scene: OrientedImage) -> dict[str, Any]:
    """What is kept of an image beside its model: the covariance of the model's parameters, and its source."""
    covariance = None if scene.covariance is None else scene.covariance.tolist()
    return {"image": scene.name, "covariance": covariance, "known_by": scene.known_by}


def _joined(found: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """Facts of adjusted images of several blocks, with the accuracy of the one that is placed worst."""
    if not found:
        return None
    of_all = [one["accuracy"] for one in found]
    worst = max(of_all, key=lambda one: math.inf if one["largest_sigma_px"] is None else one["largest_sigma_px"])
    lines, images = ([item for one in found for item in one[name]] for name in ("summary", "images"))
    return {"summary": lines, "accuracy": worst, "images": images}


def _declared(inputs: Block, block: OrientedBlock) -> dict[str, Any]:
    """Sensor, camera and orientation of one block, as they were declared."""
    angles = {
        "system": inputs.angles,
        "text": ANGLE_SYSTEMS.get(inputs.angles, ""),
        "unit": inputs.angle_unit or "deg",
        "frame": inputs.angle_frame,
    }
    return {
        "sensor": inputs.sensor,
        "options": dict(inputs.options),
        "positions": frame_description(block.crs) if block.crs is not None else None,
        "positions_heights_declared": inputs.heights,
        "angles": angles if inputs.exterior else None,
        "camera": read_camera(inputs.camera) if inputs.camera else None,
    }


def _in_project_order(project: Project, block: OrientedBlock) -> OrientedBlock:
    """Block with its scenes in the order of the project's images."""
    place = {str(image): index for index, image in enumerate(project.images)}
    return replace(block, scenes=tuple(sorted(block.scenes, key=lambda scene: place[scene.path])))


def _blocks(project: Project) -> tuple[list[OrientedBlock], dict[str, Any] | None]:
    """Blocks as declared, and how plane transformations placed their photos where they did.

    Where that fails for want of something, say all that is wanting, not only the first.
    """
    with keys_in_errors(project.path.name):
        for part in project.blocks:
            refuse_unknown_inputs(part)
        refuse_unused_ground(project.blocks, uses_surface=project.options.uses_surface)
    try:
        inputs = project.inputs
        if inputs.planar is not None:
            from geomosaic.inputs.planar_block import build_planar

            block, planar = build_planar(inputs, inputs.planar)
            return [block], planar
        return [build_block(part) for part in project.blocks], None
    except InputError as error:
        lacking = [text for part in project.blocks for text in list_missing_inputs(part)]
        if not lacking:
            raise
        raise InputError(
            "the project is not complete: it needs\n    " + "\n    ".join(lacking),
            where=project.path.name,
            hint="fill it in; `geomosaic new` marks the places with NEEDED",
        ) from error


def restore_block(project: Project, dem_memory: int) -> OrientedBlock:
    """Block from the models that "orient" wrote, with images and surface.

    Parameters
    ----------
    project : Project
    dem_memory : int
        Bytes that its DEM may hold between reads.

    Returns
    -------
    OrientedBlock
        Without control points, which have done their work in "orient", and without images that it set aside.
    """
    layout = Layout(project)
    states = {image: read_json(path) for image, path in zip(project.images, layout.models, strict=True)}
    made = _made_surface(project, dem_memory) if layout.surface else None
    blocks = []
    for part in project.blocks:
        crs = positions_crs(part.crs, part.heights) if part.crs else None
        scenes = [_restored(image, states[image], part) for image in part.images if "set_aside" not in states[image]]
        ground = made or build_surface(part, crs, memory=dem_memory)
        blocks.append(OrientedBlock(with_declared(part, scenes), ground, (), crs))
    return _in_project_order(project, join_blocks(project.blocks, blocks))


def _made_surface(project: Project, memory: int) -> Dem:
    """Ground that "orient" made of the tie points."""
    heights, sigma = Layout(project).surface
    # A GeoTIFF tells neither heights above the ellipsoid nor the path of a geoid grid.
    datum = read_json(Layout(project).facts("orient"))["surface_datum"]
    return Dem.open(heights, heights=datum, memory_limit=memory, sigma=Dem.open(sigma, heights=datum))


def _restored(image: Path, state: Mapping[str, Any], part: Block) -> OrientedImage:
    """Image with the model and the covariance that its file in `models/` holds."""
    covariance = None if state.get("covariance") is None else np.array(state["covariance"], dtype=np.float64)
    bands = chosen_bands(part, image)
    return OrientedImage(
        image.name, str(image), state["sensor"], model_from_dict(dict(state)), part.src_nodata, bands,
        covariance=covariance, known_by=state.get("known_by", ""),
    )  # fmt: skip
