"""Blending weights: ramps across seams and towards image edges; ghosting suppressed where images differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.options.render import CELL
from geomosaic.resample.agreement import View, box_of, compare, deghost, mismatch_of
from geomosaic.types import AnyArray, BoolArray, ByteArray, Float32Array, FloatArray

MAX_REDUCTION = 32
# Cells up to which the distance transform below is used: its work grows with the distance, and its squares must fit in
# 16 bits. Beyond, SciPy's.
_MAX_SEPARABLE = 48


def reduction(feather: float) -> int:
    """Reduction factor of the lattice of weights: a power of two with at least eight cells to a ramp.

    Parameters
    ----------
    feather : float
        Width of the ramp in output pixels.

    Returns
    -------
    int
        Output pixels per cell; 1 for hard seams, at most `MAX_REDUCTION`.
    """
    factor = 1
    while factor * 2 <= min(feather / 8, MAX_REDUCTION):
        factor *= 2
    return factor


def halo(feather: float, factor: int) -> int:
    """Margin of the lattice of weights around a block.

    Parameters
    ----------
    feather : float
        Width of the ramp in output pixels.
    factor : int
        Output pixels per cell.

    Returns
    -------
    int
        Cells beyond the block that its weights depend on.
    """
    # The ramp at a footprint's edge is a whole feather wide, that at a seam half of it to each side.
    return int(np.ceil(feather / factor)) + 2


def image_weight(
    label: AnyArray,
    index: int,
    footprint: BoolArray | None,
    feather: float,
    factor: int,
    distance: AnyArray | None = None,
) -> Float32Array:
    """Blending weight of one image on a reduced lattice.

    Parameters
    ----------
    label : int array (rows, cols)
        Number of the image that the seams choose for each cell.
    index : int
        Number of the image.
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
        distance = signed_distance(own, feather / 2 / factor)
    weight: AnyArray = np.clip(0.5 + distance * factor / feather, 0.0, 1.0)
    if footprint is not None:
        # Not to 0: where no other image has weight, the edge pixels still have a value.
        inside = np.clip(signed_distance(footprint, feather / factor) * factor / feather, 1e-4, 1.0)
        weight = weight * np.where(footprint | own, inside, 0.0)
    return weight.astype(np.float32)


def signed_distance(mask: BoolArray, reach: float) -> AnyArray:
    """Signed distance of cell centres to the edge of a mask.

    Parameters
    ----------
    mask : bool array (rows, cols)
    reach : float
        Distance in cells up to which the result is exact.

    Returns
    -------
    array (rows, cols)
        Cells; positive inside. ± infinity beyond `reach`, and where there is no edge.
    """
    if mask.all():
        return np.full(mask.shape, np.inf)
    if not mask.any():
        return np.full(mask.shape, -np.inf)
    cells = int(np.ceil(reach + 0.5))
    if cells > _MAX_SEPARABLE:
        from scipy.ndimage import distance_transform_edt

        exact: AnyArray = np.where(mask, distance_transform_edt(mask) - 0.5, 0.5 - distance_transform_edt(~mask))
        return np.where(np.abs(exact) > cells - 0.5, np.copysign(np.inf, exact), exact)
    near = _edge_span(mask, 0, cells), _edge_span(mask, 1, cells)
    distance = np.full(mask.shape, np.inf)
    distance[near] = _distance_transform(mask[near], cells) - 0.5
    return np.where(mask, distance, -distance)


def _edge_span(mask: BoolArray, axis: int, cells: int) -> slice:
    """Rows or columns within so many cells of the edge of a mask."""
    touched: BoolArray = np.asarray(mask.any(axis=1 - axis) & ~mask.all(axis=1 - axis))  # of both kinds
    other = np.moveaxis(mask, axis, 0)
    changes = np.asarray((other[1:] != other[:-1]).any(axis=1))  # to the next one
    touched[1:] |= changes
    touched[:-1] |= changes
    at = np.flatnonzero(touched)
    return slice(max(0, int(at[0]) - cells), int(at[-1]) + cells + 1)


def _distance_transform(mask: BoolArray, cells: int) -> AnyArray:
    """Distance of each cell to the nearest one of the other kind, infinite beyond `cells`."""
    # Separable: the distance along rows first, then the least of squares over columns (Saito and Toriwaki, 1994), both
    # no farther than asked for.
    rows, cols = mask.shape
    along = np.full(mask.shape, 4 * cells * cells, dtype=np.uint16)  # _MAX_SEPARABLE keeps sums of two within 16 bits
    for k in range(min(cells, cols - 1), 0, -1):
        differs = mask[:, k:] != mask[:, :-k]
        np.copyto(along[:, k:], k * k, where=differs)
        np.copyto(along[:, :-k], k * k, where=differs)
    least = along.copy()
    for k in range(1, min(cells, rows - 1) + 1):
        farther, differs = along + np.uint16(k * k), mask[k:] != mask[:-k]
        for here, there in ((slice(k, None), slice(None, -k)), (slice(None, -k), slice(k, None))):
            np.minimum(least[here], np.where(differs, np.uint16(k * k), farther[there]), out=least[here])
    roots = np.append(np.sqrt(np.arange(cells * cells + 1, dtype=np.float64)), np.inf)
    distance: AnyArray = roots[np.minimum(least, cells * cells + 1)]
    return distance


def interpolated(nodes: AnyArray, at: AnyArray, axis: int) -> AnyArray:
    """Linear interpolation between nodes along one axis.

    Parameters
    ----------
    nodes : array (rows, cols)
    at : array (N,)
        Positions in node numbers, from 0 to below that of the last node.
    axis : int
        0 or 1.

    Returns
    -------
    array (N, cols) or (rows, N)
    """
    first = at.astype(np.int64)
    shape = [1, 1]
    shape[axis] = len(at)
    part = (at - first).reshape(shape)
    one, two = nodes.take(first, axis=axis), nodes.take(first + 1, axis=axis)
    values: AnyArray = one + (two - one) * part
    return values


@dataclass(frozen=True)
class ImageWeight:
    """Weight of one image in a block, on a lattice of cells of `factor` pixels with `margin` cells around the block.

    Attributes
    ----------
    index : int
        Number of the image.
    weight : float32 array (rows, cols) or None
        None is 1 everywhere.
    factor : int
        Output pixels per cell.
    margin : int
        Cells beyond the block on each side.
    """

    index: int
    weight: AnyArray | None
    factor: int
    margin: int

    def cells(self, shape: tuple[int, int]) -> ByteArray:
        """Cells of 64 × 64 pixels of the block in which the image has weight."""
        assert self.weight is not None
        per = CELL // self.factor
        rows, cols = -(-shape[0] // CELL), -(-shape[1] // CELL)
        # Counts over windows from running sums: a window is a cell and what its pixels interpolate between.
        sums = np.pad(np.cumsum(np.cumsum(self.weight > 0, axis=0), axis=1), ((1, 0), (1, 0)))
        top, left = self.margin - 1 + per * np.arange(rows), self.margin - 1 + per * np.arange(cols)
        stop = np.minimum(top + per + 2, self.weight.shape[0])
        end = np.minimum(left + per + 2, self.weight.shape[1])
        count = sums[stop][:, end] - sums[top][:, end] - sums[stop][:, left] + sums[top][:, left]
        need: ByteArray = (count > 0).astype(np.uint8)
        return need


# A mean level needs no more than every eighth pixel.
_SAMPLE_STEP = 8
# Rounding of floating-point values, relative to their size; and the smallest noise whose square float32 still holds.
_RELATIVE_NOISE, _MIN_NOISE = 1e-4, 1e-12


@dataclass(frozen=True)
class ImageValues:
    """Values of an image in some cells of a block, before blending.

    Attributes
    ----------
    share : ImageWeight
    values : array (rows, cols, bands)
    seen : uint8 array (rows, cols)
        Pixels with a value.
    cells : uint8 array (rows, cols)
        Cells of 64 × 64 pixels that were rendered.
    """

    share: ImageWeight
    values: AnyArray
    seen: ByteArray
    cells: ByteArray

    @property
    def view(self) -> View:
        """What is compared with another image's; its number counts from 1."""
        assert self.share.weight is not None  # as in `Blender._blend`
        return View(self.values, self.seen, self.share.weight, self.share.index + 1)


def suppress_ghosts(shown: Sequence[ImageValues], dtype: str, label: AnyArray, total: AnyArray) -> None:
    """Weighted sums of a block, without the contribution of images that differ from a pixel's main image.

    Images are compared in pairs, from nothing but the block itself. Where they agree the sums stay as they are, to the
    bit.

    Parameters
    ----------
    shown : sequence of ImageValues
    dtype : str
        Sample type of the values.
    label : array (rows, cols)
        Number of the main image from 1, 0 where none.
    total : array (rows, cols, bands)
        Weighted sums, changed in place.
    """
    if len(shown) < 2:
        return
    integers = np.issubdtype(np.dtype(dtype), np.integer)
    levels = [_mean_level(one) for one in shown]
    for at, (one, level) in enumerate(zip(shown, levels, strict=True)):
        for other, other_level in zip(shown[at + 1 :], levels[at + 1 :], strict=True):
            cells = one.cells & other.cells
            if not cells.any():
                continue
            corner, (rows, cols) = box_of(cells)
            moments = np.zeros((5, total.shape[2], rows, cols), dtype=np.float32)
            known = np.zeros((rows, cols), dtype=np.float32)
            compare(one.view, other.view, level, cells, corner, moments, known)
            least = (
                0.5 if integers else max(_RELATIVE_NOISE * max(_magnitude(level), _magnitude(other_level)), _MIN_NOISE)
            )
            mismatch = mismatch_of(moments, known, level, least)
            if mismatch is None:
                continue
            scale = (one.share.factor, one.share.margin)
            deghost(one.view, other.view, scale, cells, corner, mismatch, label, total)


def _magnitude(level: FloatArray) -> float:
    return float(np.abs(level).mean())


def _mean_level(one: ImageValues) -> FloatArray:
    some = one.seen[::_SAMPLE_STEP, ::_SAMPLE_STEP] > 0
    values = one.values[::_SAMPLE_STEP, ::_SAMPLE_STEP][some]
    return values.mean(axis=0, dtype=np.float64) if len(values) else np.zeros(one.values.shape[2])
