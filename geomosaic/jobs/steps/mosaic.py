"""Steps "mosaic" and "orthos": the rasters of a project."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.block import Footprint, OrientedBlock, OrientedImage
from geomosaic.digests import digest_of
from geomosaic.inputs.area import FindOutlines, plan_mosaic
from geomosaic.inputs.orientation_covariance import with_sigmas
from geomosaic.inputs.vertical_datums import frame_description
from geomosaic.jobs.manifest import Layout, read_json, recorded_warnings, show_note, write_json
from geomosaic.jobs.step import KEYS_OF_IMAGES, Context, Machine, plugin_versions, versions
from geomosaic.jobs.steps.orient import restore_block
from geomosaic.mosaicking.colour.corrections import colour_facts, correction_picture
from geomosaic.mosaicking.colour.solve import keeping_calibration
from geomosaic.mosaicking.outputs import MosaicFiles
from geomosaic.mosaicking.result_cache import EarlierRun
from geomosaic.options.declaration import paths_of, stage_values
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.options.render import RunningOptions
from geomosaic.products.mosaics import reference_of, with_common_bands
from geomosaic.products.orthos import position_target
from geomosaic.project.load import Project
from geomosaic.surface.model import Surface
from geomosaic.whole_files import relative_path


def mosaic(project: Project, machine: Machine, context: Context) -> Mapping[str, Any]:
    """Step "mosaic": the mosaic with its labels, vectors and STAC item, and the facts of how it was made.

    Parameters
    ----------
    project : Project
    machine : Machine
    context : Context

    Returns
    -------
    dict
        `pixels` that hold values, and `lattice_error_px`, the largest geometric error in image pixels.

    Raises
    ------
    GeomosaicError
        Nothing is left under the final names.
    """
    from geomosaic.mosaicking.mosaic import mosaic as make
    from geomosaic.raster.pictures import png_bytes
    from geomosaic.report.figures import data_uri
    from geomosaic.report.report import place_pictures, seam_facts

    layout = Layout(project)
    started, spent = time.perf_counter(), time.process_time()
    layout.mosaic.parent.mkdir(parents=True, exist_ok=True)
    with recorded_warnings() as notes:
        options = _options(project, machine, context)
        block = with_common_bands(_block(project, options), options)
        options = keeping_calibration(options, block.scenes)
        earlier_run = _earlier_run(project, options, context)
        if context.forced and options.records.tiling is not None:
            shutil.rmtree(MosaicFiles.of(layout.mosaic, options).state, ignore_errors=True)
        grid, outlines = plan_mosaic(
            block.scenes, block.surface, project.area, _remembered(earlier_run, options.render)
        )
        result = make(
            block,
            grid,
            outlines,
            layout.mosaic,
            options,
            reference=reference_of(options, project.inputs.bands),
            about=_about(project, context),
            earlier_run=earlier_run,
        )
        target = position_target(options.uncertainty)
        # Within the context, so that they stand in the report beside the warnings.
        for note in (*result.notes, *result.balance.notes):
            show_note(note)
    judged = seam_facts(result.parts, result.quality, [outline.name for outline in outlines])
    facts: dict[str, Any] = {
        "grid": {
            "crs": frame_description(grid.crs).partition("; heights")[0],
            "width": grid.width,
            "height": grid.height,
            "resolution": grid.resolution,
            "bounds": grid.bounds,
        },
        "valid_pixels": result.valid_pixels,
        "hidden_pixels": result.hidden_pixels,
        "lattice_error_px": result.lattice_error,
        "tolerance_px": result.tolerance,
        "scale": result.scale,
        "resampling": options.render.resampling,
        "seams": options.seamlines.seams,
        "feather": result.feather,
        "rule": options.merge.rule,
        "balanced": options.balanced or options.colours.histogram is not None,
        "histogram": options.colours.histogram,
        "overlaps": result.balance.overlaps,
        "before": result.balance.before,
        "after": result.balance.after,
        "colour": colour_facts(result.balance, [outline.name for outline in outlines]),
        "stretch": None if result.stretch is None else vars(result.stretch),
        "images": [
            {
                "name": outline.name,
                "gain": gain,
                "offset": offset,
                "pixels": pixels,
                "sampling": outline.sampling,
                "complete": outline.complete,
            }
            for outline, gain, offset, pixels in zip(
                outlines, result.balance.gain, result.balance.offset, result.pixels, strict=True
            )
        ],
        "seconds": result.seconds,
        "tiles": [relative_path(path, project.output) for path in result.tile_files],
        "reused": result.reused,
        "units": result.units,
        "recalled": list(result.from_cache),
        "warnings": notes,
        "seam_quality": judged,
        "accuracy": None if result.accuracy is None else replace(result.accuracy, target=target).facts,
    }
    drawn = correction_picture(result.balance)
    seen = None if drawn is None else data_uri(png_bytes(drawn, np.ones(drawn.shape[:2], dtype=np.uint8)))
    facts["colour"]["picture"] = seen
    write_json(layout.places, place_pictures(result.places, judged["rows"] if judged else []))
    facts["total_seconds"], facts["processor_seconds"] = time.perf_counter() - started, time.process_time() - spent
    write_json(layout.facts("mosaic"), facts)
    return {"pixels": result.valid_pixels, "lattice_error_px": result.lattice_error}


def _options(project: Project, machine: Machine, context: Context) -> MosaicOptions:
    """Options of the project on this machine."""
    given: dict[str, Any] = {"progress": context.progress, **machine.options}
    render = replace(project.options.render, **given)
    return replace(project.options, render=render)


def _block(project: Project, options: MosaicOptions) -> OrientedBlock:
    """Block as "orient" left it; standard deviations that the project gives take the place of what that knew."""
    block, wanted = restore_block(project, options.render.dem_memory), options.uncertainty
    if not (wanted.accuracy and wanted.sigmas):
        return block
    return replace(block, scenes=tuple(with_sigmas(scene, wanted.sigmas) for scene in block.scenes))


def _about(project: Project, context: Context) -> dict[str, dict[str, Any]]:
    """Checksum of each image, and its residuals at control and check points."""
    points = read_json(Layout(project).facts("orient"))["control"]
    about: dict[str, dict[str, Any]] = {}
    for image in project.images:
        about[image.name] = {"sha256": context.digests[image]}
        for role in ("control", "check"):
            own = [p for p in points if (p["image"], p["role"]) == (image.name, role) and p["col"] is not None]
            if own:
                rms = math.sqrt(sum(p["col"] ** 2 + p["row"] ** 2 for p in own) / len(own))
                about[image.name][f"rms_{role}_px"] = rms
    return about


def _earlier_run(project: Project, options: MosaicOptions, context: Context) -> EarlierRun:
    """Remember units by the digests of their images, models and heights."""
    layout, settings, digests = Layout(project), project.settings, context.digests
    files = zip(project.images, layout.models, strict=True)
    aside = layout.set_aside
    scenes = [f"{digests[image]} {digests[model]}" for image, model in files if image not in aside]
    # Of all other files, those that only move seams or colours show in the seams and colours themselves; those of
    # records change no pixel.
    own = {*project.images, *layout.models, *paths_of(options, ("colour", "seams", "edits", "records"))}
    said = {
        "files": {relative_path(path, project.folder): digest for path, digest in digests.items() if path not in own},
        "dem": settings.dem.model_dump(mode="json") if settings.dem else None,
        "options": stage_values(options, "all"),
        "project": settings.project.model_dump(mode="json", include=set(KEYS_OF_IMAGES)),
        "images": [table.model_dump(mode="json") for table in settings.images],
        "versions": versions() | plugin_versions(*(part.sensor for part in project.blocks)),
    }
    colour, seams = (
        {
            "files": [digests.get(path) for path in paths_of(options, (stage,))],
            "options": stage_values(options, stage),
        }
        for stage in ("colour", "seams")
    )
    remembered = project.state / "mosaic-units.json"
    # A forced run is to prove the result from nothing: earlier units and results go.
    if context.forced:
        remembered.unlink(missing_ok=True)
        shutil.rmtree(remembered.with_name("found"), ignore_errors=True)
    return EarlierRun(remembered, scenes, digest_of(said), digest_of(colour), digest_of(seams), context.digest)


def _remembered(earlier_run: EarlierRun, running: RunningOptions) -> FindOutlines:
    """Outlines of the images, as an earlier run has found them where nothing they depend on has changed."""
    from geomosaic.mosaicking.reruns import deciding_code
    from geomosaic.mosaicking.result_cache import ResultCache
    from geomosaic.render.extent import footprints

    def find(scenes: tuple[OrientedImage, ...], surface: Surface | None, crs: CRS) -> list[Footprint]:
        key = digest_of(deciding_code(), *earlier_run.scenes, earlier_run.ground, crs.to_wkt())
        return ResultCache(earlier_run.found).get("footprints", key, lambda: footprints(scenes, surface, crs, running))

    return find


def orthos(project: Project, machine: Machine, context: Context) -> Mapping[str, Any]:
    """Step "orthos": one ortho per image, each on its own part of the mosaic's grid.

    Parameters
    ----------
    project : Project
    machine : Machine
    context : Context

    Returns
    -------
    dict
        Number of `orthos`, and `lattice_error_px`, the largest geometric error of them all in image pixels.
    """
    from geomosaic.render.accuracy import Uncertainties, write_accuracy
    from geomosaic.render.extent import footprints
    from geomosaic.render.ortho import ortho

    layout = Layout(project)
    wanted = _options(project, machine, context)
    options = wanted.render
    block = _block(project, wanted)
    known = Uncertainties.of(block, wanted.uncertainty, options) if wanted.uncertainty.accuracy else None
    grid, outlines = plan_mosaic(block.scenes, block.surface, project.area, partial(footprints, running=options))
    (project.output / "orthos").mkdir(parents=True, exist_ok=True)
    errors = []
    absent = layout.no_orthos()
    for path in absent:  # of an earlier run, to which the image belonged
        path.unlink(missing_ok=True)
    files = [pair for pair in zip(layout.orthos, layout.ortho_accuracies, strict=True) if pair[0] not in absent]
    for number, (scene, outline, (path, beside)) in enumerate(zip(block.scenes, outlines, files, strict=True)):
        # Pixels of the mosaic's own grid: orthos and mosaic lie over each other without resampling.
        part = grid.crop(grid.window_of(outline.bounds))
        errors.append(ortho(scene, block.surface, part, outline, path, options).lattice_error)
        if known is not None:
            one = replace(block, scenes=(scene,), control=())
            write_accuracy(beside, path, one, part, known.of_image(number), options, labelled=False)
    return {"orthos": len(errors), "lattice_error_px": max(errors)}
