"""RPCs of images from plain declarations: fitted to any sensor, refined with control or tie points, and written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.block import OrientedBlock, OrientedImage
from geomosaic.errors import InputError, OutputError, OutputExistsError, default_where, did_you_mean
from geomosaic.geo.transform import Transform
from geomosaic.inputs.build import build_block
from geomosaic.inputs.correction_grids import write_corrections
from geomosaic.inputs.declarations import Block, as_block
from geomosaic.options.control import RefineOptions, RpcOptions, TieOptions
from geomosaic.options.declaration import compose
from geomosaic.raster.files import write_text
from geomosaic.raster.image_metadata import read_rpc_tags, write_rpc_tags
from geomosaic.rpc.refine import GridFit, ImageRpc, fit_rpc_and_grid, refine_rpcs
from geomosaic.sensor.plugin import HasRational, SensorModel
from geomosaic.sensor.registry import plugin, rational_sensor
from geomosaic.sensor.solve import image_to_ground
from geomosaic.stores.path import to_path
from geomosaic.types import PathLike

WGS84 = CRS.from_epsg(4979)
_AROUND = 0.1  # of the relief that is seen, below and above it
_LEAST = 50.0  # metres; an RPC of a thinner box says little of heights


@dataclass(frozen=True)
class RpcInputs:
    """What is asked for.

    Attributes
    ----------
    block : Block
        Images with their sensor; control points in it refine them.
    options : RpcOptions
        Heights of the fit, and the files to write.
    refine : str, optional
        Correction of images that come with an RPC: shift, drift or affine.
    tied : TieOptions
        Tie points between the images.
    """

    block: Block
    options: RpcOptions
    refine: str | None = None
    tied: TieOptions = field(default_factory=TieOptions)


def fit_rpc(
    images: Block | Sequence[PathLike] | PathLike,
    **options: Any,
) -> tuple[ImageRpc, ...]:
    """RPC of each image, fitted to the model of its sensor.

    Parameters
    ----------
    images : Scene, Block, sequence of path or path
        Paths are of images that come with an RPC.
    **options
        Of `RpcOptions`: `height_range`, `tags`, `text`, `grid`, `folder`, `overwrite`.

    Returns
    -------
    tuple of ImageRpc
        With the RMS and the largest error of the fit, pixels.

    Raises
    ------
    InputError, SolveError, OutputError
    """
    return _make_rpcs(RpcInputs(_rational_block(images), compose(RpcOptions, options)))


def refine_rpc(
    images: Block | Sequence[PathLike] | PathLike,
    kind: str,
    **options: Any,
) -> tuple[ImageRpc, ...]:
    """RPC of each image, corrected by the control points of the block and by tie points.

    Parameters
    ----------
    images : Scene, Block, sequence of path or path
        That come with an RPC; `control` of the block takes part.
    kind : str
        'shift', 'drift' (shift and drift) or 'affine'.
    **options
        Of `TieOptions` (`ties` between the images, `fixed` images, `sigma_px`) and `RpcOptions`; `height_range` for an
        RPC with a correction grid, which is fitted first.

    Returns
    -------
    tuple of ImageRpc
        With the residuals before and after, pixels.

    Raises
    ------
    InputError, SolveError, OutputError
    """
    request = compose(RefineOptions, options)
    return _make_rpcs(RpcInputs(_rational_block(images), request.files, kind, request.tied))


def _rational_block(images: Block | Sequence[PathLike] | PathLike) -> Block:
    return images if isinstance(images, Block) else replace(as_block(images), sensor=rational_sensor())


def _make_rpcs(inputs: RpcInputs) -> tuple[ImageRpc, ...]:
    """RPC of each image, with the files that are asked for."""
    tool, wanted = _tool(), inputs.options
    if inputs.refine is not None and inputs.refine not in tool.kinds:
        raise InputError(
            f"refinement '{inputs.refine}' is not known",
            hint=f"{did_you_mean(inputs.refine, tool.kinds)} choose one of {', '.join(tool.kinds)}".strip(),
        )
    own = _is_rational(inputs.block.sensor)
    if inputs.refine is not None and not own:
        raise InputError(
            f"`refine` corrects an RPC, and these images are of sensor '{inputs.block.sensor}'",
            hint="leave it out: control points adjust the sensor itself, and the RPC is fitted to the result",
        )
    known = bool(inputs.block.control or inputs.tied.ties)
    if inputs.refine is not None and not known:
        raise InputError("nothing says where the image is to be: `refine` needs points", hint="give control or `ties`")
    if own and inputs.refine is None and known:
        raise InputError("nothing says how the RPC is refined", hint=f"give `refine`: {', '.join(tool.kinds)}")
    if own and wanted.grid:
        raise InputError(
            "`grid` holds what an RPC cannot model of another sensor, and these images come with an RPC of their own",
            hint="name their sensor with `sensor`, or leave it out",
        )
    settings = {**inputs.block.options, "refine": "none"} if own else inputs.block.options
    block = build_block(replace(inputs.block, options=settings))
    places = [_targets(scene, wanted) for scene in block.scenes]
    made = [_rational(tool, scene, block, inputs) for scene in block.scenes]
    if inputs.refine is not None:
        made = refine_rpcs(tool, block, made, inputs.refine, inputs.tied)
    if wanted.folder is not None:
        _make(wanted.folder)
    out = []
    for (model, done), scene, (tags, text, grid) in zip(made, block.scenes, places, strict=True):
        again = tool.rewrite_rational(model)
        whole = model if again is None else again.model
        facts = done.facts if again is None else {**done.facts, "rewritten_worst_px": again.worst}
        if tags is not None:
            write_rpc_tags(tags, tool.rational_tags(whole))
        if text is not None:
            write_text(text, tool.rational_text(whole), overwrite=wanted.overwrite, encoding="ascii")
        if grid is not None and done.grid is not None:
            write_corrections(grid, done.grid, overwrite=wanted.overwrite)
        written = tuple(path for path in (tags, text, grid) if path is not None)
        out.append(replace(done, facts=facts, written=written, name=scene.name))
    return tuple(out)


def _make(folder: Path) -> None:
    """Folder of the text files and grids, made where it is not there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        hint = "give another `folder`, or check its rights"
        raise OutputError(f"the folder cannot be made: {error.strerror}", where=str(folder), hint=hint) from error


def _tool() -> HasRational:
    found = plugin(rational_sensor())
    assert isinstance(found, HasRational)
    return found


def _is_rational(sensor: str) -> bool:
    """Whether the models of a sensor are RPCs already."""
    return isinstance(plugin(sensor), HasRational)


def _rational(
    tool: HasRational, scene: OrientedImage, block: OrientedBlock, inputs: RpcInputs
) -> tuple[SensorModel, ImageRpc]:
    """The RPC of an image: its own, or one fitted to its model."""
    if _is_rational(inputs.block.sensor) and inputs.block.corrections is None:
        return scene.model, ImageRpc(scene.name, "as it came", {})
    heights = inputs.options.height_range or _heights(scene, block)
    with default_where(scene.name):
        if inputs.options.grid:
            model, pair = fit_rpc_and_grid(tool, scene.model, scene.sensor, heights)
            return model, ImageRpc(scene.name, "fitted", _facts_of_pair(pair, heights), grid=pair.grid)
        fit = tool.fit_rational(scene.model, heights)
    facts = {
        "fit_rms_px": fit.rms,
        "fit_worst_px": fit.worst,
        "fit_checks": fit.checks,
        "heights_m": [float(fit.heights[0]), float(fit.heights[1])],
    }
    return fit.model, ImageRpc(scene.name, "fitted", facts)


def _facts_of_pair(pair: GridFit, heights: tuple[float, float]) -> dict[str, Any]:
    return {
        "fit_rms_px": pair.alone_rms,
        "fit_worst_px": pair.alone_worst,
        "fit_checks": pair.checks,
        "heights_m": [float(heights[0]), float(heights[1])],
        "grid_rms_px": pair.rms,
        "grid_worst_px": pair.worst,
        "grid_nodes": list(pair.grid.nodes.shape[1::-1]),
    }


def _heights(scene: OrientedImage, block: OrientedBlock) -> tuple[float, float]:
    """Ellipsoidal heights of the ground an image shows, somewhat widened."""
    if block.surface is None:
        raise InputError(
            "nothing says for which heights the RPC is made",
            where=scene.name,
            hint="give `height_range`, lowest and highest ellipsoidal height in metres, or a DEM",
        )
    cols, rows = (np.linspace(0.0, side, 33) for side in scene.model.size)
    places = np.stack(np.meshgrid(cols, rows), axis=-1).reshape(-1, 2)
    seen = Transform(block.surface.crs, WGS84)(image_to_ground(scene.model, places, block.surface))[:, 2]
    seen = seen[np.isfinite(seen)]
    if not len(seen):
        raise InputError(
            "the image sees nothing of the DEM", where=scene.name, hint="check the DEM, or give `height_range`"
        )
    low, high = float(seen.min()), float(seen.max())
    more = max(_AROUND * (high - low), 0.5 * (_LEAST - (high - low)), 0.0)
    return low - more, high + more


def _targets(scene: OrientedImage, wanted: RpcOptions) -> tuple[Path | None, Path | None, Path | None]:
    """Files to write for an image; refused before any work where they hold an RPC already."""
    path = to_path(scene.path)
    tags = path if wanted.tags else None
    folder = wanted.folder or path.parent
    text = folder / f"{path.stem}_RPC.TXT" if wanted.text else None
    grid = folder / f"{path.stem}_RPC_grid.csv" if wanted.grid else None
    if (text or grid) and folder.exists() and not folder.is_dir():
        raise InputError("the folder of the RPC files is a file", where=str(folder), hint="give another `folder`")
    if wanted.overwrite:
        return tags, text, grid
    if text is not None and text.exists():
        raise OutputExistsError("the RPC file exists", where=str(text), hint="give another `folder`, or `overwrite`")
    if grid is not None and grid.exists():
        raise OutputExistsError("the grid exists", where=str(grid), hint="give another `folder`, or `overwrite`")
    if tags is not None and read_rpc_tags(tags):
        raise OutputExistsError(
            "the image carries an RPC already", where=str(tags), hint="write `text` instead, or give `overwrite`"
        )
    return tags, text, grid
