"""Least squares matching of patches: the place of a template in another image, to a few hundredths of a pixel.

The values of a template about a pixel are those of the other image under an affine transformation, a gain and an offset
(Gruen, Adaptive least squares correlation, 1985; Förstner, 1982). The template's pixels are taken as they are, those of
the other image by cubic convolution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.kernels.library import native
from geomosaic.kernels.threads import bounds, sharing
from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray

_match_patches = native("match_patches", "aaldifdddii")

# Pixels on each side of a template's centre. Smaller ones are ambiguous, larger ones less plane.
HALF = 10
# Rounds; patches that need more are mostly wrong.
ROUNDS = 20
# Standard deviation of the weights over half the side of a patch: its corners are less plane than its middle.
WEIGHT_SIGMA = 0.6


@dataclass(frozen=True, eq=False)
class PatchMatches:
    """Places of templates in another image, N of them.

    Attributes
    ----------
    colrow : array (N, 2)
        Pixels, corner-based; NaN where a template was not found.
    affine : array (N, 2, 2)
        From the template's pixels to those of the other image.
    covariance : array (N, 2, 2)
        Of the places, square pixels.
    correlation : array (N,)
        Weighted correlation of values; NaN where not found.
    """

    colrow: FloatArray
    affine: FloatArray
    covariance: FloatArray
    correlation: FloatArray

    @property
    def found(self) -> BoolArray:
        """Whether each was found (N,)."""
        return np.isfinite(self.correlation)


def match_patches(
    first: AnyArray, second: AnyArray, pixels: IntArray, colrow: FloatArray, affine: FloatArray, farthest: float = 4.0
) -> PatchMatches:
    """Least squares matches of templates.

    Parameters
    ----------
    first, second : array (rows, cols)
        Images of one type.
    pixels : int array (N, 2)
        Column and row, counting from 0, of the pixel of the first image in the middle of each template.
    colrow : array (N, 2)
        Approximate places in the second image, corner-based, good to a few pixels.
    affine : array (N, 2, 2)
        Approximate derivatives of places in the second image by those in the first.
    farthest : float
        Pixels that a match may go from its first approximation.
    """
    count = len(pixels)
    place = np.ascontiguousarray(pixels, dtype=np.int64).reshape(-1, 2)
    warps = np.concatenate([np.reshape(affine, (-1, 4)), np.reshape(colrow, (-1, 2)) - 0.5], axis=1).astype(np.float64)
    covariances, correlations = np.full((count, 3), np.nan), np.full(count, np.nan)
    weights = _patch_weights(HALF)
    with sharing(count > 64) as share:
        share(
            lambda low, high: _match_patches(
                first, second, place, weights, ROUNDS, farthest, warps, covariances, correlations, low, high
            ),
            bounds(0, count),
        )
    lost = np.isnan(correlations)
    warps[lost] = np.nan
    return PatchMatches(
        warps[:, 4:] + 0.5,
        warps[:, :4].reshape(-1, 2, 2),
        covariances[:, [[0, 1], [1, 2]]],
        correlations,
    )


def _patch_weights(half: int) -> FloatArray:
    """Weights (2·half + 1, 2·half + 1) of a patch's pixels."""
    away = np.arange(-half, half + 1) / (half * WEIGHT_SIGMA)
    return np.exp(-0.5 * (away[:, None] ** 2 + away[None, :] ** 2))
