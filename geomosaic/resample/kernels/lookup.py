"""Values by table: a correction of whole numbers, computed once for each number."""

from __future__ import annotations

from geomosaic.resample.kernels.compiled import kernel


@kernel
def lookup(values, table, wanted, choose, out, out_valid):
    """Values by table: table[band, value] of each value.

    Band by band within a row: a third of the time of pixel by pixel, since the inner loops are long.

    Parameters
    ----------
    values : array (rows, cols, bands)
        Whole numbers without sign.
    table : array (bands, values)
    wanted : uint8 array (rows, cols)
        Pixels that are wanted, looked at only if `choose`.
    choose : bool
    out : array (rows, cols, bands)
    out_valid : uint8 array (rows, cols)
        Set to 1 where a value is put.
    """
    rows, cols, bands = values.shape
    for k in range(rows):
        line, target, seen = values[k], out[k], out_valid[k]
        pick = wanted[k if choose else 0]
        for m in range(bands):
            becomes = table[m]
            if choose:
                for c in range(cols):
                    if pick[c] != 0:
                        target[c, m] = becomes[line[c, m]]
            else:
                for c in range(cols):
                    target[c, m] = becomes[line[c, m]]
        if choose:
            for c in range(cols):
                if pick[c] != 0:
                    seen[c] = 1
        else:
            seen[:] = 1
