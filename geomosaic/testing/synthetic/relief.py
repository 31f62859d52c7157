"""Synthetic relief in closed form, and the smooth noise it is made of.

All of it is float32 (a tenth of a millimetre over a kilometre) and repeats after `PERIOD` cells; the values of the
cells come from seeded tables. Nothing has detail much finer than the edge widths and spacings it is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from geomosaic.types import AnyArray, Float32Array, IntArray

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


# Mid-morning sun in the south-east: unit vector in (u, v).
SUN = (0.64, -0.77)


def soft(distance: Float32Array, width: float) -> Float32Array:
    """Soft step between 0 and 1: ½ + ½ tanh(distance / width).

    Parameters
    ----------
    distance : float32 array (N,)
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
    # The basis has a spectrum of sinc⁴, so waves shorter than the spacing carry next to nothing.
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


def crowns(u: Float32Array, v: Float32Array, spacing: float, values: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Tree crowns: round bumps on a jittered lattice, lit from the side.

    Parameters
    ----------
    u, v : float32 array (N,)
        Places on the ground, metres.
    spacing : float
        Of the crowns, metres.
    values : float32 array (PERIOD², 4)
        Jitter in two columns, size, brightness.

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
        lit = np.float32(0.62) + np.float32(1.1) * (dp * np.float32(SUN[0]) + dq * np.float32(SUN[1])) / size
        cover += bump
        light += bump * lit * (np.float32(0.65) + np.float32(0.7) * values[index, 3])
    return 1 - np.exp(np.float32(-2.4) * cover), light / (cover + np.float32(0.08))


# amplitude (m), wavelength (m), direction (deg), phase (rad)
WAVES = np.array(
    [
        [9.0, 2900.0, 20.0, 0.4],
        [7.0, 1700.0, 105.0, 2.1],
        [4.0, 980.0, 60.0, 4.0],
        [2.5, 610.0, 150.0, 1.2],
        [1.5, 370.0, 35.0, 5.2],
        [1.2, 330.0, 112.0, 3.1],
        [0.5, 230.0, 8.0, 0.9],
        [0.5, 210.0, 78.0, 2.6],
        [0.5, 190.0, 141.0, 4.4],
    ]
)


# height (m), u (m), v (m), sigma (m)
HILLS = np.array(
    [
        [72.0, -620.0, 520.0, 270.0],
        [48.0, -150.0, 640.0, 210.0],
        [58.0, 700.0, 470.0, 260.0],
        [64.0, 430.0, -720.0, 290.0],
        [40.0, -480.0, -700.0, 220.0],
        [26.0, 980.0, -300.0, 180.0],
    ]
)


# amplitude (m), wavelength / 2π (m), phase (rad) of the river's meanders
MEANDERS = ((95.0, 330.0, 0.5), (28.0, 118.0, 1.3))


VALLEY_DEPTH, VALLEY_WIDTH = 34.0, 240.0
RIVER_OFFSET = -120.0


def river(u: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Course of the river, and its slope.

    Parameters
    ----------
    u : array (N,)
        Metres.

    Returns
    -------
    course : array (N,)
        v in metres, in the precision of `u`.
    slope : array (N,)
        dv/du.
    """
    course, slope = np.full_like(u, RIVER_OFFSET), np.zeros_like(u)
    for amplitude, length, phase in MEANDERS:
        angle = u * (1.0 / length) + phase
        course += amplitude * np.sin(angle)
        slope += amplitude / length * np.cos(angle)
    return course, slope


def relief(u: AnyArray, v: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Height of the relief above its base, and its gradient.

    Parameters
    ----------
    u, v : array (N,)
        Metres.

    Returns
    -------
    z : array (N,)
        Metres, in the precision of `u`.
    zu, zv : array (N,)
        Slopes along u and v, metres per metre.
    """
    z, zu, zv = np.zeros_like(u), np.zeros_like(u), np.zeros_like(u)
    for amplitude, length, direction, phase in WAVES.tolist():
        k = 2.0 * math.pi / length
        ku, kv = k * math.cos(math.radians(direction)), k * math.sin(math.radians(direction))
        angle = ku * u + kv * v + phase
        sine = amplitude * np.sin(angle)
        z += amplitude * np.cos(angle)
        zu -= ku * sine
        zv -= kv * sine
    for height, u0, v0, sigma in HILLS.tolist():
        du, dv = u - u0, v - v0
        bell = height * np.exp(-(du * du + dv * dv) / (2.0 * sigma**2))
        z += bell
        zu -= bell * du / sigma**2
        zv -= bell * dv / sigma**2
    course, slope = river(u)
    across = v - course
    cut = VALLEY_DEPTH * np.exp(-(across * across) / (2.0 * VALLEY_WIDTH**2))
    z -= cut
    zv += cut * across / VALLEY_WIDTH**2
    zu -= cut * across / VALLEY_WIDTH**2 * slope
    return z, zu, zv


def heights(u: AnyArray, v: AnyArray) -> AnyArray:
    """Height of the relief above its base: `relief` without its derivatives.

    Parameters
    ----------
    u, v : array (N,)
        Metres.

    Returns
    -------
    array (N,)
        Metres, in the precision of `u`.
    """
    z = np.zeros_like(u)
    for amplitude, length, direction, phase in WAVES.tolist():
        k = 2.0 * math.pi / length
        z += amplitude * np.cos(
            k * math.cos(math.radians(direction)) * u + k * math.sin(math.radians(direction)) * v + phase
        )
    for height, u0, v0, sigma in HILLS.tolist():
        z += height * np.exp(((u - u0) ** 2 + (v - v0) ** 2) * (-0.5 / sigma**2))
    across = v - river(u)[0]
    z -= VALLEY_DEPTH * np.exp(across * across * (-0.5 / VALLEY_WIDTH**2))
    return z


@lru_cache(maxsize=1)
def bounds() -> tuple[float, float, float]:
    """Lower and upper bound of the height above the base, and an upper bound of the slope; rigorous, not tight."""
    waves = float(np.abs(WAVES[:, 0]).sum())
    steepest = float((np.abs(WAVES[:, 0]) * 2.0 * np.pi / WAVES[:, 1]).sum())
    meander = sum(abs(a / length) for a, length, _ in MEANDERS)
    steepest += VALLEY_DEPTH * math.exp(-0.5) / VALLEY_WIDTH * math.hypot(1.0, meander)
    # The hills stand apart, so their slopes hardly add up: the largest at nodes, plus what the curvature can add
    # between them (|second derivatives| of a bell are at most H/σ²). Beyond the nodes they have died away.
    node = 20.0
    u, v = (p.ravel() for p in np.meshgrid(*[np.arange(-2500.0, 2500.0, node)] * 2))
    du, dv = np.zeros_like(u), np.zeros_like(u)
    for height, u0, v0, sigma in HILLS.tolist():
        bell = height / sigma**2 * np.exp(-((u - u0) ** 2 + (v - v0) ** 2) / (2.0 * sigma**2))
        du -= bell * (u - u0)
        dv -= bell * (v - v0)
    steepest += float(np.hypot(du, dv).max()) + node / math.sqrt(2.0) * float((HILLS[:, 0] / HILLS[:, 3] ** 2).sum())
    return -waves - VALLEY_DEPTH, waves + float(HILLS[:, 0].sum()), steepest
