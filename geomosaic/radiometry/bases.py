"""Basis functions of light and lens in an image, and drift of colour along strips.

Corrections are products, so their logarithms add up: log field = Σ βₖ·Bₖ(place). Places are given twice: in the image,
from its centre in units of half its diagonal (so 1 in the corners), and on the ground, from the place that the image
sees best, east and north, in units of half the footprint's diagonal. Effects of the camera are functions of the first,
effects of sun and view of the second.

Overlaps observe differences. A small bias in each, say of light that falls off to one side, adds up along a strip:
after fifty photos of half a per cent each the last is a quarter off, and no overlap shows it. What is known besides is
that exposures vary from photo to photo, and a camera does not drift: **the mean correction of neighbouring images is
zero**, first of their gains, then of the level of their values: each neighbourhood keeps the mean of its own images.
Neighbours are those within as few steps from overlap to overlap as bring `NEIGHBOURS` images together; in a smaller
block this adds no information, and changes nothing.

The weight depends on how much exposures vary, s, the spread of single corrections about the mean of their neighbours
(as a logarithm): a mean of eleven that vary by a fifth is known less well than one of a camera with a fixed exposure.

Bound: the drift is a quantity x along the strip with x'' = x / L², L = `SIGMA_RATIO`·s / (standard deviation of the
step from one photo to the next, 0.003 at best). A bias b of each step makes a drift of no more than b·L, however long
the strip: 8 b for exposures that vary by a tenth, besides what their means vary by themselves; b for constant ones.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from geomosaic.interpolation import interval
from geomosaic.types import FloatArray, IntArray

RADIAL = 3
"""Even powers of the radius: ρ², ρ⁴, ρ⁶ (D. B. Goldman, Vignette and exposure calibration, PAMI 32, 2010)."""
TREND = 4
"""x, y, x² − y² and 2xy: the view-angle trend up to second order; x² + y² cannot be told from vignetting."""
SPANS = 6
"""Intervals of the cubic splines of a hotspot across −1 … 1."""
NODES = SPANS + 3
SHARED = ("vignetting", "trend", "hotspot")
"""Terms that images share; 'haze', 'gamma' and 'dodging' are each image's own."""
TERMS = (*SHARED, "haze", "gamma", "dodging")


def width(terms: Collection[str], cameras: int) -> int:
    """Number of shared functions of a set of terms.

    Parameters
    ----------
    terms : collection of str
        Of `TERMS`; those that images do not share add none.
    cameras : int
        Cameras of the block; each has a vignetting of its own.

    Returns
    -------
    int
        Columns of `shared_functions`.
    """
    return (
        RADIAL * cameras * ("vignetting" in terms) + TREND * ("trend" in terms) + NODES * NODES * ("hotspot" in terms)
    )


def shared_functions(
    terms: Collection[str], cameras: int, camera: IntArray, image: FloatArray, view: FloatArray
) -> FloatArray:
    """Values of the functions that images share.

    Parameters
    ----------
    terms : collection of str
        Of `SHARED`.
    cameras : int
    camera : int array (N,)
        Number of the camera; below 0 for what no camera of the block took, where all functions are 0.
    image, view : array (N, 2)
        Positions in the image and on the ground, see above.

    Returns
    -------
    array (N, width)
    """
    parts = [np.zeros((len(camera), 0))]
    if "vignetting" in terms:
        rho2 = (image**2).sum(axis=1)
        radial = np.stack([rho2, rho2**2, rho2**3], axis=1)
        own = camera[:, None] == np.arange(cameras)
        parts.append((own[:, :, None] * radial[:, None, :]).reshape(len(camera), -1))
    if "trend" in terms:
        x, y = view.T
        parts.append(np.stack([x, y, x**2 - y**2, 2 * x * y], axis=1))
    if "hotspot" in terms:
        across, down = _cubic_splines(view[:, 0]), _cubic_splines(view[:, 1])
        parts.append((down[:, :, None] * across[:, None, :]).reshape(len(camera), -1))
    return np.where(camera[:, None] >= 0, np.concatenate(parts, axis=1), 0.0)


def excess_air_path(view: FloatArray) -> FloatArray:
    """Excess of the path through the air over that at the nadir.

    The path grows as 1 / cos θ ≈ 1 + tan²θ / 2, and tan θ with the distance from the nadir.

    Parameters
    ----------
    view : array (..., 2)
        Positions on the ground from the nadir, in units of half the footprint's diagonal.

    Returns
    -------
    array (...)
        0 at the nadir, 1 in the corners.
    """
    return np.asarray((view**2).sum(axis=-1))


def prior_normal_matrix(terms: Collection[str], cameras: int) -> FloatArray:
    """Normal matrix of the prior on the shared functions: fields are no larger and no rougher than light makes.

    Coefficients of vignetting have a standard deviation of 1, those of a trend 0.5. Second differences of a hotspot's
    nodes have 0.1, the nodes themselves 0.5; all in logarithms of a gain.

    Parameters
    ----------
    terms : collection of str
        Of `SHARED`.
    cameras : int

    Returns
    -------
    array (width, width)
        In the order of `shared_functions`.
    """
    size = width(terms, cameras)
    normal, at = np.zeros((size, size)), 0
    if "vignetting" in terms:
        here = np.arange(at, at + RADIAL * cameras)
        normal[here, here] = 1.0
        at += len(here)
    if "trend" in terms:
        here = np.arange(at, at + TREND)
        normal[here, here] = 1 / 0.5**2
        at += TREND
    if "hotspot" in terms:
        normal[at:, at:] = np.eye(NODES * NODES) / 0.5**2 + roughness(NODES, NODES) / 0.1**2
    return normal


def roughness(rows: int, cols: int) -> FloatArray:
    """Normal matrix of all second differences along rows and columns of a net of nodes, and twice the mixed ones.

    This is the bending energy of a thin plate on a net, f_xx² + 2·f_xy² + f_yy²: with the mixed term twice, it does not
    depend on the directions of rows and columns.

    Parameters
    ----------
    rows, cols : int
        Nodes of the net along each side.

    Returns
    -------
    array (rows·cols, rows·cols)
        Nodes row by row.
    """
    return np.asarray(
        np.kron(np.eye(rows), _difference_normal(cols, 2))
        + np.kron(_difference_normal(rows, 2), np.eye(cols))
        + 2 * np.kron(_difference_normal(rows, 1), _difference_normal(cols, 1))
    )


def _difference_normal(count: int, order: int) -> FloatArray:
    """Normal matrix (count, count) of differences of an order between neighbours."""
    if count <= order:
        return np.zeros((count, count))
    rule = np.diff(np.eye(count), order, axis=0)
    return np.asarray(rule.T @ rule)


def _cubic_splines(t: FloatArray) -> FloatArray:
    """Uniform cubic B-splines (N, NODES) over −1 … 1; positions beyond are those of the ends."""
    first, u = interval((t + 1) / 2 * SPANS, SPANS + 1)
    weights = np.stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3]) / 6
    out = np.zeros((len(t), NODES))
    rows = np.arange(len(t))
    # Each position has four splines that are not 0.
    for k in range(4):
        out[rows, first + k] = weights[k]
    return out


def bilinear_weights(image: FloatArray, nodes: int) -> tuple[IntArray, FloatArray]:
    """Bilinear weights of the nodes of a net over −1 … 1.

    Parameters
    ----------
    image : array (N, 2)
        Positions in the image.
    nodes : int
        Along each side of the net.

    Returns
    -------
    number : int array (N, 4)
    weight : array (N, 4)
    """
    (col, row), (u, v) = (part.T for part in interval((image + 1) / 2 * (nodes - 1), nodes))
    number = np.stack([row * nodes + col, row * nodes + col + 1, (row + 1) * nodes + col, (row + 1) * nodes + col + 1])
    weight = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v])
    return number.T, weight.T


NEIGHBOURS = 11
"""Images whose mean correction is observed as 0."""
SIGMA_RATIO = 0.25
"""Standard deviation of that mean over the spread of single corrections; the mean of eleven has about this."""
MIN_SPREAD, MAX_SPREAD = 0.01, 0.3
"""Limits of the estimated spread of single corrections."""
MAX_PER_STEP = 40
"""Neighbours added at one step between overlaps; of more, every second, third ..."""


def neighbourhoods(images: int, first: IntArray, second: IntArray) -> list[IntArray]:
    """Neighbourhoods of the images that have more of their group beyond; none in small groups.

    Parameters
    ----------
    images : int
    first, second : int array (overlaps,)
        Numbers of the overlapping images.

    Returns
    -------
    list of int array
        Numbers of the images, sorted.
    """
    partners: list[set[int]] = [set() for _ in range(images)]
    for i, j in zip(first.tolist(), second.tolist(), strict=True):
        partners[i].add(j)
        partners[j].add(i)
    found = []
    for start in range(images):
        near, edge = {start}, {start}
        while edge and len(near) < NEIGHBOURS:
            ring = sorted(set().union(*(partners[i] for i in edge)) - near)
            edge = set(ring[:: -(-len(ring) // MAX_PER_STEP)]) if ring else set()
            near |= edge
            # The mean of a whole group is settled by the prior already: a neighbourhood must have others beyond it.
        if len(near) > 1 and set().union(*(partners[i] for i in near)) - near:
            found.append(np.array(sorted(near)))
    return found


def mean_sigma(near: list[IntArray], level: FloatArray) -> float:
    """Standard deviation with which the mean correction of a neighbourhood is observed.

    `SIGMA_RATIO` times the spread of single corrections about the mean of their neighbours, from the median absolute
    deviation.

    Parameters
    ----------
    near : list of int array
        Neighbourhoods, at least one.
    level : array (images,)
        Corrections solved without these observations, as logarithms of gains.

    Returns
    -------
    float
    """
    departures = np.concatenate([level[group] - level[group].mean() for group in near])
    spread = 1.4826 * float(np.median(np.abs(departures)))
    return SIGMA_RATIO * min(max(spread, MIN_SPREAD), MAX_SPREAD)


def normal_entries(near: list[IntArray], weight: float) -> tuple[IntArray, IntArray, FloatArray]:
    """Entries that observed means of 0 add to a normal matrix.

    Parameters
    ----------
    near : list of int array
        Neighbourhoods: numbers of the images.
    weight : float
        Inverse variance of the mean of one neighbourhood.

    Returns
    -------
    rows, cols : int array (entries,)
        Numbers of the images; pairs repeat, and their values are to be added.
    values : array (entries,)
    """
    if not near:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0)
    rows = np.concatenate([np.repeat(group, len(group)) for group in near])
    cols = np.concatenate([np.tile(group, len(group)) for group in near])
    values = np.concatenate(
        [np.full(len(group) ** 2, _observation_weight(group, weight) / len(group)) for group in near]
    )
    return rows, cols, values


def right_hand_side(near: list[IntArray], target: FloatArray, weight: float) -> FloatArray:
    """Right-hand side of observed means that are not 0.

    Parameters
    ----------
    near : list of int array
        Neighbourhoods, as in `normal_entries`.
    target : array (images,)
        The mean of x over each neighbourhood is observed to be that of `target`.
    weight : float
        Inverse variance, as in `normal_entries`.

    Returns
    -------
    array (images,)
    """
    pull = np.zeros(len(target))
    for group in near:
        pull[group] += _observation_weight(group, weight) * target[group].mean()
    return pull


def _observation_weight(group: IntArray, weight: float) -> float:
    """Weight for one image of a neighbourhood.

    Large neighbourhoods overlap each other more, so they repeat an observation, and drift less.
    """
    return weight / len(group) * min(1.0, NEIGHBOURS / len(group)) ** 3


def connected_groups(images: int, first: IntArray, second: IntArray) -> IntArray:
    """Connected components of the graph of overlaps.

    Parameters
    ----------
    images : int
    first, second : int array (overlaps,)
        Numbers of the overlapping images.

    Returns
    -------
    int array (images,)
        Number of each image's group, from 0.
    """
    group = np.arange(images)
    while True:
        # Each image takes the smallest number among its partners', then that of the image it now points to: pointer
        # doubling, so that a strip of n images needs about log n rounds instead of n.
        least = group.copy()
        np.minimum.at(least, first, group[second])
        np.minimum.at(least, second, group[first])
        least = least[least]
        if np.array_equal(least, group):
            return np.asarray(np.unique(group, return_inverse=True)[1])
        group = least
