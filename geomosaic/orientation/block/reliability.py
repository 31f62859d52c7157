"""Reliability of a block: which errors stay unseen, and how far they would move what was measured (Baarda 1968).

With whitened residuals v = R·e of an error e, R the redundancy numbers of the observation, the test of vᵀ·R⁻¹·v has the
noncentrality eᵀ·R·e. An error is found in 80 % of all cases where that is λ₀. For observations of several components
λ₀ is that of the χ² distribution of as many, and the errors that reach it form an ellipsoid (Förstner 1987): its
longest axis is the minimal detectable error. The largest effect is that of the error on it which moves the point most.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from geomosaic.orientation.block.adjustment import BlockAdjustment
from geomosaic.orientation.block.observations import unit_matrices
from geomosaic.orientation.block.residual_statistics import CHECKED
from geomosaic.types import FloatArray, IntArray

# Baarda's choice, in which reliabilities are compared: one good observation in 1000 is rejected, and four of five wrong
# ones are found. With the smaller ALPHA of this program's own search errors have to be 1.15 times as large.
ALPHA0, POWER = 0.001, 0.8


@dataclass(frozen=True, eq=False)
class Reliability:
    """Reliability of one group of N observations; NaN of those that take no part.

    Attributes
    ----------
    detectable : array (N,)
        Minimal detectable error in the unit of the group; inf where nothing checks the observation in some direction.
    shift : array (N,)
        Metres by which an error of that size moves the observed point at most; of observations of no point, how far it
        moves what they observed, in their unit.
    """

    detectable: FloatArray
    shift: FloatArray


@cache
def noncentrality(freedom: int) -> float:
    """Noncentrality λ₀ at which a χ² test finds an error with the probability `POWER`: 17.07 of one component.

    Parameters
    ----------
    freedom : int
        Components.
    """
    limit = chi2.isf(ALPHA0, freedom)
    return float(brentq(lambda value: ncx2.sf(limit, freedom, value) - POWER, 1.0, 1000.0))


def reliability(adjustment: BlockAdjustment) -> tuple[Reliability, ...]:
    """Reliability of each group of observations of a block.

    Parameters
    ----------
    adjustment : BlockAdjustment
    """
    network, found, place = adjustment.network, [], 0
    for group, one, weight in zip(
        adjustment.problem.groups, adjustment.statistics, adjustment.state.weights, strict=True
    ):
        detectable, shift = np.full(len(group), np.nan), np.full(len(group), np.nan)
        part = weight > 0.0
        if part.any():
            share = one.share[part]
            size = share.shape[1]
            observed = np.broadcast_to(group.observed, (len(group), size))[part].sum(axis=1)
            units = unit_matrices(group, size)[part]
            moved = network.point_influence(place) if group.of_points else units @ (np.eye(size) - share)
            detectable[part], shift[part] = _largest(share, observed, units, moved)
            place += 1
        found.append(Reliability(detectable, shift))
    return tuple(found)


def _largest(
    share: FloatArray, observed: IntArray, units: FloatArray, effects: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Longest images (N,) of the ellipsoids eᵀ·R·e = λ₀ under `units` and `effects`; inf without end, NaN of NaN."""
    values, vectors = np.linalg.eigh(share)
    checked = values > CHECKED
    freedom = checked.sum(axis=1)
    limit = np.array([0.0, *(noncentrality(k) for k in range(1, share.shape[1] + 1))])[freedom]
    axes = vectors * np.where(checked, np.sqrt(limit[:, None] / np.where(checked, values, 1.0)), 0.0)[:, None, :]
    found = []
    for images in (units @ axes, effects @ axes):
        squares, known = np.full(len(images), np.nan), np.isfinite(images).all(axis=(1, 2))
        squares[known] = np.linalg.eigvalsh(np.swapaxes(images[known], 1, 2) @ images[known])[:, -1]
        found.append(np.where(freedom < observed, np.inf, np.sqrt(np.maximum(squares, 0.0))))
    return found[0], found[1]
