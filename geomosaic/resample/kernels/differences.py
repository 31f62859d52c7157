"""Differences of images from a base, and images put together by them; `resample.pyramid` has the twins in NumPy."""

from __future__ import annotations

import numpy as np

from geomosaic.resample.kernels.compiled import kernel


@kernel
def minus(values, ground, both):
    """Differences of an image from a base, bands one after the other.

    Parameters
    ----------
    values, ground : array (rows, cols, bands)
        Of the image and of the base.
    both : bool array (rows, cols)
        Where both are known.

    Returns
    -------
    float32 array (bands, rows, cols)
        0 where they are not.
    """
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
    """Mosaic values of one image's own pixels: blend + value − own difference, rounded.

    Every step is rounded to the exact type, as NumPy does.

    Parameters
    ----------
    values : array (rows, cols, bands)
    own : float32 array (bands, rows, cols)
        Differences of the image from the base; looked at only if `differs`.
    differs : bool
    blend : float32 array (bands, rows, cols)
        Blend of the differences; looked at only if `blends`.
    blends : bool
    label : int array (rows, cols)
        Image that each pixel belongs to.
    index : int
        What `label` calls this image.
    low, high : float
        Range of the output's type.
    whole : bool
        Whether values are rounded, halves up.
    kind : array (1,)
        Holds a number of the exact type: float32 or float64.
    out : array (rows, cols, bands)
        Filled where `label` is `index`.
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
