"""Differences of images from a base, and images put together by them; `resample.pyramid` has the twins in NumPy."""

from __future__ import annotations

import numpy as np

from geomosaic.resample.kernels.compiled import kernel


@kernel
def minus(values, ground, both):
    """Values (rows, cols, bands) less the ground's, where `both` are known, else 0: float32 (bands, rows, cols)."""
    rows, cols, bands = values.shape
    out = np.empty((bands, rows, cols), dtype=np.float32)
    for k in range(rows):
        line, below, known = values[k], ground[k], both[k]
        for m in range(bands):
            target = out[m, k]
            for c in range(cols):
                target[c] = np.float32(line[c, m] - below[c, m]) if known[c] else np.float32(0.0)
    return out


@kernel
def join(values, own, differs, blend, blends, label, index, low, high, whole, kind, out):
    """Put blend + value − own difference, rounded, where `label` is `index`; `kind` holds a number of the exact type.

    Every step is rounded to that type, as NumPy does.
    """
    rows, cols, bands = values.shape
    exact = kind.dtype.type
    half = exact(0.5)
    for k in range(rows):
        line, chosen, target = values[k], label[k], out[k]
        for m in range(bands):
            for c in range(cols):
                if chosen[c] != index:
                    continue
                value = exact(line[c, m])
                if blends:
                    value = exact(exact(blend[m, k, c]) + value)
                if differs:
                    value = exact(value - exact(own[m, k, c]))
                if whole:
                    value = min(max(np.floor(value + half), exact(low)), exact(high))
                target[c, m] = value
