"""RPC refinement by control points, or by tie points against other images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.block.block import ControlPoint, OrientedBlock
from geomosaic.errors import InputError, SolveError
from geomosaic.geo.transform import Transform
from geomosaic.inputs.tables import read_table, stem
from geomosaic.sensor.corrected import CorrectionGrid
from geomosaic.sensor.model import SensorModel
from geomosaic.sensor.plausibility import require_vertical_datum
from geomosaic.sensor.plugin import HasRational
from geomosaic.types import FloatArray, IntArray

COLUMNS = ("id", "image", "col", "row")


def read_ties(path: Path, images: Sequence[str]) -> tuple[IntArray, IntArray, FloatArray]:
    """Tie points of images from a table.

    Parameters
    ----------
    path : Path
        Text with the columns id, image, col, row: one line per measurement. Measurements in other images are left out.
    images : sequence of str

    Returns
    -------
    image, point : int array (M,)
        Index of the image and of the tie point of each measurement, from 0.
    colrow : array (M, 2)
        Measured image coordinates, pixels.

    Raises
    ------
    InputError
        Names file and line.
    """
    table = read_table(path, "tie point table", ",".join(COLUMNS))
    table.require(*COLUMNS, what="tie points")
    numbers = {stem(name): number for number, name in enumerate(images)}
    points: dict[str, int] = {}
    met: dict[tuple[int, str], int] = {}
    image, point, colrow = [], [], []
    for row in table:
        where, identity = numbers.get(stem(row.text("image"))), row.text("id")
        if where is None:
            continue
        first = met.setdefault((where, identity), row.line)
        if first != row.line:
            raise InputError(
                f"tie point '{identity}' is measured in {images[where]} already, on line {first}",
                where=row.where,
                hint="leave one of the two out",
            )
        image.append(where)
        point.append(points.setdefault(identity, len(points)))
        colrow.append((row.number("col"), row.number("row")))
    if not image:
        raise InputError(
            "no tie point is measured in these images", where=str(path), hint=f"the images are {', '.join(images)}"
        )
    return np.array(image), np.array(point), np.array(colrow, dtype=np.float64)


@dataclass(frozen=True)
class ImageRpc:
    """RPC of one image: its origin, figures and files.

    Attributes
    ----------
    name : str
    how : str
        'as it came', 'fitted', or what it was refined by: 'control points', 'tie points'.
    facts : mapping
        Figures of the fit and the refinement, as JSON values.
    written : tuple of Path
    grid : CorrectionGrid, optional
        Correction for what a fitted RPC cannot model of its sensor.
    """

    name: str
    how: str
    facts: dict[str, Any]
    written: tuple[Path, ...] = ()
    grid: CorrectionGrid | None = None


@dataclass(frozen=True)
class RefinementRequest:
    """Kind of correction, table of tie points, names of images kept fixed, sigma of a tie point in pixels."""

    kind: str
    ties: Path | None
    fixed: tuple[str, ...]
    sigma_px: float


def refine_rpcs(
    tool: HasRational,
    block: OrientedBlock,
    made: Sequence[tuple[SensorModel, ImageRpc]],
    request: RefinementRequest,
) -> list[tuple[SensorModel, ImageRpc]]:
    """RPCs corrected by control points where an image has them, else by tie points.

    Parameters
    ----------
    tool : HasRational
    block : OrientedBlock
    made : sequence of (SensorModel, ImageRpc)
        RPC of each image of the block.
    request : RefinementRequest

    Raises
    ------
    InputError
        An image or its points are missing.
    SolveError
        The points do not determine the correction.
    """
    names = [scene.name for scene in block.scenes]
    unknown = [name for name in request.fixed if name not in names]
    if unknown:
        raise InputError(
            f"no image is named '{unknown[0]}'", where="`fixed`", hint=f"the images are {', '.join(names)}"
        )
    out, fixed = list(made), {names.index(name) for name in request.fixed}
    for index, name in enumerate(names):
        mine = [point for point in block.control if point.image == name]
        if any(point.role == "control" for point in mine) and block.crs is not None:
            out[index] = _by_control(tool, made[index][0], name, mine, block.crs, request.kind)
            fixed.add(index)
    if request.ties is None:
        if not fixed:
            raise InputError("no control point is measured in these images", where="`control`")
        return out
    image, point, colrow = read_ties(request.ties, names)
    found = tool.correct_rational_by_ties(
        [model for model, _ in out], image, point, colrow, request.kind, request.sigma_px, sorted(fixed)
    )
    facts = {
        "rms_before_px": found.rms_before,
        "rms_after_px": found.rms_after,
        "ties": int(found.used.size),
        "left_out": int((~found.used).sum()),
    }
    for index, model in enumerate(found.models):
        if index not in fixed:
            values = {**facts, **_values(model, found.sigmas[index])}
            out[index] = model, ImageRpc(names[index], "tie points", values)
    return out


def _by_control(
    tool: HasRational, model: SensorModel, name: str, points: Sequence[ControlPoint], crs: CRS, kind: str
) -> tuple[SensorModel, ImageRpc]:
    require_vertical_datum(crs, "the control points", name, lambda _: model)

    def arrays(role: str) -> tuple[list[ControlPoint], FloatArray, FloatArray]:
        mine = [point for point in points if point.role == role]
        ground = np.array([point.xyz for point in mine], dtype=np.float64).reshape(-1, 3)
        image = np.array([point.colrow for point in mine], dtype=np.float64).reshape(-1, 2)
        return mine, Transform(crs, model.crs)(ground), image

    control, ground, image = arrays("control")
    sigmas = np.array([point.sigma_px for point in control])
    try:
        found = tool.refine_rational(model, ground, image, kind, sigmas)
    except SolveError as error:
        error.where = error.where or name
        raise
    check, check_ground, check_image = arrays("check")
    facts: dict[str, Any] = {
        "kind": kind,
        "rms_before_px": found.rms_before,
        "rms_after_px": found.rms_after,
        "points": len(control),
        "left_out": [point.id for point, used in zip(control, found.used.tolist(), strict=True) if not used],
        **_values(found.model, found.sigmas),
    }
    if check:
        off = [check_image - each.ground_to_image(check_ground) for each in (model, found.model)]
        rms = [float(np.sqrt((each**2).sum(axis=1).mean())) for each in off]
        facts |= {"checks": len(check), "check_rms_before_px": rms[0], "check_rms_after_px": rms[1]}
    return found.model, ImageRpc(name, "control points", facts)


def _values(model: SensorModel, sigmas: FloatArray) -> dict[str, Any]:
    """Free correction parameters and their sigmas, pixels."""
    p = model.parameters
    free = p.sigmas > 0.0
    chosen = [name for name, one in zip(p.names, free.tolist(), strict=True) if one]
    return {
        "corrections_px": dict(zip(chosen, p.values[free].tolist(), strict=True)),
        "sigmas_px": {
            name: value if np.isfinite(value) else None
            for name, value in zip(chosen, np.asarray(sigmas)[free].tolist(), strict=True)
        },
    }
