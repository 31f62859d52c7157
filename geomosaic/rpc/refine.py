"""RPC fitted to a sensor model with a correction grid, and refinement of RPCs by control or tie points.

The grid holds what an RPC cannot model of a sensor: attitude jitter, bent detector lines.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.block import ControlPoint, OrientedBlock, OrientedImage
from geomosaic.errors import InputError, SolveError, default_where
from geomosaic.geo.transform import Transform
from geomosaic.image_names import stem
from geomosaic.inputs.adjusted import AdjustedImage, adjustment_facts
from geomosaic.inputs.tables import read_table
from geomosaic.options.control import TieOptions
from geomosaic.sensor.corrected import Corrected, CorrectionGrid, left_out
from geomosaic.sensor.plausibility import require_vertical_datum
from geomosaic.sensor.plugin import HasRational, SensorModel
from geomosaic.sensor.solve import image_to_height, precision
from geomosaic.types import FloatArray, IntArray

WGS84 = CRS.from_epsg(4979)
# Interpolation error along a line, pixels, that the chosen node spacing must keep.
_TOLERANCE = 2.5e-3
_UNSEEN = "give heights of the ground that the image shows, and look whether RPC and sensor are of this image"
_SPACINGS = (512.0, 256.0, 128.0, 64.0, 32.0, 16.0, 8.0)
# Positions of the test lines for the spacing, as shares of the other side.
_TEST_LINES = (0.1, 0.5, 0.9)
_LEVELS = 3
_CHECKS = 20_000
_BLOCK = 200_000
_GOLDEN_STEPS = np.array([0.7548776662466927, 0.5698402909980532, 0.2198])  # spread evenly over a box without a pattern

Difference = Callable[[FloatArray, FloatArray | float], FloatArray]


@dataclass(frozen=True)
class GridFit:
    """Correction grid to an RPC, with the error of both together.

    Attributes
    ----------
    grid : CorrectionGrid
        Sensor minus RPC, at the position by the RPC, in pixels.
    rms, worst : float
        RMS and largest distance, pixels, between RPC with grid and sensor, at check points over image and heights.
    alone_rms, alone_worst : float
        The same of the RPC without the grid.
    checks : int
    """

    grid: CorrectionGrid
    rms: float
    worst: float
    alone_rms: float
    alone_worst: float
    checks: int


def fit_rpc_and_grid(
    tool: HasRational, exact: SensorModel, sensor: str, heights: tuple[float, float]
) -> tuple[Any, GridFit]:
    """RPC and correction grid that together approximate a sensor model.

    Parameters
    ----------
    tool : HasRational
    exact : SensorModel
    sensor : str
    heights : tuple of float
        Lowest and highest ellipsoidal height, metres.

    Raises
    ------
    SolveError
        No rational map describes the sensor, or it does not see the ground at these heights.
    """
    # An RPC fitted to jitter follows it in part, differently at each height, and no grid can correct that. So the RPC
    # is fitted a second time, to the sensor less the first grid: alone it is a few per cent worse, with its grid up to
    # ten times better.
    first = _residual_grid(tool.fit_rational(exact, heights).model, exact, heights).grid
    rows, columns, _ = first.nodes.shape
    sides = (first.origin[axis] + first.spacing[axis] * np.arange(n) for axis, n in enumerate((columns, rows)))
    places = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    nodes = (first.ideal(places) - places).reshape(rows, columns, 2)
    back = CorrectionGrid(first.origin, first.spacing, nodes, beyond="held")
    model = tool.fit_rational(Corrected.of(exact, back, sensor), heights).model
    return model, _residual_grid(model, exact, heights)


def _residual_grid(rational: SensorModel, exact: SensorModel, heights: tuple[float, float]) -> GridFit:
    """Correction grid from an RPC to the model it was fitted to, over ellipsoidal heights in metres."""
    # Each node is the mean of the differences at three heights: jitter and bent detector lines rotate lines of sight,
    # which moves the image by nearly the same at all heights.
    to_exact = Transform(WGS84, exact.crs)

    def difference(places: FloatArray, levels: FloatArray | float) -> FloatArray:
        """Sensor minus RPC (N, 2) at image positions by the RPC (N, 2) and heights."""
        high = np.broadcast_to(levels, len(places))
        parts = []
        for start in range(0, len(places), _BLOCK):
            some = slice(start, start + _BLOCK)
            ground = image_to_height(rational, places[some], high[some], WGS84)
            parts.append(exact.ground_to_image(to_exact(ground)) - places[some])
        return np.vstack(parts)

    middle = 0.5 * (heights[0] + heights[1])
    width, height = (float(side) for side in exact.size)
    counts = [_cells(difference, middle, (width, height), axis) for axis in (0, 1)]
    spacing = np.array([width / counts[0], height / counts[1]])
    # One node beyond each edge, so that the outermost cells are as good as the others.
    cols, rows = (spacing[axis] * np.arange(-1.0, counts[axis] + 2.0) for axis in (0, 1))
    places = np.stack(np.meshgrid(cols, rows), axis=-1).reshape(-1, 2)
    found = [difference(places, level) for level in np.linspace(*heights, _LEVELS)]
    nodes = _filled(np.mean(found, axis=0).reshape(len(rows), len(cols), 2))
    grid = CorrectionGrid(-spacing, spacing, nodes, beyond="held")
    share = np.mod(0.5 + np.arange(1.0, _CHECKS + 1.0)[:, None] * _GOLDEN_STEPS, 1.0)
    image = share[:, :2] * exact.size
    alone = difference(image, heights[0] + share[:, 2] * (heights[1] - heights[0]))
    if not np.isfinite(alone).all():
        raise SolveError("the RPC or the sensor does not see all of the image's ground at these heights", hint=_UNSEEN)
    return GridFit(grid, *_length(alone - grid.at(image)), *_length(alone), _CHECKS)


def _length(off: FloatArray) -> tuple[float, float]:
    """RMS and largest length of differences (N, 2)."""
    square = (off**2).sum(axis=1)
    return float(np.sqrt(square.mean())), float(np.sqrt(square.max()))


def _cells(difference: Difference, middle: float, size: tuple[float, float], axis: int) -> int:
    """Least number of cells along an axis that keeps the interpolation error within `_TOLERANCE`."""
    side, other = size[axis], size[1 - axis]
    along = np.linspace(0.0, side, int(min(4097.0, side + 1.0)))
    for spacing in _SPACINGS:
        cells = int(np.ceil(side / spacing))
        step = side / cells
        nodes = step * np.arange(-1.0, cells + 2.0)
        worst = 0.0
        for share in _TEST_LINES:
            at_nodes, truth = (difference(_line(t, share * other, axis), middle) for t in (nodes, along))
            line = _filled(at_nodes[None] if axis == 0 else at_nodes[:, None])
            origin, spacings = np.full(2, share * other), np.ones(2)
            origin[axis], spacings[axis] = -step, step
            if not np.isfinite(truth).all():
                raise SolveError(
                    "the RPC or the sensor does not see all of the image's ground at these heights", hint=_UNSEEN
                )
            error = CorrectionGrid(origin, spacings, line, beyond="held").at(_line(along, share * other, axis)) - truth
            worst = max(worst, float(np.abs(error).max()))
        if worst <= _TOLERANCE:
            break
    return cells


def _line(along: FloatArray, across: float, axis: int) -> FloatArray:
    places = np.full((len(along), 2), across)
    places[:, axis] = along
    return places


def _filled(nodes: FloatArray) -> FloatArray:
    """Nodes (R, C, 2) with the NaN beyond the image replaced by the values at its edge."""
    rows, columns, _ = nodes.shape
    inner = nodes[min(1, rows - 1) : max(rows - 1, 1), min(1, columns - 1) : max(columns - 1, 1)]
    around = tuple((1, 1) if count > 1 else (0, 0) for count in (rows, columns))
    return np.where(np.isfinite(nodes), nodes, np.pad(inner, (*around, (0, 0)), mode="edge"))


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


def refine_rpcs(
    tool: HasRational,
    block: OrientedBlock,
    made: Sequence[tuple[SensorModel, ImageRpc]],
    kind: str,
    tied: TieOptions,
) -> list[tuple[SensorModel, ImageRpc]]:
    """RPCs corrected by control points where an image has them, else by tie points.

    Parameters
    ----------
    tool : HasRational
    block : OrientedBlock
    made : sequence of (SensorModel, ImageRpc)
        RPC of each image of the block.
    kind : str
        Of the correction.
    tied : TieOptions

    Raises
    ------
    InputError
        An image or its points are missing.
    SolveError
        The points do not determine the correction.
    """
    names = [scene.name for scene in block.scenes]
    unknown = [name for name in tied.fixed if name not in names]
    if unknown:
        raise InputError(
            f"no image is named '{unknown[0]}'", where="`fixed`", hint=f"the images are {', '.join(names)}"
        )
    out, fixed = list(made), {names.index(name) for name in tied.fixed}
    for index, name in enumerate(names):
        mine = [point for point in block.control if point.image == name]
        if any(point.role == "control" for point in mine) and block.crs is not None:
            out[index] = _by_control(tool, made[index][0], name, mine, block.crs, kind)
            fixed.add(index)
    if tied.ties is None:
        if not fixed:
            raise InputError(
                "no control point is measured in these images",
                where="`control`",
                hint="give points of these images, or ties, or leave `control` out",
            )
        return out
    image, point, colrow = read_ties(tied.ties, names)
    found = tool.correct_rational_by_ties(
        [model for model, _ in out], image, point, colrow, kind, tied.sigma_px, sorted(fixed)
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
    with default_where(name):
        found = tool.refine_rational(model, ground, image, kind, sigmas, [point.id for point in control])
    used = found.used
    statistics = precision(found.model, ground[used], image[used], sigmas[used])
    height = float(np.mean([point.xyz[2] for point, good in zip(control, used.tolist(), strict=True) if good]))
    scene = OrientedImage(name, "", "", found.model)
    adjusted = adjustment_facts([AdjustedImage(scene, statistics, int(used.sum()), height, left_out(found.model))], crs)
    check, check_ground, check_image = arrays("check")
    facts: dict[str, Any] = {
        "kind": kind,
        "rms_before_px": found.rms_before,
        "rms_after_px": found.rms_after,
        "points": len(control),
        "left_out": [point.id for point, used in zip(control, found.used.tolist(), strict=True) if not used],
        **_values(found.model, found.sigmas),
        "accuracy": adjusted["accuracy"],
        "summary": adjusted["summary"],
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
