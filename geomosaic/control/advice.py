"""What is wrong with the control of an image, before anything is fitted to it."""

from __future__ import annotations

import numpy as np

from geomosaic.control.finding import SEVERITIES, Advice
from geomosaic.control.handed import mirrored
from geomosaic.control.pairs import contradictions
from geomosaic.control.placement import misplaced
from geomosaic.control.points import ImageControl
from geomosaic.control.spread import collinear, coverage, few_points, outside_image


def advise(
    control: ImageControl,
    *,
    kind: str = "affine",
    order: int = 1,
    size: tuple[int, int] | None = None,
    near: tuple[float, float] | None = None,
) -> tuple[Advice, ...]:
    """Examine control; what follows from a greater fault is not said again.

    Parameters
    ----------
    control : ImageControl
        Points that are not enabled are left out. Check points are examined for their coordinates only.
    kind : str
        Fit it is meant for: 'conformal', 'affine', 'projective', 'tps', 'polynomial' (with `order`), 'poly1' ...
    order : int
        Of a polynomial.
    size : tuple of int, optional
        Width and height of the image, pixels; without it nothing is said of edges and corners.
    near : tuple of float, optional
        Longitude and latitude, degrees, near the image: tells zones apart.

    Returns
    -------
    tuple of Advice
        Errors first.

    Raises
    ------
    InputError
        There is no such fit.
    """
    enabled = control.select(control.enabled)
    used = enabled.of_role("control")
    found = few_points(used, kind, order)
    beyond = outside_image(enabled, size) if size else []
    places = misplaced(enabled, near)
    found += beyond + places + contradictions(enabled)
    if not any(advice.severity == "error" for advice in beyond + places if _most(advice, enabled)):
        inside = used.select(
            ~np.isin(np.array(used.names, dtype=object), [n for a in beyond + places for n in a.points])
        )
        line = collinear(inside, kind)
        found += line
        if not line:
            found += mirrored(inside)
            if size and len(inside) > 2:
                found += coverage(inside, size)
    return tuple(sorted(found, key=lambda advice: SEVERITIES.index(advice.severity)))


def _most(advice: Advice, control: ImageControl) -> bool:
    return len(advice.points) > 0.5 * len(control) or advice.code in ("negative-rows", "swapped-columns-rows")
