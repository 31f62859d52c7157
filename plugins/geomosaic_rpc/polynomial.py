"""The cubic polynomials of RPC00B and their derivatives.

Terms in the order of the NITF extension RPC00B (STDI-0002, Compendium of Controlled Extensions, table 8-2), with
normalised longitude L, latitude P and height H:

    1, L, P, H, LP, LH, PH, L², P², H², PLH, L³, LP², LH², L²P, P³, PH², L²H, P²H, H³

RPC00A has the same terms in another order.
"""

from __future__ import annotations

import numpy as np

from geomosaic.types import FloatArray

COUNT = 20
_BLOCK = 8192  # points at a time: the terms then stay in the processor's cache


def terms(lph: FloatArray) -> FloatArray:
    """Return the 20 terms (20, N) at normalised ground points (N, 3): longitude, latitude, height."""
    out = np.empty((COUNT, len(lph)))
    L, P, H = lph.T
    out[0] = 1.0
    out[1], out[2], out[3] = L, P, H
    out[4], out[5], out[6] = L * P, L * H, P * H
    out[7], out[8], out[9] = L * L, P * P, H * H
    out[10] = out[4] * H
    out[11], out[12], out[13] = out[7] * L, L * out[8], L * out[9]
    out[14], out[15], out[16] = out[7] * P, out[8] * P, P * out[9]
    out[17], out[18], out[19] = out[7] * H, out[8] * H, out[9] * H
    return out


def slopes(lph: FloatArray) -> FloatArray:
    """Return the derivatives (3, 20, N) of the terms by L, P and H."""
    out = np.zeros((3, COUNT, len(lph)))
    L, P, H = lph.T
    by_l, by_p, by_h = out
    by_l[1], by_l[4], by_l[5], by_l[7], by_l[10] = 1.0, P, H, 2.0 * L, P * H
    by_l[11], by_l[12], by_l[13], by_l[14], by_l[17] = 3.0 * L * L, P * P, H * H, 2.0 * L * P, 2.0 * L * H
    by_p[2], by_p[4], by_p[6], by_p[8], by_p[10] = 1.0, L, H, 2.0 * P, L * H
    by_p[12], by_p[14], by_p[15], by_p[16], by_p[18] = 2.0 * L * P, L * L, 3.0 * P * P, H * H, 2.0 * P * H
    by_h[3], by_h[5], by_h[6], by_h[9], by_h[10] = 1.0, L, P, 2.0 * H, L * P
    by_h[13], by_h[16], by_h[17], by_h[18], by_h[19] = 2.0 * L * H, 2.0 * P * H, L * L, P * P, 3.0 * H * H
    return out


def evaluate(coefficients: FloatArray, lph: FloatArray) -> FloatArray:
    """Values (K, N) of K polynomials (K, 20) at normalised points (N, 3).

    Written out instead of a matrix product: BLAS may round a point differently from one array length to the next.
    """
    out = np.empty((len(coefficients), len(lph)))
    for first in range(0, len(lph), _BLOCK):
        block = slice(first, first + _BLOCK)
        out[:, block] = combine(coefficients, terms(lph[block]))
    return out


def combine(coefficients: FloatArray, each: FloatArray) -> FloatArray:
    """Sums (K, N) of coefficients (K, 20) times terms (20, N), in the order of the terms."""
    out = np.zeros((len(coefficients), each.shape[1]))
    for k in range(COUNT):
        out += coefficients[:, k, None] * each[k]
    return out
