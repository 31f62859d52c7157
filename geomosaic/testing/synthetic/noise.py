"""Smooth building blocks of the land's texture: soft edges, spline noise, cells with soft borders, bumps.

All of it is float32 (a tenth of a millimetre over a kilometre) and repeats after `PERIOD` cells; the values of the
cells come from seeded tables. Nothing has detail much finer than the edge widths and spacings it is asked for.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from geomosaic.types import Float32Array, IntArray

PERIOD = 64
MASK = PERIOD - 1


@lru_cache(maxsize=64)
def table(seed: int, name: str, columns: int) -> Float32Array:
    """Uniform random numbers of the cells, fixed by seed and name.

    Parameters
    ----------
    seed : int
    name : str
        Of what the numbers are for: each purpose has a stream of its own.
    columns : int
        Numbers per cell.

    Returns
    -------
    float32 array (PERIOD², columns)
        0..1, read-only.
    """
    key = [seed, *name.encode()]
    values = np.random.default_rng(key).random((PERIOD * PERIOD, columns)).astype(np.float32)
    values.setflags(write=False)
    return values


def soft(distance: Float32Array, width: float) -> Float32Array:
    """Soft step between 0 and 1: ½ + ½ tanh(distance / width).

    Parameters
    ----------
    distance : float32 array
        Metres from the edge, positive inside.
    width : float
        Metres.

    Returns
    -------
    float32 array
        0 far on the negative side, 1 far on the positive side.
    """
    step: Float32Array = np.float32(0.5) + np.float32(0.5) * np.tanh(distance * np.float32(1.0 / width))
    return step


def spline_noise(u: Float32Array, v: Float32Array, spacing: float, values: Float32Array) -> Float32Array:
    """Random surface: a cubic B-spline over a lattice of random values.

    The basis has a spectrum of sinc⁴, so waves shorter than the spacing carry next to nothing.

    Parameters
    ----------
    u, v : float32 array (N,)
        Places in metres.
    spacing : float
        Of the lattice, metres.
    values : float32 array (PERIOD²,)
        0..1 at its nodes.

    Returns
    -------
    float32 array (N,)
        −0.5 to 0.5, of zero mean.
    """
    p, q = u * np.float32(1.0 / spacing), v * np.float32(1.0 / spacing)
    i, j = np.floor(p), np.floor(q)
    wp, wq = _bspline(p - i), _bspline(q - j)
    columns, rows = i.astype(np.int64), j.astype(np.int64)
    out = np.zeros_like(u)
    for b in range(4):
        row = ((rows + (b - 1)) & MASK) * PERIOD
        line = np.zeros_like(u)
        for a in range(4):
            line += wp[a] * values[row + ((columns + (a - 1)) & MASK)]
        out += wq[b] * line
    return out - np.float32(0.5)


def _bspline(t: Float32Array) -> tuple[Float32Array, Float32Array, Float32Array, Float32Array]:
    """Weights of the uniform cubic B-spline at t in 0..1."""
    s, sixth = 1 - t, np.float32(1.0 / 6.0)
    t2 = t * t
    return s * s * s * sixth, (t2 * (3 * t - 6) + 4) * sixth, (s * s * (3 * s - 6) + 4) * sixth, t2 * t * sixth


def neighbours(
    p: Float32Array, q: Float32Array, places: Float32Array, jitter: float
) -> Iterator[tuple[IntArray, Float32Array, Float32Array]]:
    """Nine cells around each place, with the offsets from their jittered centres.

    Parameters
    ----------
    p, q : float32 array (N,)
        Places in cell units.
    places : float32 array (PERIOD², 2)
        Random numbers 0..1 that move the centres.
    jitter : float
        Largest shift of a centre, in cell units.

    Yields
    ------
    index : int array (N,)
        Row of the cell in the tables.
    dp, dq : float32 array (N,)
        Place minus centre, in cell units.
    """
    i, j = np.floor(p), np.floor(q)
    columns, rows = i.astype(np.int64), j.astype(np.int64)
    fp, fq = p - i, q - j
    for b in (-1, 0, 1):
        row = ((rows + b) & MASK) * PERIOD
        for a in (-1, 0, 1):
            index = row + ((columns + a) & MASK)
            centre = (places[index] - np.float32(0.5)) * np.float32(2.0 * jitter) + np.float32(0.5)
            yield index, fp - a - centre[:, 0], fq - b - centre[:, 1]


def patchwork(
    p: Float32Array, q: Float32Array, places: Float32Array, attributes: Float32Array, edge: float, border: float
) -> tuple[Float32Array, Float32Array]:
    """Cells nearest to jittered centres (Voronoi), their attributes blended over soft borders.

    Parameters
    ----------
    p, q : float32 array (N,)
        Place in cell units.
    places : float32 array (PERIOD², 2)
        Jitter of the centres.
    attributes : float32 array (PERIOD², K)
        What each cell has.
    edge, border : float
        Half-widths, in cell units, of the blend and of the border strip; both should stay under 0.05.

    Returns
    -------
    blended : float32 array (N, K)
    border : float32 array (N,)
        1 on the border of two cells, falling to 0 inside them.
    """
    found = [(index, dp * dp + dq * dq) for index, dp, dq in neighbours(p, q, places, 0.25)]
    nearest = np.minimum.reduce([d for _, d in found])
    blended = np.zeros((len(p), attributes.shape[1]), dtype=np.float32)
    narrow_sum, wide_sum, wide_squares = np.zeros_like(p), np.zeros_like(p), np.zeros_like(p)
    for index, d in found:
        excess = d - nearest
        narrow = np.exp(excess * np.float32(-1.0 / edge))
        wide = np.exp(excess * np.float32(-1.0 / border))
        blended += narrow[:, None] * attributes[index]
        narrow_sum += narrow
        wide_sum += wide
        wide_squares += wide * wide
    return blended / narrow_sum[:, None], 2 * (1 - wide_squares / (wide_sum * wide_sum))


def crowns(
    u: Float32Array, v: Float32Array, spacing: float, values: Float32Array, sun: tuple[float, float]
) -> tuple[Float32Array, Float32Array]:
    """Tree crowns: round bumps on a jittered lattice, lit from the side.

    Parameters
    ----------
    values : float32 array (PERIOD², 4)
        Jitter in two columns, size, brightness.
    sun : (float, float)
        Unit vector towards the sun, in (u, v).

    Returns
    -------
    cover, light : float32 array (N,)
        How much of the ground the crowns hide (0..1), and their light (about 0..1, ½ on average).
    """
    p, q = u * np.float32(1.0 / spacing), v * np.float32(1.0 / spacing)
    cover, light = np.zeros_like(u), np.zeros_like(u)
    for index, dp, dq in neighbours(p, q, values[:, :2], 0.3):
        size = np.float32(0.62) + np.float32(0.3) * values[index, 2]
        bump = np.maximum(1 - (dp * dp + dq * dq) / (size * size), 0)
        bump = bump * bump * bump
        lit = np.float32(0.62) + np.float32(1.1) * (dp * np.float32(sun[0]) + dq * np.float32(sun[1])) / size
        cover += bump
        light += bump * lit * (np.float32(0.65) + np.float32(0.7) * values[index, 3])
    return 1 - np.exp(np.float32(-2.4) * cover), light / (cover + np.float32(0.08))
