"""Weights across seams: a ramp of given width, from label masks on a reduced lattice."""

from __future__ import annotations

import numpy as np

from geomosaic.types import AnyArray, BoolArray, Float32Array

MOST_REDUCTION = 32


def reduction(feather: float) -> int:
    """How much coarser than the output the weights may be: a power of two, eight steps to a ramp; 1 for hard seams."""
    factor = 1
    while factor * 2 <= min(feather / 8, MOST_REDUCTION):
        factor *= 2
    return factor


def halo(feather: float, factor: int) -> int:
    """Cells beyond a block that its weights depend on: the ramp at a footprint's edge is a whole feather wide."""
    return int(np.ceil(feather / factor)) + 2


def weights(
    label: AnyArray,
    index: int,
    footprint: BoolArray | None,
    feather: float,
    factor: int,
    distance: AnyArray | None = None,
) -> Float32Array:
    """Weight of one image on a reduced lattice.

    Parameters
    ----------
    label : int array (rows, cols)
        Image number that the seams give each cell.
    index : int
        The image.
    footprint : bool array (rows, cols) or None
        Cells that the image shows; None where it shows all, to a feather beyond what matters.
    feather : float
        Width of the transition in output pixels; 0 for a hard seam.
    factor : int
        Output pixels per cell.
    distance : array (rows, cols), optional
        `signed_distance` of the cells labelled `index`, where it is known.

    Returns
    -------
    float32 array (rows, cols)
        0 to 1. Half on the seam, falling to 0 half a feather beyond it; and falling to 0 towards the footprint's own
        edge, so that no image ends in a step. Weights of several images are to be divided by their sum.
    """
    own = label == index
    if feather <= 0:
        hard: Float32Array = own.astype(np.float32)
        return hard
    if distance is None:
        distance = signed_distance(own)
    weight: AnyArray = np.clip(0.5 + distance * factor / feather, 0.0, 1.0)
    if footprint is not None:
        inside = np.clip(signed_distance(footprint) * factor / feather, 1e-4, 1.0)
        weight = weight * np.where(footprint | own, inside, 0.0)
    return weight.astype(np.float32)


def signed_distance(mask: BoolArray) -> AnyArray:
    """Distance of cell centres to the edge of a mask, in cells; positive inside, ± infinity where there is no edge."""
    from scipy.ndimage import distance_transform_edt

    if mask.all():
        return np.full(mask.shape, np.inf)
    if not mask.any():
        return np.full(mask.shape, -np.inf)
    distance: AnyArray = np.where(mask, distance_transform_edt(mask) - 0.5, 0.5 - distance_transform_edt(~mask))
    return distance
