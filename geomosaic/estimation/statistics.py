"""Statistics of least squares: sigma0, cofactors, redundancy, leave-one-out errors, correlations, tests.

With weighted design A, residuals v = R e of the errors e, where R = I − A (AᵀA)⁻¹ Aᵀ, so R holds the cofactors of the
residuals; its diagonal are the redundancy numbers (Förstner 1979). Without a set of observations their residuals would
be R_SS⁻¹ v_S, and the weighted sum of squares would be less by v_Sᵀ R_SS⁻¹ v_S (Cook and Weisberg 1982; Kok 1984): the
two axes of a point, all coordinates of some control points, any measurement of a block.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import erfc, sqrt

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.estimation.equations import Equations
from geomosaic.types import BoolArray, FloatArray, IntArray

# Redundancy number below which an observation is not checked by others.
UNCHECKED = 1e-7
# Differences up to which all signs are counted; the normal distribution serves beyond, and where lengths are equal.
EXACT = 50
# Standard deviation of a normal distribution over its median absolute deviation.
MAD_TO_SIGMA = 1.4826
# Robust standard deviations beyond which a sample has no weight: 95 % efficient on normal noise.
BIWEIGHT_LIMIT = 4.685


@dataclass(frozen=True, eq=False)
class Cofactors:
    """Cofactors of the parameters and of the points at a solution.

    Attributes
    ----------
    parameters : array (P, P), or (P,)
        Cofactors of the parameters, 0 for those held fixed; of parameters without correlation the diagonal alone.
    share : array (N, 2, 2)
        Redundancy numbers R_ii: the share of each measurement that the others check.
    redundancy : int
        Observations, a-priori values of parameters among them, minus free parameters.
    """

    parameters: FloatArray
    share: FloatArray
    redundancy: int

    @classmethod
    def of(cls, equations: Equations, free: BoolArray, points: int) -> Cofactors:
        """Cofactors of dense equations whose first rows are two for each point.

        Parameters
        ----------
        equations : Equations
        free : bool array (P,)
            Parameters that are unknowns of the equations.
        points : int

        Raises
        ------
        SolveError
            The points do not determine the parameters.
        """
        if not equations.determined:
            raise SolveError("the control points do not determine the parameters of the model", hint="add points")
        whole = np.zeros((len(free), len(free)))
        if free.any():
            whole[np.ix_(free, free)] = equations.parameter_cofactors()
        return cls(whole, equations.redundancy_numbers(points), equations.redundancy)

    @classmethod
    def of_interpolation(cls, sigma: FloatArray) -> Cofactors:
        """Cofactors of a model that passes through its points, and whose parameters are their image coordinates.

        Parameters
        ----------
        sigma : array (N,)
            Standard deviations of the image coordinates, pixels; the parameters are col of all points, then row.
        """
        # The weighted design is diag(1/σ): its decomposition would only find that, at a cost of N³.
        return cls(np.tile(sigma**2, 2), np.zeros((len(sigma), 2, 2)), 0)

    @property
    def redundancy_numbers(self) -> FloatArray:
        """Redundancy numbers (N, 2) of columns and rows, 0 (nothing checks it) to 1."""
        own: FloatArray = np.diagonal(self.share, axis1=1, axis2=2)
        return np.where(own > UNCHECKED, own, 0.0)

    def leave_one_out(self, residuals: FloatArray) -> FloatArray:
        """Residuals (N, 2) that points would have without a part in the fit; NaN where others do not hold it."""
        # By eigenvalues, as a point may be checked along one direction only, which neither axis shows.
        values, turns = np.linalg.eigh(self.share)
        held = values[:, 0] <= UNCHECKED
        inverse = np.einsum("nij,nj,nkj->nik", turns, 1.0 / np.where(held[:, None], 1.0, values), turns)
        inverse[held] = np.nan
        errors: FloatArray = np.einsum("nij,nj->ni", inverse, residuals)
        return errors

    def deletion_statistic(self, weighted: FloatArray) -> FloatArray:
        """Decrease T (N,) of the weighted sum of squares without each point; 0 where others do not check both axes.

        One number for both axes of a point, in place of Baarda's w of each.
        """
        gain, freedom = deletion_statistic(weighted, self.share, UNCHECKED)
        return np.where((freedom == 2) & np.isfinite(gain), gain, 0.0)

    def prediction_statistic(self, weighted: FloatArray, design: FloatArray) -> FloatArray:
        """Statistic eᵀ (I + A Q Aᵀ)⁻¹ e (M,) of points that took no part; inf where one cannot be computed.

        Parameters
        ----------
        weighted : array (M, 2)
            Errors of prediction over the standard deviations of the measurements.
        design : array (M, 2, P)
            Their derivatives by the parameters, weighted alike.
        """
        # Error of the measurement plus error of the prediction: the point took no part, so the two are independent.
        spread = np.eye(2) + _propagated(design, self.parameters)
        seen = np.isfinite(weighted).all(axis=1) & np.isfinite(spread).all(axis=(1, 2))
        statistic = np.full(len(weighted), np.inf)
        solved = np.linalg.solve(spread[seen], weighted[seen][:, :, None])[:, :, 0]
        statistic[seen] = (weighted[seen] * solved).sum(axis=1)
        return statistic


def deletion_statistic(residuals: FloatArray, share: FloatArray, least: float) -> tuple[FloatArray, IntArray]:
    """Decrease of the weighted sum of squares without some measurements, T = vᵀ R⁻¹ v, and what of them is checked.

    Parameters
    ----------
    residuals : array (..., K)
        Whitened residuals v; or errors of prediction, whose cofactors are then the `share`.
    share : array (..., K, K)
        Their redundancy matrix R.
    least : float
        Redundancy number up to which a direction is not checked by the others, and says nothing.

    Returns
    -------
    statistic : array (...)
        χ² distributed with `freedom` degrees of freedom, where errors are normal.
    freedom : int array (...)
        Directions that others check, 0 to K.
    """
    # In the axes of R: a measurement may be checked along one direction only, which no component shows.
    values, turns = np.linalg.eigh(share)
    checked = values > least
    turned = np.einsum("...ij,...i->...j", turns, residuals)
    squares = np.where(checked, turned**2 / np.where(checked, values, 1.0), 0.0)
    return squares.sum(axis=-1), checked.sum(axis=-1)


def sigma0_of(squares: float, redundancy: int) -> float:
    """Standard deviation of unit weight; NaN without redundancy.

    Parameters
    ----------
    squares : float
        Weighted sum of squares of the residuals.
    redundancy : int
    """
    return float(np.sqrt(squares / redundancy)) if redundancy > 0 else float("nan")


# Redundancy that a-priori standard deviations count for against sigma0: with 4, a sigma0 of 8 redundant observations,
# itself uncertain by a quarter, has two thirds of the say.
PRIOR_REDUNDANCY = 4


def variance_factor(sigma0: float, redundancy: int) -> float:
    """Factor from cofactors to covariances: sigma0² pooled with the a-priori 1, which counts as four redundant values.

    Parameters
    ----------
    sigma0 : float
        NaN without redundancy.
    redundancy : int
    """
    # Mean of the scaled inverse χ² posterior (Gelman et al., Bayesian Data Analysis, 2.6) but for its constant: without
    # redundancy 1, with much of it sigma0².
    if not redundancy > 0:
        return 1.0
    return (PRIOR_REDUNDANCY + redundancy * sigma0**2) / (PRIOR_REDUNDANCY + redundancy)


def _propagated(design: FloatArray, covariance: FloatArray) -> FloatArray:
    """Covariances A C Aᵀ (N, 2, 2) of positions by that (P, P) of the parameters, or by its diagonal (P,) alone."""
    weighted = design * covariance if covariance.ndim == 1 else design @ covariance
    return weighted @ design.transpose(0, 2, 1)


def position_sigmas(design: FloatArray, covariance: FloatArray) -> FloatArray:
    """Expected length (N,) of position errors, √(σ₁² + σ₂²); arguments as for `_propagated`.

    Parameters
    ----------
    design : array (N, 2, P)
    covariance : array (P, P), or (P,)
    """
    variance = np.trace(_propagated(design, covariance), axis1=1, axis2=2)
    sigmas: FloatArray = np.sqrt(np.maximum(variance, 0.0))
    return sigmas


def correlations(covariance: FloatArray) -> FloatArray:
    """Correlation matrix of a covariance matrix.

    Parameters
    ----------
    covariance : array (P, P)
        Of parameters in any units.

    Returns
    -------
    array (P, P)
        −1 to 1; 0 in rows and columns of parameters that were held fixed (their variance is 0).
    """
    sigma = np.sqrt(np.diag(covariance))
    products = np.outer(sigma, sigma)
    out: FloatArray = np.divide(covariance, products, out=np.zeros_like(covariance), where=products > 0.0)
    return out


def axis_rms(errors: FloatArray) -> tuple[float, float]:
    """Root mean square error of each axis.

    Parameters
    ----------
    errors : array (N, 2)
        Errors or residuals in one unit; rows with NaN do not count.

    Returns
    -------
    first, second : float
        RMS of each column in the unit of `errors`; NaN where no row counts.
    """
    seen = errors[np.isfinite(errors).all(axis=1)]
    if not len(seen):
        return float("nan"), float("nan")
    first, second = np.sqrt((seen**2).mean(axis=0))
    return float(first), float(second)


def total_rms(errors: FloatArray) -> float:
    """Root mean square length of error vectors: √(RMS₁² + RMS₂²).

    Parameters
    ----------
    errors : array (N, 2)
        Errors or residuals in one unit; rows with NaN do not count.

    Returns
    -------
    float
        In the unit of `errors`; NaN where no row counts.
    """
    return float(np.hypot(*axis_rms(errors)))


def log_tail_probability(statistic: FloatArray, scale: float, freedom: float) -> FloatArray:
    """Logarithm of the probability of statistics T as large by chance: T / (2 s²) is F(2, f) distributed.

    Parameters
    ----------
    statistic : array (N,)
        Decreases of the weighted sum of squares, two degrees of freedom each.
    scale : float
        Standard deviation of unit weight.
    freedom : float
        Redundancy that the scale rests on; inf where it is known.
    """
    # With two degrees of freedom above, the upper tail is (1 + T / (f s²))^(−f/2), and exp(−T / (2 s²)) where the scale
    # s is known beforehand, f = ∞.
    ratio = statistic / scale**2
    return -0.5 * ratio if np.isinf(freedom) else -0.5 * freedom * np.log1p(ratio / freedom)


def log_chi_squared_tail(statistic: FloatArray, freedom: IntArray) -> FloatArray:
    """Logarithm of the probability of χ² values as large by chance, finite for gross errors of any size.

    Parameters
    ----------
    statistic : array (N,)
        Not negative.
    freedom : int array (N,)
        Degrees of freedom; 0 gives 0.
    """
    from scipy.special import gammaln, log_ndtr

    # Q(x, k + 2) = Q(x, k) + (x / 2)^(k/2)·exp(−x/2) / Γ(k/2 + 1), from erfc at k = 1 and exp at k = 2 (Abramowitz and
    # Stegun 26.4): all in logarithms, where sums of powers have long become 0.
    half = 0.5 * np.asarray(statistic, dtype=np.float64)
    found = np.zeros(half.shape)
    with np.errstate(divide="ignore"):
        logarithm = np.log(half)
    for first, least in ((1, np.log(2.0) + log_ndtr(-np.sqrt(2.0 * half))), (2, -half)):
        tail, reached = least, first
        while True:
            found = np.where(freedom == reached, tail, found)
            if reached >= int(np.max(freedom, initial=0)):
                break
            with np.errstate(invalid="ignore"):
                term = 0.5 * reached * logarithm - half - gammaln(0.5 * reached + 1.0)
            tail = np.logaddexp(tail, term)
            reached += 2
    return found


def biweight(deviation: FloatArray) -> FloatArray:
    """Weights (1 − d²)² of deviations over the limit from which on they have none (Beaton and Tukey 1974).

    Parameters
    ----------
    deviation : array (N,)
    """
    return np.maximum(1.0 - deviation**2, 0.0) ** 2


def median_variance(statistic: FloatArray, freedom: IntArray) -> float:
    """Variance of unit weight after the median of χ² statistics: less than half of them, however large, do not bend it.

    Parameters
    ----------
    statistic : array (N,)
        Of variance 1, at least one.
    freedom : int array (N,)
        Degrees of freedom of each, 1 or more.
    """
    from scipy.special import gammaincinv

    return float(np.median(statistic / (2.0 * gammaincinv(np.asarray(freedom) / 2.0, 0.5))))


def tail_probability(statistic: FloatArray, scale: float, freedom: float) -> FloatArray:
    """Probability of statistics as large by chance, see `log_tail_probability`.

    Parameters
    ----------
    statistic, scale, freedom
        As for `log_tail_probability`.
    """
    return np.exp(log_tail_probability(statistic, scale, freedom))


def mean_probability(errors: FloatArray) -> float:
    """Probability, by chance, of a mean vector this far from 0: Hotelling's T² test.

    Parameters
    ----------
    errors : array (N, 2)
        Independent error vectors in one unit, without NaN.

    Returns
    -------
    float
        0 to 1: small where the errors share a systematic shift. NaN for fewer than 4 vectors, or where they all lie on
        a line.
    """
    count = len(errors)
    if count < 4:
        return float("nan")
    mean = errors.mean(axis=0)
    covariance = np.cov(errors.T)
    size = float(np.trace(covariance))
    # Errors on a line have a singular covariance: T² would divide by rounding.
    if not np.linalg.det(covariance) > 1e-12 * size**2:
        return float("nan")
    squared = count * float(mean @ np.linalg.solve(covariance, mean))
    # (N − 2) / (2 (N − 1)) · T² follows the F distribution with 2 and N − 2 degrees of freedom, whose tail is a power.
    return float((1.0 + squared / (count - 1)) ** (-(count - 2) / 2))


def signed_rank_probability(differences: FloatArray) -> float:
    """Probability, by chance, of paired differences this much above 0: one-sided signed-rank test (Wilcoxon 1945).

    Parameters
    ----------
    differences : array (N,)
        Differences of pairs. Those of 0 say nothing and are left out.

    Returns
    -------
    float
        0 to 1, exact for few differences without ties, from the normal approximation (with its correction for ties)
        otherwise; 1 where no difference is left.
    """
    unequal = differences[differences != 0.0]
    count = len(unequal)
    if not count:
        return 1.0
    _, group, sizes = np.unique(np.abs(unequal), return_inverse=True, return_counts=True)
    # Equal lengths share the mean of their ranks.
    ranks = (np.cumsum(sizes) - (sizes - 1) / 2.0)[group]
    above = float(ranks[unequal > 0.0].sum())
    if count <= EXACT and (sizes == 1).all():
        return _signed_rank_tail(count, round(above))
    # The second term is the correction for ties.
    variance = count * (count + 1) * (2 * count + 1) / 24.0 - float((sizes**3 - sizes).sum()) / 48.0
    return 0.5 * erfc((above - count * (count + 1) / 4.0) / sqrt(2.0 * variance)) if variance > 0.0 else 0.5


def _signed_rank_tail(count: int, above: int) -> float:
    """Share of all choices of signs whose positive ranks sum to `above` or more."""
    ways = np.zeros(count * (count + 1) // 2 + 1)
    ways[0] = 1.0
    # Number of subsets of the ranks by their sum: each rank may be in or out (dynamic programming).
    for rank in range(1, count + 1):
        ways[rank:] += ways[:-rank].copy()
    return float(ways[above:].sum() / 2.0**count)
