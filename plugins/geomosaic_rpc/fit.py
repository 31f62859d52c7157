"""Fit of rational polynomials to any sensor model, on exact ground points at levels of height.

For each image axis the coefficients of numerator and denominator minimise

    Σ ((N(L, P, H) − r · D(L, P, H)) / D₀(L, P, H))² + λ² · n · Σ coefficients²

over n points with normalised image coordinate r; D starts with 1, and D₀ is the denominator of the round before, so
that the residual is in the image (Tao and Hu, A Comprehensive Study of the Rational Function Model, PE&RS 67(12),
2001). The 78 coefficients depend on each other nearly completely: λ is the largest one that loses nothing at check
points between the points of the fit, which keeps the coefficients small and the map smooth beyond the box.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.geo.crs import has_heights
from geomosaic.sensor.plugin import SensorModel
from geomosaic.sensor.solve import image_to_height
from geomosaic.types import FloatArray
from geomosaic_rpc.coefficients import COUNT, Rpc, evaluate, terms
from geomosaic_rpc.model import WGS84, RpcModel

_NO_FIT = "give a narrower range of heights, or a part of the image"
_COLUMNS, _LEVELS = 17, 7
_DENSE = 241  # places along a line of the last check
_MARGIN = 0.02  # of the image, beyond its edges: products interpolate across the edge
_DAMPINGS = 10.0 ** np.arange(-4.0, -13.0, -1.0)
_ROUNDS = 4
_LOSS = 1.2  # by this factor the error at check points may exceed the smallest one
_NOTHING = 1e-4  # pixels; less error than this is worth nothing


@dataclass(frozen=True)
class RpcFit:
    """An RPC fitted to a model, with its error at check points that took no part in the fit.

    Attributes
    ----------
    model : RpcModel
    rms, worst : float
        RMS and largest distance in pixels from the model fitted to, over the check points.
    points, checks : int
        Numbers of points.
    heights : tuple of float
        Lowest and highest ellipsoidal height of the box, metres.
    damping : float
        λ.
    """

    model: RpcModel
    rms: float
    worst: float
    points: int
    checks: int
    heights: tuple[float, float]
    damping: float


def fit_rpc(model: SensorModel, heights: tuple[float, float]) -> RpcFit:
    """RPC fitted to a sensor model.

    Parameters
    ----------
    model : SensorModel
        With heights.
    heights : tuple of float
        Lowest and highest ellipsoidal height of the ground in metres, above WGS 84; at least a metre apart.

    Raises
    ------
    SolveError
        The model sees too little ground at these heights, or no rational map describes it.
    """
    low, high = heights
    if not high - low >= 1.0:
        raise SolveError(
            f"heights from {low} to {high} m are no box to fit an RPC on",
            hint="give the lowest and the highest height of the ground, at least 1 m apart",
        )
    if not has_heights(model.crs):
        raise SolveError("this sensor model has no heights, so it has no RPC", hint="use its own transformation")
    ground, image = _exact(model, _places(model.size, _COLUMNS), np.linspace(low, high, _LEVELS))
    between = 0.5 * (np.linspace(low, high, _LEVELS)[1:] + np.linspace(low, high, _LEVELS)[:-1])
    # Checked half-way between the nodes in all three directions, where a fit that swings is worst.
    check_ground, check_image = _exact(model, _places(model.size, _COLUMNS - 1, 0.0), between)
    # Each axis has 39 unknowns; twice as many points leave the fit no room to swing between them.
    if len(ground) < 4 * COUNT or not len(check_ground):
        raise SolveError(
            f"the model sees ground at {len(ground)} of {_COLUMNS**2 * _LEVELS} places between {low} and {high} m",
            hint="give heights of the ground the image shows",
        )
    frame = _normalising(model, ground)
    tried = []
    for damping in _DAMPINGS:
        rpc = _fitted(frame, ground, image, float(damping))
        off = np.hypot(*(rpc.image(check_ground) - check_image).T)
        tried.append((float(off.max()) if np.isfinite(off).all() else np.inf, off, float(damping), rpc))
        least = min(each[0] for each in tried)
        if least <= _NOTHING or (len(tried) > 2 and least < min(each[0] for each in tried[-2:])):
            break  # good enough, or it has got worse twice
    if not np.isfinite(least):
        raise SolveError("no rational polynomials describe this model over its image and these heights", hint=_NO_FIT)
    worst, off, damping, rpc = next(each for each in tried if each[0] <= max(_LOSS * least, _NOTHING))
    # What trembles from row to row, or bends along the detectors, would slip between the points so far.
    dense_ground, dense_image = _exact(model, _crosswise(model.size), between[[0, -1]])
    off = np.concatenate([off, np.hypot(*(rpc.image(dense_ground) - dense_image).T)])
    worst = float(off.max()) if np.isfinite(off).all() else np.inf
    if not np.isfinite(worst):
        raise SolveError("no rational polynomials describe this model over its image and these heights", hint=_NO_FIT)
    note = f"RPC fitted to heights from {low:g} to {high:g} m, {worst:.2g} px off at most"
    fitted = RpcModel.of(rpc, model.size, notes=(note,))
    rms = float(np.sqrt((off**2).mean()))
    return RpcFit(fitted, rms, worst, len(ground), len(off), (low, high), damping)


def _places(size: tuple[int, int], count: int, margin: float = _MARGIN) -> FloatArray:
    """Image points (N, 2) of a lattice over the image and a margin, denser towards the edges (Chebyshev's nodes)."""
    # So spread, a least squares fit has about the smallest largest error a polynomial can have.
    share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, count)) * (1.0 + 2.0 * margin)
    sides = [share * side for side in size]
    return np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)


def _crosswise(size: tuple[int, int]) -> FloatArray:
    """Image points (N, 2) close together along rows and along columns, few of which are taken."""
    few, many = ([np.linspace(0.0, side, count) for side in size] for count in (3, _DENSE))
    down = np.stack(np.meshgrid(few[0], many[1]), axis=-1).reshape(-1, 2)
    across = np.stack(np.meshgrid(many[0], few[1]), axis=-1).reshape(-1, 2)
    return np.vstack([down, across])


def _exact(model: SensorModel, places: FloatArray, levels: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ground (N, 3) of image points at several heights, and the image (N, 2); unseen ones are left out."""
    ground = np.vstack([image_to_height(model, places, float(level), WGS84) for level in levels])
    image = np.tile(places, (len(levels), 1))
    seen = np.isfinite(ground).all(axis=1)
    return ground[seen], image[seen]


def _normalising(model: SensorModel, ground: FloatArray) -> Rpc:
    """Offsets and scales that bring ground and image to -1 ... 1; no coefficients yet."""
    offset = ground[0] + 0.0
    lon = np.mod(ground[:, 0] - offset[0] + 180.0, 360.0) - 180.0  # a scene at the date line
    # Longitudes relative to the first point do not jump at ±180°.
    spread = np.column_stack([lon, ground[:, 1:]])
    low, high = spread.min(axis=0), spread.max(axis=0)
    centre = 0.5 * (low + high) + (offset[0], 0.0, 0.0)
    centre[0] = np.mod(centre[0] + 180.0, 360.0) - 180.0
    half = np.array(model.size) / 2.0
    unit = np.zeros((4, COUNT))
    unit[:, 0] = 1.0
    return Rpc(half, half, centre, 0.5 * (high - low), unit)


def _fitted(frame: Rpc, ground: FloatArray, image: FloatArray, damping: float) -> Rpc:
    lph, _ = frame.normalised(ground)
    each = terms(lph).T
    coefficients = np.zeros((4, COUNT))
    for axis in range(2):
        right = (image[:, axis] - frame.image_offset[axis]) / frame.image_scale[axis]
        design = np.hstack([each, -right[:, None] * each[:, 1:]])
        ridge = damping * np.sqrt(len(right)) * np.eye(design.shape[1])
        # The constant term is no cause of poles and is not damped.
        ridge[0, 0] = 0.0
        bottom = np.ones(len(right))
        for _ in range(_ROUNDS):
            # No case of `geomosaic.estimation`: each round is a linear solution in closed form, and where the rounds
            # settle is not the minimum of one sum of squares, which is what that solver looks for.
            # Multiplied by the denominator the equation is linear; divided by its last value the residuals are pixels.
            weighted = np.vstack([design / bottom[:, None], ridge])
            target = np.concatenate([right / bottom, np.zeros(len(ridge))])
            found = np.linalg.lstsq(weighted, target, rcond=None)[0]
            coefficients[2 * axis] = found[:COUNT]
            coefficients[2 * axis + 1] = np.concatenate([[1.0], found[COUNT:]])
            before, bottom = bottom, evaluate(coefficients[2 * axis + 1 : 2 * axis + 2], lph)[0]
            # A pole in the box: this damping is of no use. Or the weights stay as they are.
            if not (bottom > 0.05).all() or np.abs(bottom / before - 1.0).max() < 1e-3:
                break
    return Rpc(frame.image_offset, frame.image_scale, frame.ground_offset, frame.ground_scale, coefficients)
