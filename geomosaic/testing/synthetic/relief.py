"""Synthetic relief: hills, a river valley and rolling country, in closed form with its gradient."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from geomosaic.types import AnyArray

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
