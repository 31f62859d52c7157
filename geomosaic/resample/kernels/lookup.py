"""Values by table: a correction of whole numbers, computed once for each number."""

from __future__ import annotations

from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def lookup(values, table, wanted, choose, out, out_valid):
    """Put table[band, value] of each value (rows, cols, bands) in `out`, and 1 in `out_valid`.

    Where `choose` says so, only pixels with `wanted` (rows, cols) other than 0.
    """
    rows, cols, bands = values.shape
    for k in range(rows):
        for c in range(cols):
            if choose and wanted[k, c] == 0:
                continue
            for m in range(bands):
                out[k, c, m] = table[m, values[k, c, m]]
            out_valid[k, c] = 1
