"""Blunder hypotheses of few points: every model with every choice of good points, weighed by probability.

Few points leave a search with one kind helpless: the kind may be too simple, or the blunder bend it. All are tried.
The evidence of a kind with u parameters for n observations (MacKay 2003, chapter 28), its scale unknown, is

    log E = log Γ(f/2) − f/2 · log(π V) − 1/2 · log |AᵀA| − u · log w,    f = n − u,

V being the weighted sum of squares that is left, A the design and w the range a parameter may come from. A point that
is wrong may lie anywhere in the image, and is as rare as `RARE` says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import lgamma, log, pi

import numpy as np

from geomosaic.types import AnyArray, BoolArray, FloatArray

# Points it is made for; more are held against their neighbours (`neighbour_tests`).
FEWEST, MOST = 4, 11
# Share of the points that may be wrong.
SHARE = 0.35
# Range of a parameter beside those of a conformal fit, in parts of the extent of the points.
RANGE = 0.05
# Probability of a point to be wrong, before anything is known.
RARE = 0.05
# Pixels: nobody measures better, so that points which agree by rounding do not outweigh everything.
FINEST = 0.05
# Probability from which on a point is called wrong, is suspicious, and from which on any is held to be wrong.
SURE, DOUBTFUL, LIKELY = 0.9, 0.1, 0.3
# Models that are weighed; a mirrored one stands for rows counted upwards.
KINDS = ("conformal", "mirrored conformal", "affine", "projective", "poly2")
# Gauss-Newton steps of a projective fit from the affine one.
ROUNDS = 4
# Share of the largest eigenvalue below which a choice of points does not determine a model.
WORST = 1e-9


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Probabilities of points to be blunders.

    Attributes
    ----------
    ids : tuple of str
    kind : str
        Of the most probable explanation.
    probability : array (N,)
        Of each point to be wrong.
    fault : float
        Probability that any is.
    errors : array (N, 2)
        Measured minus computed under the most probable explanation, pixels.
    rms : float
        RMS length of those it holds for good.
    """

    ids: tuple[str, ...]
    kind: str
    probability: FloatArray
    fault: float
    errors: FloatArray
    rms: float

    @property
    def blunders(self) -> tuple[str, ...]:
        """Points that are almost certainly blunders."""
        return tuple(name for name, p in zip(self.ids, self.probability, strict=True) if p > SURE)

    @property
    def suspicious(self) -> tuple[str, ...]:
        """Points of which some are blunders, the most probable first, where it is not certain which."""
        if self.fault <= LIKELY or self.blunders:
            return ()
        order = np.argsort(-self.probability, kind="stable")
        return tuple(self.ids[i] for i in order if self.probability[i] > DOUBTFUL)


def weigh_hypotheses(
    ids: Sequence[str], ground: AnyArray, colrow: AnyArray, sigma: AnyArray | None = None
) -> Hypotheses:
    """Evidence of kinds of fit and choices of good points, weighed against each other.

    Parameters
    ----------
    ids : sequence of str
        Of 4 to 11 points.
    ground : array (N, 2) or (N, 3)
        Places on the map; x and y count.
    colrow : array (N, 2)
        Measured pixels.
    sigma : array (N,), optional
        Standard deviations of them; relative ones will do.
    """
    count = len(ids)
    image, places = np.array(colrow, dtype=np.float64), np.array(ground, dtype=np.float64)[:, :2]
    places = (places - places.mean(axis=0)) / max(float(np.abs(places - places.mean(axis=0)).max()), 1e-300)
    extent = max(float(np.ptp(image, axis=0).max()) / 2.0, 1e-300)
    target = (image - image.mean(axis=0)) / extent
    spread = np.ones(count) if sigma is None else np.asarray(sigma, dtype=np.float64)
    kept = _choices(count)
    weight = kept / (spread / np.median(spread))
    evidence = np.full((len(KINDS), len(kept)), -np.inf)
    left = np.zeros((len(KINDS), *kept.shape, 2))
    for k, kind in enumerate(KINDS):
        left[k], logdet, free = _fit(kind, places, target, weight)
        evidence[k] = _evidence(left[k], weight, logdet, free, FINEST / extent, kept)
    best = np.unravel_index(int(np.argmax(evidence)), evidence.shape)
    # Less the largest: exp of the evidence itself would overflow.
    share = np.exp(evidence - evidence[best])
    share /= share.sum()
    errors = left[best] * extent
    good = kept[best[1]]
    return Hypotheses(
        tuple(map(str, ids)),
        KINDS[best[0]],
        np.einsum("kc,cn->n", share, ~kept),
        float(1.0 - share[:, 0].sum()),
        errors,
        float(np.sqrt((errors[good] ** 2).sum(axis=1).mean())),
    )


def _choices(count: int) -> BoolArray:
    """All choices (C, N) of good points, all of them first."""
    rows = []
    for bad in range(int(SHARE * count) + 1):
        for out in combinations(range(count), bad):
            row = np.ones(count, dtype=np.bool_)
            row[list(out)] = False
            rows.append(row)
    return np.array(rows)


def _evidence(
    left: FloatArray, weight: FloatArray, logdet: FloatArray, free: int, finest: float, kept: BoolArray
) -> FloatArray:
    """Logarithm of the evidence (C,) and of what was probable before; -inf where nothing is left to judge by."""
    count = kept.shape[1]
    bad = count - kept.sum(axis=1)
    redundancy = 2 * (count - bad) - free
    squares = ((left * weight[:, :, None]) ** 2).sum(axis=(1, 2))
    found = np.full(len(kept), -np.inf)
    for i in np.flatnonzero((redundancy >= 2) & np.isfinite(squares) & np.isfinite(logdet)):
        f, d = int(redundancy[i]), int(bad[i])
        # The floor `finest` keeps an exact fit from having infinite evidence.
        value = lgamma(f / 2) - f / 2 * log(pi * (squares[i] + f * finest**2)) - logdet[i] / 2 - free * log(RANGE)
        # Anywhere: the points span -1 to 1 in each axis.
        found[i] = value + d * (log(RARE / (1 - RARE)) - log(4.0))
    return found


def _fit(kind: str, places: FloatArray, target: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray, int]:
    """Residuals (C, N, 2) of choices (C, N), log |AᵀA| (C,), inf where singular, and the number of parameters."""
    if kind == "projective":
        return _fit_projective(places, target, weight)
    design = _design(kind, places)
    values, logdet = _least_squares(np.broadcast_to(design, (len(weight), *design.shape)), target[None], weight)
    return target - np.einsum("nip,cp->cni", design, values), logdet, design.shape[2]


def _fit_projective(places: FloatArray, target: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray, int]:
    """Least squares of the linearised equations, started from the affine fit; as `_fit`."""
    plane = _design("affine", places)
    flat = np.broadcast_to(plane, (len(weight), *plane.shape))
    values = np.zeros((len(weight), 8))
    values[:, :6], logdet = _least_squares(flat, target[None], weight)
    # Not by `solver.solve`: some hundred small problems take the same few steps at once, and one that fails drops out.
    for _ in range(ROUNDS):
        below = 1.0 + values[:, 6:] @ places.T
        below = np.where(below > 0.05, below, np.nan)
        computed = np.einsum("nip,cp->cni", plane, values[:, :6]) / below[:, :, None]
        bent = -computed[:, :, :, None] * places[None, :, None, :]
        design = np.concatenate([flat, bent], axis=3) / below[:, :, None, None]
        design = np.where(np.isfinite(design), design, 0.0)
        step, logdet = _least_squares(design, np.where(np.isfinite(computed), target - computed, 0.0), weight)
        values = values + np.where(np.isfinite(step), step, 0.0)
    below = 1.0 + values[:, 6:] @ places.T
    computed = np.einsum("nip,cp->cni", plane, values[:, :6]) / np.where(below > 0.05, below, np.nan)[:, :, None]
    left = target - computed
    # What lies behind the horizon of a choice that leaves it out is just wrong.
    return np.where(np.isnan(left) & (weight == 0.0)[:, :, None], 2.0, left), logdet, 8


def _design(kind: str, places: FloatArray) -> FloatArray:
    """Derivatives (N, 2, P) of col, row by the parameters."""
    x, y = places.T
    one, zero = np.ones_like(x), np.zeros_like(x)
    if kind.endswith("conformal"):
        turn = 1.0 if kind.startswith("mirrored") else -1.0
        col, row = [one, zero, x, y], [zero, one, turn * y, -turn * x]
        return np.stack([np.column_stack(col), np.column_stack(row)], axis=1)
    terms = np.column_stack([one, x, y] + ([x * y, x**2, y**2] if kind == "poly2" else []))
    rest = np.zeros_like(terms)
    return np.stack([np.hstack([terms, rest]), np.hstack([rest, terms])], axis=1)


def _least_squares(design: FloatArray, right: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Parameters (C, P) of designs (C, N, 2, P), and log |AᵀA| (C,), inf where a choice does not determine them."""
    weighted = design * weight[:, :, None, None]
    normal = np.einsum("cnip,cniq->cpq", weighted, weighted)
    size = normal.shape[1]
    values = np.linalg.eigvalsh(normal)
    sound = values[:, 0] > WORST * values[:, -1]
    safe = np.where(sound[:, None, None], normal, np.eye(size))
    seen = np.einsum("cnip,cni->cp", weighted, np.broadcast_to(right, design.shape[:3]) * weight[:, :, None])
    solved: FloatArray = np.linalg.solve(safe, seen[:, :, None])[:, :, 0]
    logdet = np.where(sound, np.log(np.maximum(values, 1e-300)).sum(axis=1), np.inf)
    return np.where(sound[:, None], solved, np.nan), logdet
