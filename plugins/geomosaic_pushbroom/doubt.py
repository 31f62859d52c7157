"""Which control point is to blame where no flight fits all of them."""

from __future__ import annotations

import numpy as np

from geomosaic.types import FloatArray

CLEARLY = 5.0
"""How many times the misfit of the others a point must be off to be named."""


def odd_one(ground: FloatArray, colrow: FloatArray) -> tuple[int, float, float] | None:
    """The point that the others contradict most, if one stands out.

    From afar a scene is nearly a parallel projection, col and row linear in the ground (with squares of east and north
    where there are points enough). A point's distance from what a fit to all others says follows from the one fit to
    all of them: residual / (1 − h), h being the point's share in its own fitted value (Cook and Weisberg, 1982).

    Parameters
    ----------
    ground : array (N, 3)
        East, north, up in metres.
    colrow : array (N, 2)
        Pixels.

    Returns
    -------
    tuple
        Index, pixels it is off from what the others say, RMS of these; None where none stands out.
    """
    off = (ground - ground.mean(axis=0)) / np.abs(ground - ground.mean(axis=0)).max()
    e, n, u = off.T
    design = np.column_stack([np.ones(len(off)), e, n, u, e * e, e * n, n * n])
    design = design[:, : 7 if len(off) > 9 else 4]
    if len(off) < design.shape[1] + 2:
        return None
    away = np.hypot(*_deleted(design, colrow).T)
    worst = int(np.argmax(away))
    rest = np.arange(len(off)) != worst
    fitted = np.linalg.lstsq(design[rest], colrow[rest], rcond=None)[0]
    rms = float(np.sqrt(((colrow[rest] - design[rest] @ fitted) ** 2).sum(axis=1).mean()))
    return (worst, float(away[worst]), rms) if away[worst] > CLEARLY * max(rms, 1.0) else None


def _deleted(design: FloatArray, colrow: FloatArray) -> FloatArray:
    """Residuals (N, 2) of each point in a fit to all others."""
    basis = np.linalg.svd(design, full_matrices=False)[0]
    share = np.minimum((basis**2).sum(axis=1), 1.0 - 1e-9)
    residuals: FloatArray = (colrow - basis @ (basis.T @ colrow)) / (1.0 - share)[:, None]
    return residuals
