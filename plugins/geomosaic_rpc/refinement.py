"""Refinement of an RPC by control points: shift, shift and drift, or affine, robust against wrong points.

Robust after Rousseeuw (Least Median of Squares Regression, JASA 79, 1984): the correction through few points that
leaves the smallest median residual is untouched by wrong points as long as they are fewer than half. Points within a
multiple of the scatter it shows are good; the result is their least squares adjustment, as if the others did not exist.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.sensor.solve import resect
from geomosaic.types import BoolArray, FloatArray
from geomosaic_rpc.model import KINDS, NAMES, RpcModel

LEAST = {"shift": 1, "drift": 2, "affine": 3}
"""Points that determine each kind."""

_TRIALS = 3000
_CUT = 3.5  # scatters; of 1000 good points with normal errors 2 lie beyond, in two dimensions
_MEDIAN_LENGTH = 1.1774  # median length of a two-dimensional normal error of scatter 1: sqrt(2 ln 2)
_EXACT = 1e-6  # pixels; points that fit better than this are not told apart


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
    """

    model: RpcModel
    sigmas: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    used: BoolArray
    sigma0: float
    rms_before: float
    rms_after: float


def refine(
    model: RpcModel,
    lonlath: FloatArray,
    colrow: FloatArray,
    kind: str = "shift",
    sigmas_px: FloatArray | float | None = None,
    *,
    robust: bool = True,
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
        Standard deviations of the measurements; see `geomosaic.sensor.solve.resect`. Points within 3.5 of them are
        never left out.
    robust : bool
        Find wrong points and leave them out. With fewer than two points more than the kind needs nothing can be found.

    Returns
    -------
    Refinement

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
    spread = np.broadcast_to(np.nan if sigmas_px is None else np.asarray(sigmas_px, dtype=np.float64), seen.shape)
    used = seen.copy()
    # With one point to spare a wrong point is seen, but not told from the right ones; with two it is.
    if robust and seen.sum() >= LEAST[kind] + 2:
        basis = start.jacobian(ground)[0][:, 0, : KINDS[kind] : 2]
        used[seen] = _good(basis[seen], offsets[seen], spread[seen])
    solved = resect(start, ground[used], measured[used], None if sigmas_px is None else spread[used])
    refined = solved.model
    residuals = measured - refined.ground_to_image(ground)
    before, after = (float(np.sqrt((a[used] ** 2).sum(axis=1).mean())) for a in (offsets, residuals))
    return Refinement(
        refined, solved.sigmas, solved.covariance, residuals, used, solved.sigma0, before, after
    )  # fmt: skip


def _good(basis: FloatArray, offsets: FloatArray, spread: FloatArray) -> BoolArray:
    """Points that agree with the correction most of them support.

    Parameters
    ----------
    basis : array (N, T)
        Terms of one axis: 1, place along, place across.
    offsets : array (N, 2)
    spread : array (N,)
        A-priori sigmas in pixels; NaN where unknown.
    """
    count, terms = basis.shape
    best, lengths = math.inf, np.zeros(count)
    for chosen in _subsets(count, terms):
        part = basis[chosen]
        if abs(np.linalg.det(part)) < 1e-3:  # nearly one place or one line: no correction worth trying
            continue
        left = np.hypot(*(offsets - basis @ np.linalg.solve(part, offsets[chosen])).T)
        median = float(np.sort(left)[(count + terms) // 2])  # h of Rousseeuw and Leroy for T terms
        if median < best:
            best, lengths = median, left
    if not math.isfinite(best):
        return np.ones(count, dtype=np.bool_)
    # Small samples make the median too small (Rousseeuw and Leroy 1987, p. 202).
    scatter = best / _MEDIAN_LENGTH * (1.0 + 5.0 / max(count - terms, 1))
    good = _within(lengths, scatter, spread)
    for _ in range(20):
        fitted = np.linalg.lstsq(basis[good], offsets[good], rcond=None)[0]
        left = offsets - basis @ fitted
        free = 2 * (int(good.sum()) - terms)
        own = math.sqrt(float((left[good] ** 2).sum()) / free) if free > 0 else scatter
        # Not below half of the first scatter: good points that happen to agree well would drive out others, one by one.
        again = _within(np.hypot(*left.T), max(own, 0.5 * scatter), spread)
        if (again == good).all() or again.sum() < terms:
            break
        good = again
    return good


def _within(lengths: FloatArray, scatter: float, spread: FloatArray) -> BoolArray:
    """Points (N,) whose residual lengths lie within `_CUT` scatters, or a-priori sigmas where these are larger."""
    limit = _CUT * np.fmax(scatter, spread)
    good: BoolArray = lengths <= np.maximum(limit, _EXACT)
    return good


def _subsets(count: int, size: int) -> list[list[int]]:
    """All choices of `size` points where they are few, else so many of them, the same ones every time."""
    if math.comb(count, size) <= _TRIALS:
        return [list(each) for each in itertools.combinations(range(count), size)]
    rng = np.random.default_rng(20031)
    return [rng.choice(count, size, replace=False).tolist() for _ in range(_TRIALS)]
