"""Samples of all overlaps as arrays of one shape, with the places they have in both images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.radiometry.overlaps import LEAST_CELLS, Overlap
from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray

MOST_SAMPLES = 40_000
"""Of all overlaps together: fields that images share need no more, and time stays bounded."""
Places = Callable[[int, AnyArray], tuple[FloatArray, FloatArray]]
"""Image and cells (N, 2) of the coarse grid → places in the image and on the ground, each (N, 2); see `bases`."""


@dataclass(frozen=True)
class Views:
    """The same ground in pairs of images; P pairs of at most K samples, the rest is padding.

    Attributes
    ----------
    first, second : int array (P,)
    a, b : array (P, K, bands)
        Values, finite.
    known : bool array (P, K)
    image_a, view_a, image_b, view_b : array (P, K, 2)
        Places in each image and on the ground, see `bases`.
    """

    first: IntArray
    second: IntArray
    a: FloatArray
    b: FloatArray
    known: BoolArray
    image_a: FloatArray
    view_a: FloatArray
    image_b: FloatArray
    view_b: FloatArray

    def only(self, known: BoolArray) -> Views:
        """With some of the samples."""
        return replace(self, known=self.known & known)

    def halves(self) -> tuple[BoolArray, BoolArray]:
        """Two halves of the samples, each in four bands that alternate across every overlap."""
        count = np.maximum(self.known.sum(axis=1), 1)[:, None]
        odd = (np.arange(self.known.shape[1]) * 8 // count) % 2 == 1
        return ~odd & self.known, odd & self.known


def gather(overlaps: Sequence[Overlap], places: Places, most: int = MOST_SAMPLES) -> Views | None:
    """Put the samples of all overlaps together; None where there are none with places.

    Places are asked for once per image. An overlap that has more than its part of `most` gives every second, third ...
    sample.
    """
    used = [pair for pair in overlaps if len(pair.a) and pair.cells is not None]
    if not used:
        return None
    each = max(LEAST_CELLS, most // len(used))
    chosen = [np.arange(0, len(pair.a), -(-len(pair.a) // each)) for pair in used]
    shape, bands = (len(used), max(len(own) for own in chosen)), used[0].a.shape[1]
    a, b, known = np.ones((*shape, bands)), np.ones((*shape, bands)), np.zeros(shape, dtype=bool)
    place = np.zeros((4, *shape, 2))
    of_image: dict[int, list[tuple[int, int]]] = {}
    for p, (pair, own) in enumerate(zip(used, chosen, strict=True)):
        a[p, : len(own)], b[p, : len(own)], known[p, : len(own)] = pair.a[own], pair.b[own], True
        of_image.setdefault(pair.first, []).append((p, 0))
        of_image.setdefault(pair.second, []).append((p, 2))
    for image, where in of_image.items():
        cells = np.concatenate([_cells(used[p], chosen[p]) for p, _ in where])
        found = places(image, cells)
        at = 0
        for p, side in where:
            count = len(chosen[p])
            for k in range(2):
                place[side + k, p, :count] = found[k][at : at + count]
            at += count
    known &= np.isfinite(place).all(axis=(0, 3)) & np.isfinite(a).all(axis=2) & np.isfinite(b).all(axis=2)
    place = np.where(known[None, :, :, None], place, 0.0)
    a, b = (np.where(known[..., None], values, 1.0) for values in (a, b))
    first, second = np.array([(pair.first, pair.second) for pair in used], dtype=np.int64).T
    return Views(first, second, a, b, known, place[0], place[1], place[2], place[3])


def _cells(pair: Overlap, chosen: AnyArray) -> AnyArray:
    assert pair.cells is not None  # those without were left out
    return pair.cells[chosen]
