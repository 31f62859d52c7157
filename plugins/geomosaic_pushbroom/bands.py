"""Which look directions hold, where metadata have those of several bands."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from geomosaic.errors import InputError
from geomosaic_pushbroom.look import Look

_SAME = 0.1  # pixels


def choose(looks: Mapping[str, Look], band: str | None, where: str) -> tuple[Look, tuple[str, ...]]:
    """Look directions of the band asked for, or of all where they are the same, and what is to be noted.

    Parameters
    ----------
    looks : mapping of str to Look
        By band, one at least.
    band : str, optional

    Raises
    ------
    InputError
        There is no such band, or the bands look apart by more than a tenth of a pixel and none is named.
    """
    if band is not None:
        if band not in looks:
            raise InputError(
                f"there are no look angles of band {band}", where=where, mend=f"known bands are: {', '.join(looks)}"
            )
        return looks[band], (f"look angles of band {band}",)
    first = next(iter(looks.values()))
    apart = max(_apart(first, look) for look in looks.values())
    if apart > _SAME:
        raise InputError(
            f"the bands look apart by up to {apart:.2f} pixels, and nothing says which one is meant",
            where=where,
            mend=f"give band = {' or '.join(looks)}, and rectify each band by itself",
        )
    return first, ()


def _apart(one: Look, other: Look) -> float:
    """Largest distance in pixels between the directions of two bands."""
    cols = np.linspace(one.cols[0], one.cols[-1], 101)
    pixel = abs(one.across[-1] - one.across[0]) / (one.cols[-1] - one.cols[0])
    pairs = zip(one.slopes(cols), other.slopes(cols), strict=True)
    return float(max(np.nanmax(np.abs(a - b)) for a, b in pairs) / pixel)
