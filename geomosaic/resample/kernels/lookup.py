"""Values by table: a correction of whole numbers, computed once for each number."""

from __future__ import annotations

from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def lookup(values, table, out):
    """Put table[band, value] of each value (rows, cols, bands) in `out`."""
    rows, cols, bands = values.shape
    for k in range(rows):
        for c in range(cols):
            for m in range(bands):
                out[k, c, m] = table[m, values[k, c, m]]
