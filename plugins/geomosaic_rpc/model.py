"""The RPC sensor model, corrected in the image by shift, drift or affine, and its refinement by control points.

    (c, r) = RPC(longitude, latitude, height)
    col = c + col_shift + col_per_row·v + col_per_col·u,   u = (c − width/2) / half,   half = max(width, height) / 2
    row = r + row_shift + row_per_row·v + row_per_col·u,   v = (r − height/2) / half

so that every parameter is in pixels: what its term does at the longer image edge. The terms are those of Grodecki and
Dial (Block Adjustment of High-Resolution Satellite Images Described by Rational Polynomials, PE&RS 69(1), 2003) and of
Fraser and Hanley (Bias-Compensated RPCs, PE&RS 71(8), 2005), whose drift goes along the rows: the lines of a scanner
are taken one after the other.

Robust after Rousseeuw (Least Median of Squares Regression, JASA 79, 1984): the correction through few points that
leaves the smallest median residual is untouched by wrong points as long as they are fewer than half. Points within a
multiple of the scatter it shows are good; the result is their least squares adjustment, as if the others did not exist.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, SolveError
from geomosaic.geo.units import metres_per_unit
from geomosaic.sensor.plugin import Parameters
from geomosaic.sensor.solve import resect
from geomosaic.types import BoolArray, FloatArray
from geomosaic_rpc.coefficients import Rpc

NAMES = ("col_shift", "row_shift", "col_per_row", "row_per_row", "col_per_col", "row_per_col")
# Refinements and how many of the parameters they free.
KINDS = {"none": 0, "shift": 2, "drift": 4, "affine": 6}

WGS84 = CRS.from_epsg(4979)


@dataclass(frozen=True)
class RpcModel:
    """RPC sensor model of one scene, with corrections in the image.

    Attributes
    ----------
    rpc : Rpc
        As the producer made it.
    size : tuple of int
        Width and height in pixels.
    parameters : Parameters
        The six corrections in pixels (see above); those that the kind of refinement leaves out are held fixed.
    seed : tuple of float
        Longitude, latitude and height near the middle of the image.
    notes : tuple of str
        Where the coefficients come from and what was done to them.
    """

    rpc: Rpc
    size: tuple[int, int]
    parameters: Parameters
    seed: tuple[float, float, float]
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, rpc: Rpc, size: tuple[int, int], kind: str = "shift", *, where: str = "RPC", notes: tuple[str, ...] = ()
    ) -> Self:
        """Model that is not corrected yet.

        Parameters
        ----------
        rpc : Rpc
        size : tuple of int
            Width and height in pixels.
        kind : str
            What an adjustment may change: 'none', 'shift', 'drift' (shift and drift) or 'affine'.
        where : str
            Named in errors.
        notes : tuple of str

        Raises
        ------
        InputError
            The coefficients do not show the middle of an image of this size.
        """
        sigmas = np.where(np.arange(len(NAMES)) < KINDS[kind], np.inf, 0.0)
        zero = np.zeros(len(NAMES))
        parameters = Parameters(NAMES, ("px",) * len(NAMES), zero, sigmas, zero + 1.0)
        return cls(rpc, size, parameters, _middle(rpc, size, where), notes)

    def freed(self, kind: str) -> Self:
        """Model with the parameters of another kind of refinement free."""
        sigmas = np.where(np.arange(len(NAMES)) < KINDS[kind], np.inf, 0.0)
        return replace(self, parameters=replace(self.parameters, sigmas=sigmas))

    @property
    def crs(self) -> CRS:
        """WGS 84, longitude, latitude and ellipsoidal height."""
        return WGS84

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Ground (N, 3), degrees and metres, to image (N, 2) in pixels; NaN far outside the scene."""
        image = self.rpc.image(xyz)
        values = self.parameters.values
        if not values.any():
            return image
        u, v = self._edges(image)
        out: FloatArray = image + values[:2] + v[:, None] * values[2:4] + u[:, None] * values[4:]
        return out

    def jacobian(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of (col, row) by parameters (N, 2, 6), and by ground (N, 2, 3) per degree and metre."""
        image, by_ground = self.rpc.jacobian(xyz)
        values, half = self.parameters.values, max(self.size) / 2.0
        by_parameters = np.zeros((len(image), 2, len(NAMES)))
        for k, term in enumerate((np.where(np.isnan(image[:, 0]), np.nan, 1.0), *self._edges(image)[::-1])):
            by_parameters[:, 0, 2 * k] = by_parameters[:, 1, 2 * k + 1] = term
        # The corrections are functions of the uncorrected image: by the chain rule, I + their gradient multiplies its
        # derivatives.
        turn = np.eye(2) + np.column_stack([values[4:], values[2:4]]) / half
        return by_parameters, np.einsum("ij,njk->nik", turn, by_ground)

    def _edges(self, image: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places (N,) across and along, ±1 at the longer image edge."""
        half = max(self.size) / 2.0
        return (image[:, 0] - self.size[0] / 2.0) / half, (image[:, 1] - self.size[1] / 2.0) / half

    def with_values(self, values: FloatArray) -> Self:
        """Scene with other corrections (6,)."""
        return replace(self, parameters=self.parameters.with_values(values))

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance (6, 6) of shifts that move the ground by the errors of the file; None where it states none."""
        # ERR_BIAS and ERR_RAND are RMS errors in metres along each horizontal axis (STDI-0002, RPC00B). Both move a
        # pixel, and independently. Of a corrected scene they say no more.
        if self.rpc.errors is None or self.parameters.values.any():
            return None
        seed = np.array([self.seed])
        by_metre = (self.rpc.jacobian(seed)[1] / metres_per_unit(WGS84, seed))[0, :, :2]
        found = np.zeros((len(NAMES), len(NAMES)))
        found[:2, :2] = np.square(self.rpc.errors).sum() * by_metre @ by_metre.T
        return found

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            "rpc": self.rpc.to_dict(),
            "size": list(self.size),
            **self.parameters.to_dict(),
            "seed": list(self.seed),
            "notes": list(self.notes),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Model of a state, as `to_dict` gives it."""
        parameters = Parameters.from_dict(NAMES, ("px",) * len(NAMES), state)
        width, height = state["size"]
        lon, lat, h = state["seed"]
        return cls(Rpc.from_dict(state["rpc"]), (width, height), parameters, (lon, lat, h), tuple(state["notes"]))


def _middle(rpc: Rpc, size: tuple[int, int], where: str) -> tuple[float, float, float]:
    """Ground at the middle of an image and the middle height of its RPC, by Newton's method."""
    target = np.array(size) / 2.0
    place = rpc.ground_offset.copy()
    for _ in range(60):
        image, by_ground = (a[0] for a in rpc.jacobian(place[None]))
        left = target - image
        if np.abs(left).max() < 1e-3:  # NaN goes on to the error
            return float(place[0]), float(place[1]), float(place[2])
        matrix = by_ground[:, :2]
        if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) == 0.0:
            break
        # Half a scene at most: a full step from a far start may leave the range of the polynomials.
        step = np.linalg.solve(matrix, left)
        longest = float(np.max(np.abs(step / rpc.ground_scale[:2])))
        place[:2] += step * min(1.0, 0.5 / longest if longest > 0.0 else 1.0)
    low, high = rpc.image_offset - np.abs(rpc.image_scale), rpc.image_offset + np.abs(rpc.image_scale)
    raise InputError(
        f"the RPC does not show the middle of this image of {size[0]} x {size[1]} pixels; it is made for columns "
        f"{low[0]:.0f} to {high[0]:.0f} and rows {low[1]:.0f} to {high[1]:.0f}",
        where=where,
        hint="check that the RPC belongs to this image; for a part of a scene give offset = [col, row] of its corner",
    )


# Points that determine each kind.
LEAST = {"shift": 1, "drift": 2, "affine": 3}

_TRIALS = 3000
_CUT = 3.5  # scatters; of 1000 good points with normal errors 2 lie beyond, in two dimensions
_MEDIAN_LENGTH = 1.1774  # median length of a two-dimensional normal error of scatter 1: sqrt(2 ln 2)
_EXACT = 1e-6  # pixels; points that fit better than this count as equal


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
    """Points that agree with the correction most of them support."""
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
