"""Refinement of an RPC model by control points, wrong ones left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.sensor.solve import ControlResection, resect_control
from geomosaic.types import BoolArray, FloatArray
from geomosaic_rpc.model import NAMES, RpcModel

# Points that determine each kind.
LEAST = {"shift": 1, "drift": 2, "affine": 3}


@dataclass(frozen=True)
class Refinement:
    """RPC model corrected by control points, with its residuals.

    Attributes
    ----------
    model : RpcModel
        Corrected; its parameters stay free for a later adjustment.
    sigmas : array (6,)
        Standard deviations of the parameters in pixels; 0 for those the kind leaves out, NaN without redundancy.
    covariance : array (6, 6)
        Of the parameters, square pixels.
    residuals : array (N, 2)
        Measured minus computed (col, row) of all points, in pixels.
    used : bool array (N,)
        Which points took part.
    sigma0 : float
        See `geomosaic.sensor.solve.Resection`.
    rms_before, rms_after : float
        RMS length of the residuals of the points used, in pixels.
    search : ControlResection
        Search for wrong points.
    """

    model: RpcModel
    sigmas: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    used: BoolArray
    sigma0: float
    rms_before: float
    rms_after: float
    search: ControlResection[RpcModel]


def refine(
    model: RpcModel,
    lonlath: FloatArray,
    colrow: FloatArray,
    kind: str = "shift",
    sigmas_px: FloatArray | float | None = None,
    ids: Sequence[str] = (),
) -> Refinement:
    """RPC model corrected by control points, wrong ones left out.

    Parameters
    ----------
    model : RpcModel
        Start; its corrections so far are replaced.
    lonlath : array (N, 3)
        Longitude, latitude in degrees, ellipsoidal height in metres.
    colrow : array (N, 2)
        Measured, in pixels.
    kind : str
        'shift' (from 1 point), 'drift' (shift and drift along the rows, from 2) or 'affine' (from 3).
    sigmas_px : float or array (N,), optional
        Standard deviations of the measurements; see `geomosaic.sensor.solve.resect_control`.
    ids : sequence of str, optional
        Names of the points.

    Raises
    ------
    SolveError
        Too few points, or points that do not determine the correction.
    """
    if kind not in LEAST:
        raise ValueError(f"kind is {kind!r}, not one of {', '.join(LEAST)}")
    ground, measured = np.asarray(lonlath, dtype=np.float64), np.asarray(colrow, dtype=np.float64)
    start = model.freed(kind).with_values(np.zeros(len(NAMES)))
    offsets = measured - start.ground_to_image(ground)
    seen: BoolArray = np.isfinite(offsets.sum(axis=1))
    if seen.sum() < LEAST[kind]:
        raise SolveError(
            f"{int(seen.sum())} control points do not determine '{kind}', which needs {LEAST[kind]}",
            hint="give more points, or choose a simpler refinement",
        )
    found = resect_control(start, ground, measured, sigmas_px, ids)
    solved, residuals, used = found.solved, found.residuals, found.used
    before, after = (float(np.sqrt((a[used] ** 2).sum(axis=1).mean())) for a in (offsets, residuals))
    refined = replace(solved.model, left_out=found.left_out)
    return Refinement(
        refined, solved.sigmas, solved.covariance, residuals, used, solved.sigma0, before, after, found
    )  # fmt: skip
