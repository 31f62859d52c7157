"""The kernels in NumPy, the oracle that the compiled ones are held against: the same operations in the same order."""

from __future__ import annotations

import numpy as np

from geomosaic.interpolation import interval
from geomosaic.options.render import CELL
from geomosaic.resample.agreement import PER, SAMPLE, Mismatch, View
from geomosaic.types import AnyArray, BoolArray, ByteArray, Float32Array, FloatArray, IntArray


def lerp(nodes: AnyArray, row: AnyArray, col: AnyArray, v: AnyArray, u: AnyArray) -> AnyArray:
    """Bilinear values from four known nodes: first along the row, then down.

    Parameters
    ----------
    nodes : array (rows, cols, ...)
    row, col : int array
        Of the upper-left node; broadcast together.
    v, u : array
        Parts of the way to the lower and to the right node, 0 to 1.
    """
    upper, lower = nodes[row, col], nodes[row + 1, col]
    upper = upper + (nodes[row, col + 1] - upper) * u
    lower = lower + (nodes[row + 1, col + 1] - lower) * u
    values: AnyArray = upper + (lower - upper) * v
    return values


# --- Weighted means, tables and corrections


def accumulate(
    values: AnyArray,
    valid: AnyArray,
    weight: AnyArray,
    factor: int,
    margin: int,
    index: int,
    cells: AnyArray,
    total: AnyArray,
    sums: AnyArray,
    best: AnyArray,
    label: AnyArray,
) -> None:
    """See `kernels.blend.accumulate`."""
    height, width, _ = values.shape
    v = (np.arange(height) + 0.5) / factor - 0.5 + margin
    u = (np.arange(width) + 0.5) / factor - 0.5 + margin
    j, i = v.astype(np.int64)[:, None], u.astype(np.int64)[None, :]
    fv, fu = (v[:, None] - j).astype(np.float32), (u[None, :] - i).astype(np.float32)
    seen = (valid > 0) & _pixels(cells, valid.shape)
    w = np.where(seen, lerp(weight, j, i, fv, fu), np.float32(0.0)).astype(np.float32)
    seen = w > 0.0
    total[seen] += w[seen][:, None] * values[seen]
    sums[seen] += w[seen]
    better = w > best
    best[better] = w[better]
    label[better] = index


def finish(
    total: AnyArray,
    sums: AnyArray,
    cells: AnyArray,
    low: float,
    high: float,
    whole: bool,
    out: AnyArray,
    out_valid: AnyArray,
) -> None:
    """See `kernels.blend.finish`."""
    seen = (sums > 0.0) & _pixels(cells, sums.shape)
    values = (total[seen] * (np.float32(1.0) / sums[seen])[:, None]).astype(np.float64)
    if whole:
        values = np.clip(np.floor(values + 0.5), low, high)
    out[seen] = values
    out_valid[seen] = 1


def _pixels(cells: AnyArray, shape: tuple[int, int]) -> AnyArray:
    """Whether each pixel lies in a wanted cell of 64 x 64."""
    return np.kron(cells > 0, np.ones((CELL, CELL), dtype=bool))[: shape[0], : shape[1]]


def lookup(
    values: AnyArray, table: AnyArray, wanted: AnyArray, choose: bool, out: AnyArray, out_valid: AnyArray
) -> None:
    """See `kernels.blend.lookup`."""
    here = wanted > 0 if choose else np.ones(out_valid.shape, dtype=bool)
    for band in range(values.shape[2]):
        out[..., band][here] = table[band][values[..., band][here]]
    out_valid[here] = 1


def shade(
    values: AnyArray,
    seen: AnyArray,
    net: FloatArray,
    path: FloatArray,
    haze: FloatArray,
    place: tuple[float, float, float, float],
    dark: FloatArray,
    curve: FloatArray,
    reach: float,
    offset: FloatArray,
    low: float,
    high: float,
    whole: bool,
    out: AnyArray,
    out_valid: AnyArray,
) -> None:
    """See `kernels.blend.shade`."""
    height, width, bands = values.shape
    j, v = interval(place[1] + np.arange(height) * place[3], net.shape[0])
    i, u = interval(place[0] + np.arange(width) * place[2], net.shape[1])
    lines = net[j] + (net[j + 1] - net[j]) * v[:, None, None]
    gain = lines[:, i] + (lines[:, i + 1] - lines[:, i]) * u[None, :, None]
    here = seen > 0
    plain = np.where(here[..., None], values, 0).astype(np.float64) + dark
    if path.size:
        ways = path[j] + (path[j + 1] - path[j]) * v[:, None]
        plain = plain - haze * (ways[:, i] + (ways[:, i + 1] - ways[:, i]) * u[None, :])[..., None]
    steps = curve.shape[1] - 1
    if steps > 0:
        at = np.maximum(plain * (steps / reach), 0.0)
        step = np.minimum(at.astype(np.int64), steps - 1)
        band = np.arange(bands)
        first = curve[band, step]
        plain = first + (curve[band, step + 1] - first) * (at - step)
    exact = gain * plain + offset
    out[here] = np.clip(np.floor(exact[here] + 0.5), low, high) if whole else exact[here]
    out_valid[here] = 1


# --- Pyramids and differences from a base


def reduce(fine: AnyArray) -> AnyArray:
    """See `resample.pyramid.reduce`."""
    return _halved(_halved(fine, 1), 2)


def expand(coarse: AnyArray) -> AnyArray:
    """See `resample.pyramid.expand`."""
    return _doubled(_doubled(coarse, 1), 2)


def minus(values: AnyArray, ground: AnyArray, both: BoolArray) -> AnyArray:
    """See `resample.pyramid.minus`."""
    out = np.zeros((values.shape[2], *both.shape), dtype=np.float32)
    for band in range(len(out)):
        np.subtract(
            values[..., band], ground[..., band], out=out[band], where=both, dtype=ground.dtype, casting="same_kind"
        )
    return out


def join(
    values: AnyArray,
    own: AnyArray | None,
    blend: AnyArray | None,
    label: IntArray,
    index: int,
    limits: tuple[float, float, bool],
    out: AnyArray,
) -> None:
    """See `resample.pyramid.join`."""
    low, high, whole = limits
    mask, kind = label == index, np.result_type(values.dtype, np.float32)
    for band in range(values.shape[2]):
        exact: AnyArray = values[..., band][mask].astype(kind)
        if blend is not None:
            exact = blend[band][mask].astype(kind) + exact
        if own is not None:
            exact = exact - own[band][mask].astype(kind)
        out[..., band][mask] = np.clip(np.floor(exact + kind.type(0.5)), low, high) if whole else exact


def _halved(values: AnyArray, axis: int) -> AnyArray:
    size = values.shape[axis]
    middle = np.arange(0, size, 2)

    def tap(by: int) -> AnyArray:
        return values.take(np.clip(middle + by, 0, size - 1), axis=axis)

    return (
        (tap(-2) + tap(2)) * np.float32(0.0625) + (tap(-1) + tap(1)) * np.float32(0.25) + tap(0) * np.float32(0.375)
    )  # fmt: skip


def _doubled(values: AnyArray, axis: int) -> AnyArray:
    size = values.shape[axis]
    before = values.take(np.maximum(np.arange(size) - 1, 0), axis=axis)
    after = values.take(np.minimum(np.arange(size) + 1, size - 1), axis=axis)
    even = (before + after) * np.float32(0.125) + values * np.float32(0.75)
    odd = (values + after) * np.float32(0.5)
    shape = list(values.shape)
    shape[axis] *= 2
    joined: AnyArray = np.stack([even, odd], axis=axis + 1).reshape(shape)
    return joined


# --- Agreement of two images


def compare(
    first: View,
    second: View,
    level: FloatArray,
    cells: ByteArray,
    corner: tuple[int, int],
    out: Float32Array,
    known: Float32Array,
) -> None:
    """See `resample.agreement.compare`."""
    a, b, seen_a, seen_b = first.values, second.values, first.seen, second.seen
    rows, cols = a.shape[0] // SAMPLE, a.shape[1] // SAMPLE
    wanted = np.kron(cells > 0, np.ones((PER, PER), dtype=bool))[:rows, :cols]
    both = ((seen_a != 0) & (seen_b != 0))[: rows * SAMPLE, : cols * SAMPLE]
    wanted &= both.reshape(rows, SAMPLE, cols, SAMPLE).all(axis=(1, 3))
    r, c = np.nonzero(wanted)
    if not len(r):
        return
    sums = np.zeros((5, len(r), a.shape[2]))
    for down in (0, 2):
        for right in (0, 2):
            one, other = (
                ((v[k, i].astype(np.float64) + v[k, i + 1]) + v[k + 1, i]) + v[k + 1, i + 1]
                for v, k, i in ((v, r * SAMPLE + down, c * SAMPLE + right) for v in (a, b))
            )
            apart, mean = (one - other) * 0.25, (one + other) * 0.125 - level
            for total, part in zip(sums, (apart, mean, apart * apart, apart * mean, mean * mean), strict=True):
                total += part
    out[:, :, r - corner[0], c - corner[1]] = (sums * 0.25).transpose(0, 2, 1)
    known[r - corner[0], c - corner[1]] = 1


def deghost(
    one_view: View,
    other_view: View,
    scale: tuple[int, int],
    cells: ByteArray,
    corner: tuple[int, int],
    mismatch: Mismatch,
    label: AnyArray,
    total: AnyArray,
) -> None:
    """See `resample.agreement.deghost`."""
    (a, seen_a, weight_a, index), (b, seen_b, weight_b, other_index) = one_view, other_view
    factor, margin = scale
    height, width, _ = a.shape
    first = label == index
    here = (first | (label == other_index)) & (seen_a != 0) & (seen_b != 0)
    here &= np.kron(cells > 0, np.ones((CELL, CELL), dtype=bool))[:height, :width]
    k, c = np.nonzero(here)
    (j, fv), (i, fu) = (
        interval((at + 0.5) / SAMPLE - 0.5 - corner[axis], mismatch.share.shape[axis]) for axis, at in enumerate((k, c))
    )
    s = lerp(mismatch.share, j, i, fv, fu)
    w = np.where(first[k, c], _weights(weight_b, k, c, factor, margin), _weights(weight_a, k, c, factor, margin))
    some = (s > 0) & (w > 0)
    k, c, s, w, fv, fu = k[some], c[some], s[some], w[some], fv[some], fu[some]
    j, i = j[some], i[some]
    one = first[k, c]
    for m in range(a.shape[2]):
        x, y = a[k, c, m].astype(np.float64), b[k, c, m].astype(np.float64)
        half = np.where(one, mismatch.slope[m] * 0.5, -mismatch.slope[m] * 0.5)
        own = np.where(one, x, y)
        mean = lerp(mismatch.mean[m], j, i, fv, fu)
        off = (x - y) - (mean + mismatch.slope[m] * (own - mismatch.level[m])) / (1.0 + half)
        total[k, c, m] = total[k, c, m] + (w * s) * np.where(one, off, -off)


def _weights(weight: Float32Array, k: AnyArray, c: AnyArray, factor: int, margin: int) -> FloatArray:
    v, u = (k + 0.5) / factor - 0.5 + margin, (c + 0.5) / factor - 0.5 + margin
    j, i = v.astype(np.int64), u.astype(np.int64)
    fv, fu = (v - j).astype(np.float32), (u - i).astype(np.float32)
    found: FloatArray = lerp(weight, j, i, fv, fu).astype(np.float64)
    return found
