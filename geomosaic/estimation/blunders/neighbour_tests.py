"""Local prediction of points from their neighbours: polyharmonic splines, and the perspective most points agree with.

The spline of order m has the kernel (−1)^m r^(2m−2) log r, bordered by all powers of x and y below m; m = 2 is the thin
plate spline. Its error of prediction is that of kriging with a generalised covariance (Matheron 1981), and the
variance of it grows with the distance to the others: quickly for the higher orders, which follow a bend outwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from geomosaic.errors import SolveError, listed
from geomosaic.estimation.blunders.least_trimmed_squares import some_of
from geomosaic.estimation.statistics import total_rms
from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray


def predictions(
    places: FloatArray, image: FloatArray, kept: BoolArray, smooth: float = 1e-10, order: int = 2
) -> tuple[FloatArray, FloatArray]:
    """Errors (N, 2) of all points under the spline through those kept, the point itself left out.

    Parameters
    ----------
    places : array (N, 2)
        On the map, |x|, |y| ≤ 1 or so.
    image : array (N, 2)
        Pixels.
    kept : bool array (N,)
    smooth : float
        Added to the diagonal of the kernel: the spline then passes near its points instead of through them.
    order : int
        2 or more.

    Returns
    -------
    errors : array (N, 2)
        Measured minus predicted.
    variance : array (N,)
        Of prediction, up to a factor.
    """
    nodes, values = places[kept], image[kept]
    count, border = len(nodes), powers(nodes, order)
    matrix = np.zeros((count + border.shape[1],) * 2)
    matrix[:count, :count] = _kernel(nodes, nodes, order) + smooth * np.eye(count)
    matrix[:count, count:], matrix[count:, :count] = border, border.T
    inverse = np.linalg.inv(matrix)
    coefficients = inverse[:, :count] @ values
    errors, variance = np.zeros_like(image), np.zeros(len(image))
    own = np.diagonal(inverse)[:count]
    held = np.where(np.abs(own) > 1e-14, own, np.inf)
    # Leave-one-out errors in closed form, without a fit for each point: coefficient over the inverse's diagonal.
    errors[kept] = coefficients[:count] / held[:, None]
    variance[kept] = 1.0 / np.abs(held)
    out = ~kept
    if out.any():
        row = np.column_stack([_kernel(places[out], nodes, order), powers(places[out], order)])
        errors[out] = image[out] - row @ coefficients
        variance[out] = np.abs(np.einsum("ni,ij,nj->n", row, inverse, row))
    return errors, variance


def powers(places: FloatArray, order: int) -> FloatArray:
    """All powers (N, order · (order + 1) / 2) of x and y below an order.

    Parameters
    ----------
    places : array (N, 2)
    order : int
    """
    x, y = places.T
    return np.column_stack([x ** (i - j) * y**j for i in range(order) for j in range(i + 1)])


def _kernel(first: FloatArray, second: FloatArray, order: int) -> FloatArray:
    squared = ((first[:, None, :] - second) ** 2).sum(axis=2)
    sign = 1.0 if order % 2 == 0 else -1.0
    kernel: FloatArray = sign * 0.5 * squared ** (order - 1) * np.log(np.where(squared > 0.0, squared, 1.0))
    return kernel


# Of five points each: with 40 % blunders some fifteen are free of them.
SAMPLES = 200
# Points of a sample; four determine it.
SIZE = 5
# Points that should agree: 40 % may be blunders.
SHARE = 0.6
# Concentration steps; three quarters of the samples drop out at each.
STEPS = 10


def without_perspective(places: FloatArray, image: FloatArray) -> FloatArray:
    """Image less the projective transformation that most points agree with (least trimmed squares from small samples).

    Parameters
    ----------
    places : array (N, 2)
        On the map, |x|, |y| ≤ 1 or so.
    image : array (N, 2)
        Pixels.

    Returns
    -------
    array (N, 2)
        What is left, pixels; the image itself where no sample determines the transformation.
    """
    middle = image.mean(axis=0)
    extent = max(float(np.abs(image - middle).max()), 1e-300)
    target, everywhere = (image - middle) / extent, places
    # All samples are held against all points at a time: some of many tell as much.
    pool = some_of(len(places))
    places, count = places[pool], len(pool)
    aim = target[pool]
    held = max(SIZE, round(SHARE * count))
    random = np.random.default_rng(0)
    chosen = np.argsort(random.random((SAMPLES, count)), axis=1)[:, : min(SIZE, count)]
    for _ in range(STEPS):
        solved = _solve(places[chosen], aim[chosen])
        left = aim - _apply(solved, places)
        length = np.where(np.isfinite(left).all(axis=2), np.hypot(left[..., 0], left[..., 1]), np.inf)
        order = np.argsort(length, axis=1)
        total = np.take_along_axis(length, order, axis=1)[:, :held].sum(axis=1)
        best = np.argsort(total, kind="stable")[: max(1, len(total) // 4)]
        chosen = order[best][:, :held]
    found: FloatArray = (target - _apply(solved[best[:1]], everywhere)[0]) * extent
    return found if np.isfinite(found).all() else image - middle


def _solve(places: FloatArray, image: FloatArray) -> FloatArray:
    """Coefficients (S, 8) of col = (a + b·x + c·y) / (1 + g·x + h·y), row alike, of S samples (S, K, 2)."""
    one = np.ones((*places.shape[:2], 1))
    zero = np.zeros((*places.shape[:2], 3))
    plane = np.concatenate([one, places], axis=2)
    rows = [
        np.concatenate([plane, zero, -places * image[:, :, :1]], axis=2),
        np.concatenate([zero, plane, -places * image[:, :, 1:]], axis=2),
    ]
    design = np.concatenate(rows, axis=1)
    right = np.concatenate([image[:, :, 0], image[:, :, 1]], axis=1)
    # A trace of damping keeps samples in line solvable; they drop out by their errors.
    normal = np.einsum("ski,skj->sij", design, design) + 1e-12 * np.eye(8)
    return np.linalg.solve(normal, np.einsum("ski,sk->si", design, right)[:, :, None])[:, :, 0]


def _apply(coefficients: FloatArray, places: FloatArray) -> FloatArray:
    plane = np.column_stack([np.ones(len(places)), places])
    below = 1.0 + coefficients[:, 6:] @ places.T
    with np.errstate(divide="ignore", invalid="ignore"):
        image = np.stack([coefficients[:, :3] @ plane.T, coefficients[:, 3:6] @ plane.T], axis=2) / below[:, :, None]
    # Near the vanishing line, where the denominator is 0, places run off to infinity.
    return np.where(below[:, :, None] > 0.05, image, np.nan)


NEIGHBOURS = 8
# Of them, a plane must fit so many: three may be wrong.
AGREE = 5
# Points from which on neighbours tell.
FEWEST = 12
# Points up to which the spline of all the others is tried; beyond, neighbours alone decide.
MOST = 1500
# Median errors from which on a point is put out, and within which it is let in again.
OUT, BACK = 8.0, 6.0
# Share of the median error below which a perspective is taken off.
BETTER = 0.4
# Smoothing, in squares of the usual distance of points: noise of two that nearly touch must not tilt the spline.
SMOOTH = 0.01
# Rounds of putting points out and letting them in again, at most.
NEIGHBOUR_ROUNDS = 60
# Points of which all distances are compared: of more, a tree repays the quarter of a second that loading SciPy takes.
MOST_COMPARED = 1000
# Points whose planes through three neighbours are held at a time: 50 MB.
BLOCK = 4096


@dataclass(frozen=True, eq=False)
class NeighbourSearch:
    """Result of a search for points that contradict those around them.

    Attributes
    ----------
    ids : tuple of str
    blunders : tuple of str
    errors : array (N, 2)
        Measured minus what the points that are no blunders say, without the point itself, pixels.
    rms : float
        Length, RMS, of the errors of the points that are no blunders.
    """

    ids: tuple[str, ...]
    blunders: tuple[str, ...]
    errors: FloatArray
    rms: float

    @property
    def summary(self) -> str:
        """Summary of the result in a sentence."""
        how = "each point held against a spline through the others: "
        if not self.blunders:
            return f"{how}none contradicts its neighbours ({self.rms:.3g} px RMS)"
        verb = "contradicts its" if len(self.blunders) == 1 else "contradict their"
        return f"{how}{listed(self.blunders, 8)} {verb} neighbours, the others agree within {self.rms:.3g} px"


def search_neighbours(ids: Sequence[str], ground: AnyArray, colrow: AnyArray) -> NeighbourSearch:
    """Points that contradict those around them, whatever smooth distortion the image has.

    Parameters
    ----------
    ids : sequence of str
    ground : array (N, 2) or (N, 3)
        Places on the map; x and y count.
    colrow : array (N, 2)
        Measured pixels.

    Raises
    ------
    SolveError
        Too few points.
    """
    count = len(ids)
    if count < FEWEST:
        raise SolveError(
            f"{count} points are too few to hold each against its neighbours",
            hint=f"give {FEWEST} points or more, or look for blunders with a kind of fewer parameters (not tps)",
        )
    image = np.array(colrow, dtype=np.float64)
    places = np.array(ground, dtype=np.float64)[:, :2]
    # Numbers within ±1: powers of map coordinates would make the bordered matrix singular to rounding.
    places = (places - places.mean(axis=0)) / max(float(np.abs(places - places.mean(axis=0)).max()), 1e-300)
    near = _nearest(places)
    # The image itself, and what a perspective leaves of it: the one of which points tell more about their neighbours.
    found = [_contradicting(places, values, near) for values in (image, without_perspective(places, image))]
    plain, flat = (float(np.median(np.hypot(*each[1].T))) for each in found)
    kept, errors = found[1] if flat < BETTER * plain else found[0]
    names = tuple(str(name) for name, good in zip(ids, kept, strict=True) if not good)
    return NeighbourSearch(tuple(map(str, ids)), names, errors, total_rms(errors[kept]))


def _contradicting(places: FloatArray, image: FloatArray, near: IntArray) -> tuple[BoolArray, FloatArray]:
    """Points kept (N,) and the errors (N, 2) of all."""
    errors, weight = _by_planes(places, image, near)
    length = np.hypot(*errors.T) / np.sqrt(weight)
    # The spline is solved densely, at a cost that grows with the cube of the points.
    if len(places) > MOST:
        return length <= OUT * np.median(length), errors
    return _by_spline(places, image, near, length <= 3.0 * np.median(length))


def _nearest(places: FloatArray) -> IntArray:
    """Indices (N, 8) of the nearest other points."""
    if len(places) <= MOST_COMPARED:
        apart = ((places[:, None] - places) ** 2).sum(axis=2)
        np.fill_diagonal(apart, np.inf)
        return np.sort(np.argpartition(apart, NEIGHBOURS - 1, axis=1)[:, :NEIGHBOURS], axis=1)
    from scipy.spatial import KDTree

    found = KDTree(places).query(places, k=NEIGHBOURS + 1)[1].astype(np.int64)
    # Of points on one place the tree may name another one first, or itself not at all: then the farthest goes.
    own = found == np.arange(len(places))[:, None]
    own[~own.any(axis=1), -1] = True
    return np.sort(found[~own].reshape(-1, NEIGHBOURS), axis=1)


def _by_planes(places: FloatArray, image: FloatArray, near: IntArray) -> tuple[FloatArray, FloatArray]:
    """Errors (N, 2) of points against planes through their neighbours, and the variances (N,) of them."""
    around = places[near] - places[:, None, :]
    around /= np.maximum(np.abs(around).max(axis=(1, 2), keepdims=True), 1e-300)
    design = np.concatenate([np.ones((*near.shape, 1)), around], axis=2)
    seen = image[near]
    parts = [slice(start, start + BLOCK) for start in range(0, len(places), BLOCK)]
    own, quantile = (
        np.concatenate(each) for each in zip(*(_by_triples(design[p], seen[p]) for p in parts), strict=True)
    )
    # Those that agree with the plane are averaged; where most of all planes fit badly, more may take part.
    limit = np.maximum(2.5 * quantile, 2.5 * np.median(quantile))
    part = (own <= limit[:, None]).astype(np.float64)[:, :, None]
    normal = np.einsum("nki,nkj->nij", design * part, design) + 1e-9 * np.eye(3)
    inverse = np.linalg.inv(normal)
    plane = inverse @ np.einsum("nki,nkj->nij", design * part, seen)
    # Variance of the measurement (1) and of the plane at the point, which is the origin of `around`.
    return image - plane[:, 0], 1.0 + inverse[:, 0, 0]


def _by_triples(design: FloatArray, seen: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distances (N, 8) of neighbours from the plane through three of them that most agree with, and the limit (N,)."""
    triples = np.array(list(combinations(range(NEIGHBOURS), 3)))
    corner = design[:, triples]
    # Three points nearly in line hold no plane; they are passed over.
    good = np.abs(np.linalg.det(corner)) > 1e-3
    corner = np.where(good[:, :, None, None], corner, np.eye(3))
    planes = np.linalg.solve(corner, seen[:, triples])
    missed = np.linalg.norm(seen[:, None] - design[:, None] @ planes, axis=3)
    quantile = np.where(good, np.sort(missed, axis=2)[:, :, AGREE - 1], np.inf)
    best, rows = np.argmin(quantile, axis=1), np.arange(len(design))
    return missed[rows, best], quantile[rows, best]


def _by_spline(places: FloatArray, image: FloatArray, near: IntArray, kept: BoolArray) -> tuple[BoolArray, FloatArray]:
    """Points kept and errors, by a spline through the others: what it misses most goes, what it meets returns."""
    errors = np.zeros_like(image)
    for _ in range(NEIGHBOUR_ROUNDS):
        errors, variance = predictions(places, image, kept, SMOOTH / len(places))
        # Closer points than usual are predicted within what they are measured within, not better.
        length = np.hypot(*errors.T) / np.sqrt(variance + np.median(variance[kept]))
        typical = max(float(np.median(length[kept])), 1e-12)
        back = ~kept & (length <= BACK * typical)
        # A blunder shows at its neighbours, too: of those around one place only the worst goes.
        worst = np.where(kept[near], length[near], 0.0).max(axis=1)
        out = kept & (length > OUT * typical) & (length >= worst)
        more = (kept | back) & ~out
        # Where more than half would go, it is not the points that are wrong but the spline.
        if (more == kept).all() or more.sum() < 0.5 * len(kept):
            break
        kept = more
    return kept, errors


ORDERS = (3, 4)
# Points that predict one.
AROUND = 60
# Median errors to be expected of it, within which a point agrees with those around it.
WITHIN = 3.0
# Pixels, the median error to be expected beyond which an order, extrapolating, tells nothing: any blunder agrees.
TELLING = 7.0
# Times the least median error, up to which an order is a witness.
COMPARABLE = 2.0
# Rounds from the inside outwards, at most.
ROUNDS = 10


def explained_by_distortion(ground: AnyArray, colrow: AnyArray, suspected: BoolArray) -> BoolArray:
    """Suspected points that a smooth distortion explains, as the points around them have it.

    Parameters
    ----------
    ground : array (N, 2) or (N, 3)
        Places on the map; x and y count.
    colrow : array (N, 2)
        Measured pixels.
    suspected : bool array (N,)

    Returns
    -------
    bool array (N,)
        None where fewer than 12 others are left.
    """
    # Those that are explained help to explain the next ones, from the inside outwards.
    places, image = np.array(ground, dtype=np.float64)[:, :2], np.array(colrow, dtype=np.float64)
    kept = ~suspected
    for _ in range(ROUNDS):
        if kept.sum() < FEWEST:
            break
        agree = [i for i in np.flatnonzero(~kept) if _agrees(places, image, kept, int(i))]
        if not agree:
            break
        kept = kept.copy()
        kept[agree] = True
    return kept & suspected


def _agrees(places: FloatArray, image: FloatArray, kept: BoolArray, index: int) -> bool:
    apart = np.where(kept, np.hypot(*(places - places[index]).T), np.inf)
    near = np.append(np.argsort(apart, kind="stable")[: min(AROUND, int(kept.sum()))], index)
    local = places[near] - places[near].mean(axis=0)
    local /= max(float(np.abs(local).max()), 1e-300)
    others = np.arange(len(near)) < len(near) - 1
    medians, agree = list[float](), list[bool]()
    for order in ORDERS:
        if len(near) < order * (order + 1):  # twice the powers it needs
            continue
        try:
            errors, variance = predictions(local, image[near], others, order=order)
        except np.linalg.LinAlgError:
            continue
        lengths = np.hypot(*errors.T)
        spread = np.sqrt(np.maximum(variance, 1e-300))
        expected = float(spread[-1] * np.median(lengths[others] / spread[others]))
        medians.append(float(np.median(lengths[others])))
        agree.append(expected <= TELLING and bool(lengths[-1] <= WITHIN * expected))
    # The order that predicts the others best is the witness: a poor one expects large errors, and excuses any blunder.
    least = min(medians, default=0.0)
    return any(agrees and m <= COMPARABLE * least for agrees, m in zip(agree, medians, strict=True))
