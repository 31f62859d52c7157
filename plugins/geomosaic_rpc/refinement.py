"""Refinement of an RPC model by control points, wrong ones left out.

The corrections are linear in the uncorrected image position, alike for columns and rows, so that a fit to any choice of
points costs one small linear solution. Wrong points are found as in any control (`geomosaic.estimation.blunders`): a
trimmed start, then data snooping.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.estimation.blunders.data_snooping import snoop
from geomosaic.estimation.blunders.least_trimmed_squares import trimmed_start
from geomosaic.estimation.equations import Equations
from geomosaic.estimation.statistics import Cofactors, sigma0_of
from geomosaic.sensor.solve import resect
from geomosaic.types import AnyArray, BoolArray, FloatArray
from geomosaic_rpc.model import KINDS, NAMES, RpcModel

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
        Standard deviations of the measurements; see `geomosaic.sensor.solve.resect`. A point is not judged by a
        smaller scatter than that.
    robust : bool
        Find wrong points and leave them out. With fewer than two points more than the kind needs nothing can be found.

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
    # With one point to spare a wrong point is seen, but cannot be separated from the right ones; with two it is.
    if robust and seen.sum() >= LEAST[kind] + 2:
        design = start.jacobian(ground[seen])[0][:, :, : KINDS[kind]]
        used[seen] = _good(_Corrections(design, offsets[seen], spread[seen]))
    solved = resect(start, ground[used], measured[used], None if sigmas_px is None else spread[used])
    refined = solved.model
    residuals = measured - refined.ground_to_image(ground)
    before, after = (float(np.sqrt((a[used] ** 2).sum(axis=1).mean())) for a in (offsets, residuals))
    return Refinement(
        refined, solved.sigmas, solved.covariance, residuals, used, solved.sigma0, before, after
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _CorrectionFit:
    """Least squares fit of corrections: its values (P,), with what a search for blunders asks (`PointFit`)."""

    values: FloatArray
    cofactors: Cofactors
    sigma0: float
    redundancy: int


@dataclass(frozen=True, eq=False)
class _Corrections:
    """Offsets (N, 2) of control points with their derivatives (N, 2, P) by the corrections (`blunders.Refit`)."""

    design: FloatArray
    offsets: FloatArray
    given: FloatArray

    @cached_property
    def sigma(self) -> FloatArray:
        """Standard deviations (N,) in pixels; 1 where none are given."""
        return np.where(np.isfinite(self.given), self.given, 1.0)

    @property
    def ids(self) -> tuple[str, ...]:
        """Numbers of the points."""
        return tuple(map(str, range(len(self))))

    @property
    def magnitude(self) -> float:
        """Largest offset, pixels."""
        return float(np.abs(self.offsets).max())

    def __len__(self) -> int:
        return len(self.offsets)

    def _equations(self, chosen: AnyArray, sigma: FloatArray) -> Equations:
        design, offsets = (a[chosen] / sigma[chosen, None, None] for a in (self.design, self.offsets[:, :, None]))
        found = Equations(design.reshape(-1, design.shape[2]), offsets.ravel())
        if not found.determined:
            raise SolveError("the points chosen do not determine the correction", hint="choose more of them")
        return found

    def model(self, selection: AnyArray | None = None, sigma: FloatArray | None = None) -> FloatArray:
        """Corrections (P,) fitted to a selection."""
        chosen = np.arange(len(self)) if selection is None else selection
        return self._equations(chosen, self.sigma if sigma is None else sigma).step()

    def free_parameters(self, model: FloatArray) -> int:
        """Number of corrections."""
        return len(model)

    def errors(self, model: FloatArray) -> FloatArray:
        """Offsets (N, 2) less those that corrections (P,) explain, pixels."""
        return self.offsets - self.design @ model

    def errors_under(self, selection: AnyArray) -> FloatArray:
        """Errors (N, 2) under the corrections fitted to a selection."""
        return self.errors(self.model(selection))

    def fit(self, kept: AnyArray) -> _CorrectionFit:
        """Fit to a selection."""
        equations = self._equations(kept, self.sigma)
        values = equations.step()
        squares = float((equations.residuals(values) ** 2).sum())
        found = Cofactors.of(equations, np.ones(len(values), dtype=np.bool_), len(equations.misclosure) // 2)
        return _CorrectionFit(values, found, sigma0_of(squares, equations.redundancy), equations.redundancy)

    def statistics(self, kept: BoolArray) -> tuple[_CorrectionFit, FloatArray]:
        """Fit to the points kept, and how much each point (N,) contradicts it."""
        fit = self.fit(kept)
        weighted, design = self.errors(fit.values) / self.sigma[:, None], self.design / self.sigma[:, None, None]
        statistic = np.zeros(len(self))
        statistic[kept] = fit.cofactors.deletion_statistic(weighted[kept])
        statistic[~kept] = fit.cofactors.prediction_statistic(weighted[~kept], design[~kept])
        return fit, statistic


def _good(problem: _Corrections) -> BoolArray:
    """Points (N,) that no search for blunders rejects."""
    start = trimmed_start(problem)
    if np.isfinite(problem.given).all():
        start = replace(start, scale=max(start.scale, 1.0))
    blunders = snoop(problem, start).blunders
    return ~np.isin(np.array(problem.ids), np.array(blunders))
